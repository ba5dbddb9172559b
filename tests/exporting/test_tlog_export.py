"""MAVLink log: what pymavlink reads back, to the bit of a 32-bit float."""

import struct
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trials_to_export import BARO, LEFT, MARKERS, RIGHT, START_NS, Device, write_trial

from firmware_protocols.layout import load_layout
from imu_rig.errors import DataError
from imu_rig.exporting.device_data import TrialData
from imu_rig.exporting.formats import export_trial
from imu_rig.recording import Trial


@pytest.fixture(scope="module")
def path(trial: Trial, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tlog") / "walk.tlog"
    sys.modules.pop("pymavlink.mavutil", None)
    export_trial(TrialData(trial), "tlog", path)
    assert "pymavlink.mavutil" not in sys.modules  # which looks around in the environment
    return path


@pytest.fixture(scope="module")
def messages(path: Path) -> list[Any]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MAVLINK20", "1")
        patch.setenv("MAVLINK_DIALECT", "common")
        from pymavlink import mavutil

        log = mavutil.mavlogfile(str(path), robust_parsing=False)
        found = []
        while (message := log.recv_match()) is not None:
            found.append(message)
        log.close()
    return found


def of(messages: list[Any], kind: str, component: int) -> list[Any]:
    return [m for m in messages if m.get_type() == kind and m.get_srcComponent() == component]


def test_nothing_is_damaged_and_the_order_is_that_of_time(messages: list[Any]) -> None:
    kinds = Counter(message.get_type() for message in messages)
    assert kinds["HIGHRES_IMU"] == len(LEFT.kept) + len(RIGHT.kept)
    assert kinds["SCALED_PRESSURE"] == len(BARO.kept)
    assert set(kinds) == {"HIGHRES_IMU", "SCALED_PRESSURE", "STATUSTEXT"}
    times = [message._timestamp for message in messages]
    assert times == sorted(times)


@pytest.mark.parametrize(("device", "number"), [(LEFT, 0), (RIGHT, 1)])
def test_an_imu_reads_back_as_it_measured(messages: list[Any], device: Device, number: int) -> None:
    found = of(messages, "HIGHRES_IMU", 25 + number)
    assert {message.id for message in found} == {number}
    truth = device.truth()
    for names, expected in (
        (("xacc", "yacc", "zacc"), truth["accel"]),
        (("xgyro", "ygyro", "zgyro"), truth["gyro"]),
        (("xmag", "ymag", "zmag"), truth["mag"] / 100.0),  # gauss
    ):
        values = np.array([[getattr(message, name) for name in names] for message in found])
        assert values == pytest.approx(expected, rel=2**-23)
    assert {message.fields_updated for message in found} == {0b1_1111_1111}
    assert all(np.isnan(message.temperature) for message in found)
    utc_us = np.array([message.time_usec for message in found])
    assert np.abs(utc_us - (START_NS / 1000 + device.t * 1e6)).max() <= 2
    assert np.diff(utc_us).min() > 0
    numbers = [message.get_seq() for message in found]
    assert set(np.diff(numbers) % 256) <= {1, 2}  # texts are counted too


def test_a_barometer_reads_back_as_it_measured(messages: list[Any]) -> None:
    found, truth = of(messages, "SCALED_PRESSURE", 27), BARO.truth()
    hpa = np.array([message.press_abs for message in found])
    assert hpa == pytest.approx(truth["pressure"] / 100.0, rel=2**-23)
    celsius = np.array([message.temperature for message in found])
    assert celsius.tolist() == np.rint(truth["temperature"] * 100).tolist()
    boot_ms = np.array([message.time_boot_ms for message in found])
    assert np.abs(boot_ms - BARO.t * 1000).max() <= 0.51


def test_the_time_before_each_frame_leaves_the_bits_of_the_link(path: Path) -> None:
    data = path.read_bytes()
    at, kinds = 0, Counter()
    while at < len(data):
        (stamp,) = struct.unpack_from(">Q", data, at)
        assert stamp & 3 == 0
        assert abs(stamp - START_NS / 1000) < 10e6
        assert data[at + 8] == 0xFD  # MAVLink 2
        kinds[data[at + 15]] += 1
        at += 8 + 12 + data[at + 9]
    assert at == len(data)
    assert kinds[105] == len(LEFT.kept) + len(RIGHT.kept)


def test_markers_are_texts_and_long_ones_come_in_pieces(messages: list[Any]) -> None:
    texts = [m for m in messages if m.get_type() == "STATUSTEXT"]
    first = [m.text for m in texts if m.get_srcComponent() == 25]
    assert first == ["id 0, component 25: left shoe, raw"]
    marked = [m for m in texts if m.get_srcComponent() == 191]
    assert {m.severity for m in marked} == {6}
    pieces: dict[int, bytes] = {}
    for message in marked:  # pymavlink takes texts for ASCII
        text = bytes(message.get_msgbuf()[11:-2])[:50].rstrip(b"\0")
        pieces[message.id] = pieces.get(message.id, b"") + text
    assert [piece.decode() for piece in pieces.values()] == [label for _, label in MARKERS]
    assert [m.chunk_seq for m in marked if m.id] == [0, 1, 2, 3]
    times = dict(zip(pieces, (t for t, _ in MARKERS), strict=True))
    for message in marked:
        assert message._timestamp == pytest.approx(START_NS / 1e9 + times[message.id], abs=5e-6)


def test_what_has_no_message_is_said(trial: Trial, tmp_path: Path) -> None:
    done = export_trial(TrialData(trial), "tlog", tmp_path / "x.tlog")
    assert "barometer: MAVLink has no place for battery; left out." in done.notes
    assert list(done.files) == [tmp_path / "x.tlog"]
    layout = load_layout("baro-16").to_dict()
    layout["fields"] = [f for f in layout["fields"] if f["name"] != "pressure"]
    odd = write_trial(
        tmp_path / "odd.imu-trial", [Device("t", "baro-16", 0, descriptor={"layout": layout})]
    )
    with pytest.raises(DataError, match="no device measures"):
        export_trial(TrialData(odd), "tlog", tmp_path / "odd.tlog")
    mixed = write_trial(
        tmp_path / "mixed.imu-trial",
        [Device("t", "baro-16", 0, descriptor={"layout": layout}), LEFT],
    )
    data = TrialData(mixed)
    done = export_trial(data, "tlog", tmp_path / "mixed.tlog")
    assert "t: MAVLink has no message for it; left out." in done.notes
    assert list(data.summaries) == ["left shoe"]
