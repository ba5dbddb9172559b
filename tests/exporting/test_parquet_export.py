"""Parquet: the doubles of the trial, with units in the schema."""

import json
from pathlib import Path

import numpy as np
import pytest
from trials_to_export import BARO, LEFT, MARKERS, SUBJECT

from imu_rig.exporting.device_data import TrialData
from imu_rig.exporting.formats import export_trial
from imu_rig.recording import Trial

parquet = pytest.importorskip("pyarrow.parquet")


@pytest.fixture(scope="module")
def folder(trial: Trial, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("parquet")
    export_trial(TrialData(trial), "parquet", folder / "walk.parquet")
    return folder


def test_samples_are_the_doubles_of_the_trial(trial: Trial, folder: Path) -> None:
    table = parquet.read_table(folder / "walk_left_shoe.parquet")
    samples = trial.samples("left shoe")
    for place, axis in enumerate("xyz"):
        column = table[f"accel_{axis}_mps2"].to_numpy()
        assert np.array_equal(column, samples.values["accel"][:, place])
        assert column == pytest.approx(LEFT.truth()["accel"][:, place], rel=1e-14)
    assert np.array_equal(table["t_s"].to_numpy(), samples.t)
    assert table["counter"].to_pylist() == LEFT.kept.tolist()
    utc = table["utc"].cast("int64").to_numpy()
    assert np.array_equal(utc, 1_790_000_000_123_457 + np.rint(samples.t * 1e6).astype(int))


def test_units_gaps_markers_and_subject_stand_in_the_schema(folder: Path) -> None:
    schema = parquet.read_schema(folder / "walk_left_shoe.parquet")
    assert schema.field("gyro_z_radps").metadata == {b"unit": b"rad/s", b"state": b"raw"}
    about = {key.decode(): value.decode() for key, value in schema.metadata.items()}
    assert about["device"] == "left shoe"
    assert json.loads(about["trial"]).items() >= SUBJECT.items()
    assert [(m["t_s"], m["label"]) for m in json.loads(about["markers"])] == MARKERS
    (gap,) = json.loads(about["gaps"])
    assert gap["samples"] == 60
    other = parquet.read_table(folder / "walk_barometer.parquet")
    assert other["pressure_Pa"].to_numpy() == pytest.approx(BARO.truth()["pressure"], rel=1e-14)
    assert parquet.read_table(folder / "walk_Left_Shoe_2.parquet").num_rows == 0
