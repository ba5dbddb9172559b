"""What a session is expected to tell, in a terminal and as JSON."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from imu_rig.units import DEG, MILLI_G

if TYPE_CHECKING:
    from imu_rig.calibration.expected import ExpectedUncertainty
    from imu_rig.session.plan import SessionPlan

LABEL_WIDTH = 38


def plan_lines(plan: SessionPlan, jig: str) -> list[str]:
    """Lines that tell every stop of a plan and its time."""
    lines = []
    for step in plan.steps:
        late = [axis for axis, sign in step.approach.items() if sign < 0]
        note = f"   {', '.join(late)} from above: no room to overshoot" if late else ""
        lines.append(f"{step.index + 1:4}  {step.name:40}{step.duration_s:6.1f} s{note}")
    return [
        *lines,
        f"{len(plan.steps)} stops on jig '{jig}' take about {plan.duration_s:.0f} s, "
        "all inside its limits.",
    ]


def plan_json(plan: SessionPlan) -> dict[str, object]:
    """Return the same for programs."""
    steps = [
        {
            "name": step.name,
            "kind": step.kind,
            "pose_deg": step.pose.angles(),
            "hold_s": step.hold_s,
            "duration_s": round(step.duration_s, 2),
        }
        for step in plan.steps
    ]
    return {"duration_s": plan.duration_s, "steps": steps}


def expected_lines(expected: ExpectedUncertainty, warnings: Sequence[str] = ()) -> list[str]:
    """Lines of a short table of standard uncertainties, and what is weak.

    The last lines tell how far 95 % of a reading's and a turn's errors reach, as a result does.
    """
    from imu_rig.calibration.model import student_factor

    factor = student_factor(float("inf"))
    lines = [f"  {'expected standard uncertainty':{LABEL_WIDTH}}{'rms':>9}{'worst':>9}"]
    for group in expected.groups():
        label = f"{group.name} [{group.unit}]"
        numbers = f"{_digits(group.rms):>9}{_digits(group.worst):>9}"
        lines.append(f"  {label:{LABEL_WIDTH}}{numbers}  {group.worst_name}")
    lines.append(_single("reading at rest, 95 % [mg]", factor * expected.reading / MILLI_G))
    if expected.turn is not None:
        lines.append(_single("turn of 90 deg, 95 % [deg]", factor * expected.turn / DEG))
    if expected.level is not None:
        lines.append(_single("level of the jig's zero pose [deg]", expected.level / DEG))
    for warning in warnings:
        lines += ["", *textwrap.wrap(f"! {warning}", 78, subsequent_indent="  ")]
    return lines


def other_noise(layout: str) -> tuple[str, ...]:
    """Say of what sensor an expectation is, where it is not the one that is to be calibrated."""
    if layout.startswith("mpu9150"):
        return ()
    return (
        "This is expected of an MPU-9150; a sensor with more or less noise is known worse or "
        "better. The certificate states what was reached.",
    )


def expected_json(
    expected: ExpectedUncertainty, warnings: Sequence[str] = ()
) -> Mapping[str, object]:
    """Return the same for programs; figures in the units of their names."""
    return {
        "groups": [
            {
                "name": group.name,
                "unit": group.unit,
                "rms": group.rms,
                "worst": group.worst,
                "worst_name": group.worst_name,
            }
            for group in expected.groups()
        ],
        "reading_mg": expected.reading / MILLI_G,
        "turn_deg": None if expected.turn is None else expected.turn / DEG,
        "level_deg": None if expected.level is None else expected.level / DEG,
        "warnings": list(warnings),
    }


def _single(label: str, value: float) -> str:
    return f"  {label:{LABEL_WIDTH}}{_digits(value):>9}"


def _digits(value: float) -> str:
    """Write two digits that count, without an exponent."""
    return f"{value:.4f}" if value < 0.01 else f"{value:.3f}" if value < 1 else f"{value:.2f}"
