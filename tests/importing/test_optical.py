"""Positions of markers from tables and C3D files, and footprints, as programs write them."""

import contextlib
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from imu_rig.errors import InputError
from imu_rig.importing.c3d_points import is_c3d, open_c3d
from imu_rig.importing.footprints import read_footprints
from imu_rig.importing.optical import read_reference

ezc3d = pytest.importorskip("ezc3d")

T = np.arange(50) * 0.01
WAY = np.column_stack((1.3 * T, 0.1 * np.sin(5 * T), 0.05 + 0.02 * np.cos(9 * T)))


def write(path, header, table, delimiter=",", gap=""):
    rows = [delimiter.join(gap if np.isnan(v) else f"{v:.6f}" for v in row) for row in table]
    path.write_text("\n".join([*header, *rows]) + "\n")
    return path


@pytest.mark.parametrize(
    ("header", "scale", "options"),
    [
        (["time,x [mm],y [mm],z [mm]"], 1e3, {}),
        (["t_s,x_m,y_m,z_m"], 1.0, {}),
        (["Time (s),pos_x,pos_y,pos_z"], 1.0, {"unit": "m"}),
        (["time,heel_x_mm,heel_y_mm,heel_z_mm"], 1e3, {}),
        ([",heel,heel,heel", "time,x,y,z"], 1e3, {"unit": "mm"}),
        ([], 1e2, {"unit": "cm"}),
        (["time,a,b,c"], 1.0, {"columns": ("a", 3, "c"), "unit": "m"}),
    ],
)
def test_tables_of_any_program(tmp_path, header, scale, options):
    """Names, rows of markers, numbers alone, or stated columns."""
    path = write(tmp_path / "m.csv", header, np.column_stack((T, scale * WAY)))
    reference = read_reference(path, **options)
    assert reference.t == pytest.approx(T, abs=1e-6)
    assert reference.position == pytest.approx(WAY, abs=1e-5)


@pytest.mark.parametrize("gap", ["", "NaN"])
def test_a_lost_marker_is_no_place(tmp_path, gap):
    """One axis lost is all lost."""
    table = np.column_stack((T, 1e3 * WAY))
    table[10:20, 1:] = np.nan
    table[25, 2] = np.nan
    path = write(tmp_path / "m.csv", ["time,x [mm],y [mm],z [mm]"], table, gap=gap)
    places = read_reference(path).position
    lost = np.isnan(places).any(axis=1)
    assert np.flatnonzero(lost).tolist() == [*range(10, 20), 25]
    assert np.isnan(places[lost]).all()


def test_milliseconds_rates_and_y_up(tmp_path):
    """Time in ms is recognized by its steps; axes are turned without changing the hand."""
    path = write(tmp_path / "m.csv", ["time,x_m,y_m,z_m"], np.column_stack((1e3 * T, WAY)))
    assert read_reference(path).t == pytest.approx(T)
    bare = write(tmp_path / "b.csv", ["x_m,y_m,z_m"], WAY)
    reference = read_reference(bare, rate_hz=100.0, y_up=True)
    assert reference.t == pytest.approx(T)
    assert reference.position[:, 2] == pytest.approx(WAY[:, 1], abs=1e-5)
    assert reference.position[:, 1] == pytest.approx(-WAY[:, 2], abs=1e-5)
    assert "y up" in reference.frame


@pytest.mark.parametrize(
    ("header", "table", "options", "says"),
    [
        (["time,x,y,z"], np.column_stack((T, 1e3 * WAY)), {}, "reads like mm"),
        (["time,x,y,z"], np.column_stack((T, WAY)), {}, "state m, cm, mm"),
        (["x_m,y_m,z_m"], WAY, {}, "no time column"),
        (["time,x_m,y_m,z_m"], np.column_stack((T[::-1], WAY)), {}, "line 3: time goes back"),
        (["time,x_m,y_m,z_m"], np.column_stack((T, 1e7 * WAY)), {}, "than anybody walks"),
        (["time,x_m,y_m,z_m"], np.column_stack((T, np.nan * WAY)), {}, "never seen"),
        (["time,qx,qy,qz"], np.column_stack((T, WAY)), {}, "recognized as a position"),
        (["time,x_m,y_m,z_m"], np.column_stack((T, WAY)), {"unit": "feet"}, "no unit of length"),
        (
            ["time,a_x,a_y,a_z,heel_x,heel_y,heel_z,toe_x,toe_y,toe_z"],
            np.column_stack((T, WAY, WAY, WAY)),
            {},
            "2 markers: say which of heel, toe",
        ),
        (
            ["time,heel_x,heel_y,heel_z"],
            np.column_stack((T, WAY)),
            {"marker": "knee"},
            "no marker 'knee'; there are heel",
        ),
    ],
)
def test_what_is_wrong_with_a_table_is_told(tmp_path, header, table, options, says):
    """One sentence, by the file."""
    path = write(tmp_path / "m.csv", header, table)
    with pytest.raises(InputError, match=says) as error:
        read_reference(path, **options)
    assert str(path) in str(error.value)


def made_c3d(path, *, unit="mm", up="+Z", scale=1e3, lost=()):
    """Markers ``walker:heel`` and ``walker:toe`` at 100 Hz by the usual library."""
    file = ezc3d.c3d()
    del file["data"]["rotations"]
    points = np.ones((4, 2, len(T)))
    points[:3, 0], points[:3, 1] = scale * WAY.T, scale * (WAY.T + 0.2)
    points[:3, 0, list(lost)] = np.nan
    file["data"]["points"] = points
    point = file["parameters"]["POINT"]
    point["RATE"]["value"], point["UNITS"]["value"] = [100.0], [unit]
    point["LABELS"]["value"] = ["walker:heel", "walker:toe"]
    file.add_parameter("POINT", "Y_SCREEN", [up])
    file["data"]["analogs"] = np.zeros((1, 3, 4 * len(T)))
    file["parameters"]["ANALOG"]["RATE"]["value"] = [400.0]
    file["parameters"]["ANALOG"]["LABELS"]["value"] = ["a", "b", "c"]
    file["parameters"]["ANALOG"]["SCALE"]["value"] = [1.0] * 3
    file.write(str(path))
    return path


@pytest.fixture(scope="module")
def c3d(tmp_path_factory):
    return made_c3d(tmp_path_factory.mktemp("c3d") / "walk.c3d", lost=(3, 4))


@pytest.mark.parametrize("marker", ["heel", "walker:heel", "WALKER:Heel"])
def test_a_marker_of_a_c3d_file(c3d, marker):
    """By name, in the file's unit, lost where the system lost it, analog samples passed over."""
    reference = read_reference(c3d, marker=marker)
    assert np.diff(reference.t) == pytest.approx(np.full(len(T) - 1, 0.01))
    assert np.flatnonzero(np.isnan(reference.position[:, 0])).tolist() == [3, 4]
    assert reference.position[5:] == pytest.approx(WAY[5:], abs=1e-6)


def test_c3d_tells_its_unit_and_which_way_is_up(tmp_path):
    """Metres, and y up on its screen."""
    path = made_c3d(tmp_path / "m.c3d", unit="m", up="+Y", scale=1.0)
    places = read_reference(path, marker="heel").position
    assert places[:, 2] == pytest.approx(WAY[:, 1], abs=1e-6)
    with pytest.raises(InputError, match="2 markers: say which of walker:heel, walker:toe"):
        read_reference(path)
    with pytest.raises(InputError, match="no marker 'knee'"):
        read_reference(path, marker="knee")


def integer_c3d(endian):
    """A file of one marker in 16-bit integers at 50 Hz, made by hand from the format's pages."""
    processor = {"<": 84, ">": 86}[endian]

    def parameter(name, group, kind, shape, data):
        body = struct.pack("bB", kind, len(shape)) + bytes(shape) + data + b"\x00"
        head = struct.pack("bb", len(name), group) + name.encode()
        return head + struct.pack(f"{endian}H", len(body) + 2) + body

    group = struct.pack("bb", 5, -1) + b"POINT" + struct.pack(f"{endian}H", 3) + b"\x00"
    section = group + parameter("UNITS", 1, -1, [2], b"mm")
    section += parameter("LABELS", 1, -1, [4, 1], b"heel") + b"\x00\x00"
    section = bytes([0, 0, 1, processor]) + section
    head = bytes([2, 0x50]) + struct.pack(f"{endian}4H", 1, 0, 11, 13)
    head += struct.pack(f"{endian}HfHHf", 0, 0.5, 3, 0, 50.0)
    frames = struct.pack(f"{endian}12h", 2, 4, 6, 0, 0, 0, 0, -1, -2, -4, 2000, 5)
    return head.ljust(512, b"\x00") + section.ljust(512, b"\x00") + frames


@pytest.mark.parametrize("endian", ["<", ">"])
def test_integers_are_scaled_and_minus_one_means_lost(tmp_path, endian):
    """Half a millimetre per count; time counts from frame 1 of the capture."""
    path = tmp_path / "i.c3d"
    path.write_bytes(integer_c3d(endian))
    reference = read_reference(path)
    assert reference.t == pytest.approx([0.20, 0.22, 0.24])
    assert reference.position[0] == pytest.approx([1e-3, 2e-3, 3e-3])
    assert np.isnan(reference.position[1]).all()
    assert reference.position[2] == pytest.approx([-1e-3, -2e-3, 1.0])


def test_cut_c3d_files_are_refused(tmp_path, c3d):
    """Wherever they end."""
    whole = c3d.read_bytes()
    path = tmp_path / "cut.c3d"
    for size in (2, 100, 511, 513, 600, 1500, len(whole) // 2, len(whole) - 600):
        path.write_bytes(whole[:size])
        with pytest.raises(InputError, match="damaged"):
            open_c3d(path)


@settings(max_examples=100)
@given(where=st.integers(0, 2047), value=st.integers(0, 255))
def test_damaged_c3d_files_end_in_a_sentence(tmp_path_factory, c3d, where, value):
    """One wrong byte in header or parameters: an answer or a sentence, never more memory."""
    data = bytearray(c3d.read_bytes())
    data[where] = value
    path = tmp_path_factory.getbasetemp() / "wrong.c3d"
    path.write_bytes(data)
    if not is_c3d(path):
        return
    with contextlib.suppress(InputError):
        assert len(read_reference(path, marker="heel")) <= len(data)


def test_a_dec_file_is_refused(tmp_path):
    """Its floats are of another kind."""
    data = bytearray(integer_c3d("<"))
    data[515] = 85
    (tmp_path / "d.c3d").write_bytes(data)
    with pytest.raises(InputError, match="DEC"):
        read_reference(tmp_path / "d.c3d")


PRINTS = np.array([[0.0, 0.0], [0.63, 0.03], [2.1, -0.01], [3.6, 0.02]])


@pytest.mark.parametrize(
    ("header", "scale", "options"),
    [
        (["x,y"], 1.0, {}),
        (["x [mm],y [mm]"], 1e3, {}),
        (["stride,x_cm,y_cm"], 1e2, {}),
        ([], 1.0, {}),
        ([], 1e3, {"unit": "mm"}),
    ],
)
def test_footprints_of_a_table(tmp_path, header, scale, options):
    """Metres unless somebody says otherwise."""
    table = scale * PRINTS
    if header and header[0].startswith("stride"):
        table = np.column_stack((np.arange(4), table))
    path = write(tmp_path / "f.csv", header, table)
    assert read_footprints(path, **options).position == pytest.approx(PRINTS)


def test_footprints_with_height_and_of_matlab(tmp_path):
    """A third column is height; the matrix of the published footprints is read as it is."""
    path = write(tmp_path / "f.csv", ["x,y,z"], np.column_stack((PRINTS, [0, 0.1, 0.2, 0.3])))
    assert read_footprints(path).position[:, 2] == pytest.approx([0, 0.1, 0.2, 0.3])
    savemat(tmp_path / "f.mat", {"GCP_meters": PRINTS, "expID": 3})
    assert read_footprints(tmp_path / "f.mat").position == pytest.approx(PRINTS)


@pytest.mark.parametrize(
    ("header", "table", "says"),
    [
        (["x,y"], 1e3 * PRINTS, "more than anybody strides"),
        (["x,y"], PRINTS[:1], "1 footprints"),
        (["left,right"], PRINTS, "x and y of footprints"),
        (["x_mm,y_m"], PRINTS, "different units"),
        ([], np.column_stack((PRINTS, PRINTS)), "4 columns without names"),
    ],
)
def test_what_is_wrong_with_footprints_is_told(tmp_path, header, table, says):
    """One sentence, by the file."""
    path = write(tmp_path / "f.csv", header, table)
    with pytest.raises(InputError, match=says) as error:
        read_footprints(path)
    assert str(path) in str(error.value)


def test_files_without_positions_are_told(tmp_path):
    """MATLAB files of other things, and nothing at all."""
    savemat(tmp_path / "a.mat", {"a": np.eye(3)})
    with pytest.raises(InputError, match="without optical positions"):
        read_reference(tmp_path / "a.mat")
    with pytest.raises(InputError, match="no matrix GCP_meters"):
        read_footprints(tmp_path / "a.mat")
    for read in (read_reference, read_footprints):
        with pytest.raises(InputError, match="does not exist"):
            read(tmp_path / "none.csv")
