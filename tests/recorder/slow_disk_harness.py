"""Stall the disk under a recording and see that nothing is lost, or that the file says what is.

``python tests/recorder/slow_disk_harness.py --stalls 0.5 5`` records for a few seconds per stall,
lets one write and one sync after the other take that long, and prints what it lost: nothing within
the time that the queue is said to hold, and beyond it no packet of which the file does not know.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from imu_rig.clock import SystemClock
from imu_rig.recorder.engine import Recorder
from imu_rig.recorder.setup import TrialSetup
from imu_rig.recorder.status import RecorderStatus
from imu_rig.recording import RecordingOptions, open_trial
from imu_rig.recording.storage import OsFileSystem
from imu_rig.stopping import StopRequest
from simulators.served_devices import ServedDevices

NAMES = ("left", "right")
RATE_HZ = 400.0
QUEUE_FULL = "queue full"
CALM_S = 0.5  # before a stall and between two of them
SETTLE_S = 0.3


class StallingFileSystem(OsFileSystem):
    """A disk that takes its time over the next write or sync when told to."""

    def __init__(self) -> None:
        self.write_s = self.sync_s = 0.0
        self.stalls = 0

    def write(self, descriptor: int, data: bytes) -> int:
        seconds, self.write_s = self.write_s, 0.0
        self._stall(seconds)
        return super().write(descriptor, data)

    def fdatasync(self, descriptor: int) -> None:
        seconds, self.sync_s = self.sync_s, 0.0
        self._stall(seconds)
        super().fdatasync(descriptor)

    def _stall(self, seconds: float) -> None:
        if seconds:
            self.stalls += 1
            time.sleep(seconds)


@dataclass
class StallFigures:
    """What a recording with stalls kept; of what is ``unknown`` the file does not tell."""

    stall_s: float
    queue_s: float = 0.0
    stalls: int = 0
    sent: int = 0
    lost: int = 0
    unknown: int = 0
    gaps: int = 0
    unwritten_records: int = 0
    records_in_gaps: int = 0
    queue_peak: float = 0.0


class _Conductor:
    """Stalls a write and then a sync, lets the queue empty itself, and ends the recording."""

    def __init__(
        self,
        served: ServedDevices,
        disk: StallingFileSystem,
        stop: StopRequest,
        figures: StallFigures,
        calm_s: float,
    ) -> None:
        self._served, self._disk, self._stop, self._figures = served, disk, stop, figures
        self._calm_s = calm_s
        self._steps = [self._stall_write, self._stall_sync, self._silence, self._end]
        self._next_s: float | None = None

    def observe(self, status: RecorderStatus) -> None:
        now = time.monotonic()
        self._figures.queue_peak = max(self._figures.queue_peak, status.queue)
        if status.state != "recording" or not self._steps:
            return
        if self._next_s is None:
            self._next_s = now + self._calm_s
        elif now >= self._next_s:
            self._next_s = now + self._steps.pop(0)(status)

    def _stall_write(self, status: RecorderStatus) -> float:
        self._figures.queue_s = round(status.queue_s, 3)
        self._disk.write_s = self._figures.stall_s
        return self._figures.stall_s + self._calm_s

    def _stall_sync(self, _: RecorderStatus) -> float:
        self._disk.sync_s = self._figures.stall_s
        return self._figures.stall_s + self._calm_s

    def _silence(self, _: RecorderStatus) -> float:
        for name in NAMES:
            self._served.silence(name)
        return SETTLE_S

    def _end(self, _: RecorderStatus) -> float:
        self._stop.make("the harness is done")
        return 0.0


def run(
    stall_s: float, folder: Path, *, queue_bytes: int | None = None, calm_s: float = CALM_S
) -> StallFigures:
    """Record with stalls of that length and compare with what the devices sent."""
    disk = StallingFileSystem()
    options = RecordingOptions(file_system=disk, sync_s=0.1)
    if queue_bytes is not None:
        options = RecordingOptions(file_system=disk, sync_s=0.1, queue_bytes=queue_bytes)
    figures = StallFigures(stall_s)
    path = folder / f"stall-{stall_s:g}.imu-trial"
    stop = StopRequest()
    with ServedDevices() as served:
        devices = [
            {"name": name, "port": served.add(name, "mpu9150-28", RATE_HZ, seed=number)}
            for number, name in enumerate(NAMES)
        ]
        conductor = _Conductor(served, disk, stop, figures, calm_s)
        recorder = Recorder(
            TrialSetup.model_validate({"devices": devices}),
            path,
            SystemClock(),
            stop=stop,
            observe=conductor.observe,
            options=options,
        )
        outcome = recorder.run()
        runs = {name: served.counters(name) for name in NAMES}
    figures.stalls = disk.stalls
    figures.unwritten_records = outcome.unwritten_records
    trial = open_trial(path)
    for name in NAMES:
        ((first, last),) = runs[name]
        counter = trial.samples(name).counter
        late = int(counter[0] - first) % 256
        made = last - first + 1 - late
        told = sum(m.samples or 0 for m in trial.missing(name) if m.reason == QUEUE_FULL)
        figures.sent += made
        figures.lost += made - len(counter)
        figures.unknown += abs(made - len(counter) - told)
    full = [gap.fields for gap in trial.gaps if gap.fields.get("reason") == QUEUE_FULL]
    figures.gaps = len(full)
    figures.records_in_gaps = sum(gap["records"] for gap in full)
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stalls", type=float, nargs="+", default=[0.5, 5.0])
    parser.add_argument("--queue-bytes", type=int, default=None)
    arguments = parser.parse_args()
    bad = 0
    with tempfile.TemporaryDirectory() as folder:
        for stall_s in arguments.stalls:
            figures = run(stall_s, Path(folder), queue_bytes=arguments.queue_bytes)
            print(json.dumps(asdict(figures)), flush=True)
            within = stall_s < figures.queue_s
            bad += bool(figures.unknown or (within and figures.lost))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
