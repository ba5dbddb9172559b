"""What calibrating on the jig is worth for gait distance: Tables 1 to 3 of the published system.

Simulated sensors, each calibrated by a simulated session on a hobby jig, then worn on a foot over
10 m on another day, when its offsets are a little different::

    python tests/benchmarks/distance_study.py walks --walks 20
    python tests/benchmarks/distance_study.py detectors --walks 8

``walks`` measures each walk without and with its certificate, by the published method (threshold
and double integration) and by the default smoother. Where the sensor points at the start is known,
as on a marked line: yaw is counted from there. The errors of the sensors are drawn within 3 % of
scale, 2 % of cross-axis, 80 mg and 3 deg/s, which is worse than the data sheet's typical figures,
and again within a share of that. 1 deg/s fits the published distances before calibration better:
with more, an attitude tumbles that only the accelerometer corrects.

``detectors`` shows what the classic detectors' thresholds rest on: the least one that finds every
stance, and the greatest that finds none in a swing, at several speeds.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from calibration_study import run, session_of, solved, table

from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.certificate import apply_certificate, certificate_of
from imu_rig.errors import DataError
from imu_rig.gait.detectors import DETECTORS, detector_named
from imu_rig.gait.distance import WalkOptions, walk_distance
from imu_rig.gait.footfalls import runs
from imu_rig.gait.improvement import TrialComparison, compare_trials
from imu_rig.gait.smoother import smooth_foot
from imu_rig.rotation import about_z, to_matrix
from imu_rig.units import DEG, MILLI_G
from simulators.budget import Budget
from simulators.config import RigConfig
from simulators.inertial_sensor import InertialSensor
from simulators.walker.device import Carried
from simulators.walker.path import Straight
from simulators.walker.record import UnitRecord, record_walk
from simulators.walker.scenarios import Scenario
from simulators.walker.steps import Stand, Walk
from simulators.walker.walker import Walker

SCENARIO = "level-10m"
PUBLISHED = (31.40, 78.64, 69.71)
"""Mean improvement of the published trials along x, y and z [%]."""

DAY_ACCEL, DAY_GYRO = 2.5 * MILLI_G, 0.1 * DEG
"""By how much an offset differs from day to day, standard deviation per axis."""

SHARES = (1.0, 0.3)
"""Of the error budget."""

EDGE = 2
"""Samples at both ends of a swing that do not count: the foot leaves, or is there."""

SPEEDS = (0.5, 0.8, 1.2, 1.5, 1.8, 3.0)
METHODS = ("published method", "gyroscope zeroed at rest", "default smoother")


@dataclass(frozen=True, eq=False)
class Walked:
    """One walk: the true distance (3,) and those measured by each method, (2, 3) [m].

    Rows of the measured are without and with calibration; NaN where a trial was refused.
    """

    reference: FloatArray
    measured: dict[str, FloatArray]


def worn(record: UnitRecord, config: RigConfig, seed: int) -> ImuBlock:
    """Return what the sensor of a rig reads on a walk on another day than its calibration."""
    rng = np.random.default_rng([seed, 5])
    sensor = config.sensor
    offsets = {
        "accel_offset": np.array(sensor.accel_offset) + rng.normal(0.0, DAY_ACCEL, 3),
        "gyro_offset": np.array(sensor.gyro_offset) + rng.normal(0.0, DAY_GYRO, 3),
    }
    changed = sensor.model_copy(update={name: tuple(v.tolist()) for name, v in offsets.items()})
    readings = InertialSensor(changed, config.kind.ranges, rng).read(record.means, None)
    return ImuBlock(record.t, readings.accel, readings.gyro, record.t)


def yaw_of(quaternion: FloatArray) -> float:
    """Return the azimuth of the sensor's x axis [rad]."""
    R = to_matrix(quaternion)
    return float(np.arctan2(R[1, 0], R[0, 0]))


def rig(seed: int, share: float) -> RigConfig:
    """Draw a hobby jig, and a sensor within a share of the usual tolerances."""
    usual = Budget()
    x, y, z = (share * limit for limit in usual.accel_bias_mg)
    budget = usual.model_copy(
        update={
            "scale": share * usual.scale,
            "cross_axis": share * usual.cross_axis,
            "accel_bias_mg": (x, y, z),
            "gyro_bias_dps": share * usual.gyro_bias_dps,
        }
    )
    return RigConfig.random(seed, budget=budget)


def walk(task: tuple[int, float]) -> Walked:
    """Calibrate one sensor, let it be worn on one walk, and measure that."""
    seed, share = task
    config = rig(seed, share)
    certificate = certificate_of(solved(session_of(config), "joint"))
    walker = Walker(SCENARIO, seed)
    record = record_walk(walker, [Carried("right-foot", config.imu)], exact=True)["right-foot"]
    foot = record.units[0]
    raw = worn(foot, config, seed)
    blocks = raw, apply_certificate(certificate, raw)
    rest = foot.t < 3.0  # before the first step
    zeroed = [replace(b, gyro=b.gyro - b.gyro[rest].mean(axis=0)) for b in blocks]
    yaw = yaw_of(foot.truth.attitude[0])
    options = WalkOptions(start_yaw=yaw)
    measured = (
        [walk_distance(block, options).distance for block in blocks],
        [walk_distance(block, options).distance for block in zeroed],
        [_smoothed(block, yaw) for block in blocks],
    )
    return Walked(
        foot.truth.position[-1] - foot.truth.position[0],
        {name: np.array(rows) for name, rows in zip(METHODS, measured, strict=True)},
    )


def _smoothed(block: ImuBlock, yaw: float) -> FloatArray:
    try:
        trajectory = smooth_foot(block).trajectory
    except DataError:
        return np.full(3, np.nan)
    way = trajectory.position[-1] - trajectory.position[0]
    return np.asarray(about_z(yaw - yaw_of(trajectory.quaternion[0])) @ way)


def compared(walked: Sequence[Walked], method: str) -> TrialComparison | None:
    """Set all walks by one method beside each other, but those it refused; None where all are."""
    walked = [w for w in walked if np.isfinite(w.measured[method]).all()]
    if not walked:
        return None
    return compare_trials(
        np.array([w.reference for w in walked]),
        np.array([w.measured[method][0] for w in walked]),
        np.array([w.measured[method][1] for w in walked]),
    )


def walks(
    number: int, seed: int, processes: int, shares: Sequence[float] = SHARES
) -> dict[str, Any]:
    """Run the walks, print the tables, and return their figures by share, method and axis."""
    tasks = [(share, seed + i) for share in shares for i in range(number)]
    walked: list[Walked] = run(walk, [(one, share) for share, one in tasks], processes)
    return {
        str(share): shown(walked[i * number : (i + 1) * number], f"{share:g} of the errors")
        for i, share in enumerate(shares)
    }


def shown(walked: Sequence[Walked], of: str) -> dict[str, Any]:
    """Print the tables of some walks, and return their figures."""
    found: dict[str, Any] = {}
    for method in METHODS:
        comparison = compared(walked, method)
        if comparison is None:
            print(f"\n{method}: refused without calibration, {of}")
            continue
        rows = []
        for axis, published in zip(comparison.axes, PUBLISHED, strict=True):
            before, after = axis.uncalibrated_error, axis.calibrated_error
            found[f"{method}, {axis.axis}"] = {
                "uncalibrated_m": axis.uncalibrated.tolist(),
                "calibrated_m": axis.calibrated.tolist(),
                "reference_m": axis.reference.tolist(),
                "improvement_percent": axis.mean,
                "sd": axis.sd,
                "median": axis.median,
                "pooled": axis.pooled,
            }
            rows.append(
                [
                    axis.axis,
                    *(f"{np.mean(e):.3f} / {np.median(e):.3f}" for e in (before, after)),
                    f"{axis.mean:.1f} ({axis.sd:.1f})",
                    f"{axis.median:.1f}",
                    f"{axis.pooled:.1f}",
                    f"{published:.1f}",
                ]
            )
        head = ["", "uncalibrated: mean / median error [m]", "calibrated", "improvement (SD) [%]"]
        table(
            f"{method}, {len(comparison)} of {len(walked)} walks of 10 m, {of}",
            [*head, "median", "of the mean error", "published"],
            rows,
        )
    return found


def spoken(speed: float, seed: int) -> UnitRecord:
    """Let a sensor that was never calibrated be worn on 8 m."""
    scenario = Scenario("8m", "8 m", (Stand(3.0), Walk((Straight(8.0),), (speed,)), Stand(2.0)))
    devices = [Carried("left-foot", "mpu9150")]
    return record_walk(Walker(scenario, seed), devices, seed)["left-foot"].units[0]


def limits(record: UnitRecord, name: str) -> tuple[float, float]:
    """Return the least threshold that finds every stance, and the greatest that finds no swing.

    The fixed threshold sees a calibrated sensor, as its attitude could not bear the other.
    """
    means = record.means
    exact = ImuBlock(record.t, means.force, means.rate, record.t)
    raw = ImuBlock(record.t, record.accel, record.gyro, record.t)
    statistic = detector_named(name).detect(exact if name == "threshold" else raw).statistic
    stances, swings = (
        zip(*runs(phase), strict=True) for phase in (record.phase != 0, record.phase == 0)
    )
    stance = max(float(np.min(statistic[a : b + 1])) for a, b in stances)
    swing = min(float(np.min(statistic[a + EDGE : b + 1 - EDGE])) for a, b in swings)
    return stance, swing


def detectors(number: int, seed: int) -> dict[str, Any]:
    """Print what range of thresholds serves which speed, and return it."""
    records = {v: [spoken(v, s) for s in range(seed, seed + number)] for v in SPEEDS}
    found: dict[str, Any] = {}
    for name in DETECTORS:
        found[name] = {}
        for speed in SPEEDS:
            pairs = [limits(record, name) for record in records[speed]]
            found[name][str(speed)] = [max(p[0] for p in pairs), min(p[1] for p in pairs)]
    table(
        "thresholds that find every stance, up to those that find a swing",
        ["", *(f"{speed} m/s" for speed in SPEEDS), "default"],
        [
            [
                name,
                *(f"{low:.3g} - {high:.3g}" for low, high in found[name].values()),
                f"{detector_named(name).threshold:.3g}",
            ]
            for name in DETECTORS
        ],
    )
    return found


def main() -> None:
    """Run one of the studies."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("study", choices=("walks", "detectors"))
    parser.add_argument("--walks", type=int, default=20, help="of the 10 m, or of each speed")
    parser.add_argument("--seed", type=int, default=1, help="of the first")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--json", type=Path, help="where to write every figure")
    arguments = parser.parse_args()
    if arguments.study == "walks":
        found = walks(arguments.walks, arguments.seed, arguments.processes)
    else:
        found = detectors(arguments.walks, arguments.seed)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(found, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
