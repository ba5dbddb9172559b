"""What a protocol can tell on a jig, before anything moves; what it cannot, and what to add."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from imu_rig import rotation
from imu_rig.arrays import FloatArray
from imu_rig.calibration.accuracy import sphere
from imu_rig.calibration.advice import choose, magnitude_sigma
from imu_rig.calibration.expected import (
    Design,
    ExpectedUncertainty,
    Leg,
    expected_uncertainty,
)
from imu_rig.calibration.expected_paper import expected_of_paper
from imu_rig.calibration.magnitude import NAMES
from imu_rig.calibration.model import AXES
from imu_rig.calibration.multi_position import COMFORTABLE_POSES
from imu_rig.calibration.paper import Model
from imu_rig.calibration.solve import chosen_method
from imu_rig.devices.jig_config import JigConfig
from imu_rig.errors import DataError, InputError
from imu_rig.session.plan import ARRIVAL_S, PlannedStep, SessionPlan, Stage, travel_time
from imu_rig.session.protocol import Pose
from imu_rig.units import DEG

REMOUNTING_S = 60.0
"""What it takes a person to turn the sensor over."""
FREE_ACCEL = np.array([0.01] * 6 + [0.25] * 3)
"""Standard uncertainties of gain [1] and offset [m/s^2] that hardly better a data sheet: poses
that gravity's magnitude tells no more from do not determine the parameter."""
FREE_SCALE, FREE_CROSS = 1.0, 1e-2
"""The same of a gyroscope: scale [%], cross-axis [rad]."""
SHORT = 2.5
"""How much worse than poses all around the sphere makes a warning."""
LEVEL_TILT = 60.0
"""Beyond this tilt the roll axis is too steep for gravity to see its turns [deg]."""
MORE_REACH = "allow poses a larger reach"
"""What helps a list that was searched for within its reach already."""
PAPER: dict[str, Model] = {"paper": "full", "paper-diagonal": "diagonal"}


@dataclass(frozen=True)
class Outlook:
    """Expected uncertainties of a plan by one method, and what is weak about it."""

    expected: ExpectedUncertainty
    warnings: tuple[str, ...]


def outlook(plan: SessionPlan, jig: JigConfig, method: str, *, searched: bool = False) -> Outlook:
    """Predict what a session on a jig will tell.

    What to add to a protocol that was ``searched`` for within a reach and a time is more of these,
    not poses that lie beyond them.

    Raises
    ------
    InputError
        If there is no such method, or the protocol cannot determine a parameter by it; says what
        to add.
    """
    method = chosen_method(method, on_jig=True)
    name = plan.protocol.name
    if plan.protocol.only_checks:
        raise InputError(
            f"Protocol '{name}' checks a calibrated sensor and calibrates nothing: take a longer "
            "protocol, such as full, or compare with a certificate by imu-rig verify."
        )
    design = design_of(plan, jig)
    if method == "ferraris":
        raise InputError(
            "Method ferraris is for recordings made by hand on a table (imu-rig solve FILE "
            "--method ferraris); on a jig take joint, which needs no exact angles."
        )
    if method in PAPER:
        return _of_paper(design, name, method)
    _refuse_free_accelerometer(design, plan, jig, searched=searched)
    expected = expected_uncertainty(design, angles_known=method != "multi-position")
    _refuse_free_gyroscope(expected, design, plan, jig, searched=searched)
    return Outlook(expected, tuple(_warnings(design, plan, jig, searched=searched)))


def design_of(plan: SessionPlan, jig: JigConfig) -> Design:
    """Poses and moves of a plan that take part in a fit."""
    begin, t = [], 0.0
    kept: list[PlannedStep] = []
    legs: list[list[Leg]] = []
    for before, step in zip((None, *plan.steps), plan.steps, strict=False):
        turned_over = before is not None and before.mounting != step.mounting
        t += REMOUNTING_S if turned_over else 0.0
        if step.kind != "check":
            linked = before is not None and before.kind != "check" and not turned_over
            kept.append(step)
            legs.append(_legs(step.stages, jig, plan.protocol.pause_s) if linked else [])
            begin.append(t + step.duration_s - step.hold_s)
        t += step.duration_s
    starts = np.array(begin)
    return Design(
        angles=np.array([_angles(step.pose) for step in kept]),
        mounting=np.array([step.mounting for step in kept], dtype=np.int64),
        mounting_turns=np.array(plan.protocol.mounting_turns),
        begin=starts,
        end=starts + np.array([step.hold_s for step in kept]),
        legs=legs,
        settle=plan.protocol.settle_s,
    )


def _legs(stages: Sequence[Stage], jig: JigConfig, pause_s: float) -> list[Leg]:
    legs = []
    for number, stage in enumerate(stages):
        start, end = _angles(stage.start), _angles(stage.end)
        # A turn by less than a pulse takes no time at all.
        legs.append(Leg(start, end, max(travel_time(jig, stage), 1e-3)))
        rest = ARRIVAL_S + (pause_s if number < len(stages) - 1 else 0.0)
        legs.append(Leg(end, end, rest))
    return legs


def _angles(pose: Pose) -> FloatArray:
    return np.array([pose.pan, pose.tilt, pose.roll]) * DEG


def _of_paper(design: Design, name: str, method: str) -> Outlook:
    try:
        expected, open_turns = expected_of_paper(design, PAPER[method])
    except DataError as error:
        raise InputError(
            f"Protocol '{name}' is not enough for method {method}: {error}."
        ) from error
    warnings = []
    if open_turns is not None:
        warnings.append(
            f"The gyroscope will not be calibrated: {open_turns}; turn one servo at a time, each "
            "of the three both ways."
        )
    return Outlook(expected, tuple(warnings))


def _refuse_free_accelerometer(
    design: Design, plan: SessionPlan, jig: JigConfig, *, searched: bool
) -> None:
    directions = design.directions()
    free = np.flatnonzero(magnitude_sigma(directions) > FREE_ACCEL)
    if not len(free):
        return
    names = [*NAMES, *(f"bias {axis}" for axis in AXES)]
    # Poses that come back to the same direction of gravity count once.
    count = len(np.unique(np.round(directions, 2), axis=0))
    left = "everything" if len(free) == len(names) else _list([names[i] for i in free])
    actions = [MORE_REACH]
    if not searched:
        actions = [_poses_to_add(design, plan, jig), "take a longer protocol, such as full"]
    able = [m for m, model in PAPER.items() if _enough_for_paper(design, model)]
    if able and not searched:
        actions.append(f"or --method {able[0]}, which trusts the jig's angles")
    raise InputError(
        f"Protocol '{plan.protocol.name}' cannot determine the accelerometer: gravity points "
        f"{count} way{'s' if count > 1 else ''} in it, which leaves {left} open (nine parameters "
        f"need nine ways or more that are well spread, and {COMFORTABLE_POSES} are advised); "
        f"{', '.join(actions)}."
    )


def _enough_for_paper(design: Design, model: Model) -> bool:
    try:
        expected_of_paper(design, model)
    except DataError:
        return False
    return True


def _poses_to_add(design: Design, plan: SessionPlan, jig: JigConfig) -> str:
    """Name poses within the jig's reach that tell most about what is open."""
    low, high = jig.tilt.limits_deg
    tilts = [t for t in (0, 45, -45, 60, -60, 90, -90) if low <= t <= high]
    low, high = jig.roll.limits_deg
    rolls = [r for r in range(-180, 181, 45) if low <= r <= high]
    angles = np.array([(0.0, t, r) for t, r in product(tilts, rolls)]) * DEG
    first = design.mounting[0]
    up = design.directions_at(angles, np.full(len(angles), first))
    chosen = choose(up, design.directions())
    if not chosen:
        return "add poses in between, or take a longer protocol, such as full"
    by_tilt: dict[float, list[float]] = {}
    for i in chosen:
        _, tilt, roll = np.round(angles[i] / DEG)
        by_tilt.setdefault(tilt, []).append(roll)
    text = _list(
        [
            f"tilt {tilt:g} with roll {_list([f'{roll:g}' for roll in sorted(found)])}"
            for tilt, found in sorted(by_tilt.items())
        ]
    )
    closed = np.concatenate((design.directions(), up[list(chosen)]))
    if np.any(magnitude_sigma(closed) > FREE_ACCEL):
        return f"{_second_mounting(plan)}, with poses at {text} in both"
    return f"add poses at {text}"


def _refuse_free_gyroscope(
    expected: ExpectedUncertainty,
    design: Design,
    plan: SessionPlan,
    jig: JigConfig,
    *,
    searched: bool,
) -> None:
    figures = expected.gyro
    if figures is None:
        return
    scales = [a for a, u in zip(AXES, figures.scale_percent_u, strict=True) if u > FREE_SCALE]
    crossed = [
        n for n, u in zip(figures.cross_names, figures.cross_rad_u, strict=True) if u > FREE_CROSS
    ]
    if not scales and not crossed:
        return
    # Column j of the gain is what a turn about axis j does.
    axes = sorted(set(scales) or {name[1] for name in crossed})
    what = [f"scale {axis}" for axis in scales] + [f"cross-axis {name}" for name in crossed]
    turns = _list([_turn_to_add(axis, design, plan, jig) for axis in axes])
    reason = _why(design)
    action = f"add turns by 90 degrees or more from one pose to the next: {turns}"
    raise InputError(
        f"Protocol '{plan.protocol.name}' cannot determine {_list(what)} of the gyroscope{reason}; "
        f"{MORE_REACH if searched else action}."
    )


def _turn_to_add(axis: str, design: Design, plan: SessionPlan, jig: JigConfig) -> str:
    """Say which servo turns a sensor axis while that axis is level."""
    turn = np.asarray(design.mounting_turns[design.mounting[0]])
    plate = rotation.rotate(rotation.from_rotation_vector(turn), np.eye(3)["xyz".index(axis)])
    along = int(np.argmax(np.abs(plate)))
    if along == 0:
        return f"roll at tilt 0 for {axis}"
    if along == 1:
        return f"tilt at roll 0 or 180 for {axis}"
    low, high = jig.roll.limits_deg
    if low > -90 and high < 90:
        return f"{_second_mounting(plan)} for {axis}"
    return f"tilt at roll 90 or -90 for {axis}"


def _why(design: Design) -> str:
    """Say what the turns there are lack."""
    moved = [
        (np.abs(leg.end - leg.start) / DEG, leg)
        for legs in design.legs
        for leg in legs
        if np.any(leg.start != leg.end)
    ]
    pan, tilt, roll = (np.array([turn[i] for turn, _ in moved] or [0.0]) for i in range(3))
    steep = np.array([abs(leg.start[1]) / DEG >= LEVEL_TILT for _, leg in moved] or [True])
    if not np.any(pan + tilt + roll):
        return ", because nothing turns"
    if not np.any(tilt + roll):
        return ", because pan turns about gravity, which does not see the angle"
    if np.any(roll) and np.all(steep[roll > 0]):
        return f", because roll turns only where the arm stands steep (tilt {LEVEL_TILT:g} or more)"
    if not np.any(roll):
        return ", because roll never turns"
    if not np.any(tilt):
        return ", because tilt never turns"
    return ""


def _warnings(design: Design, plan: SessionPlan, jig: JigConfig, *, searched: bool) -> list[str]:
    found = []
    directions = design.directions()
    m = len(directions)
    if m < COMFORTABLE_POSES:
        found.append(
            f"{m} poses for nine accelerometer parameters leave the fit fragile ({m - 9} to "
            f"spare, {COMFORTABLE_POSES - 9} advised): "
            f"{'allow more time' if searched else _poses_to_add(design, plan, jig)}."
        )
    spread = magnitude_sigma(directions)[[0, 3, 5]].max()
    best = magnitude_sigma(sphere(m))[[0, 3, 5]].max()
    if m >= COMFORTABLE_POSES and spread > SHORT * best:
        tilt, roll = (np.abs(design.angles[:, i]).max() / DEG for i in (1, 2))
        action = MORE_REACH
        if not searched:
            action = f"{_poses_to_add(design, plan, jig)}, or {_second_mounting(plan)}"
        found.append(
            f"Poses with tilt up to {tilt:.0f} and roll up to {roll:.0f} degrees show gravity too "
            f"little of some axis: the accelerometer's scale will be {spread / best:.0f} times as "
            f"uncertain as from poses all around; {action}."
        )
    if np.ptp(design.angles[:, 0]) < 30.0 * DEG:
        found.append(
            "Pan stays where it is, so that a base that is not level cannot be told from the "
            "zero of the tilt axis: "
            + (
                "allow it a reach of 90 degrees."
                if searched
                else "let it alternate between two angles 90 degrees apart."
            )
        )
    return found


def _second_mounting(plan: SessionPlan) -> str:
    more = "another" if plan.protocol.mountings else "a second"
    return f"add {more} mounting, the sensor turned by 90 degrees about the tilt axis"


def _list(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]
