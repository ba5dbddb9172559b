"""Designing a protocol for a jig and a time: a structured list of poses, then a search around it.

The structured list is a ring of roll angles, at each of them tilt level first and then one, two or
four excursions up and down, with pan alternating between two values from one roll angle to the
next. It is within some percent of the best and can be read. The search shifts, turns around and
swaps poses of it, and its result is taken only where it is clearly better.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.calibration.expected import expected_sensors
from imu_rig.calibration.multi_position import COMFORTABLE_POSES
from imu_rig.devices.jig_config import JigConfig
from imu_rig.errors import InputError
from imu_rig.session.observability import Outlook, design_of, outlook
from imu_rig.session.plan import SessionPlan, plan_session
from imu_rig.session.protocol import AXIS_NAMES, AxisName, JigProtocol, Mounting, Step
from imu_rig.units import DEG, MILLI_G

SHORTEST_HOLD_S, LONGEST_HOLD_S = 0.8, 4.0
"""Below, settling eats the hold; above, more poses tell more than longer ones."""
LIKELY_HOLDS_S = (0.8, 1.2, 1.6, 2.0, 2.5, 3.2)
MOST_POSES = 48
LEAST_TURN = 15.0
"""A search keeps neighbouring poses this far apart in some axis [deg]."""
SNAP = 5.0
"""Angles of a searched list are multiples of it [deg]."""
ACCEL_GOAL = (0.02e-2, 0.1e-3, 0.08 * MILLI_G)
"""Standard uncertainties that count as equally good: scale [1], lean [rad], bias [m/s^2]."""
GYRO_GOAL = (0.01e-2, 0.1e-3, 0.001 * DEG)
"""The same of a gyroscope, bias in rad/s."""
WARM, COLD = 0.03, 0.002
"""How much worse a step of the search may be, at its begin and its end."""
CLEARLY = 0.97
"""A searched list is taken only if it is this much better than the one that can be read."""
WORTH_TURNING = 1.5
"""A second mounting is proposed where it makes the worst figure this much better."""
FULL_TILT, FULL_ROLL = 75.0, 135.0
"""Reach to both sides that shows gravity enough of every axis [deg]."""
SEARCH = 120
MOUNTINGS = (
    Mounting(
        name="flat",
        instruction="Fix the IMU flat on the plate, its x axis along the roll axis and its z axis "
        "up.",
    ),
    Mounting(
        name="on its end",
        instruction="Turn the IMU by 90 degrees about the tilt axis, so that its x axis points "
        "down.",
        axis=(0.0, 1.0, 0.0),
        angle_deg=90.0,
    ),
)
Angles = tuple[float, float, float]
Range = tuple[float, float]


@dataclass(frozen=True)
class Task:
    """What a protocol is designed for.

    ``reach`` are the angles that poses may have [deg], within the limits of the jig; ``time_s`` is
    the jig's time, without what a person takes to turn the sensor over.
    """

    jig: JigConfig
    reach: Mapping[AxisName, Range]
    time_s: float
    mountings: int = 1
    gyro_only: bool = False
    name: str = "planned"
    title: str = ""

    @staticmethod
    def on(
        jig: JigConfig,
        time_s: float,
        *,
        reach: Mapping[AxisName, float] | None = None,
        mountings: int = 1,
        gyro_only: bool = False,
        name: str = "planned",
    ) -> Task:
        """Describe a task by the largest angle of each axis [deg]; the jig's limits by default.

        Raises
        ------
        InputError
            If nothing of an axis' limits is within its reach.
        """
        ranges: dict[AxisName, Range] = {}
        for axis in AXIS_NAMES:
            low, high = getattr(jig, axis).limits_deg
            most = (reach or {}).get(axis, 360.0)
            ranges[axis] = (max(low, -most), min(high, most))
            if ranges[axis][0] > ranges[axis][1]:
                raise InputError(
                    f"The limits of {axis} in jig '{jig.name}' ({low:g} to {high:g} deg) leave "
                    f"nothing within a reach of {most:g} deg."
                )
        return Task(jig, ranges, time_s, mountings, gyro_only, name)


@dataclass(frozen=True)
class Stop:
    """One pose of a list under design: pan, tilt, roll [deg], and the mounting, from 0."""

    angles: Angles
    mounting: int


@dataclass(frozen=True)
class Designed:
    """A protocol with its plan and what it is expected to tell.

    ``structured`` tells whether the readable list was kept; ``score`` is its worst figure over
    its goal; ``turned_over`` that of the same task with a second mounting, where it is worth it.
    """

    protocol: JigProtocol
    plan: SessionPlan
    outlook: Outlook
    score: float
    structured: bool
    turned_over: float | None = None


def design_protocol(
    task: Task,
    *,
    search: int = SEARCH,
    seed: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Designed:
    """Design a protocol; the same task gives the same protocol.

    Parameters
    ----------
    task : Task
        Jig, reach, time and what counts.
    search : int
        Steps of the search; 0 keeps the structured list.
    seed : int
        Of the search.
    progress : callable
        Told how many steps of how many are done.

    Raises
    ------
    InputError
        If the time is too short, or the poses within reach do not determine the sensor.
    """
    stops, score = _best_structured(task)
    _refuse_undetermined(task, stops)
    # A step costs as the square of the poses or more.
    steps = round(search * min(1.0, (24 / len(stops)) ** 2))
    found, best = _search(task, stops, score, steps, seed, progress)
    structured = best > CLEARLY * score
    if structured:
        found, best = stops, score
    plan = _must(_planned(task, found))
    told = outlook(plan, task.jig, "joint", searched=True)
    turned_over = None
    if task.mountings == 1 and _short(task):
        other = _best_structured(replace(task, mountings=2))[1]
        turned_over = other if other * WORTH_TURNING < best else None
    return Designed(plan.protocol, plan, told, best, structured, turned_over)


def _refuse_undetermined(task: Task, stops: Sequence[Stop]) -> None:
    """Refuse a list that leaves a parameter open; propose a second mounting where that helps."""
    try:
        outlook(_must(_planned(task, stops)), task.jig, "joint", searched=True)
    except InputError as error:
        if task.mountings > 1:
            raise
        try:
            _refuse_undetermined(*_turned_over(task))
        except InputError:
            raise error from None
        raise InputError(
            f"{str(error).removesuffix('.')}, or take --mountings 2 (the sensor turned over once "
            "by hand), which determines everything within this reach."
        ) from error


def _turned_over(task: Task) -> tuple[Task, list[Stop]]:
    """Return the same task with a second mounting, and its readable list."""
    other = replace(task, mountings=2)
    return other, _best_structured(other)[0]


def _must(plan: SessionPlan | None) -> SessionPlan:
    """Return the plan of a list that is known to fit."""
    if plan is None:
        raise InputError("the poses do not fit the time")
    return plan


def _short(task: Task) -> bool:
    """Whether the reach leaves gravity little of some axis to see."""
    tilt, roll = task.reach["tilt"], task.reach["roll"]
    return min(-tilt[0], tilt[1]) < FULL_TILT or min(-roll[0], roll[1]) < FULL_ROLL


def _best_structured(task: Task) -> tuple[list[Stop], float]:
    """Choose numbers of roll angles and excursions by the time there is."""
    fitting: list[tuple[int, float, list[Stop]]] = []
    least = float("inf")
    for excursions in (1, 2, 4):
        for rolls in range(3, MOST_POSES // (1 + excursions) + 1):
            stops = structured(task, rolls, excursions)
            travel = _travel(task, stops)
            least = min(least, travel + SHORTEST_HOLD_S * len(stops))
            hold = _hold(task, stops, travel)
            if hold is not None:
                fitting.append((excursions, hold, stops))
    if not fitting:
        raise InputError(
            f"{task.time_s:g} s are too short to calibrate on jig '{task.jig.name}': allow "
            f"{_round_up(1.5 * least)} s or more."
        )
    # Below some poses each of them decides too much, whatever the expected figures say.
    fitting = [f for f in fitting if len(f[2]) >= COMFORTABLE_POSES] or fitting
    # More poses or longer holds: lists around these holds are worth a look.
    likely = {
        min(
            (i for i, f in enumerate(fitting) if f[0] == excursions),
            key=lambda i: abs(fitting[i][1] - hold),
        )
        for excursions in {f[0] for f in fitting}
        for hold in LIKELY_HOLDS_S
    }
    score, stops = float("inf"), fitting[0][2]
    for i in sorted(likely):
        found = _score(task, fitting[i][2])
        if found is not None and found < score:
            score, stops = found, fitting[i][2]
    return stops, score


def structured(task: Task, rolls: int, excursions: int) -> list[Stop]:
    """Return the readable list of ``rolls`` roll angles, shared among the mountings."""
    shares = [len(part) for part in np.array_split(np.arange(rolls), task.mountings)]
    stops = []
    for mounting, share in enumerate(shares):
        if not share:
            continue
        ring = _ring(task.reach["roll"], share, mounting)
        for number, roll in enumerate(ring):
            pan = _pans(task.reach["pan"])[number % 2]
            for tilt in _tilts(task.reach["tilt"], number, excursions):
                stops.append(Stop((pan, tilt, roll), mounting))
    return stops


def _ring(reach: Range, count: int, mounting: int) -> list[float]:
    low, high = max(reach[0], -180.0), min(reach[1], 180.0)
    step = 360.0 / count
    if high - low >= 360.0 - step:
        # In another mounting the ring stands between the angles of the first.
        begin = low + (0.5 * step if mounting % 2 and low + 360.0 - 0.5 * step <= high else 0.0)
        return [round(begin + i * step, 1) for i in range(count)]
    return [round(float(roll), 1) for roll in np.linspace(low, high, count)]


def _pans(reach: Range) -> tuple[float, float]:
    low, high = reach
    first = min(max(0.0, low), high)
    if first + 90.0 <= high:
        return first, first + 90.0
    if high - low >= 90.0:
        return high - 90.0, high
    return low, high


def _tilts(reach: Range, number: int, excursions: int) -> list[float]:
    low, high = reach
    level = min(max(0.0, low), high)
    size = (60.0, 45.0, 90.0, 45.0)[number % 4]
    tilts = [level]
    for part in (1.0, 0.5)[: max(1, excursions // 2)]:
        up, down = min(part * size, high), max(-part * size, low)
        # Where one side has no room, both excursions go to the other.
        if up - level < SNAP:
            up = 0.5 * (level + down)
        if level - down < SNAP:
            down = 0.5 * (level + up)
        both = [down, up] if number % 2 else [up, down]
        # A single one goes the other way on the other half of the ring.
        tilts += both if excursions > 1 else both[(number // 4) % 2 :][:1]
    return [round(tilt, 1) for tilt in tilts]


def _search(
    task: Task,
    stops: list[Stop],
    score: float,
    steps: int,
    seed: int,
    progress: Callable[[int, int], None],
) -> tuple[list[Stop], float]:
    """Anneal around a list, within reach and time."""
    rng = np.random.default_rng(seed)
    best, best_score = stops, score
    for step in range(steps):
        warmth = WARM * (COLD / WARM) ** (step / max(1, steps - 1))
        tried = _changed(task, stops, rng)
        found = _score(task, tried) if _apart(tried) else None
        if found is not None and found < score * (1.0 + warmth * rng.exponential()):
            stops, score = tried, found
            if score < best_score:
                best, best_score = stops, score
        progress(step + 1, steps)
    return best, best_score


def _changed(task: Task, stops: list[Stop], rng: np.random.Generator) -> list[Stop]:
    """Shift an angle of one pose, or turn around a part of the list."""
    changed = list(stops)
    i = int(rng.integers(len(stops)))
    kind = rng.random()
    if kind < 0.35:
        # Only within one mounting: it is changed once.
        same = [j for j, stop in enumerate(stops) if stop.mounting == stops[i].mounting]
        j = min(max(i + int(rng.integers(-4, 5)), same[0]), same[-1])
        a, b = min(i, j), max(i, j) + 1
        changed[a:b] = changed[a:b][::-1]
        return changed
    axis: AxisName = "pan" if kind < 0.5 else "tilt" if kind < 0.8 else "roll"
    place = AXIS_NAMES.index(axis)
    angles = list(stops[i].angles)
    if axis == "pan":
        first, second = _pans(task.reach["pan"])
        angles[0] = second if angles[0] == first else first
    else:
        low, high = task.reach[axis]
        shifted = angles[place] + rng.normal(0.0, 25.0)
        angles[place] = min(max(SNAP * round(shifted / SNAP), low), high)
    changed[i] = Stop((angles[0], angles[1], angles[2]), stops[i].mounting)
    return changed


def _apart(stops: Sequence[Stop]) -> bool:
    """Whether something turns between any two neighbours."""
    angles = np.array([stop.angles for stop in stops])
    turned_over = np.diff([stop.mounting for stop in stops]) != 0
    return bool(np.all((np.abs(np.diff(angles, axis=0)).max(axis=1) >= LEAST_TURN) | turned_over))


def _score(task: Task, stops: list[Stop]) -> float | None:
    """Worst figure over its goal, with a little of all; None beyond the time or undetermined."""
    plan = _planned(task, stops)
    if plan is None:
        return None
    accel, gyro = expected_sensors(design_of(plan, task.jig))
    # At a nominal sensor the figures are the elements of K and b themselves.
    groups = [] if task.gyro_only else [(accel, ACCEL_GOAL)]
    groups.append((gyro, GYRO_GOAL))
    parts: list[FloatArray] = []
    for affine, (scale, lean, bias) in groups:
        K = affine.K_uncertainty
        parts += [np.diag(K) / scale, K[~np.eye(3, dtype=bool)] / lean, affine.b_uncertainty / bias]
    figures = np.concatenate(parts)
    return float(figures.max() + 0.2 * np.sqrt(np.mean(figures**2)))


def _planned(task: Task, stops: Sequence[Stop]) -> SessionPlan | None:
    """Plan with holds that fill the time; None if it does not reach."""
    travel = _travel(task, stops)
    hold = _hold(task, stops, travel)
    return None if hold is None else plan_session(_protocol(task, stops, hold), task.jig)


def _travel(task: Task, stops: Sequence[Stop]) -> float:
    plan = plan_session(_protocol(task, stops, 1.0), task.jig)
    return plan.duration_s - len(stops)


def _hold(task: Task, stops: Sequence[Stop], travel: float) -> float | None:
    hold = np.floor(20.0 * (task.time_s - travel) / len(stops)) / 20.0
    return None if hold < SHORTEST_HOLD_S else float(min(hold, LONGEST_HOLD_S))


def _protocol(task: Task, stops: Sequence[Stop], hold: float) -> JigProtocol:
    steps: list[Step] = []
    before: Stop | None = None
    for stop in stops:
        told: dict[str, float | int] = {
            axis: angle
            for i, (axis, angle) in enumerate(zip(AXIS_NAMES, stop.angles, strict=True))
            if before is None or before.angles[i] != angle
        }
        if task.mountings > 1 and (before is None or before.mounting != stop.mounting):
            told["mounting"] = stop.mounting + 1
        steps.append(Step.model_validate(told))
        before = stop
    title = task.title or f"{len(stops)} poses"
    mountings = MOUNTINGS[: task.mountings] if task.mountings > 1 else ()
    return JigProtocol(
        name=task.name, title=title, hold_s=hold, steps=tuple(steps), mountings=mountings
    )


def _round_up(seconds: float) -> int:
    return int(5 * np.ceil(seconds / 5.0))
