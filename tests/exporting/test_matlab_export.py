"""MATLAB file: what SciPy reads back, exactly."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat, whosmat
from trials_to_export import BARO, LEFT, MARKERS, RIGHT, START_NS, Device

import imu_rig.exporting.matlab_file as matlab_file
from imu_rig.errors import InputError
from imu_rig.exporting.device_data import TrialData
from imu_rig.exporting.formats import export_trial
from imu_rig.recording import Trial


@pytest.fixture(scope="module")
def path(trial: Trial, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mat") / "walk.mat"
    export_trial(TrialData(trial), "mat", path)
    return path


@pytest.fixture(scope="module")
def content(path: Path) -> dict[str, Any]:
    return loadmat(path, simplify_cells=True)


def test_each_device_is_a_struct_of_its_own(path: Path, content: dict[str, Any]) -> None:
    names = [name for name, _, _ in whosmat(path)]
    assert names == ["trial", "left_shoe", "device_31m", "barometer", "Left_Shoe_2"]
    assert content["trial"]["devices"].tolist() == names[1:]
    assert path.read_bytes().startswith(b"MATLAB 5.0 MAT-file, imu-rig")


@pytest.mark.parametrize(
    ("device", "name"), [(LEFT, "left_shoe"), (RIGHT, "device_31m"), (BARO, "barometer")]
)
def test_samples_are_the_doubles_of_the_trial(
    trial: Trial, content: dict[str, Any], device: Device, name: str
) -> None:
    found, samples = content[name], trial.samples(device.name)
    for field, truth in device.truth().items():
        assert found[field] == pytest.approx(truth, rel=1e-14)
        assert np.array_equal(found[field], samples.values[field])
    assert np.array_equal(found["t"], samples.t)
    assert np.array_equal(found["host_s"], samples.host_s)
    assert found["counter"].tolist() == device.kept.tolist()
    assert found["utc_start_posix"] == START_NS / 1e9
    assert found["utc_start"] == "2026-09-21T14:13:20.123457Z"


def test_units_gaps_and_markers(content: dict[str, Any]) -> None:
    left = content["left_shoe"]
    assert {left["units"][n] for n in ("accel", "gyro", "mag")} == {"m/s2", "rad/s", "uT"}
    assert content["barometer"]["units"]["pressure"] == "Pa"
    assert left["gaps"]["samples"] == 60
    assert left["gaps"]["start_s"] == pytest.approx(LEFT.t[99], abs=1e-5)
    assert left["gaps"]["reason"] == "lost on the way"
    markers = content["trial"]["markers"]
    assert list(zip(markers["t"], markers["label"], strict=True)) == MARKERS
    assert content["Left_Shoe_2"]["t"].size == 0


def test_a_variable_beyond_the_format_is_refused(
    trial: Trial, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(matlab_file, "LARGEST_VARIABLE", 10_000)
    with pytest.raises(InputError, match="left shoe has 240 samples"):
        export_trial(TrialData(trial), "mat", tmp_path / "x.mat")
    assert list(tmp_path.iterdir()) == []
