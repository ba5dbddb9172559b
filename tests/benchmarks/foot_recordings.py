"""The default foot smoother on public recordings with known truth.

    python tests/benchmarks/foot_recordings.py                 # folder from IMU_RIG_DATA
    python tests/benchmarks/foot_recordings.py --sensitivity   # each default halved and doubled

One configuration for all. Horizontal errors are those after the best yaw and translation, and no
lever arm from the sensor to the marker is fitted. With ``--sensitivity`` every line says by how
much halving and doubling one default changes the optical mean, and what of the rest it changes; a
default on a plateau does little.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from gait_reference import (
    FEET,
    FOOTPRINT_TRIALS,
    MOCAP_SENSOR,
    SHOE_SENSOR,
    mocap_lengths,
)

from imu_rig.blocks import ImuBlock
from imu_rig.gait.grade import SensorGrade
from imu_rig.gait.options import FootOptions, StanceOptions
from imu_rig.gait.smoother import smooth_foot
from imu_rig.gait.strides import gait_parameters
from imu_rig.importing.footprints import read_footprints
from imu_rig.importing.formats import load_foreign
from imu_rig.importing.optical import read_reference
from imu_rig.reference.alignment import Alignment, align
from imu_rig.reference.footprints import StrideComparison, compare_footprints
from imu_rig.reference.reference import Reference

LOOPS = ("short_walk", "long_walk")
NOT_VARIED = ("gravity", "gyro_matrix", "accel_matrix", "late_s")
"""What is known, and what changes the uncertainty only."""
NOTABLE = 0.04


@dataclass(frozen=True, eq=False)
class Recordings:
    """All recordings with their truth, read once."""

    optical: dict[str, tuple[ImuBlock, Reference]]
    footprints: dict[str, tuple[ImuBlock, np.ndarray]]
    mocap: dict[str, ImuBlock]
    mocap_folder: Path
    loops: dict[str, ImuBlock]


@dataclass(frozen=True, eq=False)
class Figures:
    """What came out of all of them."""

    optical: dict[str, Alignment]
    footprints: dict[str, StrideComparison]
    mocap: dict[str, StrideComparison]
    closure: dict[str, float]

    @property
    def horizontal(self) -> np.ndarray:
        """Horizontal errors of the optical trials [m]."""
        return np.array([found.rmse_horizontal for found in self.optical.values()])

    @property
    def vertical(self) -> float:
        """Median of their vertical errors [m]."""
        return float(np.median([found.rmse_vertical for found in self.optical.values()]))

    @property
    def mocap_mae(self) -> float:
        """Mean absolute error of stride length of both feet [m]."""
        return float(np.abs(np.concatenate([c.errors for c in self.mocap.values()])).mean())


def read_recordings(foot: Path) -> Recordings:
    """Read all from the folder ``foot`` of the data."""
    shoes, mocap = foot / "gcp_footprints", foot / "gaitmap_mocap"
    feet = load_foreign(mocap / "imu_sample.csv", columns=MOCAP_SENSOR)
    return Recordings(
        optical={
            file.stem: (load_foreign(file).imu(), read_reference(file))
            for file in sorted((foot / "pyshoe_vicon").glob("*.mat"))
        },
        footprints={
            name: (
                load_foreign(shoes / f"SensorConnectData_{name}.csv", columns=SHOE_SENSOR).imu(),
                read_footprints(shoes / f"SensorConnectData_{name}.mat"),
            )
            for name in FOOTPRINT_TRIALS
        },
        mocap={side: feet.imu(f"{side}_sensor") for side in FEET},
        mocap_folder=mocap,
        loops={n: load_foreign(foot / "xio_loop" / f"{n}.csv").imu() for n in LOOPS},
    )


def figures(
    recordings: Recordings,
    options: FootOptions = FootOptions(),  # noqa: B008
    grade: SensorGrade | None = None,
) -> Figures:
    """Smooth every recording and compare it with its truth."""
    optical = {}
    for name, (block, reference) in recordings.optical.items():
        way = smooth_foot(block, options, grade=grade).trajectory
        optical[name] = align(way.t, way.position, reference)
    footprints = {
        name: compare_footprints(
            gait_parameters(smooth_foot(block, options, grade=grade)), measured
        )
        for name, (block, measured) in recordings.footprints.items()
    }
    mocap = {
        side: mocap_lengths(
            recordings.mocap_folder, side, gait_parameters(smooth_foot(block, options, grade=grade))
        )
        for side, block in recordings.mocap.items()
    }
    closure = {}
    for name, block in recordings.loops.items():
        position = smooth_foot(block, options, grade=grade).trajectory.position
        closure[name] = float(np.linalg.norm(position[-1] - position[0]))
    return Figures(optical, footprints, mocap, closure)


def lines(found: Figures) -> Iterator[str]:
    """Tell all figures."""
    for name, trial in found.optical.items():
        yield f"{name}: {trial.rmse_horizontal:.3f} m, height {trial.rmse_vertical:.3f} m"
    yield (
        f"optical, {len(found.optical)} trials: mean {found.horizontal.mean():.4f} m, worst "
        f"{found.horizontal.max():.3f} m, median height {found.vertical:.3f} m"
    )
    for name, strides in found.footprints.items():
        yield (
            f"footprints {name}: {strides.count} strides of {strides.true_count}, distance "
            f"{strides.distance_percent:+.2f} %, stride length MAE {1e3 * strides.mae:.1f} mm"
        )
    yield f"motion capture: stride length MAE {1e3 * found.mocap_mae:.1f} mm"
    for name, closure in found.closure.items():
        yield f"{name}: ends {closure:.3f} m from where it began"


def varied(factor: float) -> Iterator[tuple[str, FootOptions, SensorGrade]]:
    """Yield each default times a factor, with its name."""
    options, grade = FootOptions(), SensorGrade()
    for group in (options, options.stance, grade):
        for field in fields(group):
            value = getattr(group, field.name)
            if field.name in NOT_VARIED or not isinstance(value, float):
                continue
            changed = replace(group, **{field.name: factor * value})
            if isinstance(changed, FootOptions):
                yield field.name, changed, grade
            elif isinstance(changed, StanceOptions):
                yield f"stance.{field.name}", replace(options, stance=changed), grade
            else:
                yield f"grade.{field.name}", options, changed


def change_of(base: Figures, found: Figures) -> str:
    """Tell what a change of a default changed."""
    text = f"{100 * (found.horizontal.mean() / base.horizontal.mean() - 1):+6.1f} %"
    for name, strides in found.footprints.items():
        more = strides.count - base.footprints[name].count
        if more:
            text += f" ({name}: {more:+d} strides)"
        elif abs(strides.distance_percent - base.footprints[name].distance_percent) > 0.2:
            text += f" ({name}: {strides.distance_percent:+.2f} %)"
    return text


def main() -> None:
    """Print the figures, or how they change."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sensitivity", action="store_true")
    asked = parser.parse_args()
    if "IMU_RIG_DATA" not in os.environ:
        parser.error("set IMU_RIG_DATA to the folder of the recordings")
    recordings = read_recordings(Path(os.environ["IMU_RIG_DATA"]) / "foot")
    base = figures(recordings)
    print("\n".join(lines(base)))
    if not asked.sensitivity:
        return
    print(f"\n{'default':<26}{'halved':<40}doubled")
    little = 0
    for (name, *half), (_, *twice) in zip(varied(0.5), varied(2.0), strict=True):
        halved, doubled = figures(recordings, *half), figures(recordings, *twice)
        texts = change_of(base, halved), change_of(base, doubled)
        usual = base.horizontal.mean()
        most = max(abs(f.horizontal.mean() / usual - 1) for f in (halved, doubled))
        little += most < NOTABLE
        print(f"{name:<26}{texts[0]:<40}{texts[1]}", flush=True)
    print(f"{little} defaults change the optical mean by less than {100 * NOTABLE:.0f} %")


if __name__ == "__main__":
    main()
