"""Devices that must be spoken to: set up before they are read, kept going, recorded both ways."""

import os
import threading
import tty
from contextlib import contextmanager

import pytest

import imu_rig.devices.stream_device as stream_device
from firmware_protocols.layout import load_layout
from firmware_protocols.packets import encode
from imu_rig.clock import SystemClock
from imu_rig.devices.imu import ImuDevice
from imu_rig.devices.ports import open_port
from imu_rig.errors import DeviceError, DeviceLost

MPU = load_layout("mpu9150-28")
PATIENCE_S = 20.0
PACKET = encode(
    MPU, {"seq": 0, "status": 0, "time": 0, "accel": [1, 2, 3], "gyro": [4, 5, 6], "mag": [7, 8, 9]}
)


@contextmanager
def port():
    """A pseudo-terminal: the device's end and the name of the host's."""
    device, host = os.openpty()
    tty.setraw(host)
    try:
        yield device, os.ttyname(host)
    finally:
        os.close(device)
        os.close(host)


class Asking:
    """Sends a question, wants the answer "yes", says "on" every second."""

    answered = b""
    problem = None

    def begin(self, write, hear):
        write(b"well?")
        self.answered = hear(2.0)
        if not self.answered.startswith(b"yes"):
            raise DeviceError(f"it says {self.answered!r}, switch it to yes")

    def heard(self, data):
        self.problem = "refuses" if b"no" in data else self.problem

    def keep(self, write):
        write(b"on")


@pytest.fixture
def asking(monkeypatch):
    made = []

    def make(protocol):
        made.append(Asking())
        return made[-1]

    monkeypatch.setattr(stream_device, "conversation_for", make)
    return made


def device(url, heard, sent):
    return ImuDevice(
        "foot",
        url,
        MPU,
        SystemClock(),
        tap=lambda t_ns, data: heard.append(data),
        sent=lambda t_ns, data: sent.append(data),
    )


def answer(file, data):
    """Wait for the question and answer it, in a thread of its own."""

    def run():
        assert os.read(file, 100) == b"well?"
        os.write(file, data)

    thread = threading.Thread(target=run)
    thread.start()
    return thread


def test_what_is_said_and_heard_is_recorded_and_decoded(asking):
    heard, sent = [], []
    with port() as (file, url):
        imu = device(url, heard, sent)
        thread = answer(file, b"yes" + PACKET)
        imu.start()
        thread.join()
        kept = os.read(file, 100)
        imu.stop()
    assert kept == b"on"
    assert sent[:2] == [b"well?", b"on"]
    assert b"".join(heard) == b"yes" + PACKET
    assert len(imu.poll()) == 1
    assert imu.health.skipped_bytes == len(b"yes")


def test_a_refusal_names_device_and_port_and_leaves_the_port_free(asking):
    with port() as (file, url):
        imu = device(url, [], [])
        for _ in range(2):  # the second would find the port busy if it were not closed
            thread = answer(file, b"perhaps")
            with pytest.raises(DeviceError, match=f"foot on {url}: it says b'perhaps', switch"):
                imu.start()
            thread.join()
        assert not imu.running
        thread = answer(file, b"perhaps")
        with pytest.raises(DeviceLost, match=r"foot is not back: .*switch"):
            imu.reopen()
        thread.join()


def test_every_opening_begins_a_new_conversation(asking):
    with port() as (file, url):
        imu = device(url, [], [])
        for _ in range(2):
            thread = answer(file, b"yes")
            imu.reopen()
            thread.join()
        imu.stop()
    assert [each.answered for each in asking] == [b"yes", b"yes"]


def test_what_the_conversation_knows_explains_why_nothing_comes(asking):
    with port() as (file, url):
        imu = device(url, [], [])
        thread = answer(file, b"yes, but no")
        imu.start()
        thread.join()
        assert imu.identify_problem() == f"foot on {url} refuses."
        imu.stop()


class Waiting(Asking):
    """Waits for an answer for as long as it takes."""

    def begin(self, write, hear):
        write(b"well?")
        while not self.answered:
            self.answered = hear(60.0)


@pytest.mark.parametrize("again", [False, True])
def test_stopped_while_it_is_set_up_it_gives_up_and_leaves_the_port_free(monkeypatch, again):
    made = [Waiting(), Waiting()]
    made[0].answered = b"yes" if again else b""
    monkeypatch.setattr(stream_device, "conversation_for", lambda protocol: made.pop(0))
    with port() as (file, url):
        imu = device(url, [], [])
        if again:
            imu.start()
            assert os.read(file, 100) == b"well?"
            imu.stop()
        refused = []

        def start():
            try:
                imu.start()
            except DeviceError as error:
                refused.append(str(error))

        thread = threading.Thread(target=start)
        thread.start()
        assert os.read(file, 100) == b"well?"
        imu.stop()
        assert not imu.running
        open_port(url).close()  # it is free by now
        thread.join(PATIENCE_S)
        assert refused == [f"foot on {url}: was stopped while it was being set up."]
        made.append(Asking())
        thread = answer(file, b"yes")
        imu.start()  # it can be started again
        thread.join()
        assert imu.running
        imu.stop()


def test_stopped_by_the_tap_while_it_is_set_up_it_does_not_wait_for_itself(asking):
    with port() as (file, url):
        imu = ImuDevice("foot", url, MPU, SystemClock(), tap=lambda t_ns, data: imu.stop())
        thread = answer(file, b"yes")
        with pytest.raises(DeviceError, match="stopped while it was being set up"):
            imu.start()
        thread.join()
        assert not imu.running


def test_stopped_at_the_end_of_the_setting_up_no_thread_begins_to_read(monkeypatch):
    class Silent(Asking):
        def begin(self, write, hear):
            imu.stop()

    monkeypatch.setattr(stream_device, "conversation_for", lambda protocol: Silent())
    with port() as (_, url):
        imu = device(url, [], [])
        with pytest.raises(DeviceError, match="stopped while it was being set up"):
            imu.start()
        assert not imu.running
