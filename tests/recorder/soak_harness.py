"""A day of recording in a few minutes: does memory, a descriptor, a thread or the time run away?

``python tests/recorder/soak_harness.py --hours 24`` prints a line per simulated hour and the
figures, and ends with 1 if one of them is missed. The recorder's own parts run on a clock that is
moved from one arrival to the next: readers with their threads, keepers, decoders, clock fits and
the writer of the file. The devices' clocks are off by tens of ppm and wander over hours, their
packets come in late pieces, and now and then one is unplugged for a while.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from unittest import mock

import numpy as np

from firmware_protocols.layout import PacketLayout, load_layout
from imu_rig.arrays import FloatArray
from imu_rig.clock import NS_PER_S, SteppedClock
from imu_rig.devices import stream_device
from imu_rig.devices.ports import Port
from imu_rig.devices.stream_device import PacketDevice
from imu_rig.errors import DeviceLost, PortMissing
from imu_rig.packet_stream import PacketBlock
from imu_rig.recorder.keeper import STATISTICS_S, DeviceKeeper
from imu_rig.recorder.setup import DeviceSetup
from imu_rig.recording import RecordingOptions, TrialWriter
from simulators.device_packets import DevicePackets

HOUR_S = 3600.0
PIECE_S = 0.5  # of packets that arrive together
LOOK_S = 2.0  # between the keepers' looks; a real one looks more often, with the same work in all
DELAY_S = 0.002  # at least, on the way
LATE_S = 0.003  # more on average, and exponentially
WANDER = 1e-6  # of a device's skew, up and down
WANDER_HOURS = 5.0
MADE_S = 60.0  # of packets made at once
ABSENCE_S = 20.0
WARM_HOURS = 2.0  # until which memory may grow
MOST_QUEUED = 1 << 20
START_S = 5000.0  # of the host's clock

MOST_GROWTH_MB = 5.0
MOST_DRIFT_MS = 1.0


class _RunningClock(SteppedClock):
    """A stepped clock on which waits of the machine's time are as good as none."""

    speed = 1e6


class FakePort(Port):
    """A port that hands out what it is given, and whoever gives knows when it was dealt with."""

    def __init__(self, url: str) -> None:
        super().__init__(url)
        self._changed = threading.Condition()
        self._data = b""
        self._idle = False
        self._gone = False

    def give(self, data: bytes) -> None:
        """Hand over bytes and wait until the reader comes for more."""
        with self._changed:
            self._changed.wait_for(lambda: self._idle)
            self._data, self._idle = data, False
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._idle)

    def vanish(self) -> None:
        """Be unplugged under the reader's feet."""
        with self._changed:
            self._gone = True
            self._changed.notify_all()

    def _read(self, timeout_s: float) -> bytes:
        with self._changed:
            self._idle = True
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._data or self._gone, timeout_s)
            if self._gone:
                raise DeviceLost(f"{self.url} was unplugged.")
            data, self._data = self._data, b""
            return data

    def _write(self, data: bytes) -> None:
        raise AssertionError("nobody writes to a sensor that only sends")

    def _close(self) -> None:
        pass


@dataclass
class Truth:
    """What a device's clock shows and when it really is."""

    layout: PacketLayout
    rate_hz: float
    skew: float
    seed: int

    def host_s(self, made_s: FloatArray) -> FloatArray:
        """Host time at which the device believes ``made_s`` since its start."""
        period = WANDER_HOURS * HOUR_S / (2 * math.pi)
        wander = WANDER * period * (np.cos(made_s / period + self.seed) - math.cos(self.seed))
        host: FloatArray = START_S + made_s / (1.0 + self.skew) + wander
        return host


class MeasuredDevice(PacketDevice):
    """Keeps account of how far its times are from the truth."""

    truth: Truth

    def begin(self, truth: Truth) -> None:
        self.truth = truth
        self.errors: list[float] = []  # mean of each hour [s]
        self.worst_s = 0.0
        self._sum = self._count = 0.0

    def poll(self) -> dict[str, PacketBlock]:
        blocks = super().poll()
        block = blocks[""]
        if len(block) and block.counter is not None:
            truth = self.truth.host_s((block.counter + 1) / self.truth.rate_hz)
            error = block.t - truth - DELAY_S
            self._sum += float(error.sum())
            self._count += len(error)
            if block.t[0] > START_S + 600.0:  # when the fit has its first ten minutes
                self.worst_s = max(self.worst_s, float(np.abs(error).max()))
        return blocks

    def end_hour(self) -> None:
        self.errors.append(self._sum / max(1.0, self._count))
        self._sum = self._count = 0.0


@dataclass
class SimulatedDevice:
    """One device with its recorder's parts, and where it is in its own time."""

    truth: Truth
    device: MeasuredDevice
    keeper: DeviceKeeper
    rng: np.random.Generator
    port: FakePort | None = None
    away_until_s: float = 0.0
    arrived_s: float = 0.0
    sent_bytes: int = 0
    pieces: int = 0


@dataclass
class SoakFigures:
    """What a long recording did."""

    hours: float = 0.0
    machine_s: float = 0.0
    packets: int = 0
    unplugged: int = 0
    lost_records: int = 0
    growth_mb: float = 0.0
    rss_mb: float = 0.0
    descriptors: tuple[int, int] = (0, 0)
    threads: tuple[int, int] = (0, 0)
    worst_drift_ms_per_h: float = 0.0
    worst_error_ms: float = 0.0
    file_mb: float = 0.0
    wire_mb: float = 0.0
    problems: list[str] = field(default_factory=list)


class _Day:
    """The simulated devices and everything that records them, moved on step by step."""

    def __init__(self, folder: Path, rate_hz: float, unplugs_per_hour: float) -> None:
        self.clock = _RunningClock(int(START_S * NS_PER_S))
        self.trial = TrialWriter.create(
            folder / "day.imu-trial",
            {"kind": "trial"},
            clock=self.clock,
            options=RecordingOptions(note_s=0.05),
        )
        self.unplugged = 0
        self._unplug_s = HOUR_S / unplugs_per_hour if unplugs_per_hour else math.inf
        self._next_unplug_s = START_S + self._unplug_s / 2
        imu, baro = load_layout("mpu9150-28"), load_layout("baro-16")
        truths = [
            Truth(imu, rate_hz, 50e-6, 1),
            Truth(imu, rate_hz, -35e-6, 2),
            Truth(baro, rate_hz / 2, 20e-6, 3),
        ]
        self.devices = [self._device(f"device {n}", truth) for n, truth in enumerate(truths)]
        self._pieces = [self._make_pieces(device) for device in self.devices]

    def _device(self, name: str, truth: Truth) -> SimulatedDevice:
        trial = self.trial
        source = trial.add_source(name, "imu", {"layout": truth.layout.to_dict()})
        device = MeasuredDevice(
            name,
            f"fake://{name}",
            truth.layout,
            self.clock,
            tap=lambda t_ns, data: trial.bytes_in(source, t_ns, data),
        )
        device.begin(truth)
        setup = DeviceSetup(name=name, port=device.url)
        keeper = DeviceKeeper(setup, device, trial, source, self.clock, lambda sentence: None)
        return SimulatedDevice(truth, device, keeper, np.random.default_rng(truth.seed))

    def open_port(self, url: str, **_: object) -> FakePort:
        simulated = next(d for d in self.devices if d.device.url == url)
        if self.now_s < simulated.away_until_s:
            raise PortMissing(f"There is no port {url}.")
        simulated.port = FakePort(url)
        return simulated.port

    @property
    def now_s(self) -> float:
        return self.clock.now_ns() / NS_PER_S

    def start(self) -> None:
        for simulated in self.devices:
            simulated.keeper._open_first()

    def stop(self) -> None:
        for simulated in self.devices:
            simulated.device.stop()
        self.trial.close()

    def run_until(self, end_s: float) -> None:
        """Deliver every piece at its time, and let the keepers do their turns between them."""
        looked_s = told_s = self.now_s
        while self.now_s < end_s:
            to_s = self.now_s + PIECE_S
            due = []
            for simulated, pieces in zip(self.devices, self._pieces, strict=True):
                while simulated.arrived_s < to_s:
                    arrival_s, data = next(pieces)
                    simulated.arrived_s = arrival_s
                    due.append((arrival_s, simulated, data))
            for arrival_s, simulated, data in sorted(due, key=lambda item: item[0]):
                self._move_to(arrival_s)
                if simulated.port is not None and self.now_s >= simulated.away_until_s:
                    simulated.port.give(data)
                    simulated.sent_bytes += len(data)
                    simulated.pieces += 1
            self._move_to(to_s)
            self._unplug_now_and_then()
            for simulated in self.devices:
                simulated.keeper._watch_port(self.clock.now_ns())
            if self.now_s - looked_s >= LOOK_S:
                looked_s = self.now_s
                for simulated in self.devices:
                    simulated.keeper._look(self.clock.now_ns())
            if self.now_s - told_s >= STATISTICS_S:
                told_s += STATISTICS_S
                for simulated in self.devices:
                    simulated.keeper._tell()
            while self.trial.queued_bytes > MOST_QUEUED:
                time.sleep(0.001)

    def _move_to(self, at_s: float) -> None:
        self.clock.advance(max(0.0, at_s - self.now_s))

    def _unplug_now_and_then(self) -> None:
        if self.now_s < self._next_unplug_s:
            return
        self._next_unplug_s += self._unplug_s
        simulated = self.devices[self.unplugged % len(self.devices)]
        if simulated.port is not None:
            simulated.away_until_s = self.now_s + ABSENCE_S
            simulated.port.vanish()
            simulated.port = None
            self.unplugged += 1
            while simulated.device.running:  # the reader's thread has not noticed yet
                time.sleep(0.0001)

    def _make_pieces(self, simulated: SimulatedDevice) -> Iterator[tuple[float, bytes]]:
        """Yield what a device sends, a piece at a time, with its arrival; never out of order."""
        truth = simulated.truth
        packets = DevicePackets(truth.layout, truth.rate_hz, truth.seed)
        number = round(MADE_S * truth.rate_hz)
        each = max(1, round(PIECE_S * truth.rate_hz))
        first, earliest_s = 0, 0.0
        while True:
            data = packets.make(first, number)
            last = np.minimum(np.arange(each, number + each, each), number)
            host_s = truth.host_s((first + last) / truth.rate_hz)
            delays = DELAY_S + simulated.rng.exponential(LATE_S, len(last))
            start = 0
            for stop, at_s in zip(last.tolist(), (host_s + delays).tolist(), strict=True):
                earliest_s = max(at_s, earliest_s)
                yield earliest_s, data[start * truth.layout.length : stop * truth.layout.length]
                start = stop
            first += number


@contextmanager
def _day(folder: Path, rate_hz: float, unplugs_per_hour: float) -> Iterator[_Day]:
    day = _Day(folder, rate_hz, unplugs_per_hour)
    with mock.patch.object(stream_device, "open_port", day.open_port):
        day.start()
        try:
            yield day
        finally:
            day.stop()


def run(
    hours: float,
    folder: Path,
    *,
    rate_hz: float = 100.0,
    unplugs_per_hour: float = 6.0,
    warm_hours: float = WARM_HOURS,
    step_hours: float = 1.0,
    talk: bool = False,
) -> SoakFigures:
    """Record ``hours`` and look after the machine's resources after each."""
    figures = SoakFigures(hours=hours)
    began = time.monotonic()
    warm: tuple[float, int, int] | None = None
    with _day(folder, rate_hz, unplugs_per_hour) as day:
        for step in range(1, round(hours / step_hours) + 1):
            day.run_until(START_S + step * step_hours * HOUR_S)
            day.trial.flush()
            for simulated in day.devices:
                simulated.device.end_hour()
            now = (
                _rss_mb(),
                sum(1 for _ in Path("/proc/self/fd").iterdir()),
                threading.active_count(),
            )
            if warm is None and step * step_hours >= warm_hours:
                warm = now
            if talk:
                means = [f"{1e3 * d.device.errors[-1]:+.3f}" for d in day.devices]
                print(
                    f"hour {step * step_hours:g}: {now[0]:.1f} MB, {now[1]} descriptors, "
                    f"{now[2]} threads, mean time errors {', '.join(means)} ms, "
                    f"{time.monotonic() - began:.0f} s",
                    file=sys.stderr,
                )
        if warm is None:
            raise ValueError("a soak is longer than its warming up")
        figures.unplugged = day.unplugged
        figures.lost_records = day.trial.unwritten_records
        path = day.trial.path
    figures.machine_s = round(time.monotonic() - began, 1)
    figures.packets = sum(d.device.health.good for d in day.devices)
    figures.growth_mb = round(now[0] - warm[0], 2)
    figures.rss_mb = round(now[0], 1)
    figures.descriptors, figures.threads = (warm[1], now[1]), (warm[2], now[2])
    for simulated in day.devices:
        errors = np.array(simulated.device.errors)
        drift = float(np.abs(np.diff(errors)).max(initial=0.0)) / step_hours
        figures.worst_drift_ms_per_h = max(figures.worst_drift_ms_per_h, round(1e3 * drift, 4))
        worst_ms = round(1e3 * simulated.device.worst_s, 3)
        figures.worst_error_ms = max(figures.worst_error_ms, worst_ms)
        good = simulated.device.health.good
        if good * simulated.truth.layout.length != simulated.sent_bytes:
            figures.problems.append(f"{simulated.device.name}: {good} packets are not all")
    figures.file_mb = round(path.stat().st_size / 1e6, 3)
    figures.wire_mb = round(sum(d.sent_bytes + 28 * d.pieces for d in day.devices) / 1e6, 3)
    return figures


def _rss_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--unplugs-per-hour", type=float, default=6.0)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        figures = run(
            arguments.hours,
            Path(folder),
            rate_hz=arguments.rate,
            unplugs_per_hour=arguments.unplugs_per_hour,
            warm_hours=min(WARM_HOURS, arguments.hours / 2),
            talk=True,
        )
    print(json.dumps(vars(figures)))
    missed = (
        figures.problems
        or figures.lost_records
        or figures.growth_mb > MOST_GROWTH_MB
        or figures.worst_drift_ms_per_h > MOST_DRIFT_MS
        or figures.descriptors[0] != figures.descriptors[1]
        or figures.threads[0] != figures.threads[1]
    )
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
