"""CSV: every sample with its unit, time and wall clock; gaps and markers beside it."""

import csv
from pathlib import Path

import numpy as np
import pytest
from trials_to_export import BARO, LEFT, MARKERS, RIGHT, SUBJECT, Device, write_trial

from firmware_protocols.layout import load_layout
from imu_rig.exporting.device_data import TrialData
from imu_rig.exporting.formats import export_trial
from imu_rig.recording import Trial, open_trial

DOCUMENT = Path(__file__).parents[2] / "docs" / "export-trials.md"
IMU_COLUMNS = [
    *("t_s", "accel_x_mps2", "accel_y_mps2", "accel_z_mps2"),
    *("gyro_x_radps", "gyro_y_radps", "gyro_z_radps"),
    *("mag_x_uT", "mag_y_uT", "mag_z_uT", "status", "counter", "utc"),
]


@pytest.fixture(scope="module")
def folder(trial: Trial, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("csv")
    export_trial(TrialData(trial), "csv", folder / "walk.csv")
    return folder


def table(path: Path) -> list[list[str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.reader(file))


def test_each_device_has_a_table_in_the_same_folder(folder: Path) -> None:
    assert sorted(path.name for path in folder.iterdir()) == [
        "walk_Left_Shoe_2.csv",
        *("walk_barometer.csv", "walk_gaps.csv", "walk_left_shoe.csv", "walk_markers.csv"),
        "walk_왼발_31m.csv",
    ]


@pytest.mark.parametrize(("device", "name"), [(LEFT, "left_shoe"), (RIGHT, "왼발_31m")])
def test_an_imu_reads_back_as_it_measured(folder: Path, device: Device, name: str) -> None:
    header, *rows = table(folder / f"walk_{name}.csv")
    assert header == IMU_COLUMNS
    truth = device.truth()
    expected = np.column_stack([truth["accel"], truth["gyro"], truth["mag"], truth["status"]])
    found = np.array([row[1:-2] for row in rows], float)
    assert found.shape == expected.shape
    assert np.all(np.abs(found - expected) <= 1.1e-9 * np.abs(expected).max(axis=0))
    assert np.array([row[0] for row in rows], float) == pytest.approx(device.t, abs=2e-6)
    assert [int(row[-2]) for row in rows] == device.kept.tolist()


def test_the_example_of_the_document_is_such_a_table(folder: Path) -> None:
    first = next(line for line in DOCUMENT.read_text().splitlines() if line.startswith("t_s,"))
    after = DOCUMENT.read_text().partition(f"{first}\n")[2].splitlines()[0]
    assert first.split(",") == IMU_COLUMNS
    assert len(after.split(",")) == len(IMU_COLUMNS)
    per_unit = load_layout("mpu9150-28").field("mag").counts_per_unit
    counts = np.array(after.split(",")[7:10], float) * per_unit
    assert counts == pytest.approx(np.rint(counts), abs=1e-6)


def test_other_sensors_have_their_own_fields_and_units(folder: Path) -> None:
    header, *rows = table(folder / "walk_barometer.csv")
    assert header == ["t_s", "temperature_degC", "battery_percent", "pressure_Pa", "counter", "utc"]
    truth = BARO.truth()
    for column, name in ((1, "temperature"), (2, "battery")):
        assert [float(row[column]) for row in rows] == truth[name].tolist()  # exact
    pressure = np.array([row[3] for row in rows], float)
    assert pressure == pytest.approx(truth["pressure"], rel=0, abs=1e-9 * truth["pressure"].max())


def test_the_wall_clock_stays_in_step_when_it_is_set(folder: Path) -> None:
    """It was put on by an hour during the trial."""
    rows = table(folder / "walk_left_shoe.csv")[1:]
    utc = np.array([row[-1].removesuffix("Z") for row in rows], "datetime64[us]")
    assert all(row[-1].endswith("Z") and len(row[-1]) == 27 for row in rows)
    start = np.datetime64("2026-09-21T14:13:20.123457")
    since = (utc - start).astype(np.int64)
    assert since.tolist() == [round(float(row[0]) * 1e6) for row in rows]


def test_gaps_and_markers_stand_in_tables_of_their_own(folder: Path) -> None:
    header, *gaps = table(folder / "walk_gaps.csv")
    assert header == ["device", "start_s", "stop_s", "samples", "reason"]
    ((device, start, stop, samples, reason),) = gaps
    assert (device, samples, reason) == ("left shoe", "60", "lost on the way")
    assert [float(start), float(stop)] == pytest.approx([LEFT.t[99], LEFT.t[100]], abs=2e-6)
    header, *markers = table(folder / "walk_markers.csv")
    assert header == ["t_s", "utc", "label"]
    assert [(float(t), label) for t, _, label in markers] == MARKERS
    assert markers[0][1] == "2026-09-21T14:13:20.623457Z"


def test_an_empty_device_has_a_header(folder: Path) -> None:
    assert table(folder / "walk_Left_Shoe_2.csv") == [IMU_COLUMNS]


def test_one_device_keeps_the_name_of_the_file(trial: Trial, tmp_path: Path) -> None:
    done = export_trial(TrialData(trial, ["barometer"]), "csv", tmp_path / "b.csv")
    assert done.files == [tmp_path / "b.csv", tmp_path / "b_markers.csv"]


def test_what_is_known_of_the_trial_is_printable(trial: Trial) -> None:
    about = TrialData(trial).about
    assert about["subject"] == SUBJECT["subject"]
    assert all(text.isprintable() for text in about.values())
    assert TrialData(trial).device(RIGHT.name).name == "../왼발 [31m"


def test_the_golden_trial_is_written_as_it_was_made(tmp_path: Path) -> None:
    """Packet n has the accelerations 0, n / 4096 and 1 g, rates -n / 32.8, 10 and 0 deg/s."""
    golden = Path(__file__).resolve().parent.parent / "data" / "golden-devices-v1.imu-trial"
    export_trial(TrialData(open_trial(golden), ["left shoe"]), "csv", tmp_path / "x.csv")
    lines = (tmp_path / "x.csv").read_bytes().split(b"\n")
    assert lines[2] == (
        b"0.012000,0,0.0023942017,9.80665,-0.0005321126,0.1745329252,0,0,1,"
        b"2026-09-21T14:13:20.012000Z"
    )
    assert lines[300] == (
        b"2.992000,0,0.7158662964,9.80665,-0.1591016605,0.1745329252,0,0,299,"
        b"2026-09-21T14:13:22.992000Z"
    )


def test_columns_of_the_same_name_are_told_apart(tmp_path: Path) -> None:
    layout = load_layout("mpu9150-28").to_dict()
    twin = {"name": "accel_x", "type": "i16", "unit": "m/s2"}
    number = {"name": "t_s", "type": "i16"}
    layout["fields"] = [*layout["fields"], twin, number]
    device = Device("odd", count=0, descriptor={"layout": layout})
    data = TrialData(write_trial(tmp_path / "x.imu-trial", [device])).device("odd")
    labels = [column.label for column in data.columns]
    assert len(set(labels)) == len(labels)
    assert {"accel_x_mps2", "accel_x_mps2_2", "t_s_2"} <= set(labels)
