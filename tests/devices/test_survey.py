"""Ports without a word about what is there: what is heard, and what is made of it."""

import os
import threading
import time
import tty
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocols.layout import load_layout
from imu_rig.devices import listening, survey
from imu_rig.devices.listening import MOST_BYTES, Heard, baud_matters, listen
from imu_rig.devices.ports import SeenPort
from imu_rig.devices.survey import find_out, judge, stable_names
from imu_rig.devices.usb_names import usb_name
from simulators.device_packets import DevicePackets
from simulators.served_devices import ServedDevices

MPU = load_layout("mpu9150-28")
PACKETS = DevicePackets(MPU, 100.0, 3).make(0, 150)
FOREIGN = DevicePackets(replace(MPU, name="lab", header=b"\xeb\x91"), 100.0, 3).make(0, 150)
NOISE = np.random.default_rng(4).bytes(1200)


def heard(data, baud=115_200, url="/dev/ttyUSB9", **more):
    return Heard(url, baud, data, span_s=1.5, total=len(data), opened=True, **more)


@pytest.mark.parametrize(
    ("data", "state", "words"),
    [
        (PACKETS, "recognized", "speaks mpu9150-28"),
        (FOREIGN, "unknown", "packets of 28 bytes that begin with EB 91"),
        (NOISE, "noise", "baud rate (115200) is wrong"),
        (b"", "silent", "sends nothing"),
        (b"t=1.00 ax=0.1\r\n" * 40, "text", "text ('t=1.00 ax=0.1')"),
        (b"\x1b[0;32mI (312) cpu: up\x1b[0m\r\n" * 9, "text", "text ('I (312) cpu: up')"),
        ("Luft 21.5 °C\r\n".encode() * 9, "text", "text ('Luft 21.5 °C')"),
        (bytes.fromhex("FAFF3100D0"), "known", "Config state"),
        (b"\x00" * 900, "noise", "nothing but the byte 00"),
    ],
)
def test_what_is_heard_is_named(data, state, words):
    finding = judge(heard(data))
    assert finding.state == state
    assert words in finding.says


@settings(max_examples=15)
@given(st.data())
def test_no_damage_breaks_the_judgement(data):
    stream = bytearray(data.draw(st.sampled_from([PACKETS, FOREIGN, b"FA FF\r\n" * 50])))
    places = st.integers(0, len(stream) - 1)
    for place in data.draw(st.lists(places, max_size=30)):
        stream[place] ^= 0x41
    for place in data.draw(st.lists(places, max_size=10)):
        del stream[place : place + data.draw(st.integers(1, 200))]
    finding = judge(heard(bytes(stream)))
    assert finding.says
    assert finding.says.isprintable()


def test_a_device_that_must_be_asked_comes_with_its_layouts():
    assert judge(heard(bytes.fromhex("FAFF3E00C3"))).layouts == ("xsens-mti", "xsens-mti-legacy")
    assert judge(heard(PACKETS)).layouts == ()


def test_rates_are_those_of_every_stream():
    finding = judge(heard(PACKETS))
    assert finding.rates_hz == {"": pytest.approx(100.0)}


def test_text_reaches_nobody_with_its_escapes():
    assert "\x1b" not in judge(heard(b"\x1b[31mred alert\x1b[0m and so on\r\n" * 20)).says


@pytest.mark.parametrize("right", [57_600, 9_600])
def test_noise_is_listened_to_at_other_baud_rates(right):
    tried = []

    def listen_to(url, seconds, baud, **_):
        tried.append(baud)
        return heard(PACKETS if baud == right else NOISE, baud)

    finding = find_out("/dev/ttyUSB9", 1.0, listen_to=listen_to)
    assert (finding.state, finding.heard.baud) == ("recognized", right)
    assert tried[0] == 115_200
    assert tried[-1] == right
    assert len(tried) == len(set(tried))


def test_a_baud_rate_that_was_stated_is_the_only_one():
    tried = []

    def listen_to(url, seconds, baud, **_):
        tried.append(baud)
        return heard(NOISE, baud)

    assert find_out("/dev/ttyUSB9", 1.0, 38_400, listen_to=listen_to).state == "noise"
    assert find_out("/dev/ttyACM0", 1.0, listen_to=listen_to).state == "noise"
    assert tried == [38_400, 115_200]


@pytest.mark.parametrize(
    ("url", "matters"),
    [
        ("/dev/ttyUSB0", True),
        ("COM7", True),
        ("usb:0403:6001:FT1", True),
        ("/dev/ttyACM0", False),
        ("/dev/rfcomm0", False),
        ("socket://localhost:1", False),
        ("/dev/pts/3", False),
    ],
)
def test_baud_rates_belong_to_lines(url, matters):
    assert baud_matters(url) == matters


# --- listening ------------------------------------------------------------------------------------


@contextmanager
def terminal():
    master, slave = os.openpty()
    tty.setraw(slave)
    try:
        yield master, os.ttyname(slave)
    finally:
        for descriptor in (master, slave):
            try:
                os.close(descriptor)
            except OSError:
                continue


def test_a_device_is_heard_at_its_rate():
    with ServedDevices() as served:
        port = served.add("imu", MPU)
        finding = find_out(port, 0.4)
    assert finding.state == "recognized"
    assert finding.heard.rate(len(finding.heard.data) // 28) == pytest.approx(100.0, rel=0.15)


class Paced:
    """A port that had held back ten packets and goes on with one every 10 ms, on its own time."""

    def __init__(self):
        self.now, self.sent = 0.0, 0

    def read(self, timeout_s):
        self.now += 0.01
        self.sent += 1
        return bytes(280 if self.sent == 1 else 28)

    def close(self):
        pass


def test_what_had_come_before_does_not_count_into_the_rate(monkeypatch):
    port = Paced()
    monkeypatch.setattr(listening, "open_port", lambda url, baud: port)
    monkeypatch.setattr(listening, "time", SimpleNamespace(monotonic=lambda: port.now))
    found = listen("/dev/made-up", 0.5)
    assert found.rate(len(found.data) // 28) == pytest.approx(100.0, rel=0.01)


def test_a_flood_is_bounded():
    sent = [0]
    stop = threading.Event()

    def flood(master):
        block = NOISE * 12
        os.set_blocking(master, False)
        while not stop.is_set():
            try:
                sent[0] += os.write(master, block)
            except BlockingIOError:
                time.sleep(0.001)

    with terminal() as (master, name):
        thread = threading.Thread(target=flood, args=(master,))
        thread.start()
        try:
            found = listen(name, 0.25)
        finally:
            stop.set()
            thread.join()
    assert len(found.data) == min(MOST_BYTES, found.total)
    assert found.total <= sent[0]
    assert found.total > 10_000
    assert judge(found).state == "noise"


def test_a_port_that_vanishes_keeps_what_it_said(monkeypatch):
    with ServedDevices() as served:
        port = served.add("imu", MPU)
        timer = threading.Timer(0.25, served.unplug, ["imu"])
        timer.start()
        found = listen(port, 5.0)
        timer.join()
    assert "has gone" in found.error
    assert judge(found).state == "recognized"


@pytest.mark.parametrize("url", ["/no/such/port", "/etc/passwd", "usb:NOBODY", "\x00", "socket://"])
def test_what_cannot_be_opened_says_why(url):
    finding = find_out(url, 0.2)
    assert finding.state == "closed"
    assert finding.says.endswith(".")
    assert finding.heard.data == b""


def test_pauses_are_where_something_came_after_silence():
    with terminal() as (master, name):

        def speak():
            for _ in range(8):
                os.write(master, b"12345")
                time.sleep(0.03)

        thread = threading.Thread(target=speak)
        thread.start()
        found = listen(name, 0.3)
        thread.join()
    assert found.pauses
    assert all(place % 5 == 0 for place in found.pauses)


def test_listening_can_be_ended():
    stop = threading.Event()
    stop.set()
    with terminal() as (_, name):
        begin = time.monotonic()
        assert listen(name, 30.0, stop=stop).data == b""
    assert time.monotonic() - begin < 5.0


# --- names ----------------------------------------------------------------------------------------


def test_stable_names_are_those_of_links_that_lead_somewhere(tmp_path):
    port = tmp_path / "ttyUSB0"
    port.touch()
    folder = tmp_path / "by-id"
    folder.mkdir()
    (folder / "usb-FTDI-if00-port0").symlink_to(port)
    (folder / "gone").symlink_to(tmp_path / "nothing")
    (folder / "loop").symlink_to(folder / "loop")
    assert stable_names(folder) == {str(port): str(folder / "usb-FTDI-if00-port0")}
    assert stable_names(tmp_path / "none") == {}


@pytest.mark.parametrize(
    ("vendor", "product", "stable", "location", "name"),
    [
        (0x1FFB, 0x008A, "/x/usb-Pololu_42-if00", None, "Mini Maestro 12, command port"),
        (0x1FFB, 0x008A, "/x/usb-Pololu_42-if02", None, "Mini Maestro 12, TTL port"),
        (0x1FFB, 0x0089, None, "1-2:1.0", "Micro Maestro 6, command port"),
        (0x1FFB, 0x1234, None, None, "Maestro"),
        (0x0403, 0x6015, None, None, "FTDI adapter"),
        (0x10C4, 0xEA60, None, None, "CP210x adapter"),
        (0x9999, 0x0001, None, None, ""),
        (None, None, None, None, ""),
    ],
)
def test_ports_are_named_by_their_usb_numbers(vendor, product, stable, location, name):
    port = SeenPort("/dev/ttyACM0", "", vendor, product, "42", location)
    assert usb_name(port, stable) == name


def test_all_ports_are_looked_at_at_once(monkeypatch):
    monkeypatch.setattr(
        survey,
        "seen_ports",
        lambda: [SeenPort("/dev/ttyS99", "\x1b[2Jnasty", None, None, None)],
    )
    with ServedDevices() as served:
        urls = [served.add(f"imu {n}", MPU, seed=n) for n in range(4)]
        urls.append(served.add_servos())
        found = survey.survey([*urls, urls[0]], seconds=0.3, probe=True)
    assert [one.port.url for one in found] == ["/dev/ttyS99", *urls]
    states = [one.finding.state for one in found]
    assert states == ["closed", *["recognized"] * 4, "known"]
    assert "Maestro" in found[-1].finding.says
    assert not found[0].may_open


def test_only_what_may_be_a_maestro_is_asked(monkeypatch):
    asked = []
    ports = [
        SeenPort("/dev/command", "", 0x1FFB, 0x0089, "1", "1-2:1.0"),
        SeenPort("/dev/ttl", "", 0x1FFB, 0x0089, "1", "1-2:1.2"),
        SeenPort("/dev/adapter", "", 0x0403, 0x6001, "2", "1-3:1.0"),
        SeenPort("/dev/old", "", None, None, None),
    ]
    monkeypatch.setattr(survey, "seen_ports", lambda: ports)
    monkeypatch.setattr(survey, "find_out", lambda url, *_, **__: judge(heard(b"", url=url)))
    monkeypatch.setattr(
        survey, "_ask_maestro", lambda finding: asked.append(finding.heard.url) or finding
    )
    survey.survey(probe=False)
    assert asked == []
    survey.survey(probe=True)
    assert sorted(asked) == ["/dev/command", "/dev/old"]


def test_a_port_under_two_names_is_opened_once(tmp_path, monkeypatch):
    monkeypatch.setattr(survey, "seen_ports", list)
    with terminal() as (_, name):
        link = tmp_path / "by-id"
        link.symlink_to(name)
        found = survey.survey([name, str(link), name], seconds=0.1)
    assert [(one.port.url, one.finding.state) for one in found] == [(name, "silent")]


def test_a_list_opens_nothing(monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("a port was opened")

    monkeypatch.setattr(listening, "open_port", refuse)
    (found,) = (s for s in survey.survey(["/dev/ttyS98"], seconds=None) if "98" in s.port.url)
    assert found.finding.state == "listed"
    assert not found.may_open
