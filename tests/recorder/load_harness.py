"""Record four sensors at 400 per second, a barometer and servos; count and time everything.

``python tests/recorder/load_harness.py --minutes 10`` prints the figures and ends with 1 if a
packet is missing. The devices run in a process of their own; the share of a core is that of the
recorder's alone, user and system time of all its threads, from the moment all devices are heard.
With ``--program`` it is ``imu-rig record`` on a terminal, its table and its start included.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import pty
import resource
import select
import signal
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from device_process import DeviceProcess

from imu_rig.clock import SystemClock
from imu_rig.recorder.engine import Recorder
from imu_rig.recorder.setup import TrialSetup
from imu_rig.recorder.status import RecorderStatus
from imu_rig.recording import open_trial
from imu_rig.recording.latency import Latency
from imu_rig.stopping import StopRequest

IMUS = 4
RATE_HZ = 400.0
PATIENCE_S = 20.0
SETTLE_S = 0.3  # for what is under way to arrive, after the devices fell silent

# What the program ends with 1 beyond; the suite holds it to losses alone.
MOST_P99_MS = 20.0
MOST_CPU_SHARE = 0.5

DEVICES = {
    f"imu {number}": {
        "protocol": "mpu9150-28",
        "rate_hz": RATE_HZ,
        "seed": number,
        "skew_ppm": 20.0 * number,
    }
    for number in range(IMUS)
} | {"barometer": {"protocol": "baro-16", "seed": 9}}


@dataclass(frozen=True)
class LoadFigures:
    """What a recording did; packets sent before the port was ready do not count as lost.

    Of a recording by the program the latency is that of its middle second, for the file holds no
    other.
    """

    seconds: float
    sent: int
    lost: int
    before: int
    corrupt: int
    servo_answers: int
    unwritten_records: int
    cpu_share: float
    latency_p50_ms: float | None
    latency_p99_ms: float
    latency_max_ms: float
    slowest_write_ms: float
    file_mb: float


class _Conductor:
    """Lets the recording run its time, silences the devices, waits, and ends it."""

    def __init__(self, devices: DeviceProcess, stop: StopRequest, seconds: float) -> None:
        self._devices, self._stop, self._seconds = devices, stop, seconds
        self._begun: tuple[float, float] | None = None
        self._silent_s: float | None = None
        self.cpu_share = 0.0

    def observe(self, status: RecorderStatus) -> None:
        now = time.monotonic()
        if status.state != "recording":
            return
        if self._begun is None:
            self._begun = now, _cpu_s()
        elif self._silent_s is None and now - self._begun[0] >= self._seconds:
            self.cpu_share = (_cpu_s() - self._begun[1]) / (now - self._begun[0])
            for name in DEVICES:
                self._devices.call("silence", name)
            self._silent_s = now
        elif self._silent_s is not None and now - self._silent_s > SETTLE_S:
            self._stop.make("the time is over")


def run(seconds: float, folder: Path) -> LoadFigures:
    """Record and compare with what the devices say they sent."""
    path = folder / "load.imu-trial"
    with DeviceProcess(DEVICES, servos="servos") as devices:
        setup = TrialSetup.model_validate(
            {
                "devices": [
                    {"name": name, "port": devices.urls[name], "layout": how["protocol"]}
                    for name, how in DEVICES.items()
                ],
                "jig": {"maestro": devices.urls["servos"]},
            }
        )
        stop = StopRequest()
        conductor = _Conductor(devices, stop, seconds)
        recorder = Recorder(setup, path, SystemClock(), stop=stop, observe=conductor.observe)
        outcome = recorder.run()
        runs = {name: devices.call("counters", name) for name in DEVICES}
    return _figures(seconds, path, runs, outcome.latency, conductor.cpu_share)


def run_program(seconds: float, folder: Path) -> LoadFigures:
    """Record with the program on a terminal of its own, and compare likewise."""
    with DeviceProcess(DEVICES, servos="servos") as devices:
        options = ["--maestro", devices.urls["servos"], "--output", str(folder)]
        for name, how in DEVICES.items():
            options += ["--device", f"{name}={devices.urls[name]},layout={how['protocol']}"]
        program = str(Path(sys.executable).with_name("imu-rig"))
        child, terminal = pty.fork()
        if child == 0:
            os.execv(program, [program, "record", *options])
        began = time.monotonic()
        _watch(terminal, seconds)
        for name in DEVICES:
            devices.call("silence", name)
        _watch(terminal, SETTLE_S)
        os.kill(child, signal.SIGINT)
        _watch(terminal, PATIENCE_S)
        _, _, used = os.wait4(child, 0)
        share = (used.ru_utime + used.ru_stime) / (time.monotonic() - began)
        os.close(terminal)
        runs = {name: devices.call("counters", name) for name in DEVICES}
    (path,) = folder.rglob("*.imu-trial")
    return _figures(seconds, path, runs, None, share)


def _watch(terminal: int, seconds: float) -> None:
    """Take what a program shows, for some time or until it ends."""
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        if select.select([terminal], [], [], left)[0]:
            try:
                os.read(terminal, 1 << 16)
            except OSError:  # nobody has the terminal open any more
                return


def _figures(
    seconds: float,
    path: Path,
    runs: dict[str, list[tuple[int, int]]],
    latency: Latency | None,
    cpu_share: float,
) -> LoadFigures:
    """Compare a file with what the devices sent."""
    trial = open_trial(path)
    lost = before = sent = corrupt = 0
    for name in DEVICES:
        ((first, last),) = runs[name]
        received = trial.samples(name).counter
        late = int(received[0] - first) % 256
        sent += last - first + 1
        before += late
        lost += last - first + 1 - late - len(received)
        corrupt += trial.device_statistics(name)[-1][1]["corrupt"]
    notes = [values for _, values in trial.statistics]
    if latency is None:  # what the file says of each second; of its middle second the 99 %
        of_seconds = [(n["latency_p99_s"], n["latency_max_s"]) for n in notes if n["latency_max_s"]]
        p99_s = sorted(p99_s for p99_s, _ in of_seconds)[len(of_seconds) // 2]
        latency = Latency(len(trial.records), math.nan, p99_s, max(m for _, m in of_seconds))
    return LoadFigures(
        seconds=seconds,
        sent=sent,
        lost=lost,
        before=before,
        corrupt=corrupt,
        servo_answers=len(trial.wire("jig").t),
        unwritten_records=notes[-1]["unwritten_records"],
        cpu_share=round(cpu_share, 3),
        latency_p50_ms=None if math.isnan(latency.p50_s) else round(latency.p50_s * 1e3, 2),
        latency_p99_ms=round(latency.p99_s * 1e3, 2),
        latency_max_ms=round(latency.max_s * 1e3, 2),
        slowest_write_ms=round(1e3 * max(n["slowest_write_s"] for n in notes), 2),
        file_mb=round(path.stat().st_size / 1e6, 2),
    )


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--program", action="store_true", help="record with the program itself")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        record = run_program if arguments.program else run
        figures = record(60.0 * arguments.minutes, Path(folder))
    print(json.dumps(asdict(figures)))
    missed = (
        figures.lost
        or figures.unwritten_records
        or figures.latency_p99_ms > MOST_P99_MS
        or figures.cpu_share > MOST_CPU_SHARE
    )
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
