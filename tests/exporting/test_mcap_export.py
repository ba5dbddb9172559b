"""MCAP: what its own reader finds, and what Foxglove asks for."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from trials_to_export import (
    BARO,
    DEVICES,
    LEFT,
    MARKERS,
    RIGHT,
    START_NS,
    SUBJECT,
    Device,
    float_trial,
)

from imu_rig.exporting.device_data import TrialData
from imu_rig.exporting.formats import export_trial
from imu_rig.recording import Trial


@pytest.fixture(scope="module")
def path(trial: Trial, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mcap") / "walk.mcap"
    export_trial(TrialData(trial), "mcap", path)
    return path


@pytest.fixture(scope="module")
def topics(path: Path) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            content = json.loads(message.data)
            found.setdefault(channel.topic, []).append((schema, message.log_time, content))
    return found


def column(topics: dict[str, list[Any]], topic: str, name: str) -> np.ndarray:
    values = [content[name] for _, _, content in topics[topic]]
    return np.array([list(v.values()) if isinstance(v, dict) else v for v in values])


@pytest.mark.parametrize(("device", "topic"), [(LEFT, "/left_shoe/imu"), (RIGHT, "/왼발_31m/imu")])
def test_an_imu_reads_back_as_it_measured(topics: Any, device: Device, topic: str) -> None:
    names = {"accel": "linear_acceleration", "gyro": "angular_velocity", "mag": "magnetic_field"}
    truth = device.truth()
    for field, name in names.items():
        found = column(topics, topic, name)
        assert np.all(np.abs(found - truth[field]) <= 1.1e-9 * np.abs(truth[field]).max())
    assert column(topics, topic, "counter").tolist() == device.kept.tolist()
    assert column(topics, topic, "status").tolist() == truth["status"].tolist()


def test_the_example_of_the_document_is_such_a_message(topics: Any) -> None:
    document = Path(__file__).parents[2] / "docs" / "export-trials.md"
    example = json.loads(document.read_text().partition("```json\n")[2].partition("```")[0])
    _, _, message = topics["/left_shoe/imu"][0]
    assert list(example) == list(message)
    assert {k: list(v) for k, v in example.items() if isinstance(v, dict)} == {
        k: list(v) for k, v in message.items() if isinstance(v, dict)
    }


def test_times_are_wall_clock_in_nanoseconds(topics: Any) -> None:
    for topic, device in (("/left_shoe/imu", LEFT), ("/barometer/samples", BARO)):
        log_times = np.array([log_time for _, log_time, _ in topics[topic]])
        expected = START_NS + np.rint(device.t * 1e9).astype(int)
        assert np.abs(log_times - expected).max() <= 2000
        stamps = [c["timestamp"] for _, _, c in topics[topic]]
        assert [s["sec"] * 10**9 + s["nsec"] for s in stamps] == log_times.tolist()
        assert all(0 <= s["nsec"] < 10**9 for s in stamps)


def test_other_sensors_keep_the_names_of_their_fields(topics: Any) -> None:
    truth = BARO.truth()
    for name in ("pressure", "temperature", "battery"):
        found = column(topics, "/barometer/samples", name)
        assert found == pytest.approx(truth[name], rel=1e-9)


def check(value: Any, schema: dict[str, Any]) -> None:
    """Hold a value to the parts of JSON schema that are used."""
    types = {"object": dict, "integer": int, "number": int | float, "string": str}
    if "type" in schema:  # one of these, never a list: Foxglove refuses others
        assert isinstance(value, types[schema["type"]])
    else:
        assert all(isinstance(option["const"], int) for option in schema["oneOf"])
        assert [option["const"] for option in schema["oneOf"]].count(value) == 1
    if "properties" in schema:
        assert set(schema.get("required", ())) <= set(value) <= set(schema["properties"])
        for name, part in schema["properties"].items():
            if name in value:
                check(value[name], part)
    assert isinstance(value, dict | str) or value >= schema.get("minimum", value)


def test_every_message_is_as_its_schema_says(topics: Any) -> None:
    for messages in topics.values():
        for schema, _, content in messages:
            assert schema.encoding == "jsonschema"
            described = json.loads(schema.data)
            assert described["type"] == "object"
            assert described["$schema"].startswith("https://json-schema.org/")
            check(content, described)


def test_what_is_no_number_is_left_out(tmp_path: Path) -> None:
    layout = {
        "name": "floats",
        "title": "Floats",
        "byte_order": "little",
        "header": "A5 5D",
        "counter": "seq",
        "clock": "time",
        "rate_hz": 100.0,
        "fields": [
            {"name": "seq", "type": "u8"},
            {"name": "time", "type": "u32"},
            {"name": "accel", "type": "f32", "count": 3, "unit": "m/s2"},
            {"name": "load", "type": "f64", "unit": "N"},
        ],
        "checksum": {"kind": "crc16-ccitt-false"},
    }
    accel = [[1, 2, 3], [np.nan, 5, 6], [7, np.inf, 9], [np.nan] * 3]
    load = [1e300, np.nan, -1e-300, 0.5]
    trial = float_trial(tmp_path / "floats.imu-trial", layout, np.array(accel), np.array(load))
    export_trial(TrialData(trial), "mcap", tmp_path / "x.mcap")
    with (tmp_path / "x.mcap").open("rb") as file:
        read = [(s, json.loads(m.data)) for s, _, m in make_reader(file).iter_messages()]
    for schema, content in read:
        check(content, json.loads(schema.data))
    assert [content["linear_acceleration"] for _, content in read] == [
        {"x": 1, "y": 2, "z": 3},
        {"y": 5, "z": 6},
        {"x": 7, "z": 9},
        {},
    ]
    assert [content.get("load") for _, content in read] == [1e300, None, -1e-300, 0.5]


def test_units_stand_in_the_schema(topics: Any) -> None:
    schema = json.loads(topics["/left_shoe/imu"][0][0].data)["properties"]
    assert schema["linear_acceleration"]["description"] == "accel, raw, m/s2"
    assert schema["angular_velocity"]["description"] == "gyro, raw, rad/s"
    pressure = json.loads(topics["/barometer/samples"][0][0].data)["properties"]["pressure"]
    assert pressure["description"] == "pressure, raw, Pa"


def test_markers_and_gaps_are_log_messages(topics: Any) -> None:
    logged = topics["/markers"]
    assert {schema.name for schema, _, _ in logged} == {"foxglove.Log"}
    said = [((log - START_NS) / 1e9, c["level"], c["name"], c["message"]) for _, log, c in logged]
    assert [(t, text) for t, _, name, text in said if name == "marker"] == MARKERS
    (gap,) = [entry for entry in said if entry[2] != "marker"]
    assert gap[0] == pytest.approx(LEFT.t[99], abs=1e-5)
    assert gap[1:3] == (3, "left shoe")
    assert "60 samples" in gap[3]
    assert sorted(said) == said


def test_the_file_is_chunked_compressed_and_says_whose_it_is(path: Path) -> None:
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
        assert summary.statistics.message_count == sum(len(d.kept) for d in DEVICES) + 3
        assert {channel.message_encoding for channel in summary.channels.values()} == {"json"}
        assert {c.topic for c in summary.channels.values()} >= {"/Left_Shoe_2/imu", "/markers"}
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
    assert metadata["trial"].items() >= SUBJECT.items()
    assert metadata["device left shoe"]["calibrated"] == "none"
