"""Strides of public recordings beside footprints and motion capture.

    python tests/benchmarks/gait_reference.py /path/to/data/foot

None of these recordings chose a parameter: limits and thresholds come from physics and simulation.
"""

from __future__ import annotations

import csv
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np

from imu_rig.gait.smoother import smooth_foot
from imu_rig.gait.strides import Strides, gait_parameters
from imu_rig.importing.column_map import ColumnMap
from imu_rig.importing.footprints import read_footprints
from imu_rig.importing.formats import load_foreign
from imu_rig.importing.optical import read_reference
from imu_rig.reference.alignment import Alignment, align
from imu_rig.reference.footprints import StrideComparison, compare_footprints

FOOTPRINT_TRIALS = ("33", "34")
SHOE_SENSOR = ColumnMap(accel_unit="g", gyro_unit="rad/s", mag_unit="G")
MOCAP_RATE_HZ = 204.8
MOCAP_SENSOR = ColumnMap(rate_hz=MOCAP_RATE_HZ, accel_unit="m/s2", gyro_unit="deg/s")
FEET = ("left", "right")


def footprint_trial(folder: Path, name: str) -> StrideComparison:
    """All strides of a trial beside its footprints, which were measured by tape."""
    block = load_foreign(folder / f"SensorConnectData_{name}.csv", columns=SHOE_SENSOR).imu()
    strides = gait_parameters(smooth_foot(block))
    return compare_footprints(strides, read_footprints(folder / f"SensorConnectData_{name}.mat"))


def mocap_strides(folder: Path) -> dict[str, Strides]:
    """Strides of each foot of the gait trial, found without its events."""
    recording = load_foreign(folder / "imu_sample.csv", columns=MOCAP_SENSOR)
    return {foot: gait_parameters(smooth_foot(recording.imu(f"{foot}_sensor"))) for foot in FEET}


def mocap_lengths(folder: Path, foot: str, strides: Strides) -> StrideComparison:
    """Lengths of the strides that motion capture measured, beside ours nearest in time."""
    ours, true = [], []
    paths = _heel_paths(folder, foot)
    for row in _events(folder, foot):
        path = paths[int(row["s_id"])]
        middle = 0.5 * (float(row["start"]) + float(row["end"])) / MOCAP_RATE_HZ
        nearest = int(np.argmin(np.abs(0.5 * (strides.start + strides.end) - middle)))
        ours.append(strides.length[nearest])
        true.append(np.linalg.norm((path[-1] - path[0])[:2]))
    length, truth = np.array(ours), np.array(true)
    return StrideComparison(
        length, truth, len(set(ours)), len(true), float(length.sum()), float(truth.sum())
    )


def mocap_events(folder: Path, foot: str, strides: Strides) -> dict[str, np.ndarray]:
    """Our contacts and toe-offs less those of motion capture nearest in time [s]."""
    rows = _events(folder, foot)
    errors = {}
    for name, column, found in (
        ("contact", "ic", strides.contact),
        ("toe_off", "tc", strides.toe_off),
    ):
        found = found[np.isfinite(found)]
        true = np.array([float(row[column]) for row in rows]) / MOCAP_RATE_HZ
        errors[name] = np.array([found[np.argmin(np.abs(found - t))] - t for t in true])
    return errors


def optical_trial(file: Path) -> Alignment:
    """The default trajectory of an optical trial in the frame of its reference."""
    track = smooth_foot(load_foreign(file).imu())
    return align(track.trajectory.t, track.trajectory.position, read_reference(file))


def _events(folder: Path, foot: str) -> list[dict[str, str]]:
    with (folder / "stride_events_sample.csv").open() as file:
        return [row for row in csv.DictReader(file) if row["foot"] == foot]


def _heel_paths(folder: Path, foot: str) -> dict[int, np.ndarray]:
    paths: dict[int, list[list[float]]] = defaultdict(list)
    with (folder / "position_sample.csv").open() as file:
        for row in csv.DictReader(file):
            if row[""] == f"{foot}_sensor":
                paths[int(row["s_id"])].append([float(row[f"pos_{axis}"]) for axis in "xyz"])
    return {number: np.array(path) for number, path in paths.items()}


def main(folder: Path) -> None:
    """Print every figure."""
    for name in FOOTPRINT_TRIALS:
        print(f"footprints {name}")
        print("\n".join(f"  {s}" for s in footprint_trial(folder / "gcp_footprints", name).lines()))
    mocap = folder / "gaitmap_mocap"
    errors = []
    for foot, strides in mocap_strides(mocap).items():
        compared = mocap_lengths(mocap, foot, strides)
        errors.append(np.abs(compared.errors))
        print(f"motion capture, {foot}")
        print("\n".join(f"  {line}" for line in compared.lines()))
        for name, off in mocap_events(mocap, foot, strides).items():
            ms = 1000 * off
            print(
                f"  {name:<11} {np.median(ms):+.0f} ms, 9 of 10 within {_spread(ms):.0f} ms of it"
            )
    print(f"motion capture, both feet: {1000 * np.concatenate(errors).mean():.1f} mm MAE")
    for file in sorted((folder / "pyshoe_vicon").glob("*.mat")):
        found = optical_trial(file)
        print(f"{file.stem}: {found.rmse_horizontal:.3f} m, height {found.rmse_vertical:.3f} m")


def _spread(values: np.ndarray) -> float:
    return float(np.quantile(np.abs(values - np.median(values)), 0.9))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
