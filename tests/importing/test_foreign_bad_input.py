"""Recordings of other programs that cannot be read: one sentence that says where and what to do."""

import numpy as np
import pytest
from foreign_files import (
    XSENS_NAMES,
    broad_content,
    pyshoe_content,
    write_inertial,
    write_mat,
    write_xsens,
    xsens_rows,
)
from scipy.io import savemat

from imu_rig.errors import InputError
from imu_rig.importing.column_map import ColumnMap
from imu_rig.importing.formats import load_foreign


def refusal(path, columns=None, form=None):
    with pytest.raises(InputError) as caught:
        load_foreign(path, form, columns)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    return message


def spoilt_xsens(tmp_path, change, **options):
    rows = xsens_rows()
    change(rows)
    return write_xsens(tmp_path / "a.txt", rows, **options)


def put(row, column, text):
    def change(rows):
        rows[row][column] = text

    return change


def swap(rows):
    rows[40], rows[41] = rows[41], rows[40]


def twice(rows):
    rows.insert(41, list(rows[40]))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (put(40, 7, "1e300"), ["line 45", "gyro is no sensor's"]),
        (put(40, 4, "oops"), ["line 45", "Acc_Y", "oops"]),
        (put(40, 4, ""), ["line 45", "some of its readings are missing"]),
        (put(40, 4, "inf"), ["line 45", "Acc_Y"]),
        (put(40, 0, "12.5"), ["line 45", "PacketCounter is 12.5", "no count"]),
        (put(40, 0, ""), ["line 45", "PacketCounter"]),
        (swap, ["line 46", "PacketCounter 140 follows 141"]),
        (twice, ["line 46", "PacketCounter 140 comes twice"]),
        (lambda rows: rows[199].pop(), ["line 204", "11 columns instead of 12"]),
        (lambda rows: [row.pop() for row in rows], ["header another number"]),
        (lambda rows: rows.__delitem__(slice(1, None)), ["fewer than 2 packets"]),
        (lambda rows: [put(i, 1, str(7 * i))(rows) for i in range(200)], ["stated rate of 100"]),
        (
            lambda rows: [put(i, j, "")(rows) for i in range(200) for j in range(3, 9)],
            ["no numbers under Acc_X"],
        ),
    ],
)
def test_xsens_damage_is_named_by_its_line(tmp_path, change, words):
    message = refusal(spoilt_xsens(tmp_path, change))
    for word in words:
        assert word in message


def test_xsens_without_rate_or_with_two(tmp_path):
    rows = [[r[0], "", *r[2:]] for r in xsens_rows()]
    path = write_xsens(tmp_path / "a.txt", rows, rate=None)
    assert "--rate" in refusal(path)
    assert load_foreign(path, columns=ColumnMap(rate_hz=50)).imu().t[-1] == pytest.approx(199 / 50)
    write_xsens(path, rows, rate="100.0Hz")
    assert "leave out the rate" in refusal(path, ColumnMap(rate_hz=50))


def test_units_that_rest_contradicts_are_refused(tmp_path):
    rows = xsens_rows()
    for row in rows:
        row[3:6] = [f"{float(v) / 9.80665:.6f}" for v in row[3:6]]
    path = write_xsens(tmp_path / "a.txt", rows)
    assert "--accel-unit g" in refusal(path)
    block = load_foreign(path, columns=ColumnMap(accel_unit="g")).imu()
    assert np.linalg.norm(block.accel.mean(axis=0)) == pytest.approx(9.8, abs=0.1)
    content = broad_content()
    content["imu_acc"] = content["imu_acc"] / 9.80665
    assert "looks like g" in refusal(write_mat(tmp_path / "b.mat", content))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "is empty"),
        ("PacketCounter\tAcc_X\n1\t2\n".encode("utf-16"), "UTF-16"),
        (b"\x1f\x8b\x08\x00zipped", "compressed"),
        (b"\x89IMU\r\n\x1a\n", "trial file"),
        (b"MATLAB 7.3 MAT-file, made by a test", "version 7.3"),
        (b"MATLAB 5.0 MAT-file", "damaged"),
        (b"MATLAB 5.0 MAT-file" + bytes(200), "damaged"),
        (b"Timestamp (us),Gyroscope X (deg/s)\n", "no table of numbers"),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path, data, words):
    (tmp_path / "a").write_bytes(data)
    assert words in refusal(tmp_path / "a")


def test_places_that_are_no_files(tmp_path):
    assert "does not exist" in refusal(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    assert "folder without CSV files" in refusal(tmp_path / "empty")
    assert "no format" in refusal_of_format(tmp_path)


def refusal_of_format(tmp_path):
    (tmp_path / "a.csv").write_text("1,2,3\n")
    with pytest.raises(InputError) as caught:
        load_foreign(tmp_path / "a.csv", "pickle")
    return str(caught.value)


def test_x_io_damage_is_named_by_its_line(tmp_path):
    path = tmp_path / "Inertial.csv"
    write_inertial(path, range(0, 1_000_000, 10_000))
    lines = path.read_text().splitlines()

    def message(at, text):
        path.write_text("\n".join([*lines[:at], text, *lines[at + 1 :]]))
        return refusal(path)

    cells = lines[30].split(",")
    assert "line 31: time goes back" in message(30, ",".join(["100000", *cells[1:]]))
    assert "line 31, column Gyroscope Y" in message(30, ",".join([*cells[:2], "", *cells[3:]]))
    assert "'nan'" in message(30, ",".join([*cells[:2], "nan", *cells[3:]]))
    assert "line 31: 3 columns instead of 7" in message(30, ",".join(cells[:3]))
    assert "which no sensor gives" in message(30, ",".join([*cells[:2], "1e300", *cells[3:]]))
    assert "1 columns instead" in message(100, "9")


@pytest.mark.parametrize("rows", [2, 3, 5])
def test_a_few_rows_are_a_recording(tmp_path, rows):
    path = write_xsens(tmp_path / "a.txt", xsens_rows(rows))
    assert len(load_foreign(path).imu()) == rows
    write_inertial(tmp_path / "b.csv", range(0, 10_000 * rows, 10_000))
    assert len(load_foreign(tmp_path / "b.csv").imu()) == rows


def test_a_folder_is_not_left(tmp_path):
    (tmp_path / "outside").mkdir()
    write_inertial(tmp_path / "outside" / "Inertial.csv", range(0, 1_000_000, 10_000))
    (tmp_path / "session").mkdir()
    (tmp_path / "session" / "Inertial.csv").symlink_to(tmp_path / "outside" / "Inertial.csv")
    (tmp_path / "session" / "device").symlink_to(tmp_path / "outside")
    assert "without CSV files" in refusal(tmp_path / "session")


def without(content, *names):
    return {name: value for name, value in content.items() if name not in names}


def changed(content, name, change):
    return content | {name: change(np.array(content[name], dtype=float))}


def set_nan(matrix):
    matrix[41, 1] = np.nan
    return matrix


def set_back(ts):
    ts[0, 100] = ts[0, 99]
    return ts


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (changed(broad_content(), "imu_gyr", set_nan), ["row 42 of imu_gyr"]),
        (changed(broad_content(), "imu_gyr", np.transpose), ["imu_gyr is 3 x 300, not n x 3"]),
        (changed(broad_content(), "opt_quat", lambda q: q[:-1]), ["opt_quat has 299 rows"]),
        (changed(broad_content(), "opt_quat", lambda q: 2 * q), ["row 1 of opt_quat", "norm 2"]),
        (changed(broad_content(), "sampling_rate", lambda r: -r), ["sampling_rate is -285"]),
        (changed(broad_content(), "sampling_rate", lambda r: r * np.nan), ["no number"]),
        (changed(broad_content(), "sampling_rate", lambda r: [r, r]), ["sampling_rate is 1 x 2"]),
        (
            broad_content() | {"imu_acc": broad_content()["imu_acc"] + 1j},
            ["of no kind that is read"],
        ),
        (without(broad_content(), "imu_acc"), ["of no kind that is read"]),
        (changed(pyshoe_content(), "ts", set_back), ["row 101 of ts"]),
        (changed(pyshoe_content(), "ts", lambda t: 1000 * t), ["ts must be in seconds"]),
        (changed(pyshoe_content(), "ts", lambda t: t[:, :50]), ["ts has 50 rows, imu 300"]),
        (changed(pyshoe_content(), "imu", lambda m: m[:, :5]), ["imu is 300 x 5, not n x 6"]),
        (changed(pyshoe_content(), "imu", lambda m: m[:0]), ["imu has 0 rows"]),
        (pyshoe_content() | {"imu": "text"}, ["of no kind that is read"]),
        ({"imu": {"a": 1}, "ts": np.array([1, "a"], dtype=object)}, ["of no kind that is read"]),
    ],
)
def test_wrong_matrices_are_named(tmp_path, content, words):
    message = refusal(write_mat(tmp_path / "a.mat", content))
    for word in words:
        assert word in message


def test_matlab_files_state_their_units(tmp_path):
    path = write_mat(tmp_path / "a.mat", broad_content())
    assert "leave those options out" in refusal(path, ColumnMap(gyro_unit="deg/s"))
    assert "no pyshoe trial" in refusal(path, form="pyshoe")


def test_a_huge_matrix_is_refused_by_its_shape_alone(tmp_path, monkeypatch):
    path = write_mat(tmp_path / "a.mat", pyshoe_content(n=500), do_compression=True)
    monkeypatch.setattr("imu_rig.importing.matlab_file.MAXIMUM_ROWS", 400)
    monkeypatch.setattr("imu_rig.importing.matlab_file.read_matrix", None)
    assert "has 500 rows" in refusal(path)


@pytest.mark.parametrize("compressed", [False, True])
def test_damaged_matlab_files_are_read_right_or_refused(tmp_path, compressed):
    path = tmp_path / "a.mat"
    savemat(path, pyshoe_content(n=40), do_compression=compressed)
    whole = path.read_bytes()
    rng = np.random.default_rng(5)
    for trial in range(120):
        data = bytearray(whole)
        for _ in range(1 + trial % 3):
            at = int(rng.integers(20, min(len(data), 2000)))
            data[at] ^= 1 << int(rng.integers(8))
        if trial % 5 == 0:
            del data[int(rng.integers(100, len(data))) :]
        path.write_bytes(data)
        recording = read_or_none(path)
        assert recording is None or len(recording.imu()) == 40


def read_or_none(path):
    try:
        return load_foreign(path)
    except InputError:
        return None


def test_text_with_a_byte_order_mark_is_read(tmp_path):
    rows = xsens_rows()
    path = write_xsens(tmp_path / "a.txt", rows)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert len(load_foreign(path).imu()) == 200
    names = XSENS_NAMES
    write_xsens(path, [[cell.replace(".", ",") for cell in r] for r in rows], names)
    assert len(load_foreign(path).imu()) == 200  # a decimal comma
