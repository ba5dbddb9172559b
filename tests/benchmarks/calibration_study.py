"""How accurate calibrations are, how true their intervals, and which faults they name.

A study over simulated sessions with known truth::

    python tests/benchmarks/calibration_study.py accuracy --sessions 80
    python tests/benchmarks/calibration_study.py coverage --sessions 200 --variant designed
    python tests/benchmarks/calibration_study.py faults --sessions 20 --json faults.json

Errors are those of figures that do not depend on the frame of K. An accelerometer that is not
linear has two truths: its best line over gravity, which is what poses at rest show, and its gain at
zero input; each statement is scored against its own.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import re
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.calibration.model import Affine, PhysicalFigures, physical_figures, sensor_frame
from imu_rig.calibration.result import CalibrationResult
from imu_rig.calibration.session import CommandedPoses, CommandedTurn
from imu_rig.calibration.solve import METHODS, solve
from imu_rig.devices.jig import load_jig
from imu_rig.errors import ImuRigError
from imu_rig.session.plan import PlannedStep, plan_session
from imu_rig.session.protocol import load_protocol
from imu_rig.units import DEG, MILLI_G
from simulators.config import RigConfig
from simulators.imu_kinds import DEFAULT_KIND
from simulators.jig import Jig
from simulators.pose_errors import draw_pose_errors
from simulators.quick_session import QuickSession, SessionFaults, quick_session
from simulators.rig import AffineTruth
from simulators.servo import Servo

PROCESSES = 2
PERCENT_OF_FULL_SCALE = (1.0 / 100.0 * 2.0 / 2.0**2, 1.0 / 100.0 * 2.0 / 2.0**3)
"""Quadratic and cubic share of 1 g at 1 g that err by 1 % of the full scale of 2 g, at 2 g."""

GROUPS = {
    "accel scale": "%",
    "accel non-orth": "mrad",
    "accel bias": "mg",
    "gyro scale": "%",
    "gyro cross": "mrad",
    "gyro bias": "deg/s",
    "accel scale at zero": "%",
    "accel bias at zero": "mg",
}
DESIGNED_NONLINEARITY = 0.2  # % of full scale, a limit
NORMAL_95 = 1.96
FAULT_SIGMAS = 1.5  # times the stated 95 % interval


# --- sessions -----------------------------------------------------------------------------------


@cache
def planned_steps(protocol: str) -> tuple[PlannedStep, ...]:
    """Return the stops of a built-in protocol that take part in a fit."""
    plan = plan_session(load_protocol(protocol), load_jig("paper-jig"))
    return tuple(step for step in plan.steps if step.kind != "check")


def designed(
    seed: int,
    *,
    percent: float = DESIGNED_NONLINEARITY,
    full: bool = False,
    imu: str = DEFAULT_KIND,
) -> RigConfig:
    """Draw a hobby jig and a sensor whose nonlinearity is within ``percent`` of 2 g.

    With ``full`` every term is at the limit, with a random sign.
    """
    config = RigConfig.random(seed, imu=imu)
    rng = np.random.default_rng([seed, 77])
    share = rng.uniform(-1.0, 1.0, (2, 3))
    if full:
        share = np.sign(share)
    quadratic, cubic = share * percent * np.array(PERCENT_OF_FULL_SCALE)[:, np.newaxis]
    return with_sensor(
        config, accel_quadratic=tuple(quadratic.tolist()), accel_cubic=tuple(cubic.tolist())
    )


def with_sensor(config: RigConfig, **changes: Any) -> RigConfig:
    return config.model_copy(update={"sensor": config.sensor.model_copy(update=changes)})


def with_jig(config: RigConfig, **changes: Any) -> RigConfig:
    return config.model_copy(update={"jig": config.jig.model_copy(update=changes)})


def _noisy(seed: int) -> RigConfig:
    config = designed(seed)
    sensor = config.sensor
    return with_sensor(
        config,
        accel_noise_ug=2.0 * sensor.accel_noise_ug,
        gyro_noise_dps=2.0 * sensor.gyro_noise_dps,
    )


def _walking(seed: int) -> RigConfig:
    config = designed(seed)
    sensor = config.sensor
    return with_sensor(
        config,
        accel_walk_mg=3.0 * sensor.accel_walk_mg,
        gyro_walk_dps=3.0 * sensor.gyro_walk_dps,
    )


def _warming(seed: int) -> RigConfig:
    return with_sensor(
        designed(seed),
        powered_s=0.0,
        warm_up_c=8.0,
        accel_offset_mg_per_c=0.5,
        accel_gain_percent_per_c=0.02,
        gyro_offset_dps_per_c=0.03,
    )


def _g_sensitive(seed: int) -> RigConfig:
    matrix = np.random.default_rng([seed, 78]).normal(0.0, 0.1 / np.sqrt(3.0), (3, 3))
    return with_sensor(designed(seed), g_sensitivity=tuple(tuple(row) for row in matrix.tolist()))


VARIANTS: dict[str, Callable[[int], RigConfig]] = {
    "designed": designed,
    "noise x2": _noisy,
    "walk x3": _walking,
    "vibration 20 mg": lambda seed: with_jig(designed(seed), vibration_mg=20.0),
    "warm-up 8 C": _warming,
    "g-sensitivity 0.1 deg/s/g": _g_sensitive,
    "nonlinearity 0.5 %": lambda seed: designed(seed, percent=0.5, full=True),
}
BREAKERS = ("warm-up 8 C", "g-sensitivity 0.1 deg/s/g", "nonlinearity 0.5 %")
"""Variants that a solver may not be able to bear, and then has to mention."""


def session_of(
    config: RigConfig, protocol: str = "full", faults: SessionFaults | None = None
) -> QuickSession:
    """Run a built-in protocol on a rig."""
    steps = planned_steps(protocol)
    turns = load_protocol(protocol).mounting_turns
    return quick_session(
        config,
        [(step.pose.pan, step.pose.tilt, step.pose.roll) for step in steps],
        hold_s=[step.hold_s for step in steps],
        mounting=[step.mounting for step in steps],
        mountings_deg=tuple((x / DEG, y / DEG, z / DEG) for x, y, z in turns),
        faults=faults,
    )


def commanded_of(session: QuickSession) -> CommandedPoses:
    """Return what a session tells a solver about its poses."""
    mountings = tuple((x * DEG, y * DEG, z * DEG) for x, y, z in session.mountings_deg)
    return CommandedPoses(
        session.angles_deg,
        turns=tuple(
            CommandedTurn(t.t0, t.t1, t.start_deg, t.stop_deg, mountings[session.mounting[t.pose]])
            for t in session.turns
        ),
        mounting=session.mounting,
        mounting_turns=mountings,
    )


def solved(session: QuickSession, method: str) -> CalibrationResult:
    """Solve a session by a method of the front door."""
    return solve(
        session.block,
        session.windows,
        method=method,
        gravity=session.truth.gravity,
        commanded=commanded_of(session),
    )


# --- scores -------------------------------------------------------------------------------------


@dataclass
class Score:
    """One solved session: errors and standard uncertainties by group, in the units of `GROUPS`.

    `half` holds the half widths of the stated 95 % intervals. `refused` is the sentence of a solver
    that gave up. `frame` holds errors of the frame [deg] by what they concern, `frame_half` the
    half widths of their stated intervals, where they are stated.
    """

    method: str
    error: dict[str, list[float]] = field(default_factory=dict)
    sigma: dict[str, list[float]] = field(default_factory=dict)
    half: dict[str, list[float]] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    findings: list[dict[str, Any]] = field(default_factory=list)
    refused: str = ""
    seconds: float = 0.0
    frame: dict[str, list[float]] = field(default_factory=dict)
    frame_half: dict[str, list[float]] = field(default_factory=dict)


def score(session: QuickSession, method: str) -> Score:
    """Solve a session and compare with its truth."""
    begin = time.process_time()
    try:
        result = solved(session, method)
    except ImuRigError as refusal:
        return Score(method, refused=str(refusal))
    scored = Score(method, seconds=time.process_time() - begin)
    scored.warnings = list(result.warnings)
    scored.findings = [
        {
            "kind": finding.kind,
            "axis": finding.axis,
            "poses": [int(pose) for pose in finding.poses],
            "size": float(finding.size),
            "text": finding.text,
        }
        for finding in getattr(result, "findings", ())
    ]
    line = _exact(session.accel_line)
    _compare(scored, "accel", physical_figures(result.accel), physical_figures(line), result.accel)
    if result.gyro is not None and result.gyro_figures is not None:
        true = physical_figures(_exact(session.truth.gyro), line)
        _compare(scored, "gyro", result.gyro_figures, true, result.gyro)
    at_zero = getattr(result, "accel_at_zero", None)
    if at_zero is not None:
        true = physical_figures(_exact(session.truth.accel))
        _compare(scored, "accel", physical_figures(at_zero), true, at_zero, " at zero")
    _score_frame(scored, session, result)
    return scored


def _exact(truth: AffineTruth) -> Affine:
    return Affine(truth.K, truth.b, np.zeros((12, 12)))


def _compare(
    scored: Score,
    sensor: str,
    found: PhysicalFigures,
    true: PhysicalFigures,
    affine: Affine,
    suffix: str = "",
) -> None:
    cross, bias = ("non-orth", MILLI_G) if sensor == "accel" else ("cross", DEG)
    parts = {
        "scale": (found.scale_percent, true.scale_percent, found.scale_percent_u, 1.0),
        cross: (found.cross_rad, true.cross_rad, found.cross_rad_u, 1e-3),
        "bias": (found.bias, true.bias, found.bias_u, bias),
    }
    for part, (value, truth, sigma, unit) in parts.items():
        group = f"{sensor} {part}{suffix}"
        if group in GROUPS:
            scored.error[group] = ((value - truth) / unit).tolist()
            scored.sigma[group] = (sigma / unit).tolist()
            scored.half[group] = (affine.coverage_factor * sigma / unit).tolist()


def _score_frame(scored: Score, session: QuickSession, result: CalibrationResult) -> None:
    """Compare where the sensor sits on the jig, as far as the method tells.

    A method that answers in the jig's frame states a whole rotation. One that answers in the
    sensor's own frame may state the direction of the roll axis in it, and how the sensor stands
    when the jig next goes to zero.
    """
    if result.frame == "jig":
        true_Q = sensor_frame(session.truth.accel.K)[0]
        turn = sensor_frame(result.accel.K)[0] @ true_Q.T @ session.mounting_matrices[0].T
        skewed = 0.5 * (turn - turn.T)
        scored.frame["mounting"] = _degrees((skewed[2, 1], skewed[0, 2], skewed[1, 0]))
    jig = getattr(result, "jig", None)
    if jig is None:
        return
    up, roll_axis = zero_pose(session)
    level = np.array([-up[0], up[1]])
    for part, estimate, true in (
        ("roll axis", (jig.roll_axis.value[0, 1:], jig.roll_axis.sigma[0, 1:]), roll_axis[1:]),
        ("level", (jig.level.value, jig.level.sigma), level),
    ):
        scored.frame[part] = _degrees(estimate[0] - true)
        scored.frame_half[part] = _degrees(NORMAL_95 * estimate[1])


def zero_pose(session: QuickSession) -> tuple[FloatArray, FloatArray]:
    """Visit once more the pose with all servos at zero.

    Returns the vertical in that pose, shape (3,), and the direction of the roll axis, shape (3,),
    in the sensor's own frame, in which the accelerometer's K is upper triangular.
    """
    model = session.truth.jig
    rng = np.random.default_rng(round(1e6 * abs(model.pan.zero_deg)))
    joints = np.zeros((1, 6))
    for joint, servo in enumerate((model.pan, model.tilt, model.roll)):
        stopped = Servo(servo, rng)
        for second, angle in enumerate((-6.0, 0.0)):  # from below, as in a session
            stopped.hear(stopped.pulse_us(angle), float(second))
        joints[0, joint] = stopped.target
    jig = Jig(model, gravity=1.0, earth_rate=(0.0,) * 3, field=(0.0,) * 3)
    rolled = joints.copy()
    rolled[:, 2] += 0.1
    turn = jig.attitude(joints)[0].T @ jig.attitude(rolled)[0]
    axis = np.array((turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]))
    joints[0, 3:] = draw_pose_errors(model, rng).wobble
    Q = sensor_frame(session.truth.accel.K)[0]
    return Q.T @ jig.attitude(joints)[0][2], Q.T @ axis / np.linalg.norm(axis)


def _degrees(angles: Any) -> list[float]:
    degrees: list[float] = (np.asarray(angles) / DEG).tolist()
    return degrees


# --- running ------------------------------------------------------------------------------------


def run(job: Callable[[Any], Any], tasks: Sequence[Any], processes: int = PROCESSES) -> list[Any]:
    """Do all tasks, several at a time, with progress on standard error."""
    done: list[Any] = []
    begin = time.monotonic()

    def collect(results: Iterable[Any]) -> list[Any]:
        for result in results:
            done.append(result)
            passed = time.monotonic() - begin
            print(
                f"\r{len(done)}/{len(tasks)}, {passed:.0f} s", end="", file=sys.stderr, flush=True
            )
        print(file=sys.stderr)
        return done

    if processes < 2:
        return collect(map(job, tasks))
    for threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(threads, "1")
    fresh = multiprocessing.get_context("spawn")  # which heeds the number of threads
    with ProcessPoolExecutor(processes, mp_context=fresh) as pool:
        return collect(pool.map(job, tasks))


def table(title: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print columns of text."""
    cells = [list(head), *(list(row) for row in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(head))]
    print(f"\n{title}")
    for row in cells:
        first, *others = (cell for cell in row)
        padded = [first.ljust(widths[0])]
        padded += [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        print("  ".join(padded))


def _pooled(scores: Iterable[Score], name: str, group: str) -> FloatArray:
    parts = [getattr(scored, name).get(group, []) for scored in scores]
    return np.array([value for part in parts for value in part])


# --- accuracy -----------------------------------------------------------------------------------

ACCURACY_CASES: dict[str, Callable[[int], RigConfig]] = {
    "uniform within 0.2 %": designed,
    "0.2 % everywhere, random sign": lambda seed: designed(seed, full=True),
}


def accuracy_job(task: tuple[str, int, str, tuple[str, ...]]) -> tuple[str, int, list[Score]]:
    """Solve one session by every method."""
    case, seed, protocol, methods = task
    session = session_of(ACCURACY_CASES[case](seed), protocol)
    return case, seed, [score(session, method) for method in methods]


def accuracy(arguments: argparse.Namespace) -> dict[str, Any]:
    """Print errors by method, on the same sessions."""
    methods = available(arguments.methods)
    seeds = range(arguments.seed, arguments.seed + arguments.sessions)
    cases = [case for case in ACCURACY_CASES if arguments.variant in (None, case)]
    tasks = [(case, seed, arguments.protocol, methods) for case in cases for seed in seeds]
    results = run(accuracy_job, tasks, arguments.processes)
    for case in cases:
        by_method = {
            method: [
                s for c, _, scores in results if c == case for s in scores if s.method == method
            ]
            for method in methods
        }
        groups = [
            group
            for group in GROUPS
            if any(_pooled(scores, "error", group).size for scores in by_method.values())
        ]
        rows = [
            [
                f"{group} [{GROUPS[group]}]",
                *(_two(_pooled(scores, "error", group)) for scores in by_method.values()),
            ]
            for group in groups
        ]
        for part in ("mounting", "roll axis", "level"):
            rows.append([f"{part} [deg]", *(_frame(v, part) for v in by_method.values())])
        rows.append(
            ["refused", *(str(sum(bool(s.refused) for s in v)) for v in by_method.values())]
        )
        rows.append(
            [
                "time [s]",
                *(f"{np.median([s.seconds for s in scores]):.2f}" for scores in by_method.values()),
            ]
        )
        title = f"{case} nonlinearity, {len(seeds)} sessions: median / 95th percentile of the error"
        table(title, ["", *by_method], rows)
    return {f"{case} {seed}": [vars(s) for s in scores] for case, seed, scores in results}


def _two(errors: FloatArray) -> str:
    if not errors.size:
        return "-"
    size = np.abs(errors)
    return f"{np.median(size):.4f} / {np.quantile(size, 0.95):.4f}"


def _frame(scores: list[Score], part: str) -> str:
    errors = np.array([error for s in scores for error in s.frame.get(part, [])])
    halves = np.array([half for s in scores for half in s.frame_half.get(part, [])])
    if not errors.size:
        return "-"
    text = _two(errors)
    if not halves.size:
        return text
    return f"{text} (+-{np.median(halves):.2f} covers {np.mean(np.abs(errors) <= halves):.3f})"


# --- coverage -----------------------------------------------------------------------------------


def coverage_job(task: tuple[str, int, str, str]) -> tuple[str, int, Score]:
    """Solve one session of a variant."""
    variant, seed, protocol, method = task
    return variant, seed, score(session_of(VARIANTS[variant](seed), protocol), method)


def coverage(arguments: argparse.Namespace) -> dict[str, Any]:
    """Print how often the stated 95 % intervals contain the truth."""
    method = available(arguments.methods)[0]
    seeds = range(arguments.seed, arguments.seed + arguments.sessions)
    variants = [v for v in VARIANTS if arguments.variant in (None, v)]
    tasks = [(v, seed, arguments.protocol, method) for v in variants for seed in seeds]
    results = run(coverage_job, tasks, arguments.processes)
    of = {v: [scored for name, _, scored in results if name == v] for v in variants}
    groups = [g for g in GROUPS if any(_pooled(scores, "error", g).size for scores in of.values())]
    table(
        f"method {method}, {len(seeds)} sessions each: share within the stated 95 % (rms of z)",
        ["", *groups],
        [[v, *(_covered(of[v], group) for group in groups)] for v in variants],
    )
    table(
        "warnings",
        ["", "sessions with one", "refused", "first words"],
        [
            [
                v,
                str(sum(bool(s.warnings) for s in of[v])),
                str(sum(bool(s.refused) for s in of[v])),
                _first_words(of[v]),
            ]
            for v in variants
        ],
    )
    return {f"{v} {seed}": vars(scored) for v, seed, scored in results}


def _covered(scores: list[Score], group: str) -> str:
    error = _pooled(scores, "error", group)
    if not error.size:
        return "-"
    within = np.mean(np.abs(error) <= _pooled(scores, "half", group))
    z = error / _pooled(scores, "sigma", group)
    return f"{within:.3f} ({np.sqrt(np.mean(z**2)):.2f})"


def _first_words(scores: list[Score]) -> str:
    words = Counter(" ".join(w.split()[:6]) for s in scores for w in [*s.warnings, s.refused] if w)
    return "; ".join(f"{number} x {start}" for start, number in words.most_common(4)) or "-"


# --- faults -------------------------------------------------------------------------------------

CLIP_AT = 9.3  # m/s^2
SLIP_DEG = 5.0
SLIP_SIZE_DEG = 1.5  # by which a slip's stated size may err

FAULTS = (
    "clean",
    "clean, linear",
    "swapped",
    "clipped z",
    "time x2",
    "time x0.5",
    "slip pan",
    "slip tilt",
    "slip roll",
    "bumped",
)


def fault_of(name: str, seed: int, poses: int) -> SessionFaults:
    """Draw the place of a fault in a session."""
    rng = np.random.default_rng([seed, 79])
    first, second = (int(p) for p in rng.choice(poses, 2, replace=False))
    at = int(rng.integers(3, poses - 3))
    sign = float(rng.choice((-1.0, 1.0)))
    match name.split():
        case ["swapped"]:
            return SessionFaults(swapped=(first, second))
        case ["clipped", axis]:
            return SessionFaults(clipped=("xyz".index(axis), CLIP_AT))
        case ["time", factor]:
            return SessionFaults(time_factor=float(factor[1:]))
        case ["slip", axis]:
            number = ("pan", "tilt", "roll").index(axis)
            return SessionFaults(slip=(number, at, sign * SLIP_DEG))
        case ["bumped"]:
            return SessionFaults(bumped=at)
        case _:
            return SessionFaults()


def named_right(name: str, faults: SessionFaults, scored: Score) -> bool:
    """Return whether a solver said what happened: the kind, and where."""
    found = scored.findings
    match name.split():
        case ["clean"]:  # whose sensor is not linear, and may be said to be so
            others = set(scored.warnings) - {f["text"] for f in found if f["kind"] == "nonlinear"}
            return not (others or scored.refused)
        case ["clean,", "linear"]:
            return not (found or scored.warnings or scored.refused)
        case ["swapped"]:
            named = {p for f in found if f["kind"] == "mislabelled" for p in f["poses"]}
            return faults.swapped is not None and named == set(faults.swapped)
        case ["clipped", axis]:
            said = any(f"Axis {axis} of the accelerometer is at its" in w for w in scored.warnings)
            return said or any(f["kind"] == "saturated" and f["axis"] == axis for f in found)
        case ["time", _]:
            said = re.search(r"sample rate|time base|clock", scored.refused)
            return said is not None or any(f["kind"] == "rate" for f in found)
        case ["slip", axis]:
            return faults.slip is not None and any(
                f["kind"] == "slip"
                and f["axis"] == axis
                and f["poses"]
                and abs(f["poses"][0] - faults.slip[1]) <= 1
                and abs(f["size"] - faults.slip[2]) <= SLIP_SIZE_DEG
                for f in found
            )
        case _:
            return any(f["kind"] == "bumped" and f["poses"] == [faults.bumped] for f in found)


def fault_job(task: tuple[str, int, str, str]) -> tuple[str, int, bool, Score]:
    """Solve one session with a fault."""
    name, seed, protocol, method = task
    faults = fault_of(name, seed, len(planned_steps(protocol)))
    percent = 0.0 if name == "clean, linear" else DESIGNED_NONLINEARITY
    scored = score(session_of(designed(seed, percent=percent), protocol, faults), method)
    return name, seed, named_right(name, faults, scored), scored


def faults(arguments: argparse.Namespace) -> dict[str, Any]:
    """Print how many faults were named right, and what they did to the figures."""
    method = available(arguments.methods)[0]
    seeds = range(arguments.seed, arguments.seed + arguments.sessions)
    names = [name for name in FAULTS if arguments.variant in (None, name)]
    tasks = [(name, seed, arguments.protocol, method) for name in names for seed in seeds]
    results = run(fault_job, tasks, arguments.processes)
    rows = []
    for name in names:
        scores = [scored for n, _, _, scored in results if n == name]
        right = sum(named for n, _, named, _ in results if n == name)
        kinds = Counter(f["kind"] for s in scores for f in s.findings)
        rows.append(
            [
                name,
                f"{right}/{len(scores)}",
                str(sum(bool(s.refused) for s in scores)),
                f"{sum(_harmless(s) for s in scores)}/{len(scores)}",
                _share_within(scores),
                ", ".join(f"{number} {kind}" for kind, number in kinds.most_common()) or "-",
                _first_words(scores),
            ]
        )
    table(
        f"method {method}, {len(seeds)} sessions each; intervals are {FAULT_SIGMAS:g} x the stated "
        "95 %",
        ["", "named", "refused", "all within or refused", "share within", "findings", "said"],
        rows,
    )
    return {f"{n} {seed}": {"right": named, **vars(s)} for n, seed, named, s in results}


def _harmless(scored: Score) -> bool:
    if scored.refused:
        return True
    return all(
        abs(error) <= FAULT_SIGMAS * half
        for group in scored.error
        for error, half in zip(scored.error[group], scored.half[group], strict=True)
    )


def _share_within(scores: list[Score]) -> str:
    error = np.concatenate([_pooled(scores, "error", group) for group in GROUPS])
    half = np.concatenate([_pooled(scores, "half", group) for group in GROUPS])
    return f"{np.mean(np.abs(error) <= FAULT_SIGMAS * half):.4f}" if error.size else "-"


# --- command line -------------------------------------------------------------------------------


def available(methods: str) -> tuple[str, ...]:
    """Return the methods of a comma-separated list that there are."""
    return tuple(method for method in methods.split(",") if method in METHODS)


def main() -> None:
    """Run one part of the study."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts = {"accuracy": (accuracy, 80), "coverage": (coverage, 200), "faults": (faults, 20)}
    choices = parser.add_subparsers(dest="part", required=True)
    for name, (function, sessions) in parts.items():
        part = choices.add_parser(name, help=function.__doc__)
        part.add_argument("--sessions", type=int, default=sessions)
        part.add_argument("--seed", type=int, default=1000, help="of the first session")
        part.add_argument("--protocol", default="full", help="a built-in protocol")
        part.add_argument(
            "--methods",
            default="joint,paper,multi-position",
            help="with commas between; coverage and faults take the first that exists",
        )
        part.add_argument("--variant", help="one line of the table only")
        part.add_argument("--processes", type=int, default=PROCESSES)
        part.add_argument("--json", type=Path, help="where to write every score")
    arguments = parser.parse_args()
    scores = parts[arguments.part][0](arguments)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(scores, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
