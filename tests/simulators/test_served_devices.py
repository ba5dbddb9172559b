"""Served devices send what they say they sent, whatever is done to them."""

import time
from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np
import pytest
import serial

from firmware_protocols.decoder import StreamDecoder
from firmware_protocols.known import load_protocol
from firmware_protocols.layout import PacketLayout, load_layout
from firmware_protocols.maestro import GetPosition, SetTarget, encode
from firmware_protocols.packets import counts, values
from imu_rig.clock import ScaledClock
from simulators.device_packets import DevicePackets
from simulators.served_devices import ServedDevices

IMU = load_layout("mpu9150-28")
BARO = load_layout("baro-16")
PATIENCE_S = 5.0
DEG = np.pi / 180


@pytest.fixture
def transport() -> str:
    return "pty"


@pytest.fixture
def devices(transport) -> Iterator[ServedDevices]:
    with ServedDevices(transport=transport) as served:
        yield served


both_transports = pytest.mark.parametrize("transport", ["pty", "tcp"])


class Listener:
    """Reads a port and decodes what comes, from the first packet on.

    Whoever opens a serial port throws away what came before; so the device is silent till then.
    """

    def __init__(self, devices: ServedDevices, name: str, url: str, layout: PacketLayout) -> None:
        self.layout = layout
        self.decoder = StreamDecoder(layout)
        self.rows = np.empty(0, layout.dtype)
        devices.silence(name, True)
        self.port = serial.serial_for_url(url, timeout=0.02)
        devices.silence(name, False)

    def __enter__(self) -> "Listener":
        return self

    def __exit__(self, *_: object) -> None:
        self.port.close()

    def until(self, condition: Callable[[], object]) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline, "did not happen in time"
            new = self.decoder.feed(self.port.read(4096)).rows
            self.rows = np.concatenate((self.rows, new))

    def hear(self, number: int) -> None:
        self.until(lambda: len(self.rows) >= number)


def decoded(layout: PacketLayout, data: bytes) -> np.ndarray:
    return StreamDecoder(layout).feed(data).rows


@both_transports
def test_everything_sent_arrives_and_is_counted(devices):
    url = devices.add("left shoe", IMU, 400.0)
    with Listener(devices, "left shoe", url, IMU) as client:
        client.hear(40)
        devices.silence("left shoe")
        client.until(lambda: len(client.rows) == devices.sent("left shoe"))
        assert client.decoder.stats.lost == client.decoder.stats.corrupt == 0
        ((first, last),) = devices.counters("left shoe")
        assert last - first + 1 == len(client.rows)
        seq = counts(IMU, client.rows, "seq")
        assert (seq[0], seq[-1]) == (first % 256, last % 256)
    assert devices.dropped("left shoe") == 0


def test_nobody_connected_is_nothing_sent(devices):
    devices.add("shoe", IMU, 400.0)
    time.sleep(0.05)
    assert devices.sent("shoe") == 0
    assert devices.counters("shoe") == []


@both_transports
def test_an_unplugged_device_counts_on_and_comes_back_under_the_same_name(devices):
    url = devices.add("shoe", IMU, 400.0)
    with Listener(devices, "shoe", url, IMU) as client:
        client.hear(10)
        devices.unplug("shoe")
        with pytest.raises(OSError):  # noqa: PT011  (each kind of port has its own text)
            client.until(lambda: False)
    with pytest.raises(serial.SerialException):
        serial.serial_for_url(url, timeout=0.02)
    time.sleep(0.1)
    devices.plug("shoe")
    with Listener(devices, "shoe", url, IMU) as client:
        client.hear(10)
        runs = devices.counters("shoe")
        assert len(runs) == 2
        assert runs[1][0] - runs[0][1] > 20  # at least half of 0.1 s at 400 Hz were missed
        assert counts(IMU, client.rows[:1], "seq")[0] == runs[1][0] % 256


def test_a_silent_device_keeps_its_port_and_counts_on(devices):
    url = devices.add("shoe", IMU, 400.0)
    with Listener(devices, "shoe", url, IMU) as client:
        client.hear(10)
        devices.silence("shoe", True)
        time.sleep(0.1)
        client.until(lambda: len(client.rows) == devices.sent("shoe"))
        before = len(client.rows)
        devices.silence("shoe", False)
        client.hear(before + 10)
        (_, last), (first, _) = devices.counters("shoe")
        assert client.decoder.stats.lost == first - last - 1 > 20


def test_garbage_holds_no_packets_and_ends(devices):
    url = devices.add("shoe", IMU, 400.0)
    devices.garbage("shoe", True)
    with Listener(devices, "shoe", url, IMU) as client:
        client.until(lambda: client.decoder.stats.skipped_bytes > 1000)
        assert len(client.rows) == devices.sent("shoe") == 0
        devices.garbage("shoe", False)
        client.hear(10)


def test_a_restarted_device_begins_at_zero(devices):
    url = devices.add("baro", BARO, 200.0)
    with Listener(devices, "baro", url, BARO) as client:
        client.hear(10)
        devices.restart("baro")
        client.hear(30)
        seq = counts(BARO, client.rows, "seq")
        clock_s = counts(BARO, client.rows, "time") * 1e-6
        start = int(np.flatnonzero(np.diff(seq) < 0)[0]) + 1
        assert clock_s[start] == pytest.approx((seq[start] + 1) / 200.0, abs=1e-6)
        assert [first for first, _ in devices.counters("baro")][1] == seq[start]


def test_bursts_hold_packets_back_and_lose_none(devices):
    url = devices.add("shoe", IMU, 400.0, burst_s=0.1)
    arrivals = []
    with Listener(devices, "shoe", url, IMU) as client:

        def arrived() -> bool:
            if not arrivals or arrivals[-1] != len(client.rows):
                arrivals.append(len(client.rows))
            return len(client.rows) > 200

        client.until(arrived)
        assert client.decoder.stats.lost == 0
        assert max(b - a for a, b in pairwise(arrivals)) >= 16  # 40 ms of packets at once


def test_a_scaled_clock_makes_packets_in_its_time():
    clock = ScaledClock(20.0)
    with ServedDevices(clock) as devices:
        start_ns = clock.now_ns()
        url = devices.add("baro", BARO)
        with Listener(devices, "baro", url, BARO) as client:
            client.hear(200)
            made = devices.counters("baro")[0][1] + 1
            assert made <= (clock.now_ns() - start_ns) / 1e9 * 50 + 1
            assert client.decoder.stats.lost == 0


def test_the_clock_runs_fast_by_its_skew():
    clock = ScaledClock(1.0)
    with ServedDevices(clock) as devices:
        usual, fast = (devices.add(n, IMU, 400.0, skew_ppm=s) for n, s in (("a", 0), ("b", 2e5)))
        with (
            Listener(devices, "a", usual, IMU) as first,
            Listener(devices, "b", fast, IMU) as second,
        ):
            first.hear(200)
            second.hear(20)
            made = {n: devices.counters(n)[-1][1] for n in ("a", "b")}
    assert made["b"] / made["a"] == pytest.approx(1.2, rel=0.08)


def test_counter_and_clock_wrap_with_their_types():
    packets = DevicePackets(IMU, 400.0, seed=3)
    rows = decoded(IMU, packets.make(2_000_000, 3) + packets.make(2_000_003, 2))
    assert counts(IMU, rows, "seq").tolist() == [(2_000_000 + k) % 256 for k in range(5)]
    ticks = counts(IMU, rows, "time")
    assert np.allclose(np.diff(ticks) % 2**32, 2500, atol=1)
    packets.reset_clock()
    rows = decoded(IMU, packets.make(2_000_000, 1))
    assert counts(IMU, rows, "time")[0] == (2_000_001 * 2500) % 2**32


def test_rate_and_field_belong_to_one_motion():
    rows = decoded(IMU, DevicePackets(IMU, 200.0, seed=5).make(0, 1600))
    gyro = values(IMU, rows, "gyro") * DEG
    mag = values(IMU, rows, "mag")
    turning = (mag[2:] - mag[:-2]) / 0.01
    kernel = np.ones(20) / 20  # the noise of single samples does not matter
    calm = [
        np.stack([np.convolve(v[:, k], kernel, "valid") for k in range(3)], 1)
        for v in (turning, -np.cross(gyro, mag)[1:-1])
    ]
    assert np.std(calm[0] - calm[1]) < 0.06 * np.std(calm[0])


def test_gravity_is_felt_and_everything_moves():
    rows = decoded(IMU, DevicePackets(IMU, 200.0, seed=5).make(0, 1600))
    accel = values(IMU, rows, "accel")
    assert np.linalg.norm(accel, axis=1).mean() == pytest.approx(1.0, abs=0.1)
    assert (np.ptp(accel, axis=0) > 0.1).all()
    assert (np.abs(values(IMU, rows, "gyro")).max(axis=0) < 1000).all()
    assert not np.array_equal(
        rows["accel"], decoded(IMU, DevicePackets(IMU, 200.0, 6).make(0, 1600))
    )


def test_a_barometer_tells_of_air_and_of_its_battery():
    packets = DevicePackets(BARO, 50.0, seed=1)
    first, later = (decoded(BARO, packets.make(k, 400)) for k in (0, 4 * 3600 * 50))
    assert np.abs(values(BARO, first, "pressure") - 101_325).max() < 100
    assert 20 < values(BARO, first, "temperature").mean() < 40
    assert values(BARO, first, "battery")[0] - values(BARO, later, "battery")[0] > 20


@pytest.mark.parametrize(
    ("protocol", "stream", "volts"), [("adis16405-36", "", 5.0), ("waist-unit", "accel", 3.3)]
)
def test_boards_are_fed_what_their_chips_run_on(protocol, stream, volts):
    layout = load_protocol(protocol).streams[stream]
    rows = decoded(layout, DevicePackets(layout, 100.0, seed=1).make(3_600_000, 200))
    unit = {"V": 1.0, "mV": 1e-3}[layout.field("supply").unit]
    assert unit * values(layout, rows, "supply") == pytest.approx(volts, abs=0.01)


def test_a_layout_without_a_rate_needs_one():
    layout = PacketLayout(
        name="own", title="", byte_order="little", header=b"\x01", fields=IMU.fields
    )
    with ServedDevices() as devices, pytest.raises(ValueError, match="rate"):
        devices.add("own", layout)


def test_servos_obey_and_come_back(devices):
    url = devices.add_servos("jig")
    assert devices.add("shoe", IMU) != url
    with serial.serial_for_url(url, timeout=PATIENCE_S) as client:
        client.write(encode(SetTarget(0, 6000)) + encode(GetPosition(0)))
        assert client.read(2) == (6000).to_bytes(2, "little")
    devices.unplug("jig")
    with pytest.raises(serial.SerialException):
        serial.serial_for_url(url, timeout=0.02)
    devices.plug("jig")
    with serial.serial_for_url(url, timeout=PATIENCE_S) as client:
        client.write(encode(GetPosition(0)))
        assert client.read(2) == (6000).to_bytes(2, "little")


def test_a_name_is_given_once():
    with ServedDevices() as devices:
        devices.add("shoe", IMU)
        with pytest.raises(ValueError, match="shoe"):
            devices.add_servos("shoe")
