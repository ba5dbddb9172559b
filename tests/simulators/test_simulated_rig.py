"""The rig on real ports: live, faster than life, stepped, and gone without a trace."""

import threading
import time
from pathlib import Path

import numpy as np
import pytest
import serial

from firmware_protocols.decoder import StreamDecoder
from firmware_protocols.layout import load_layout
from firmware_protocols.maestro import GetPosition, SetSpeed, SetTarget, encode
from imu_rig.clock import ScaledClock, SteppedClock, SystemClock
from simulators.config import RigConfig
from simulators.rig import LEAD_S, SimulatedRig

LAYOUT = load_layout("mpu9150-28")
TRANSPORTS = ["pty", "tcp"]


def opened(url: str, timeout: float = 2.0) -> serial.SerialBase:
    return serial.serial_for_url(url, timeout=timeout)


def packets(client: serial.SerialBase, number: int, decoder: StreamDecoder) -> np.ndarray:
    rows = []
    while sum(map(len, rows)) < number:
        data = client.read(28)
        assert data, "the device fell silent"
        rows.append(decoder.feed(data).rows)
    return np.concatenate(rows)


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_a_program_talks_to_both_devices_at_once_in_real_time(transport):
    with SimulatedRig(RigConfig(), clock=SystemClock(), transport=transport) as rig:
        with opened(rig.maestro_url) as maestro, opened(rig.imu_url) as imu:
            maestro.write(encode(SetSpeed(2, 4)) + encode(SetTarget(2, 6000)))
            maestro.write(encode(SetTarget(2, 6400)) + encode(GetPosition(2)))
            first = int.from_bytes(maestro.read(2), "little")
            decoder = StreamDecoder(LAYOUT)
            rows = packets(imu, 40, decoder)
            maestro.write(encode(GetPosition(2)))
            later = int.from_bytes(maestro.read(2), "little")
        assert 6000 <= first < 6020
        assert 6100 < later <= 6400
        assert decoder.stats.corrupt == decoder.stats.lost == 0
        assert np.median(np.linalg.norm(rows["accel"] / 4096, axis=1)) == pytest.approx(1.0, 0.15)
        state = rig.state()
        assert state.moving
        assert 1500.0 < state.pulses_us["roll"] <= 1600.0
        assert rig.dropped == {"imu": 0, "maestro": 0}


def test_the_world_keeps_up_with_a_clock_faster_than_life():
    clock = ScaledClock(8.0)
    with SimulatedRig(RigConfig(), clock=clock) as rig, opened(rig.imu_url) as imu:
        start_ns = clock.now_ns()
        rows = packets(imu, 400, StreamDecoder(LAYOUT))
        passed_s = (clock.now_ns() - start_ns) * 1e-9
    sampled_s = np.diff(rows["time"][[0, -1]].astype(np.int64))[0] * 1e-6
    assert sampled_s == pytest.approx(3.99)
    assert passed_s >= sampled_s - 0.2


def stepped_session(seed: int, transport: str) -> tuple[bytes, bytes]:
    """A short session in steps, through real ports; everything both devices said."""
    said, replied = bytearray(), bytearray()
    rig = SimulatedRig(RigConfig.random(seed), clock=SteppedClock(), transport=transport)
    with rig, opened(rig.imu_url, 0) as imu, opened(rig.maestro_url, 0) as maestro:
        rig.step(0.0)  # a TCP client is let in here
        for step in range(200):
            if step % 60 == 10:
                maestro.write(encode(SetTarget(1, 5700 + 5 * step)) + encode(GetPosition(1)))
            if step == 100:
                rig.fault("imu", "intermittent")
            rig.step(0.02)
            said += imu.read(65536)
            replied += maestro.read(65536)
    return bytes(said), bytes(replied)


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_a_stepped_run_repeats_bit_for_bit(transport):
    said, replied = stepped_session(3, transport)
    assert len(said) > 250 * 28
    assert len(replied) == 4 * 2
    assert stepped_session(3, transport) == (said, replied)
    assert stepped_session(4, transport)[0] != said


def test_a_stepped_rig_has_no_thread_and_moves_only_when_told():
    threads = threading.active_count()
    clock = SteppedClock()
    with SimulatedRig(RigConfig(), clock=clock) as rig:
        assert threading.active_count() == threads
        rig.step(1.5)
        assert clock.now_ns() == 1_500_000_000
        assert rig.state().t_s == pytest.approx(1.5)
        assert rig.lag_s == pytest.approx(0.0, abs=1e-9)
    with (
        SimulatedRig(RigConfig(), clock=SystemClock()) as live,
        pytest.raises(RuntimeError, match="SteppedClock"),
    ):
        live.step(1.0)


def test_a_fast_clock_waits_for_a_world_that_is_too_slow_and_goes_on_without_it(monkeypatch):
    clock = ScaledClock(20.0)
    rig = SimulatedRig(RigConfig(), clock=clock)
    advance = rig.world.advance

    def toil(t_s):
        time.sleep(0.01)
        advance(t_s)

    monkeypatch.setattr(rig.world, "advance", toil)
    with rig:
        end = time.monotonic() + 0.5
        behind = []
        while time.monotonic() < end:
            behind.append(rig.lag_s)
            time.sleep(0.005)
    assert max(behind) <= LEAD_S + 1e-6
    before = clock.now_ns()
    clock.sleep(1.0)
    assert clock.now_ns() - before >= 1_000_000_000


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_unplugging_takes_the_port_and_clearing_brings_it_back_by_name(transport):
    with SimulatedRig(RigConfig(), clock=SystemClock(), transport=transport) as rig:
        name = rig.imu_url
        with opened(name) as imu:
            packets(imu, 5, StreamDecoder(LAYOUT))
            rig.fault("imu", "unplug")
            with pytest.raises(OSError):  # noqa: PT011  (each kind of port has its own text)
                packets(imu, 50, StreamDecoder(LAYOUT))
        with pytest.raises(serial.SerialException):
            opened(name)
        rig.clear("imu")
        assert rig.imu_url == name
        with opened(name) as imu:
            rows = packets(imu, 20, StreamDecoder(LAYOUT))
        # The device ran on meanwhile: its clock is that of the world.
        offset_s = rig.config.firmware.clock_offset_s
        assert rows["time"][-1] * 1e-6 - offset_s == pytest.approx(rig.state().t_s, abs=0.5)


def test_an_unplugging_for_a_time_ends_by_itself():
    with SimulatedRig(RigConfig(), clock=SteppedClock()) as rig:
        name = Path(rig.imu_url)
        rig.fault("imu", "unplug", duration_s=0.5)
        assert not name.is_symlink()
        rig.step(0.4)
        assert not name.is_symlink()
        rig.step(0.2)
        assert name.exists()


def test_a_client_that_stops_reading_stalls_neither_world_nor_the_other_device():
    config = RigConfig.model_validate({"firmware": {"rate_hz": 1000.0}})
    with SimulatedRig(config, clock=SteppedClock()) as rig:
        with opened(rig.imu_url) as imu, opened(rig.maestro_url) as maestro:
            for _ in range(10):
                rig.step(0.5)
            assert rig.dropped["imu"] > 0
            maestro.write(encode(SetTarget(0, 6000)) + encode(GetPosition(0)))
            rig.step(0.01)
            assert maestro.read(2) == (6000).to_bytes(2, "little")
            imu.timeout = 0
            decoder = StreamDecoder(LAYOUT)
            for _ in range(100):
                decoder.feed(imu.read(4096))
                rig.step(0.05)
        assert decoder.stats.good > 2000
        assert decoder.stats.lost > 0


def belongings(folder: Path) -> tuple[set[str], int, list[Path]]:
    names = {thread.name for thread in threading.enumerate()}
    return names, len(list(Path("/proc/self/fd").iterdir())), sorted(folder.rglob("*"))


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="counts descriptors in /proc")
@pytest.mark.parametrize("transport", TRANSPORTS)
def test_stop_leaves_no_thread_descriptor_or_file_and_may_be_called_twice(
    transport, private_temporary_folder
):
    before = belongings(private_temporary_folder)
    rig = SimulatedRig(RigConfig(), clock=SystemClock(), transport=transport)
    rig.start()
    rig.start()
    with opened(rig.imu_url) as imu:
        packets(imu, 3, StreamDecoder(LAYOUT))
        rig.fault("maestro", "unplug")
        rig.stop()
        rig.stop()
    assert belongings(private_temporary_folder) == before
    rig.clear("maestro")
    assert belongings(private_temporary_folder) == before
    with pytest.raises(RuntimeError, match="make a new one"):
        rig.start()


def test_pseudo_terminals_live_in_a_folder_of_the_user_alone():
    with SimulatedRig(RigConfig(), clock=SteppedClock()) as rig:
        for url in rig.ports().values():
            assert Path(url).is_symlink()
            assert Path(url).parent.stat().st_mode & 0o077 == 0


def test_there_are_no_ports_before_the_start():
    rig = SimulatedRig(RigConfig(), clock=SteppedClock())
    with pytest.raises(RuntimeError, match="before its start"):
        _ = rig.imu_url


def test_the_truth_is_that_of_the_configuration_and_cannot_be_written():
    config = RigConfig.random(11)
    truth = SimulatedRig(config, clock=SteppedClock()).truth
    assert truth.accel.K.tolist() == [list(row) for row in config.sensor.accel_gain]
    assert truth.gyro.b.tolist() == list(config.sensor.gyro_offset)
    assert truth.gravity == config.gravity
    with pytest.raises(ValueError, match="read-only"):
        truth.accel.K[0, 0] = 2.0


def test_the_truth_of_a_time_has_the_offsets_of_that_time():
    clock = SteppedClock(5_000_000_000)
    with SimulatedRig(RigConfig.random(11), clock=clock) as rig:
        rig.step(20.0)
        early = rig.truth_between(5_000_000_000, 10_000_000_000)
        late = rig.truth_between(20_000_000_000, 25_000_000_000)
        assert early.gyro.K is rig.truth.gyro.K
        assert (early.gyro.b != late.gyro.b).all()
        assert late.gyro.b == pytest.approx(rig.truth.gyro.b, abs=np.radians(0.1))
        assert late.accel.b == pytest.approx(rig.truth.accel.b, abs=1e-3)


def test_a_servo_on_a_channel_that_is_not_there_is_refused():
    config = RigConfig.model_validate({"maestro": {"channels": 6}})
    jig = config.jig.model_copy(update={"pan": config.jig.pan.model_copy(update={"channel": 7})})
    with pytest.raises(ValueError, match="pan: channel 7 is not on a Maestro with 6 channels"):
        SimulatedRig(config.model_copy(update={"jig": jig}), clock=SteppedClock())


def test_a_failing_world_unplugs_its_ports_rather_than_leave_clients_waiting(monkeypatch):
    caught = []
    monkeypatch.setattr(threading, "excepthook", lambda args: caught.append(args.exc_value))
    with SimulatedRig(RigConfig(), clock=SystemClock()) as rig, opened(rig.imu_url) as imu:
        monkeypatch.setattr(rig.world, "advance", lambda _: 1 / 0)
        with pytest.raises(OSError):  # noqa: PT011
            packets(imu, 1000, StreamDecoder(LAYOUT))
        deadline = time.monotonic() + 5.0
        while not caught and time.monotonic() < deadline:
            time.sleep(0.01)
    assert isinstance(caught[0], ZeroDivisionError)
