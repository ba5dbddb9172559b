"""What is told of a recording that has ended: figures, what it falls short of, what comes next."""

from __future__ import annotations

import contextlib
import math
import shlex
import textwrap
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from imu_rig.cli.words import clock, losses, size, uncertainty
from imu_rig.errors import INCOMPLETE_EXIT, ImuRigError, SessionInterrupted
from imu_rig.foreign_text import one_line

if TYPE_CHECKING:
    from imu_rig.recorder.engine import RecordingOutcome
    from imu_rig.recorder.status import DeviceStatus
    from imu_rig.stopping import StopRequest

UNSURE_S = 0.5  # of times; less is a slow link, more in a short trial is a clock that errs
NAME_WIDTH = 24
WIDTH = 78
MOST_BYTES_AT_ONCE = 20_000_000
"""A larger file is not read again at the end to state its uncertainty of time."""


@dataclass(frozen=True)
class Times:
    """How well the devices' times are known on the trial's clock.

    Attributes
    ----------
    uncertainty_s : dict
        Standard uncertainty by device [s], where it was found out.
    problems : dict
        Why times cannot be right, by device: a sentence without its stop.
    """

    uncertainty_s: dict[str, float] = field(default_factory=dict)
    problems: dict[str, str] = field(default_factory=dict)


UNKNOWN = Times()


def times_of(outcome: RecordingOutcome, stop: StopRequest) -> Times:
    """Read the file again for its times; not for one who has no time for that."""
    from imu_rig.cli.working import Working
    from imu_rig.recording.reader import open_trial

    times = Times()
    if outcome.file_bytes > MOST_BYTES_AT_ONCE:
        return times
    with contextlib.suppress(ImuRigError, OSError), Working("Reading the file again"):
        trial = open_trial(outcome.path)
        for device in outcome.rows:
            if stop.brief or stop.hurry:
                break
            if not device.packets:
                continue
            sigma_s = trial.time_uncertainty_s(device.name)
            times.uncertainty_s[device.name] = sigma_s
            problem = trial.time_problem(device.name)
            if problem is None and UNSURE_S < sigma_s < math.inf:
                problem = (
                    f"its times are known to {uncertainty(sigma_s)} only: the clock tick or rate "
                    "in its layout is wrong, or the computer was too busy to read it"
                )
            if problem is not None:
                times.problems[device.name] = problem
    return times


def shortfalls(outcome: RecordingOutcome, max_loss: float, times: Times = UNKNOWN) -> list[str]:
    """Say in sentences what a recording is not that it should be; ``max_loss`` is 0 to 1."""
    told = [f"{one_line(name, 60)}: {problem}." for name, problem in times.problems.items()]
    mute = [device for device in outcome.devices if _mute(device)]
    for device in mute:  # one sentence, however many streams it has
        told.append(
            f"{one_line(device.name, 60)} was never heard: "
            f"{device.problem or f'{device.port} is silent.'}"
        )
    for device in [row for whole in outcome.devices if whole not in mute for row in whole.rows]:
        name = one_line(device.name, 60)
        if not device.required:
            continue
        if not device.packets:
            told.append(f"{name} was never heard: {device.problem or f'{device.port} is silent.'}")
        elif device.state != "live":
            told.append(
                f"{name} was {device.state} at the end, and had been for {device.age_s:.0f} s."
            )
        if device.packets and device.loss > max_loss:
            told.append(
                f"{name} lost {losses(device.lost, device.loss)} of its packets, and "
                f"{100 * max_loss:g} % are accepted (--max-loss)."
            )
    if outcome.unwritten_records:
        told.append(
            f"{outcome.unwritten_records} records found no room while the disk was too slow; the "
            "file says when."
        )
    if outcome.problem:
        told.append(outcome.problem)
    return told


def _mute(device: DeviceStatus) -> bool:
    """Whether nothing came of any of a device's streams, for one and the same reason."""
    reasons = {row.problem for row in device.rows}
    return device.required and not device.packets and len(reasons) == 1


def exit_code(outcome: RecordingOutcome, short: list[str]) -> int:
    """Return what the program tells whoever started it."""
    if short:
        return INCOMPLETE_EXIT
    return SessionInterrupted.exit_code if outcome.reason == "interrupted" else 0


def summary_lines(outcome: RecordingOutcome, times: Times = UNKNOWN) -> list[str]:
    """Lines that tell a recording."""
    ended = {"complete": "complete", "interrupted": "stopped before its planned end"}
    facts = [
        f"{clock(outcome.elapsed_s)} recorded",
        size(outcome.file_bytes),
        f"{outcome.markers} marker{'s'[: outcome.markers != 1]}",
        ended.get(outcome.reason, outcome.reason),
    ]
    lines = [str(outcome.path), f"  {', '.join(facts)}", ""]
    names = [_short(device.name) for device in outcome.rows]
    width = max(map(len, [*names, "device"]))
    lines.append(f"  {'device':{width}}{'packets':>10}{'Hz':>8}{'lost':>17}{'gaps':>6}{'time':>11}")
    for name, device in zip(names, outcome.rows, strict=True):
        rate = f"{device.rate_hz:.1f}" if device.rate_hz else "–"
        lost = losses(device.lost, device.loss)
        time = uncertainty(times.uncertainty_s.get(device.name))
        lines.append(
            f"  {name:{width}}{device.packets:>10}{rate:>8}{lost:>17}{device.gaps:>6}{time:>11}"
        )
    gone = [
        f"  {name}: {device.state} at the end"
        for name, device in zip(names, outcome.rows, strict=True)
        if device.state != "live"
    ]
    lines += ["", *gone] if gone else []
    for device in outcome.rows:
        if device.fault_counts:
            faults = ", ".join(one_line(fault, 60) for fault, _ in device.fault_counts)
            told = textwrap.wrap(f"{one_line(device.name, 60)} reported: {faults}", WIDTH)
            lines += ["", *(f"  {line}" for line in told)]
    file = shlex.quote(str(outcome.path))
    lines += ["", f"  imu-rig info {file}", f"  imu-rig export {file} --to csv"]
    return lines


def _short(name: str) -> str:
    line = one_line(name, 60)
    return line if len(line) <= NAME_WIDTH else f"{line[: NAME_WIDTH - 1]}…"
