"""Unplug one of three devices again and again at random moments, and see what the file tells of it.

``python tests/recorder/unplug_harness.py --times 200`` prints the figures and ends with 1 unless
every unplugging was noticed and recorded with both counters, and nothing else is missing.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from imu_rig.clock import SystemClock
from imu_rig.recorder.engine import Recorder
from imu_rig.recorder.setup import TrialSetup
from imu_rig.recorder.status import RecorderStatus
from imu_rig.recording import open_trial
from imu_rig.stopping import StopRequest
from simulators.served_devices import ServedDevices

NAMES = ("left shoe", "right shoe", "pelvis")
RATE_HZ = 200.0
SETTLE_S = 0.3
PATIENCE_S = 10.0
LONGEST_CALM_S = 0.6  # between two unpluggings
LONGEST_ABSENCE_S = 1.5


# What the program ends with 1 beyond.
MOST_NOTICED_S = 1.0
MOST_LIVE_AGAIN_S = 2.0


@dataclass
class UnplugFigures:
    """What became of the unpluggings."""

    unplugged: int = 0
    noticed_worst_s: float = 0.0
    live_again_worst_s: float = 0.0
    gaps: int = 0
    gaps_without_counters: int = 0
    wrong_gaps: int = 0
    missing_elsewhere: int = 0
    unwritten_records: int = 0
    problems: list[str] = field(default_factory=list)


class _Watched:
    """A recording in a thread of its own, and what it says."""

    def __init__(self, setup: TrialSetup, path: Path) -> None:
        self.stop = StopRequest()
        self.status: RecorderStatus | None = None
        self.said: list[tuple[float, str]] = []
        self.error: BaseException | None = None
        recorder = Recorder(
            setup,
            path,
            SystemClock(),
            stop=self.stop,
            observe=self._observe,
            notify=lambda sentence: self.said.append((time.monotonic(), sentence)),
        )
        self._recorder = recorder
        self._thread = threading.Thread(target=self._run, name="watched recording")
        self._thread.start()

    def _observe(self, status: RecorderStatus) -> None:
        self.status = status

    def _run(self) -> None:
        try:
            self.outcome = self._recorder.run()
        except BaseException as error:
            self.error = error

    def end(self) -> None:
        self.stop.make("the harness is done")
        self._thread.join()
        if self.error is not None:
            raise self.error

    def live(self, name: str) -> bool:
        devices = () if self.status is None else self.status.devices
        return any(d.name == name and d.state == "live" for d in devices)

    def said_since(self, moment: float) -> bool:
        return any(at >= moment for at, _ in self.said)


def _until(condition: Callable[[], bool]) -> float:
    """Wait for something and return how long it took [s]."""
    start = time.monotonic()
    while not condition():
        if time.monotonic() - start > PATIENCE_S:
            return float("inf")
        time.sleep(0.002)
    return time.monotonic() - start


def run(
    times: int,
    folder: Path,
    seed: int = 1,
    *,
    transport: Literal["pty", "tcp"] = "pty",
    calm_s: float = LONGEST_CALM_S,
    absence_s: float = LONGEST_ABSENCE_S,
) -> UnplugFigures:
    """Unplug ``times`` times and compare the file with what the devices sent."""
    moments = random.Random(seed)
    figures = UnplugFigures()
    path = folder / "unplug.imu-trial"
    unplugged = dict.fromkeys(NAMES, 0)
    with ServedDevices(transport=transport) as served:
        devices = [
            {"name": name, "port": served.add(name, "mpu9150-28", RATE_HZ, seed=number)}
            for number, name in enumerate(NAMES)
        ]
        recording = _Watched(TrialSetup.model_validate({"devices": devices}), path)
        try:
            _until(lambda: all(map(recording.live, NAMES)))
            for number in range(times):
                name = moments.choice(NAMES)
                time.sleep(moments.uniform(0.0, calm_s))
                gone = time.monotonic()
                served.unplug(name)
                unplugged[name] += 1
                away_s = moments.uniform(0.01, absence_s)
                noticed_s = _until(lambda gone=gone: recording.said_since(gone))
                figures.noticed_worst_s = max(figures.noticed_worst_s, noticed_s)
                time.sleep(max(0.0, gone + away_s - time.monotonic()))
                heard = len(recording.said)
                served.plug(name)
                back_s = _until(
                    lambda name=name, heard=heard: (
                        len(recording.said) > heard and recording.live(name)
                    )
                )
                figures.live_again_worst_s = max(figures.live_again_worst_s, back_s)
                if sys.stderr.isatty():
                    print(f"\r{number + 1} of {times}", end="", file=sys.stderr)
            for name in NAMES:
                served.silence(name)
            time.sleep(SETTLE_S)
        finally:
            recording.end()
        runs = {name: served.counters(name) for name in NAMES}
    figures.unplugged = times
    figures.unwritten_records = recording.outcome.unwritten_records
    for name in NAMES:
        _compare(path, name, unplugged[name], runs[name], figures)
    return figures


def _compare(
    path: Path, name: str, times: int, runs: list[tuple[int, int]], figures: UnplugFigures
) -> None:
    """See that every hole in a device's numbers is one gap of the file, and the other way round."""
    trial = open_trial(path)
    samples = trial.samples(name)
    counter = samples.counter
    number = trial.sources[name].id
    gaps = [gap.fields for gap in trial.gaps if gap.source == number]
    figures.gaps += len(gaps)
    if len(gaps) != times:
        figures.problems.append(f"{name}: {len(gaps)} gaps for {times} unpluggings")
    steps = np.diff(counter)
    holes = {(int(counter[k]), int(counter[k + 1])) for k in np.flatnonzero(steps != 1)}
    for gap in gaps:
        before, after = gap.get("counter_before"), gap.get("counter_after")
        if gap["reason"] != "unplugged":
            figures.problems.append(f"{name}: a gap because of {gap['reason']}")
        if before is None or after is None:
            figures.gaps_without_counters += 1
        elif after - before > 1 and (before, after) not in holes:
            figures.wrong_gaps += 1
            figures.problems.append(f"{name}: a gap {before} to {after}, no such hole")
        else:
            holes.discard((before, after))
    for before, after in holes:
        figures.missing_elsewhere += after - before - 1
        figures.problems.append(f"{name}: {before} to {after} are missing without a gap")
    # what the device itself did not send is missing, and besides only what hung in the cable
    made = runs[-1][1] - runs[0][0] + 1
    late = int(counter[0] - runs[0][0]) % 256
    if int(counter[-1] - counter[0]) + 1 != made - late:
        figures.problems.append(f"{name}: numbers {counter[0]} to {counter[-1]}, made {made}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--transport", choices=["pty", "tcp"], default="pty")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        figures = run(arguments.times, Path(folder), arguments.seed, transport=arguments.transport)
    print(json.dumps(asdict(figures)))
    missed = (
        figures.problems
        or figures.missing_elsewhere
        or figures.gaps_without_counters
        or figures.noticed_worst_s > MOST_NOTICED_S
        or figures.live_again_worst_s > MOST_LIVE_AGAIN_S
    )
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
