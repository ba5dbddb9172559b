"""What holds for every format: new files only, all or none, the same bytes every time."""

import resource
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import ezc3d
import numpy as np
import pyarrow.parquet
import pytest
from mcap.reader import make_reader
from scipy.io import loadmat
from trials_to_export import EMPTY, START_NS, Device, write_trial

from imu_rig.errors import DataError, InputError, StorageError
from imu_rig.exporting.device_data import TrialData
from imu_rig.exporting.formats import FORMATS, choose, destination, export_trial
from imu_rig.recording import Trial

EVERY_FORMAT = pytest.mark.parametrize("to", list(FORMATS))


def target(folder: Path, to: str) -> Path:
    return folder / f"walk{FORMATS[to].suffix}"


@EVERY_FORMAT
def test_the_same_trial_gives_the_same_bytes(trial: Trial, tmp_path: Path, to: str) -> None:
    contents = []
    for name in ("one", "two"):
        folder = tmp_path / name
        folder.mkdir()
        done = export_trial(TrialData(trial), to, target(folder, to))
        assert sorted(done.files) == sorted(folder.iterdir())
        contents.append({path.name: path.read_bytes() for path in done.files})
    assert contents[0] == contents[1]
    assert all(contents[0].values())


@EVERY_FORMAT
def test_no_file_is_overwritten_and_nothing_else_is_left(
    trial: Trial, tmp_path: Path, to: str
) -> None:
    path = target(tmp_path, to)
    taken = path.with_name(f"walk_barometer{path.suffix}") if FORMATS[to].each else path
    taken.write_text("mine")
    with pytest.raises(InputError, match=r"exists.*never overwritten"):
        export_trial(TrialData(trial), to, path)
    assert [p.name for p in tmp_path.iterdir()] == [taken.name]
    assert taken.read_text() == "mine"


@contextmanager
def full_disk(at_bytes: int) -> Iterator[None]:
    """Let the system refuse to write a file any further, as a full disk does."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (at_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("at_bytes", [1000, 7000])
@EVERY_FORMAT
def test_a_full_disk_leaves_nothing(trial: Trial, tmp_path: Path, to: str, at_bytes: int) -> None:
    data = TrialData(trial)
    for name in data.names:
        data.device(name)
    with full_disk(at_bytes), pytest.raises(StorageError, match=r"could not be written: [A-Za-z]"):
        export_trial(data, to, target(tmp_path, to))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("to", ["csv", "parquet"])
def test_a_disk_that_fills_up_later_leaves_nothing_either(
    trial: Trial, tmp_path: Path, to: str
) -> None:
    first, second = (tmp_path / name for name in ("first", "second"))
    first.mkdir()
    second.mkdir()
    data = TrialData(trial, ["barometer", "left shoe"])
    done = export_trial(data, to, target(first, to))
    sizes = {path.name: path.stat().st_size for path in done.files}
    small = sizes[f"walk_barometer{FORMATS[to].suffix}"]
    large = sizes[f"walk_left_shoe{FORMATS[to].suffix}"]
    data.names = ("barometer", "left shoe")  # the one that fits first
    with full_disk((small + large) // 2), pytest.raises(StorageError, match="walk_left_shoe"):
        export_trial(data, to, target(second, to))
    assert list(second.iterdir()) == []


@EVERY_FORMAT
def test_a_trial_without_samples_is_refused(tmp_path: Path, to: str) -> None:
    nothing = write_trial(tmp_path / "nothing.imu-trial", [EMPTY], marked=False)
    with pytest.raises(DataError, match="holds no samples"):
        export_trial(TrialData(nothing), to, target(tmp_path, to))
    assert [path.name for path in tmp_path.iterdir()] == ["nothing.imu-trial"]


@EVERY_FORMAT
def test_a_folder_that_is_not_there_is_named(trial: Trial, tmp_path: Path, to: str) -> None:
    with pytest.raises(InputError, match="none is not a folder"):
        export_trial(TrialData(trial), to, target(tmp_path / "none", to))


@pytest.mark.parametrize("to", ["parquet", "c3d"])
def test_a_package_that_is_missing_is_named_with_its_cure(
    trial: Trial, tmp_path: Path, to: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen = FORMATS[to]
    monkeypatch.delitem(sys.modules, f"imu_rig.exporting.{chosen.module}", raising=False)
    monkeypatch.delattr(sys.modules["imu_rig.exporting"], chosen.module, raising=False)
    monkeypatch.setitem(sys.modules, chosen.needs, None)
    with pytest.raises(InputError, match=rf"pip install 'imu-rig\[{to}\]'"):
        export_trial(TrialData(trial), to, target(tmp_path, to))


@EVERY_FORMAT
def test_a_start_that_nobody_knows_is_made_up_nowhere_unsaid(
    trial: Trial, tmp_path: Path, to: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Trial, "start_utc_ns", None)
    done = export_trial(TrialData(trial), to, target(tmp_path, to))
    (said,) = [note for note in done.notes if "time of day" in note]
    assert ("2000-01-01" in said) == (to in ("mcap", "tlog"))
    y2000_s = datetime(2000, 1, 1, tzinfo=UTC).timestamp()
    for path in done.files:
        if to == "csv":
            with path.open() as file:
                assert "utc" not in file.readline()
        elif to == "parquet":
            assert "utc" not in pyarrow.parquet.read_schema(path).names
        elif to == "mat":
            device = loadmat(path, squeeze_me=True)["left_shoe"]
            assert np.isnan(device["utc_start_posix"].item())
            assert device["utc_start"].item() == "unknown"
        elif to == "c3d":
            parameters = ezc3d.c3d(str(path))["parameters"]["IMU_RIG"]
            assert parameters["UTC_START"]["value"] == ["unknown"]
        elif to == "mcap":
            with path.open("rb") as file:
                summary = make_reader(file).get_summary()
            assert 0 <= summary.statistics.message_start_time - y2000_s * 1e9 < 60e9
        else:
            (first_us,) = struct.unpack(">Q", path.read_bytes()[:8])
            assert 0 <= first_us - y2000_s * 1e6 < 60e6


def test_whoever_waits_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imu_rig.exporting.output.NUMBERS_AT_A_TIME", 500)  # of ten columns
    trial = write_trial(tmp_path / "x.imu-trial", [Device("foot", count=100)], marked=False)
    told: list[str] = []
    export_trial(TrialData(trial), "csv", tmp_path / "x.csv", told.append)
    assert told == ["exporting foot, 0 %", "exporting foot, 50 %"]
    assert len((tmp_path / "x.csv").read_text().splitlines()) == 101


def test_the_format_is_that_of_the_option_or_the_suffix(tmp_path: Path) -> None:
    assert choose(None, Path("x.MCAP")) == "mcap"
    assert choose("csv", Path("x.mcap")) == "csv"
    for wrong in (("xls", None), (None, None), (None, Path("x.txt")), (None, Path("folder"))):
        with pytest.raises(InputError, match="csv, mcap, tlog, mat, parquet, c3d"):
            choose(*wrong)
    assert destination(Path("a/walk.imu-trial"), "mat", None) == Path("a/walk.mat")
    assert destination(Path("a/walk.imu-trial"), "mat", tmp_path) == tmp_path / "walk.mat"
    assert destination(Path("a/walk.imu-trial"), "mat", Path("b.mat")) == Path("b.mat")


def test_the_wall_clock_is_that_of_the_start(trial: Trial) -> None:
    assert TrialData(trial).about["start_utc"] == "2026-09-21T14:13:20.123457Z"
    assert trial.start_utc_ns == START_NS
