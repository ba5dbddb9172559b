"""What the two-filter smoother reaches on the published experiments and beside the default one.

Simulated Xsens MTi on a board and on a foot, calibrated beforehand as the paper has it: gains and
offsets are known, the gyroscope's bias is taken off by the first seconds of rest::

    python tests/benchmarks/two_filter_study.py half-circle --seeds 10
    python tests/benchmarks/two_filter_study.py straight --seeds 5
    python tests/benchmarks/two_filter_study.py walks --seeds 2
    python tests/benchmarks/two_filter_study.py figures --folder FOLDER

``half-circle`` tells how far each estimate leaves the arc of 0.36 m. ``straight`` tells the
distance of 50 m, by a device with the ranges of an MTi, which a swinging foot exceeds, and by one
without. ``walks`` tells distance and height of other walks, by either smoother. ``figures`` draws
the paper's.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.gait.detectors import SmallMotion
from imu_rig.gait.smoother import smooth_foot
from imu_rig.gait.trajectory import Trajectory
from imu_rig.gait.two_filter import StepSmoothing, TwoFilterOptions, smooth_steps
from imu_rig.report.svg import report_style
from imu_rig.report.two_filter import methods_over_time, plan, two_filter_figures
from imu_rig.units import DEG
from simulators.inertial_sensor import InertialSensor, SensorRange, SensorRanges
from simulators.walker.device import Carried, CarriedDevice
from simulators.walker.record import UnitRecord, record_walk
from simulators.walker.walker import Walker

RADIUS_M = 0.36
KIND = "xsens-mti"
REST_S = 2.0
ON_BOARD = SmallMotion(most_rate=2.0 * DEG, most_scatter=0.05)
"""A hand sets a sensor in motion more gently than a leg: some times the noise of a sensor at rest
is motion."""
ON_FOOT = SmallMotion()
WALKS = ("slow-shuffle", "level-10m", "brisk", "running", "turns", "stairs-up", "slope-up")
NOT_LEVEL = ("stairs-up", "slope-up")
PAPER_M = 48.5
"""What the paper's smoother made of its 50 m."""


@dataclass(frozen=True, eq=False)
class Carry:
    """A simulated recording, calibrated, and what was true."""

    block: ImuBlock
    unit: UnitRecord


def carried(scenario: str, seed: int, *, clips: bool = True) -> Carry:
    """Return a calibrated recording; one that does not clip has no end of its range."""
    walker, device = Walker(scenario, seed), Carried("left-foot", KIND)
    unit = record_walk(walker, [device], seed)["left-foot"].units[0]
    model = CarriedDevice(device, walker, seed).sensors[""].model
    accel, gyro = unit.accel, unit.gyro
    if not clips:
        endless = SensorRanges(SensorRange(), SensorRange(), SensorRange())
        sensor = InertialSensor(model, endless, np.random.default_rng(seed))
        readings = sensor.read(unit.means, None)
        accel, gyro = readings.accel, readings.gyro
    accel = accel @ np.array(model.accel_gain).T - np.array(model.accel_offset)
    gyro = gyro @ np.array(model.gyro_gain).T - np.array(model.gyro_offset)
    gyro = gyro - gyro[unit.t < unit.t[0] + REST_S].mean(axis=0)
    return Carry(ImuBlock(unit.t, accel, gyro, unit.t), unit)


def by_steps(carry: Carry, detector: SmallMotion, *, level: bool = True) -> StepSmoothing:
    """Smooth by the published method."""
    options = TwoFilterOptions(height_sigma=0.01 if level else None)
    return smooth_steps(carry.block, detector.detect(carry.block), options)


def from_the_arc(path: Trajectory, *, turn: bool = False) -> float:
    """Return how far a path leaves the half circle at most [m].

    ``turn`` lets the path end on the y axis first, where its own x axis is another.
    """
    if turn:
        chord = path.position[-1] - path.position[0]
        path = path.turned(0.5 * np.pi - float(np.arctan2(chord[1], chord[0])))
    x, y = (path.position - path.position[0])[:, :2].T
    return float(np.abs(np.hypot(x, y - RADIUS_M) - RADIUS_M).max())


def half_circle(seed: int) -> dict[str, float]:
    """Return the distance from the arc [m] by estimate."""
    carry = carried("half-circle", seed)
    result = by_steps(carry, ON_BOARD)
    return {
        "forward filter": from_the_arc(result.forward.trajectory),
        "backward filter": from_the_arc(result.backward.trajectory),
        "two-filter smoother": from_the_arc(result.smoothed.trajectory),
        "default smoother": from_the_arc(smooth_foot(carry.block).trajectory, turn=True),
    }


def ends(position: FloatArray) -> tuple[float, float]:
    """Return distance on the plan and rise from the first to the last position [m]."""
    moved = position[-1] - position[0]
    return float(np.hypot(moved[0], moved[1])), float(moved[2])


@dataclass(frozen=True)
class Compared:
    """Share by which the sum of all ways between rests is wrong, and the error of the rise [m]."""

    distance: float
    rise: float


def walked(carry: Carry, result: StepSmoothing, path: Trajectory) -> Compared:
    """Compare a path with the truth at the boundaries of the steps."""
    rows = result.boundaries
    truth = carry.unit.truth.position
    path_rows = rows - rows[0] if len(path) < len(truth) else rows
    ways = [
        np.linalg.norm(np.diff(p[:, :2], axis=0), axis=1).sum()
        for p in (path.position[path_rows], truth[rows])
    ]
    rise = ends(path.position[path_rows])[1] - ends(truth[rows])[1]
    return Compared(ways[0] / ways[1] - 1.0, rise)


def compared(scenario: str, seed: int, *, clips: bool) -> dict[str, Compared]:
    """Return the errors of a walk by either smoother."""
    carry = carried(scenario, seed, clips=clips)
    result = by_steps(carry, ON_FOOT, level=scenario not in NOT_LEVEL)
    return {
        "two-filter smoother": walked(carry, result, result.smoothed.trajectory),
        "default smoother": walked(carry, result, smooth_foot(carry.block).trajectory),
    }


def study_half_circle(seeds: int) -> None:
    """Print the half circle's table."""
    found = [half_circle(seed) for seed in range(1, seeds + 1)]
    print(f"Half circle of {RADIUS_M} m: greatest distance from the arc [mm], {seeds} sensors")
    for name in found[0]:
        values = 1e3 * np.array([one[name] for one in found])
        print(f"  {name:20} median {np.median(values):6.1f}   worst {values.max():6.1f}")


def study_straight(seeds: int) -> None:
    """Print what becomes of 50 m."""
    print(f"50 m straight; the paper: {PAPER_M} m, {PAPER_M / 50.0 - 1.0:+.1%}")
    for clips in (True, False):
        carries = [carried("straight-50m", seed, clips=clips) for seed in range(1, seeds + 1)]
        print("  ranges of an MTi" if clips else "  no end of the ranges")
        lengths: dict[str, list[float]] = {"two-filter smoother": [], "default smoother": []}
        for carry in carries:
            result = by_steps(carry, ON_FOOT)
            lengths["two-filter smoother"].append(ends(result.smoothed.trajectory.position)[0])
            lengths["default smoother"].append(
                ends(smooth_foot(carry.block).trajectory.position)[0]
            )
        for name, values in lengths.items():
            share = np.array(values) / 50.0 - 1.0
            print(
                f"    {name:20} {np.mean(values):6.2f} m   mean {share.mean():+.2%}   "
                f"from {share.min():+.2%} to {share.max():+.2%}"
            )


def study_walks(seeds: int) -> None:
    """Print distances and heights of other walks."""
    print("Error of the way [%] and of the rise [m], no end of the ranges")
    for scenario in WALKS:
        every = [compared(scenario, seed, clips=False) for seed in range(1, seeds + 1)]
        line = "   ".join(
            f"{name} {np.mean([one[name].distance for one in every]):+.2%} "
            f"{np.mean([abs(one[name].rise) for one in every]):.3f}"
            for name in every[0]
        )
        print(f"  {scenario:14} {line}")


def figures(folder: Path) -> Iterator[Path]:
    """Draw the paper's Figures 4 to 9 and return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    with report_style():
        board = by_steps(carried("half-circle", 1), ON_BOARD)
        angle = np.linspace(0.0, np.pi, 200)
        arc = RADIUS_M * np.column_stack((np.sin(angle), 1.0 - np.cos(angle)))
        drawn = {"half-circle": plan(board, arc), "half-circle-x": methods_over_time(board)}
        walk = by_steps(carried("straight-50m", 1), ON_FOOT)
        drawn |= {f"walk-{one.name}": one.figure for one in two_filter_figures(walk)}
        for name, figure in drawn.items():
            figure.savefig(folder / f"{name}.png", dpi=110)
            yield folder / f"{name}.png"


def main() -> None:
    """Run what the command line names."""
    parser = argparse.ArgumentParser(description="The two-filter smoother on simulated recordings.")
    parser.add_argument("study", choices=("half-circle", "straight", "walks", "figures"))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--folder", type=Path, default=Path("two-filter-figures"))
    given = parser.parse_args()
    if given.study == "figures":
        for path in figures(given.folder):
            print(path)
        return
    tables = {"half-circle": study_half_circle, "straight": study_straight, "walks": study_walks}
    tables[given.study](given.seeds)


if __name__ == "__main__":
    main()
