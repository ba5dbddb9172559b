"""C3D: analog channels on one grid, with what that did to the samples told."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trials_to_export import BARO, LEFT, MARKERS, RIGHT, SUBJECT, Device, write_trial

from imu_rig.errors import InputError
from imu_rig.exporting.device_data import TrialData
from imu_rig.exporting.formats import export_trial
from imu_rig.recording import Trial

ezc3d = pytest.importorskip("ezc3d")


@pytest.fixture(scope="module")
def done(trial: Trial, tmp_path_factory: pytest.TempPathFactory) -> Any:
    return export_trial(TrialData(trial), "c3d", tmp_path_factory.mktemp("c3d") / "walk.c3d")


@pytest.fixture(scope="module")
def file(done: Any) -> Any:
    return ezc3d.c3d(str(done.files[0]))


def values(file: Any, group: str, name: str) -> Any:
    return file["parameters"][group][name]["value"]


def channel(file: Any, label: str) -> np.ndarray:
    return file["data"]["analogs"][0, values(file, "ANALOG", "LABELS").index(label)]


def test_channels_have_names_units_and_a_rate(file: Any) -> None:
    labels, units = values(file, "ANALOG", "LABELS"), values(file, "ANALOG", "UNITS")
    named = dict(zip(labels, units, strict=True))
    assert named["left_shoe.accel_x"] == "m/s2"
    assert named["barometer.pressure"] == "Pa"
    assert values(file, "ANALOG", "RATE") == pytest.approx(100.0, rel=1e-5)
    assert values(file, "POINT", "USED") == [0]
    assert "raw, left shoe" in values(file, "ANALOG", "DESCRIPTIONS")


@pytest.mark.parametrize(("device", "key"), [(LEFT, "left_shoe"), (RIGHT, "device_31m")])
def test_samples_stand_at_their_time_and_gaps_are_not_a_number(
    file: Any, device: Device, key: str
) -> None:
    truth = device.truth()
    for place, axis in enumerate("xyz"):
        found = channel(file, f"{key}.accel_{axis}")
        assert len(found) == 300
        assert found[device.kept] == pytest.approx(truth["accel"][:, place], rel=2**-23)
        assert np.all(np.isnan(np.delete(found, device.kept)))


def test_a_slow_device_is_held_not_interpolated(file: Any) -> None:
    found = channel(file, "barometer.pressure")
    sent = set(BARO.truth()["pressure"].astype(np.float32).tolist())
    taken = found[~np.isnan(found)].tolist()
    assert set(taken) == sent
    assert 2 * len(BARO.kept) - 1 <= len(taken) <= 2 * len(BARO.kept) + 1


def test_the_placing_is_told_in_the_file_and_to_the_user(file: Any, done: Any) -> None:
    assert values(file, "IMU_RIG", "DEVICES")[:3] == ["left shoe", "../왼발 [31m", "barometer"]
    assert values(file, "IMU_RIG", "EMPTY").tolist()[:2] == [60, 50]
    assert values(file, "IMU_RIG", "LEFT_OUT").tolist() == [0, 0, 0, 0]
    assert "nearest" in values(file, "IMU_RIG", "PLACING")[0]
    assert values(file, "IMU_RIG", "UTC_START") == ["2026-09-21T14:13:20.125457Z"]
    assert values(file, "IMU_RIG", "SUBJECT") == [SUBJECT["subject"]]
    assert "left shoe: 0 points repeat a sample, 0 samples are left out, 60 points are NaN." in (
        done.notes
    )


def test_markers_are_events(file: Any) -> None:
    times = values(file, "EVENT", "TIMES")
    start = float(values(file, "IMU_RIG", "START_S")[0])
    assert times[0].tolist() == [0.0, 0.0]
    assert times[1] + start == pytest.approx([t for t, _ in MARKERS], abs=1e-5)
    assert values(file, "EVENT", "LABELS")[0] == MARKERS[0][1]


def test_a_long_trial_has_several_samples_in_a_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The format counts frames in 16 bits; here in fewer, to be quick."""
    monkeypatch.setattr("imu_rig.exporting.c3d_file.MOST_FRAMES", 100)
    device = Device("foot", "baro-16", count=301)
    trial = write_trial(tmp_path / "long.imu-trial", [device], marked=False)
    (path,) = export_trial(TrialData(trial), "c3d", tmp_path / "long.c3d").files
    file = ezc3d.c3d(str(path))
    found = channel(file, "foot.pressure")
    assert len(found) == 304
    assert np.all(np.isnan(found[-3:]))
    assert found[:-3] == pytest.approx(device.truth()["pressure"], rel=2**-23)
    assert values(file, "POINT", "FRAMES") == [76]
    assert values(file, "POINT", "RATE") == pytest.approx(12.5, rel=1e-5)
    assert values(file, "ANALOG", "RATE") == pytest.approx(50.0, rel=1e-5)


def test_more_than_a_file_can_be_is_refused(
    trial: Trial, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for limit, words in (("MOST_CHANNELS", "channels"), ("MOST_NUMBERS", "more than a C3D")):
        with monkeypatch.context() as patch:
            patch.setattr(f"imu_rig.exporting.c3d_file.{limit}", 10)
            with pytest.raises(InputError, match=words):
                export_trial(TrialData(trial), "c3d", tmp_path / "x.c3d")
    assert list(tmp_path.iterdir()) == []
