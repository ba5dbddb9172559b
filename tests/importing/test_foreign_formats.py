"""Recordings of other programs: told by what they hold, read with their units, times and gaps."""

import numpy as np
import pytest
from foreign_files import (
    INERTIAL,
    XSENS_NAMES,
    G,
    broad_content,
    motion,
    pyshoe_content,
    write_inertial,
    write_mat,
    write_table,
    write_xsens,
    xsens_rows,
)

from imu_rig.blocks import Samples
from imu_rig.errors import InputError
from imu_rig.importing.column_map import ColumnMap, make_column_map
from imu_rig.importing.foreign import ForeignRecording, SharedClock
from imu_rig.importing.formats import FORMATS, is_table, load_foreign, read_imu, recognize
from imu_rig.importing.joined import join_recordings
from imu_rig.importing.trial_file import counted

DEG = np.pi / 180


def one(recording):
    (stream,) = recording.streams.values()
    return stream


def table_text(n=50):
    accel, gyro = motion(n)
    rows = "\n".join(
        ",".join(f"{v:.6f}" for v in [*a, *g]) for a, g in zip(accel, gyro, strict=True)
    )
    return "ax,ay,az,gx,gy,gz\n" + rows + "\n"


def test_a_format_is_told_by_its_content_whatever_its_name(tmp_path):
    write_xsens(tmp_path / "a.csv", xsens_rows())
    write_inertial(tmp_path / "b.txt", range(0, 2_000_000, 10_000))
    write_inertial(tmp_path / "c.mat", np.arange(200) / 100, header="Time (s)")
    write_mat(tmp_path / "d.csv", broad_content())
    write_mat(tmp_path / "e", pyshoe_content())
    (tmp_path / "f.mat").write_text(table_text())
    names = {path.name: recognize(path) for path in tmp_path.iterdir()}
    assert names == {
        "a.csv": "xsens",
        "b.txt": "x-imu3",
        "c.mat": "ngimu",
        "d.csv": "broad",
        "e": "pyshoe",
        "f.mat": "table",
    }
    assert set(names.values()) == set(FORMATS)
    si = ColumnMap(rate_hz=100, accel_unit="m/s2", gyro_unit="rad/s")
    for path in tmp_path.iterdir():
        recording = load_foreign(path, columns=si if path.name == "f.mat" else None)
        assert recording.format == names[path.name]
        assert len(recording.imu()) == len(one(recording))


def test_options_for_columns_make_a_table_of_a_text(tmp_path):
    path = write_xsens(tmp_path / "a.txt", xsens_rows())
    stated = make_column_map(
        {
            "time": "SampleTimeFine",
            "time_unit": "us",
            "accel_unit": "m/s2",
            "gyro_unit": "rad/s",
            "mag_unit": "G",
        },
        "options",
    )
    recording = load_foreign(path, columns=stated)
    assert recording.format == "table"
    assert recording.imu().t[1] - recording.imu().t[0] == pytest.approx(1e-4)


# Xsens


def test_xsens_time_is_the_packets_not_the_rows(tmp_path):
    rows = xsens_rows(400, first=65_400)  # the counter wraps at 2^16
    accel, gyro = motion(400)
    kept = np.ones(400, bool)
    kept[[50, 51, 52, 137, 300]] = False
    path = write_xsens(tmp_path / "a.txt", [r for r, k in zip(rows, kept, strict=True) if k])
    samples = one(load_foreign(path))
    number = np.flatnonzero(kept)
    assert np.array_equal(samples.counter, 65_400 + number)
    assert np.allclose(samples.t, number / 100, atol=1e-12)
    assert np.allclose(samples.values["accel"], accel[kept], atol=1e-6)
    assert np.allclose(samples.values["gyro"], gyro[kept], atol=1e-6)
    assert samples.units["mag_normalized"] == "a.u."


def test_xsens_packets_without_numbers_are_lost_packets(tmp_path):
    rows = xsens_rows()
    for i in (30, 31):
        rows[i][3:] = [""] * 9
    rows[90][3:] = ["NaN"] * 9
    recording = load_foreign(write_xsens(tmp_path / "a.txt", rows))
    missing = sorted({*range(100, 300)} - {*one(recording).counter.tolist()})
    assert missing == [130, 131, 190]
    assert any("3 rows without numbers" in note for note in recording.notes)


@pytest.mark.parametrize("empty", ["", "NaN"])
def test_xsens_without_its_clock_goes_by_its_counter_and_rate(tmp_path, empty):
    rows = [[r[0], empty, *r[2:]] for r in xsens_rows() if r[0] != "00150"]
    samples = one(load_foreign(write_xsens(tmp_path / "a.txt", rows, rate="40.0Hz")))
    assert samples.t[-1] == pytest.approx(199 / 40)
    assert samples.t[50] - samples.t[49] == pytest.approx(2 / 40)


def test_xsens_clock_alone_tells_time_and_wraps(tmp_path):
    rows = xsens_rows()
    for i, row in enumerate(rows):
        row[1] = str((2**32 - 5_000 + 100 * i) % 2**32)
    names = [n for n in XSENS_NAMES if n != "PacketCounter"]
    path = write_xsens(tmp_path / "a.txt", [r[1:] for r in rows], names, rate=None)
    samples = one(load_foreign(path))
    assert samples.counter is None
    assert np.allclose(samples.t, np.arange(200) / 100)


def test_a_dot_counts_microseconds_and_degrees(tmp_path):
    rows = xsens_rows(ticks=16_667)
    in_degrees = [[*r[:2], *r[3:6], *(f"{float(v) / DEG:.8f}" for v in r[6:9])] for r in rows]
    names = [*XSENS_NAMES[:2], *XSENS_NAMES[3:9]]
    path = write_xsens(tmp_path / "dot.csv", in_degrees, names, rate=None, delimiter=",")
    recording = load_foreign(path)
    block = recording.imu()
    assert np.allclose(np.diff(block.t), 0.016667)
    assert np.allclose(block.gyro, motion()[1], atol=1e-6)
    assert any("DOT" in note for note in recording.notes)


def test_xsens_says_more_than_readings(tmp_path):
    names = [*XSENS_NAMES, *(f"Quat_q{i}" for i in range(4)), "Roll", "Pitch", "Yaw", "Pressure"]
    rows = [[*r, "0.5", "-0.5", "0.5", "0.5", "10", "20", "-30", "101325"] for r in xsens_rows()]
    recording = load_foreign(write_xsens(tmp_path / "a.txt", rows, names, device="00B42D4F"))
    samples = recording.streams["00B42D4F"]
    assert samples.values["orientation"][5].tolist() == [0.5, -0.5, 0.5, 0.5]
    assert samples.values["roll_pitch_yaw"][5].tolist() == [10, 20, -30]
    assert samples.values["pressure"].shape == (200,)
    assert samples.units["pressure"] == "Pa"
    assert recording.reference is None
    assert any("no reference" in note for note in recording.notes)


def test_xsens_start_in_utc_and_a_field_with_a_stated_unit(tmp_path):
    parts = ("Nano", "Year", "Month", "Day", "Hour", "Minute", "Second")
    names = [*XSENS_NAMES, *(f"UTC_{part}" for part in parts)]
    rows = [[*r, "250000000", "2020", "2", "29", "23", "59", "58"] for r in xsens_rows()]
    recording = load_foreign(
        write_xsens(tmp_path / "a.txt", rows, names), columns=ColumnMap(mag_unit="0.02 LSB/uT")
    )
    assert recording.start_utc_ns == 1_583_020_798_250_000_000
    assert recording.imu().mag.mean() == pytest.approx(25.0, abs=0.1)


# x-io


def test_x_imu3_stamps_count_from_1970_without_loss(tmp_path):
    stamps = 1_700_000_000_123_456 + 2_500 * np.arange(200)
    values = write_inertial(tmp_path / "Inertial.csv", stamps)
    recording = load_foreign(tmp_path / "Inertial.csv")
    assert recording.format == "x-imu3"
    assert recording.start_utc_ns == 1_700_000_000_123_456_000
    samples = one(recording)
    assert np.allclose(samples.t, 0.0025 * np.arange(200), atol=1e-12, rtol=0)
    assert np.array_equal(samples.values["accel"], values[:, 3:] * G)
    assert np.array_equal(samples.values["gyro"], values[:, :3] * DEG)


def test_a_folder_of_an_x_imu3_gives_every_rate_its_own_stream(tmp_path):
    device = tmp_path / "session" / "x-IMU3 Foot 0123ABCD"
    device.mkdir(parents=True)
    write_inertial(device / "Inertial.csv", 5_000_000 + 2_500 * np.arange(400))
    axes = "X Axis (a.u.),Y Axis (a.u.),Z Axis (a.u.)"
    field = np.random.default_rng(2).standard_normal((20, 3))
    slow = 5_001_000 + 50_000 * np.arange(20)
    write_table(device / "Magnetometer.csv", f"Timestamp (us),{axes}", slow, field)
    write_table(
        device / "Temperature.csv", "Timestamp (us),Temperature (degC)", slow[:5], np.arange(5.0)
    )
    elements = ",".join(f"{e} Element" for e in "WXYZ")
    unit = np.tile([1.0, 0, 0, 0], (20, 1))
    write_table(device / "Quaternion.csv", f"Timestamp (us),{elements}", slow, unit)
    (device / "Notification.csv").write_text("Timestamp (us),String\n5,hello\n6,bye\n")
    (device / "Ping.json").write_text("{}")
    for folder, prefix in ((device, ""), (tmp_path / "session", "")):
        recording = load_foreign(folder)
        streams = recording.streams
        assert set(streams) == {
            "x-IMU3 Foot 0123ABCD",
            f"{prefix}Magnetometer",
            f"{prefix}Temperature",
            f"{prefix}Quaternion",
        }
        assert recording.sensors == ["x-IMU3 Foot 0123ABCD"]
        assert len(recording.imu()) == 400
        assert recording.imu().mag is None
        magnetic = streams["Magnetometer"]
        assert magnetic.t[0] == pytest.approx(0.001)
        assert np.allclose(magnetic.values["magnetometer"], field, atol=1e-6)
        assert magnetic.units["magnetometer"] == "a.u."
        assert streams["Temperature"].values["temperature"].tolist() == [0, 1, 2, 3, 4]
        assert streams["Quaternion"].values["quaternion"].shape == (20, 4)
        assert any("Notification" in note for note in recording.notes)
        assert recording.start_utc_ns is None


def test_a_session_of_two_devices(tmp_path):
    for name, seed in (("left", 1), ("right", 2)):
        (tmp_path / name).mkdir()
        write_inertial(tmp_path / name / "Inertial.csv", 2_500 * np.arange(100) + seed, seed=seed)
    recording = load_foreign(tmp_path)
    assert recording.sensors == ["left", "right"]
    assert recording.streams["left"].t[0] == 0
    assert recording.streams["right"].t[0] == pytest.approx(1e-6)
    with pytest.raises(InputError, match="2 inertial sensors"):
        read_imu(tmp_path)
    assert len(read_imu(tmp_path, sensor="right")) == 100


def test_ngimu_sensors_with_field_and_pressure(tmp_path):
    accel, gyro = motion()
    more = np.tile([20.0, -5.0, 40.0, 1013.25], (200, 1))
    names = (
        f"{INERTIAL},Magnetometer X (uT),Magnetometer Y (uT),Magnetometer Z (uT),Barometer (hPa)"
    )
    values = np.hstack((gyro / DEG, accel / G, more))
    write_table(tmp_path / "sensors.csv", f"Time (s),{names}", np.arange(200) / 400, values)
    samples = one(load_foreign(tmp_path / "sensors.csv"))
    assert np.allclose(samples.values["accel"], accel, atol=1e-5)
    assert samples.values["mag"][0].tolist() == [20, -5, 40]
    assert samples.units["mag"] == "uT"
    assert samples.values["barometer"][0] == 1013.25
    assert samples.units["barometer"] == "hPa"


def test_rows_said_twice_are_read_once_and_equal_stamps_are_spread(tmp_path):
    stamps = np.arange(200) / 400
    write_inertial(tmp_path / "a.csv", stamps, header="Time (s)")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    twice = [*lines[:50], lines[49], *lines[50:]]
    (tmp_path / "b.csv").write_text("\n".join(twice))
    recording = load_foreign(tmp_path / "b.csv")
    assert len(one(recording)) == 200
    assert any("1 rows twice" in note for note in recording.notes)
    stamps[100:103] = stamps[103]
    write_inertial(tmp_path / "c.csv", stamps, header="Time (s)")
    t = one(load_foreign(tmp_path / "c.csv")).t
    assert np.allclose(t, np.arange(200) / 400)


# MATLAB


@pytest.mark.parametrize("compressed", [False, True])
def test_broad_keeps_its_reference_with_what_the_cameras_lost(tmp_path, compressed):
    content = broad_content()
    path = write_mat(tmp_path / "a.mat", content, do_compression=compressed)
    recording = load_foreign(path)
    block = recording.imu()
    assert np.array_equal(block.accel, content["imu_acc"])
    assert np.array_equal(block.gyro, content["imu_gyr"])
    assert np.array_equal(block.mag, content["imu_mag"])
    assert np.allclose(block.t, np.arange(300) * 7 / 2000)
    reference = recording.reference
    assert np.array_equal(reference.orientation, content["opt_quat"], equal_nan=True)
    assert np.array_equal(reference.position, content["opt_pos"], equal_nan=True)
    assert np.array_equal(reference.moving, content["movement"][:, 0])
    assert np.array_equal(reference.t, block.t)


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("dtype", ["f4", "i1", "u2", "i8", ">f8"])
def test_numbers_of_every_type_are_read(tmp_path, compressed, dtype):
    content = pyshoe_content()
    truth = (100 * np.random.default_rng(1).random((300, 3))).astype(dtype)
    path = write_mat(tmp_path / "a.mat", content | {"gt": truth}, do_compression=compressed)
    position = load_foreign(path).reference.position
    assert np.array_equal(position, truth.astype(float) * [1, -1, 1])


def test_pyshoe_truth_becomes_right_handed_and_axes_stay(tmp_path):
    content = pyshoe_content()
    recording = load_foreign(write_mat(tmp_path / "a.mat", content))
    block = recording.imu()
    assert np.array_equal(block.accel, content["imu"][:, :3])
    assert np.array_equal(block.gyro, content["imu"][:, 3:])
    assert np.array_equal(block.t, content["ts"][0] - content["ts"][0, 0])
    assert np.array_equal(recording.reference.position, content["gt"] * [1, -1, 1])
    notes = " ".join(recording.notes)
    assert "z points down" in notes
    assert "left-handed" in notes
    assert "zv_* are left out" in notes


# Tables


def two_sensors(n=80):
    left, right = np.hstack(motion(n, 1)), np.hstack(motion(n, 2))
    return left, right, np.stack((left, right), axis=2).reshape(n, 12)


@pytest.mark.parametrize("style", ["two rows", "prefix", "map"])
def test_several_sensors_of_one_table(tmp_path, style):
    left, right, mixed = two_sensors()
    axes = [f"{kind}_{axis}" for kind in ("acc", "gyr") for axis in "xyz"]
    pairs = [(side, axis) for axis in axes for side in ("left", "right")]
    options = {"rate_hz": 204.8, "accel_unit": "m/s2", "gyro_unit": "rad/s"}
    if style == "two rows":
        head = ["sensor," + ",".join(s for s, _ in pairs), "axis," + ",".join(a for _, a in pairs)]
    elif style == "prefix":
        head = ["row," + ",".join(f"{s}_{a}" for s, a in pairs)]
    else:
        head = ["row," + ",".join(f"c{i}" for i in range(12))]
        options["sensors"] = {
            "left": {"accel": "c0 c2 c4", "gyro": "c6 c8 c10"},
            "right": {"accel": [3, 5, 7], "gyro": [9, 11, 13]},
        }
    lines = [f"{i}," + ",".join(f"{v:.9f}" for v in row) for i, row in enumerate(mixed)]
    (tmp_path / "a.csv").write_text("\n".join([*head, *lines]))
    recording = load_foreign(tmp_path / "a.csv", columns=make_column_map(options, "map"))
    assert recording.sensors == ["left", "right"]
    for name, data in (("left", left), ("right", right)):
        block = recording.imu(name)
        assert np.allclose(block.accel, data[:, :3], atol=1e-8)
        assert np.allclose(block.gyro, data[:, 3:], atol=1e-8)
        assert block.t[-1] == pytest.approx(79 / 204.8)


def test_a_table_of_one_sensor_is_read_as_ever(tmp_path):
    (tmp_path / "a.csv").write_text(table_text())
    stated = ColumnMap(rate_hz=100, accel_unit="m/s2", gyro_unit="rad/s")
    assert is_table(tmp_path / "a.csv", stated)
    recording = load_foreign(tmp_path / "a.csv", columns=stated)
    assert list(recording.streams) == ["a"]
    assert np.array_equal(recording.imu().gyro, read_imu(tmp_path / "a.csv", stated).gyro)


# Joining and counting


def test_sensors_of_one_station_are_put_on_one_time(tmp_path):
    late = write_xsens(tmp_path / "late.txt", xsens_rows(first=7))
    early = write_xsens(tmp_path / "early.txt", xsens_rows(first=65_530))
    joined = join_recordings([load_foreign(late), load_foreign(early)])
    assert joined.streams["early"].t[0] == 0
    assert joined.streams["late"].t[0] == pytest.approx(0.13)  # 13 counts over the wrap
    assert any("PacketCounter" in note for note in joined.notes)


def test_what_shares_no_clock_is_not_joined(tmp_path):
    paths = [write_mat(tmp_path / f"{i}.mat", pyshoe_content()) for i in range(2)]
    with pytest.raises(InputError, match="no clock in common"):
        join_recordings([load_foreign(path) for path in paths])
    t = np.arange(3.0)
    clock = SharedClock("c", 0.0)
    same = [ForeignRecording("x", (p,), {"a": Samples(t, t)}, clock=clock) for p in paths]
    with pytest.raises(InputError, match="named 'a'"):
        join_recordings(same)


def test_a_gap_is_counted_and_jitter_is_not():
    rng = np.random.default_rng(4)
    steady = np.arange(3000) / 400
    jittery = np.sort(steady + rng.uniform(0, 0.004, 3000))  # up to 1.6 periods late
    assert np.array_equal(counted(jittery), np.arange(3000))
    present = np.ones(3000, bool)
    present[1000:1010] = present[2000] = False
    assert np.array_equal(counted(steady[present]), np.flatnonzero(present))
    numbers = counted(jittery[present])
    assert numbers[-1] == pytest.approx(2999, abs=2)
    assert np.diff(numbers)[999] == pytest.approx(11, abs=2)
    burst = steady.copy()
    burst[500:520] = steady[519] + np.arange(20) * 1e-5  # held back and sent at once
    assert np.array_equal(counted(burst), np.arange(3000))
