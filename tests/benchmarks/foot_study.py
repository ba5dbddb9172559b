"""How good the foot smoother is over walks and sensors of which the truth is known.

A study in simulation; every walk is simulated once and read by many sensors of three grades::

    python tests/benchmarks/foot_study.py walks --sensors 3
    python tests/benchmarks/foot_study.py loops --seeds 8 --sensors 6
    python tests/benchmarks/foot_study.py sprints
    python tests/benchmarks/foot_study.py nees --sensors 10
    python tests/benchmarks/foot_study.py uncalibrated --seeds 3 --sensors 7
    python tests/benchmarks/foot_study.py defaults

Position and heading are compared from the first sample on, where both are known by definition.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError
from imu_rig.gait.grade import SensorGrade
from imu_rig.gait.options import FootOptions, StanceOptions
from imu_rig.gait.smoother import smooth_foot
from imu_rig.gait.strides import gait_parameters
from imu_rig.gait.trajectory import FootTrack, Trajectory
from imu_rig.reference.planar import residual, root_mean_square
from imu_rig.rotation import about_z, conjugate, multiply, to_rotation_vector
from imu_rig.units import DEG, MILLI_G
from simulators.budget import Budget, draw_sensor
from simulators.inertial_sensor import InertialSensor
from simulators.mpu9150 import MPU9150_RANGES
from simulators.sampling import Means
from simulators.walker.grades import GRADES, read_as
from simulators.walker.scenarios import SCENARIOS, Scenario, Slide
from simulators.walker.sensor import SensorMotion
from simulators.walker.steps import Footfall
from simulators.walker.walker import Surroundings, Walker

RATE_HZ = 200.0
WALKS = tuple(name for name, one in SCENARIOS.items() if not isinstance(one.legs, Slide))
NUMBERS = {name: number for number, name in enumerate(SCENARIOS)}
NEES_WALKS = ("loop-80m", "straight-50m", "turns", "mixed", "running")
LOOP = "loop-80m"
LOOP_MARGIN = 1.3
UNCALIBRATED_WALK = "straight-50m"
SPRINTS = ("fast-run", "sprint")
SPRINT_STRIDE_M, SPRINT_ERROR = (2.8, 3.2), 0.03
CORRECTIONS = {
    "default": None,
    "none": SensorGrade(gyro_bias=1e-9, raw_odds=0.0),
    "full": SensorGrade(gyro_bias=10.0 * DEG, raw_odds=0.0),
}
"""The gyroscope's bias as the default has it, as zero, and as measured."""

PARTS = {"tilt": (0, 1), "yaw": (2,), "velocity": (3, 4, 5), "position": (6, 7, 8)}
SWING_MS = 0.2
"""A foot that is faster than this swings [m/s]."""

JUDGED = ("tilt", "yaw", "velocity", "position")

NEES = (0.3, 2.0)


# --- simulation ---------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Shape:
    """The exact motion of one foot on one walk.

    Attributes
    ----------
    means : Means
        What a perfect sensor reads.
    truth : SensorMotion
        In the middle of the intervals: a mean is nearest to what happens there.
    falls : list of Footfall
    """

    means: Means
    truth: SensorMotion
    falls: list[Footfall]

    def read(self, grade: str, sensor: int) -> ImuBlock:
        """Return what one sensor of a grade reads."""
        readings = read_as(grade, self.means, sensor)
        return ImuBlock(self.truth.t, readings.accel, readings.gyro, self.truth.t)


@cache
def shape_of(scenario: Scenario | str, seed: int) -> Shape:
    """Simulate a walk, once."""
    walker = Walker(scenario, seed, surroundings=Surroundings.ideal())
    sensor = walker.sensor("left-foot")
    ends = np.arange(1, int(walker.end_s * RATE_HZ) + 1) / RATE_HZ
    return Shape(sensor.means(ends, 0.0), sensor.at(ends - 0.5 / RATE_HZ), walker.falls[0])


def known(name: str) -> SensorGrade:
    """Return what a certificate would say of a sensor of a grade."""
    grade = GRADES[name]
    return SensorGrade(
        gyro_bias=grade.gyro_bias_dps * DEG,
        raw_odds=0.0,
        gyro_matrix=grade.matrix,
        accel_matrix=grade.matrix,
        accel_bias=grade.accel_bias_mg * MILLI_G,
        late_s=0.0,
    )


def reads(
    shapes: Sequence[str], grade: str, seeds: int, sensors: int
) -> Iterator[tuple[Shape, ImuBlock]]:
    """Yield walks of several people, each with several sensors of a grade."""
    for seed in range(1, seeds + 1):
        for name in shapes:
            shape = shape_of(name, seed)
            for sensor in range(sensors):
                yield shape, shape.read(grade, 10_000 * seed + 100 * NUMBERS[name] + sensor)


# --- scores -------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Errors:
    """Truth less estimate, the estimate turned and moved to agree with it at the first sample.

    Attributes
    ----------
    yaw : float
        By which the estimate was turned [rad].
    values : shape (n, 9)
        Of attitude (navigation axes) [rad], velocity and position.
    strides : shape (k - 1, 3)
        Of the displacements between footfalls [m].
    true_strides : shape (k - 1, 3)
    """

    yaw: float
    values: FloatArray
    strides: FloatArray
    true_strides: FloatArray

    @property
    def closure(self) -> float:
        """Horizontal error at the end [m]."""
        return float(np.hypot(*self.values[-1, 6:8]))

    @property
    def lengths(self) -> tuple[FloatArray, FloatArray]:
        """True lengths of strides on the plan, and their errors [m]."""
        true = np.linalg.norm(self.true_strides[:, :2], axis=1)
        return true, np.linalg.norm((self.true_strides - self.strides)[:, :2], axis=1) - true


def errors_of(track: FootTrack, truth: SensorMotion) -> Errors:
    """Compare a track with the truth at the same samples."""
    off = multiply(truth.attitude[0], conjugate(track.trajectory.quaternion[0]))
    yaw = float(2.0 * np.arctan2(off[3], off[0]))
    path: Trajectory = track.trajectory.turned(yaw)
    path = path.moved(truth.position[0] - path.position[0])
    attitude = to_rotation_vector(multiply(truth.attitude, conjugate(path.quaternion)))
    values = np.hstack((attitude, truth.velocity - path.velocity, truth.position - path.position))
    rows = track.footfalls.quietest
    true = np.diff(truth.position[rows], axis=0)
    return Errors(yaw, values, true - np.diff(path.position[rows], axis=0), true)


def path_error(track: FootTrack, truth: SensorMotion) -> float:
    """Return the horizontal root mean square error after the best turn and shift [m]."""
    return root_mean_square(residual(track.trajectory.position, truth.position)[:, :2])


def falls_found(track: FootTrack, shape: Shape) -> tuple[int, int]:
    """Return how many stays on the ground were missed, and how many footfalls were none."""
    t = shape.truth.t[track.footfalls.quietest]
    begins = np.array([fall.contact for fall in shape.falls])
    ends = np.array([fall.toe_off for fall in shape.falls])
    stay = np.searchsorted(begins, t, side="right") - 1
    on_ground = t <= ends[stay]
    found = len(np.unique(stay[on_ground]))
    return len(shape.falls) - found, len(t) - found


def squares(errors: FloatArray, covariance: FloatArray) -> FloatArray:
    """Normalized errors squared per degree of freedom, of (n, p) and (n, p, p)."""
    whitened = np.linalg.solve(covariance, errors[:, :, np.newaxis])[:, :, 0]
    return np.asarray(np.einsum("ni,ni->n", errors, whitened) / errors.shape[1])


def nees_of(track: FootTrack, truth: SensorMotion) -> dict[str, float]:
    """Return the mean normalized error squared over one walk, part by part.

    From the second footfall on: before, position and yaw are known by definition.
    """
    errors = errors_of(track, truth)
    uncertainty = track.covariance
    assert uncertainty is not None
    late = uncertainty.rows >= track.footfalls.quietest[min(1, len(track.footfalls) - 1)]
    turn = np.kron(np.eye(3), about_z(errors.yaw))
    values = turn @ uncertainty.values[late] @ turn.T
    rows = uncertainty.rows[late]
    scores = {}
    for part, index in PARTS.items():
        covariance = values[:, index, :][:, :, index]
        scores[part] = float(np.mean(squares(errors.values[rows][:, index], covariance)))
    speed = np.linalg.norm(truth.velocity[rows], axis=1)
    swings = speed > SWING_MS
    velocity = values[swings, 3:6, 3:6]
    scores["swing"] = float(np.mean(squares(errors.values[rows][swings, 3:6], velocity)))
    strides = turn[:3, :3] @ uncertainty.strides @ turn[:3, :3].T
    long = errors.lengths[0] > 0.2
    if long.any():
        along = errors.true_strides[long] * (1.0, 1.0, 0.0) / errors.lengths[0][long, np.newaxis]
        variance = np.einsum("ni,nij,nj->n", along, strides[long], along)
        short = np.einsum("ni,ni->n", along, errors.strides[long])
        scores["stride"] = float(np.mean(squares(errors.strides[long], strides[long])))
        scores["length"] = float(np.mean(short**2 / variance))
    return scores


# --- studies ------------------------------------------------------------------------------------


def study_walks(
    seeds: int, sensors: int, grades: Sequence[str], walks: Sequence[str] = WALKS
) -> bool:
    """Score every walk with every grade: distance, path, footfalls, height."""
    print("distance error: median, worst [%]; horizontal RMSE after best yaw and translation [m]")
    good = True
    for name in walks:
        for grade in grades:
            rows: list[tuple[float, ...]] = []
            for shape, block in reads((name,), grade, seeds, sensors):
                try:
                    track = smooth_foot(block)
                except DataError as refusal:
                    print(f"{name:15s} {grade:7s} refused: {refusal}", flush=True)
                    good = False
                    continue
                errors = errors_of(track, shape.truth)
                true, off = errors.lengths
                # Sums of strides, as a path that stands wanders on.
                share = 100.0 * off.sum() / true.sum() if true.sum() > 1.0 else 0.0
                height = np.abs(errors.values[track.footfalls.quietest, 8]).max()
                rise = np.ptp(shape.truth.position[track.footfalls.quietest, 2])
                rows.append(
                    (
                        share,
                        path_error(track, shape.truth),
                        height,
                        rise,
                        *falls_found(track, shape),
                    )
                )
            if not rows:
                continue
            table = np.array(rows)
            print(
                f"{name:15s} {grade:7s} distance {np.median(table[:, 0]):+6.2f} "
                f"({np.abs(table[:, 0]).max():5.2f})  RMSE {np.median(table[:, 1]):.3f} "
                f"({table[:, 1].max():.3f})  height off {table[:, 2].max():.3f} of "
                f"{table[:, 3].max():.2f}  missed {table[:, 4].sum():.0f} extra "
                f"{table[:, 5].sum():.0f}",
                flush=True,
            )
            good &= bool(np.all(table[:, 5] == 0))
    return good


def study_loops(seeds: int, sensors: int, grades: Sequence[str]) -> bool:
    """Score closed loops with the default bias correction, with none, and with all of it.

    Bias and creep of the standing foot turn a track alike, and nothing tells them apart. All
    sensors of one person share the creep: of somebody who stands perfectly still, full correction
    is best, of somebody who turns by a degree, none. It takes several people to judge.
    """
    good = True
    for grade in grades:
        closures: dict[str, list[float]] = {name: [] for name in CORRECTIONS}
        yaws: dict[str, list[float]] = {name: [] for name in CORRECTIONS}
        for shape, block in reads((LOOP,), grade, seeds, sensors):
            for name, correction in CORRECTIONS.items():
                try:
                    errors = errors_of(smooth_foot(block, grade=correction), shape.truth)
                except DataError:  # so far off that it is no foot
                    closures[name].append(np.inf)
                    yaws[name].append(180.0)
                    continue
                closures[name].append(errors.closure)
                yaws[name].append(errors.values[-1, 2] / DEG)
        median = {name: float(np.median(found)) for name, found in closures.items()}
        ratio = median["default"] / min(median["none"], median["full"])
        good &= ratio <= LOOP_MARGIN
        print(
            f"{grade:7s} default {ratio:.2f} times the better ({len(closures['none'])} loops "
            f"of {seeds} people)"
        )
        for name in CORRECTIONS:
            print(
                f"        {name:8s} closure median {median[name]:.2f} worst "
                f"{max(closures[name]):.2f} m, yaw rms {root_mean_square_of(yaws[name]):.2f} deg",
                flush=True,
            )
    return good


def study_sprints(
    seeds: int, sensors: int, grades: Sequence[str], walks: Sequence[str] = SPRINTS
) -> bool:
    """Score strides of 3 m: all found, each within 3 %."""
    good = True
    for name in walks:
        for grade in grades:
            off: list[float] = []
            missed = extra = falls = 0
            for shape, block in reads((name,), grade, seeds, sensors):
                try:
                    track = smooth_foot(block)
                except DataError as refusal:
                    print(f"{name} {grade} refused: {refusal}", flush=True)
                    good = False
                    continue
                lost, more = falls_found(track, shape)
                missed, extra, falls = missed + lost, extra + more, falls + len(shape.falls)
                true, error = errors_of(track, shape.truth).lengths
                long = (true > SPRINT_STRIDE_M[0]) & (true < SPRINT_STRIDE_M[1])
                off += (error[long] / true[long]).tolist()
            if not off:
                continue
            share = np.abs(off)
            good &= missed == 0 and extra == 0 and bool(share.max() < SPRINT_ERROR)
            print(
                f"{name:9s} {grade:7s} {falls} footfalls, missed {missed}, extra {extra}; "
                f"{len(off)} strides of 3 m: mean {100 * np.mean(off):+.2f} %, median off "
                f"{100 * np.median(share):.2f} %, worst {100 * share.max():.2f} %",
                flush=True,
            )
    return good


def study_nees(seeds: int, sensors: int, grades: Sequence[str]) -> bool:
    """Score the published covariance, of sensors of which nothing and of which all is known.

    Judged grade by grade where the grade is known. Of one of which nothing is known, more is
    allowed for than simulated sensors do: gains of a half percent, and clocks apart by 3 ms.
    """
    good = True
    for title, what in (("nothing known", lambda _: None), ("with a certificate", known)):
        everything: list[dict[str, float]] = []
        for grade in grades:
            scores = []
            for shape, block in reads(NEES_WALKS, grade, seeds, sensors):
                try:
                    track = smooth_foot(block, grade=what(grade), covariance=True)
                except DataError as refusal:
                    print(f"{grade} refused: {refusal}", flush=True)
                    good = False
                    continue
                scores.append(nees_of(track, shape.truth))
            everything += scores
            print(f"{title:18s} {grade:7s} {_nees_line(scores)}", flush=True)
            if what is known:
                means = {part: np.mean([score[part] for score in scores]) for part in JUDGED}
                good &= all(NEES[0] <= mean <= NEES[1] for mean in means.values())
        print(f"{title:18s} all     {_nees_line(everything)}", flush=True)
    return good


def _nees_line(scores: list[dict[str, float]]) -> str:
    parts = []
    for part in (*PARTS, "swing", "stride", "length"):
        values = [score[part] for score in scores if part in score]
        parts.append(f"{part} {np.mean(values):.2f} ({np.median(values):.2f})")
    return ", ".join(parts) + f"; mean (median) of {len(scores)} runs"


def root_mean_square_of(values: Sequence[float]) -> float:
    """Root mean square of numbers."""
    return float(np.sqrt(np.mean(np.square(values))))


def study_uncalibrated(seeds: int, sensors: int, grades: Sequence[str]) -> bool:
    """Score the uncertainty of distances that chips measure as their data sheets allow them."""
    del grades
    off: list[float] = []
    for seed in range(1, seeds + 1):
        shape = shape_of(UNCALIBRATED_WALK, seed)
        for sensor in range(sensors):
            rng = np.random.default_rng(1000 * seed + sensor)
            chip = InertialSensor(draw_sensor(rng, Budget()), MPU9150_RANGES, rng)
            readings = chip.read(shape.means, None)
            t = shape.truth.t
            try:
                block = ImuBlock(t, readings.accel, readings.gyro, t)
                # Simulated chips read gyroscope and accelerometer at once.
                track = smooth_foot(block, grade=SensorGrade(late_s=0.0), covariance=True)
            except DataError as refusal:
                print(f"refused: {refusal}", flush=True)
                continue
            error = float(errors_of(track, shape.truth).lengths[1].sum())
            strides = gait_parameters(track)
            off.append(error / strides.distance_sigma)
            print(f"{strides.distance:.2f} +- {strides.distance_sigma:.2f} m, off {error:+.2f} m")
    rms = root_mean_square_of(off)
    print(f"off by {rms:.2f} sigma (rms), {100 * np.mean(np.abs(off) < 2.0):.0f} % within two")
    return 0.3**0.5 < rms < 2.0**0.5


def study_defaults(seeds: int, sensors: int, grades: Sequence[str]) -> bool:
    """Halve and double each default: how much path and distance change."""

    def score(options: FootOptions) -> tuple[float, float, int]:
        rms, off, wrong = [], [], 0
        for grade in grades:
            for shape, block in reads(DEFAULTS_WALKS, grade, seeds, sensors):
                try:
                    track = smooth_foot(block, options, grade=known(grade))
                except DataError:
                    wrong += 100
                    continue
                true, error = errors_of(track, shape.truth).lengths
                off.append(100.0 * abs(error.sum()) / true.sum())
                rms.append(path_error(track, shape.truth))
                wrong += sum(falls_found(track, shape))
        return float(np.mean(rms)), float(np.mean(off)), wrong

    usual = score(FootOptions())
    print(f"default: RMSE {usual[0]:.3f} m, distance off {usual[1]:.2f} %, footfalls {usual[2]}")
    for name, change in _changes():
        told = []
        for factor in (0.5, 2.0):
            rms, off, wrong = score(change(factor))
            told.append(
                f"x{factor:g} {100 * (rms / usual[0] - 1):+6.1f} % RMSE, {off - usual[1]:+.2f} % "
                f"distance, {wrong - usual[2]:+d} footfalls"
            )
        print(f"{name:22s} {' | '.join(told)}", flush=True)
    return True


DEFAULTS_WALKS = ("level-10m", "slow-shuffle", "turns", "running", "stairs-up")


def _changes() -> Iterator[tuple[str, Callable[[float], FootOptions]]]:
    usual = FootOptions()

    def of(name: str, inside: str | None) -> Callable[[float], FootOptions]:
        def change(factor: float) -> FootOptions:
            if inside is None:
                return replace(usual, **{name: factor * getattr(usual, name)})
            part: Any = getattr(usual, inside)
            return replace(usual, **{inside: replace(part, **{name: factor * getattr(part, name)})})

        return change

    for option in fields(StanceOptions):
        yield f"stance.{option.name}", of(option.name, "stance")
    for option in fields(FootOptions):
        if isinstance(getattr(usual, option.name), float) and option.name != "gravity":
            yield option.name, of(option.name, None)


STUDIES: dict[str, Callable[..., bool]] = {
    "walks": study_walks,
    "loops": study_loops,
    "sprints": study_sprints,
    "nees": study_nees,
    "uncalibrated": study_uncalibrated,
    "defaults": study_defaults,
}


def main() -> None:
    """Run one study."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("study", choices=STUDIES)
    parser.add_argument("--seeds", type=int, default=1, help="people per walk")
    parser.add_argument("--sensors", type=int, default=1, help="sensors per person and grade")
    parser.add_argument("--grades", default=",".join(GRADES))
    parser.add_argument("--only", help="one walk of the study of walks or sprints")
    told = parser.parse_args()
    only = ([told.only],) if told.only else ()
    good = STUDIES[told.study](told.seeds, told.sensors, told.grades.split(","), *only)
    print("within bounds" if good else "NOT within bounds")


if __name__ == "__main__":
    main()
