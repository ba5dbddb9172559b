"""Record every kind of device at its published rate at once, and count what was lost.

``python tests/recorder/all_devices_harness.py --seconds 60`` prints a table and ends with 1 if a
packet is missing. The devices run in a process of their own, on pseudo-terminals, with servos
beside them; those that must be spoken to are set up by the recorder as in life.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from device_process import DeviceProcess

from firmware_protocols.known import load_protocol
from imu_rig.clock import SystemClock
from imu_rig.recorder.engine import Recorder
from imu_rig.recorder.setup import TrialSetup
from imu_rig.recorder.status import RecorderStatus
from imu_rig.recording import open_trial
from imu_rig.recording.reader import Trial
from imu_rig.stopping import StopRequest

PROTOCOLS = (
    "mpu9150-28",
    "adis16405-36",
    "ms5803-32",
    "waist-unit",
    "two-imu",
    "xsens-mti",
    "mavlink-highres",
)
SETTLE_S = 0.3  # for what is under way to arrive, after the devices fell silent


@dataclass(frozen=True)
class StreamFigures:
    """What became of one stream.

    ``lost`` is by the device's own numbers, between the first sample in the file and the last one
    handed out; ``late`` are those handed out before the first in the file: before its port was
    read, or while it was set up.
    """

    name: str
    rate_hz: float
    published_hz: float
    received: int
    lost: int
    late: int
    corrupt: int


@dataclass(frozen=True)
class AllDevicesFigures:
    seconds: float
    streams: list[StreamFigures]
    servo_answers: int
    unwritten_records: int
    cpu_share: float
    latency_p99_ms: float

    @property
    def lost(self) -> int:
        return sum(stream.lost for stream in self.streams)


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
            for name in PROTOCOLS:
                self._devices.call("silence", name)
            self._silent_s = now
        elif self._silent_s is not None and now - self._silent_s > SETTLE_S:
            self._stop.make("the time is over")


def run(seconds: float, folder: Path) -> AllDevicesFigures:
    """Record and compare with what the devices say they sent."""
    path = folder / "all.imu-trial"
    asked = {
        name: {"protocol": name, "seed": number, "skew_ppm": 20.0 * number}
        for number, name in enumerate(PROTOCOLS, 1)
    }
    with DeviceProcess(asked, servos="servos") as devices:
        setup = TrialSetup.model_validate(
            {
                "devices": [
                    {"name": name, "port": devices.urls[name], "layout": name} for name in PROTOCOLS
                ],
                "jig": {"maestro": devices.urls["servos"]},
            }
        )
        stop = StopRequest()
        conductor = _Conductor(devices, stop, seconds)
        outcome = Recorder(
            setup, path, SystemClock(), stop=stop, observe=conductor.observe, wait_s=30.0
        ).run()
        trial = open_trial(path)
        streams = [
            _figures(trial, devices, name, stream)
            for name in PROTOCOLS
            for stream in load_protocol(name).streams
        ]
    return AllDevicesFigures(
        seconds=seconds,
        streams=streams,
        servo_answers=len(trial.wire("jig").t),
        unwritten_records=outcome.unwritten_records,
        cpu_share=round(conductor.cpu_share, 3),
        latency_p99_ms=round(outcome.latency.p99_s * 1e3, 2),
    )


def _figures(trial: Trial, devices: DeviceProcess, name: str, stream: str) -> StreamFigures:
    full = f"{name}/{stream}" if stream else name
    samples = trial.samples(full)
    missing = trial.missing(full)
    received = len(samples)
    # The voice of a device that is spoken to makes all its streams: its packets have no numbers of
    # their own, and what is missing at the end shows by the time of the last.
    voices = [stream, ""] if stream else [stream]
    runs = next((r for voice in voices if (r := _runs(devices, name, voice)) is not None), [])
    layout = load_protocol(name).streams[stream]
    handed_out = runs[-1][1] - runs[-1][0] + 1
    late = handed_out - received
    inside = sum(m.samples or 0 for m in missing if m.start_s >= samples.t[0])
    lost = inside
    if layout.counter is not None and name != "xsens-mti":
        modulus = 1 << layout.field(layout.counter).bits
        late = int(samples.counter[0] - runs[-1][0]) % modulus
        lost = handed_out - late - received
    span_s = float(samples.t[-1] - samples.t[0])
    return StreamFigures(
        name=full,
        rate_hz=(received - 1 + inside) / span_s,
        published_hz=float(layout.rate_hz or 0.0),
        received=received,
        lost=max(lost, inside),
        late=late,
        corrupt=trial.device_statistics(full)[-1][1]["corrupt"],
    )


def _runs(devices: DeviceProcess, name: str, stream: str) -> list[tuple[int, int]] | None:
    found: list[tuple[int, int]] | None = devices.call("counters_of", name).get(stream)
    return found


def _cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def table(figures: AllDevicesFigures) -> list[str]:
    """Return the figures as lines."""
    lines = [f"{'stream':26}{'published':>10}{'Hz':>9}{'packets':>9}{'lost':>6}{'corrupt':>9}"]
    lines += [
        f"{s.name:26}{s.published_hz:10.2f}{s.rate_hz:9.2f}{s.received:9}{s.lost:6}{s.corrupt:9}"
        for s in figures.streams
    ]
    load = ", ".join(f"{load:.1f}" for load in os.getloadavg())
    return [
        *lines,
        "",
        f"{figures.seconds:g} s, {figures.lost} lost, {figures.unwritten_records} unwritten, "
        f"{figures.servo_answers} answers of the servo controller",
        f"recorder {100 * figures.cpu_share:.0f} % of a core, {figures.latency_p99_ms} ms from "
        f"arrival to file for 99 %; load of the machine {load} on {os.cpu_count()} cores",
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        figures = run(arguments.seconds, Path(folder))
    print("\n".join(table(figures)))
    return 1 if figures.lost or figures.unwritten_records else 0


if __name__ == "__main__":
    sys.exit(main())
