"""Text tables of other loggers: read right, or refused with the line, the column and the remedy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imu_rig.errors import InputError
from imu_rig.importing.column_map import (
    ColumnMap,
    load_column_map,
    make_column_map,
    recognize,
    recognize_time,
)
from imu_rig.importing.read_table import read_table
from imu_rig.importing.text_table import detect_form, read_numbers
from imu_rig.importing.unit_text import find_unit, parse_unit

DEG = np.pi / 180
G = 9.80665
SI = {"accel_unit": "m/s2", "gyro_unit": "rad/s"}
NAMES = "ax ay az gx gy gz"


def samples(n=60, seed=1):
    """Rows of six: near one g on a tilted sensor, small rates."""
    rng = np.random.default_rng(seed)
    accel = np.array([3.0, -4.0, 8.4]) + 0.05 * rng.standard_normal((n, 3))
    return np.hstack((accel, 0.02 * rng.standard_normal((n, 3))))


def lines(table, delimiter=",", decimal="."):
    return [delimiter.join(f"{v:.6f}" for v in row).replace(".", decimal) for row in table]


def write(tmp_path, text, name="t.csv"):
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def read(path, **options):
    return read_table(path, make_column_map(options, "options"))


def refusal(path, **options):
    with pytest.raises(InputError) as caught:
        read(path, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    return message


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " ", ", ", "   "])
@pytest.mark.parametrize(
    "head", ["", NAMES, "# made by hand\n#\n", "# " + NAMES, "made by hand\nFs,50\n\n" + NAMES]
)
@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
def test_delimiters_headers_comments_and_line_ends(tmp_path, delimiter, head, ending):
    data = samples()
    names = NAMES.replace(" ", delimiter)
    above = [line for line in head.replace(NAMES, names).split("\n") if line]
    text = ending.join(above + lines(data, delimiter)) + ending
    bare = {} if NAMES in head else {"columns": NAMES}
    block = read(write(tmp_path, text), rate_hz=50, **bare, **SI)
    assert np.allclose(block.accel, data[:, :3], atol=1e-6)
    assert np.allclose(block.gyro, data[:, 3:], atol=1e-6)
    assert np.allclose(block.t, np.arange(60) / 50)


@pytest.mark.parametrize("decimal", [".", ","])
def test_decimal_sign_is_recognized(tmp_path, decimal):
    data = samples()
    text = "\n".join([NAMES.replace(" ", ";"), *lines(data, ";", decimal)])
    block = read(write(tmp_path, text), rate_hz=100, **SI)
    assert np.allclose(block.accel, data[:, :3], atol=1e-6)


def test_byte_order_mark_quotes_trailing_delimiter_and_missing_last_newline(tmp_path):
    data = samples()
    header = ",".join(f'"{n}"' for n in NAMES.split()) + ","
    text = "\ufeff" + "\n".join([header, *(line + "," for line in lines(data))])
    assert np.allclose(read(write(tmp_path, text), rate_hz=100, **SI).gyro, data[:, 3:], atol=1e-6)
    quoted = "\n".join(
        [NAMES.replace(" ", ","), *('"' + ln.replace(",", '","') + '"' for ln in lines(data))]
    )
    assert np.allclose(
        read(write(tmp_path, quoted), rate_hz=100, **SI).gyro, data[:, 3:], atol=1e-6
    )


def test_text_columns_that_nobody_wants_are_passed_over(tmp_path):
    data = samples()
    rows = [f"left,{line}" for line in lines(data)]
    text = "\n".join(["part," + NAMES.replace(" ", ","), *rows])
    assert len(read(write(tmp_path, text), rate_hz=100, **SI)) == 60


def test_a_table_larger_than_one_piece_is_read_whole(tmp_path, monkeypatch):
    monkeypatch.setattr("imu_rig.importing.text_table.PIECE_BYTES", 1000)
    data = samples(500)
    text = "\r\n".join([NAMES.replace(" ", ","), *lines(data)])
    path = write(tmp_path, text)
    assert np.allclose(read(path, rate_hz=100, **SI).accel, data[:, :3], atol=1e-6)
    spoilt = text.replace(lines(data)[412], "1,2,3")
    assert "line 414: 3 columns instead of 6" in refusal(write(tmp_path, spoilt), rate_hz=100, **SI)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.lists(
            st.floats(-1e6, 1e6, allow_nan=False, allow_infinity=False), min_size=4, max_size=4
        ),
        min_size=3,
        max_size=20,
    ),
    st.sampled_from([",", ";", "\t", " "]),
)
def test_every_number_comes_back_as_it_was_written(tmp_path_factory, rows, delimiter):
    path = tmp_path_factory.mktemp("table") / "t.txt"
    path.write_text("\n".join(delimiter.join(map(repr, row)) for row in rows))
    form = detect_form(path)
    assert np.array_equal(read_numbers(path, form, range(4)), np.array(rows))


@pytest.mark.parametrize(
    ("header", "units"),
    [
        (
            "acc_x [m/s^2],acc_y [m/s^2],acc_z [m/s^2],gyr_x [deg/s],gyr_y [deg/s],gyr_z [deg/s]",
            (1, DEG),
        ),
        (
            "Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g),"
            "Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s)",
            (G, DEG),
        ),
        ("accel_x_mps2,accel_y_mps2,accel_z_mps2,gyro_x_dps,gyro_y_dps,gyro_z_dps", (1, DEG)),
        ("AccX (m/s²),AccY (m/s²),AccZ (m/s²),GyrX (°/s),GyrY (°/s),GyrZ (°/s)", (1, DEG)),
        (
            "i: ax [mg],i: ay [mg],i: az [mg],i: wx [rad/s],i: wy [rad/s],i: wz [rad/s]",
            (G / 1000, 1),
        ),
    ],
)
def test_units_in_column_names(tmp_path, header, units):
    data = samples() / np.repeat([units[0], units[1]], 3)
    path = write(tmp_path, "\n".join([header, *lines(data)]))
    block = read(path, rate_hz=100)
    assert np.allclose(block.accel, data[:, :3] * units[0], atol=1e-3)
    assert np.allclose(block.gyro, data[:, 3:] * units[1], atol=1e-6)


def test_raw_counts_become_si(tmp_path):
    counts = np.round(samples() / G * [16384] * 1)[:, :3]
    gyro = np.round(samples()[:, 3:] / DEG * 131)
    text = "\n".join(
        [
            NAMES.replace(" ", ","),
            *(",".join(f"{v:.0f}" for v in row) for row in np.hstack((counts, gyro))),
        ]
    )
    block = read(
        write(tmp_path, text), rate_hz=100, accel_unit="16384 LSB/g", gyro_unit="131 LSB/(deg/s)"
    )
    assert np.allclose(block.accel, counts / 16384 * G)
    assert np.allclose(block.gyro, gyro / 131 * DEG)


def test_columns_by_number_and_name_with_turned_signs(tmp_path):
    data = samples()
    path = write(tmp_path, "\n".join(["a,b,c,d,e,f", *lines(data)]))
    block = read(path, rate_hz=100, accel=["b", "-a", 3], gyro="d,-e,f", **SI)
    assert np.allclose(block.accel, data[:, [1, 0, 2]] * [1, -1, 1], atol=1e-6)
    assert np.allclose(block.gyro, data[:, 3:] * [1, -1, 1], atol=1e-6)
    block = read(path, rate_hz=100, accel="1,-2,3", gyro=[4, 5, 6], **SI)
    assert np.allclose(block.accel, data[:, :3] * [1, -1, 1], atol=1e-6)


def test_magnetometer_and_temperature(tmp_path):
    data = np.hstack(
        (
            samples(),
            [[0.2, -0.1, 0.4]] + 0.01 * samples(seed=2)[:, :3],
            np.linspace(20, 25, 60)[:, None],
        )
    )
    path = write(tmp_path, "\n".join([NAMES.replace(" ", ",") + ",mx,my,mz,temp", *lines(data)]))
    block = read(path, rate_hz=100, mag_unit="gauss", temperature="temp", **SI)
    assert np.allclose(block.mag, data[:, 6:9] * 100, atol=1e-3)
    assert np.allclose(block.temperature, data[:, 9], atol=1e-5)


@pytest.mark.parametrize(("unit", "factor"), [("s", 1), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)])
@pytest.mark.parametrize("way", ["header", "option", "neither"])
def test_time_columns(tmp_path, unit, factor, way):
    t = 100.0 + np.arange(60) * 0.01 + 1e-3 * np.sin(np.arange(60))
    name = {"header": f"time [{unit}]", "option": "time", "neither": "timestamp"}[way]
    rows = [f"{v / factor:.6f},{line}" for v, line in zip(t, lines(samples()), strict=True)]
    path = write(tmp_path, "\n".join([name + "," + NAMES.replace(" ", ","), *rows]))
    options = {"time_unit": unit} if way == "option" else {}
    block = read(path, **options, **SI)
    assert np.allclose(block.t, t, atol=1e-6)
    assert block.device_s is not None


def test_a_counter_of_samples_keeps_lost_ones_lost(tmp_path):
    keep = np.delete(np.arange(60), [20, 21, 22])
    rows = [f"{k},{line}" for k, line in zip(keep, lines(samples()[keep]), strict=True)]
    path = write(tmp_path, "\n".join(["PacketCounter," + NAMES.replace(" ", ","), *rows]))
    block = read(path, time="PacketCounter", time_unit="samples", rate_hz=50, **SI)
    assert np.allclose(block.t, keep / 50)
    assert "--rate" in refusal(path, time="PacketCounter", time_unit="samples", **SI)


def test_samples_that_share_a_stamp_are_spread_evenly(tmp_path):
    stamps = np.repeat(np.arange(1, 16) * 0.04, 4)
    rows = [f"{s:.3f},{line}" for s, line in zip(stamps, lines(samples()), strict=True)]
    path = write(tmp_path, "\n".join(["t," + NAMES.replace(" ", ","), *rows]))
    assert np.allclose(read(path, **SI).t, np.arange(1, 61) * 0.01)


def test_a_map_in_a_file(tmp_path):
    path = write(
        tmp_path,
        'columns = "t ax ay az"\naccel_unit = "g"\ntime_unit = "s"\nskip_rows = 2\n',
        "map.toml",
    )
    column_map = load_column_map(path)
    assert column_map.columns == ("t", "ax", "ay", "az")
    rows = [f"{k / 10},0.1,{0.2 + k / 1e3},{0.97 - k / 1e3}" for k in range(50)]
    rows[5] = rows[5].replace(",0.1,", ",0.11,")
    data = write(tmp_path, "\n".join(["junk", "0,0,0,0", *rows]))
    block = read_table(data, column_map)
    assert block.accel[0] == pytest.approx(np.array([0.1, 0.2, 0.97]) * G)
    assert not np.any(block.gyro)
    assert column_map.updated(accel_unit="m/s2", time=None).accel_unit == "m/s2"
    assert column_map.updated(rate_hz=None) == column_map


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("accel = [1, 2]", "accel"),
        ("nonsense = 1", "nonsense"),
        ("rate_hz = -5", "rate_hz"),
        ("rate_hz = inf", "rate_hz"),
        ("= 3", "not a TOML file"),
        ("skip_rows = 1.5", "skip_rows"),
        ('decimal = "x"', "decimal"),
    ],
)
def test_a_wrong_map_names_file_and_field(tmp_path, text, words):
    path = write(tmp_path, text, "map.toml")
    with pytest.raises(InputError, match=words) as caught:
        load_column_map(path)
    assert "map.toml" in str(caught.value)


def test_a_missing_map_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml"):
        load_column_map(tmp_path / "none.toml")
    with pytest.raises(InputError, match="column options: rate_hz"):
        ColumnMap().updated(rate_hz=-1)


HEADER = NAMES.replace(" ", ",")


def spoilt(row, change):
    rows = lines(samples())
    rows[row] = change(rows[row])
    return "\n".join([HEADER, *rows])


def field(column, text):
    def change(line):
        fields = line.split(",")
        fields[column] = text
        return ",".join(fields)

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (field(1, "nan"), "line 42, column ay holds 'nan'"),
        (field(1, "inf"), "line 42, column ay holds 'inf'"),
        (field(4, ""), "line 42, column gy is empty"),
        (field(5, "off"), "line 42, column gz holds 'off', which is no number"),
        (field(0, "1_000"), "line 42, column ax holds '1_000'"),
        (lambda line: line + ",7", "line 42: 7 columns instead of 6"),
        (lambda line: line[: line.rindex(",")], "line 42: 5 columns instead of 6"),
    ],
)
def test_a_bad_line_is_named(tmp_path, change, words):
    assert words in refusal(write(tmp_path, spoilt(40, change)), rate_hz=100, **SI)


def test_a_torn_last_line_is_named(tmp_path):
    text = "\n".join([HEADER, *lines(samples())])[:-30]
    assert "line 61" in refusal(write(tmp_path, text), rate_hz=100, **SI)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "is empty"),
        (b"\n\n  \n", "no lines of data"),
        (b"# only\n# comments\n", "no lines of data"),
        (b"hello world\nthis is prose\n", "no table of numbers"),
        (b"1,2\n3,4\n", "no table of numbers"),
        (b"\x1f\x8b\x08 zipped", "compressed"),
        (b"PK\x03\x04\x00\x00 a spreadsheet", "zero bytes"),
        ("a,b,c\n1,2,3\n".encode("utf-16"), "UTF-16"),
        ("a,b,c\n1,2,3\n".encode("utf-16-le"), "zero bytes"),
        (b"ax,ay,az\n1,2,3\n", "only 1 rows"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path, data, words):
    assert words in refusal(write(tmp_path, data), rate_hz=100, accel_unit="g")


def test_an_endless_line_is_refused_before_it_is_read(tmp_path, monkeypatch):
    monkeypatch.setattr("imu_rig.importing.text_table.PIECE_BYTES", 10_000)
    assert "a line of" in refusal(write(tmp_path, b"7" * 50_000))


def test_absurd_lengths_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("imu_rig.importing.text_table.MAXIMUM_ROWS", 50)
    path = write(tmp_path, "\n".join([HEADER, *lines(samples())]))
    assert "cut it up" in refusal(path, rate_hz=100, **SI)


def test_missing_files_and_folders_are_named(tmp_path):
    assert "does not exist" in refusal(tmp_path / "none.csv")
    assert "not a file" in refusal(tmp_path)


def test_a_dead_axis_is_named(tmp_path):
    data = samples()
    data[:, 4] = 0.25
    path = write(tmp_path, "\n".join([HEADER, *lines(data)]))
    assert "column gy is 0.25 in every row" in refusal(path, rate_hz=100, **SI)


@pytest.mark.parametrize(
    ("header", "options", "words"),
    [
        (None, {}, "--columns ax,ay,az,gx,gy,gz"),
        (HEADER, {}, "--rate HZ"),
        ("Fs: 50\n" + HEADER, {}, "preamble says 'Fs: 50'"),
        ("u,v,w,x,y,z", {}, "--accel X,Y,Z"),
        (HEADER, {"accel": ["ax", "ay", "no"], "rate_hz": 9}, "no column 'no'"),
        (HEADER, {"accel": [1, 2, 9], "rate_hz": 9}, "no column 9: the table has 6"),
        (HEADER, {"accel": "1,2,0", "rate_hz": 9}, "no column 0"),
        (HEADER, {"accel": [1, 2, 2], "rate_hz": 9}, "names one twice"),
        (HEADER, {"columns": "a b c", "rate_hz": 9}, "6 columns, but 3 names"),
        ("ax,ay,az,ax,ay,az", {"rate_hz": 9}, "more than one set"),
        ("ax [g],ay [g],az [mg],gx,gy,gz", {"rate_hz": 9}, "different units"),
        (HEADER, {"accel_unit": "furlong", "rate_hz": 9}, "'furlong' is no unit"),
        (HEADER, {"delimiter": "xy"}, "cannot be a delimiter"),
    ],
)
def test_columns_that_are_not_clear_are_asked_for(tmp_path, header, options, words):
    path = write(tmp_path, "\n".join([*([header] if header else []), *lines(samples())]))
    if "delimiter" in options:
        with pytest.raises(InputError, match=words):
            read(path, **options)
        return
    assert words in refusal(path, **options)


@pytest.mark.parametrize(
    ("stamps", "options", "words"),
    [
        (np.r_[np.arange(30), np.arange(30)] * 0.01, {}, "line 32: time goes back"),
        (np.zeros(60), {}, "is 0 in every row"),
        (np.arange(60) * 0.01, {"rate_hz": 50}, "stated as 50 Hz, but its time column runs at 100"),
        (np.arange(60) * 10.0, {"time_unit": "s"}, "the rate is 0.1 Hz"),
        (np.arange(60) * 0.7e-3, {"time_unit": "fortnight"}, "'fortnight' is no unit of time"),
        (np.arange(60) * 1e12, {}, "fits no unit"),
    ],
)
def test_time_that_cannot_be_is_refused(tmp_path, stamps, options, words):
    rows = [f"{s!r},{line}" for s, line in zip(stamps.tolist(), lines(samples()), strict=True)]
    path = write(tmp_path, "\n".join(["time," + HEADER, *rows]))
    assert words in refusal(path, **options, **SI)


@pytest.mark.parametrize(
    ("text", "kind", "factor"),
    [
        ("m/s^2", "accel", 1.0),
        ("m/s²", "accel", 1.0),
        ("G", "accel", G),
        ("mg", "accel", G / 1000),
        ("2048 LSB/g", "accel", G / 2048),
        ("1000 counts/(m/s2)", "accel", 1e-3),
        ("16.4 LSB/(deg/s)", "gyro", DEG / 16.4),
        ("16.4 lsb/dps", "gyro", DEG / 16.4),
        ("°/s", "gyro", DEG),
        ("µT", "mag", 1.0),
        ("mG", "mag", 0.1),
        ("usec", "time", 1e-6),
    ],
)
def test_units_as_people_write_them(text, kind, factor):
    assert parse_unit(text, kind) == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize(
    "text", ["", "0 LSB/g", "-5 LSB/g", "1e999 LSB/g", "1.2.3 LSB/g", "LSB/g", "5 LSB/furlong"]
)
def test_what_is_no_unit(text):
    assert find_unit(text, "accel") is None
    with pytest.raises(InputError, match="LSB/g"):
        parse_unit(text, "accel")


def test_names_are_recognized_only_when_they_are_clear():
    assert (
        recognize(
            ["linear_acceleration_x", "linear_acceleration_y", "linear_acceleration_z"], "accel"
        )
        is None
    )
    assert recognize(["max", "may", "maz"], "accel") is None
    assert recognize(["ax", "ay"], "accel") is None
    assert recognize_time(["counter", "uptime_cycles"]) is None
    assert recognize_time(["n", "time_ms"]) == (1, "ms")
    found = recognize(["t", "z_acc", "y_acc", "x_acc"], "accel")
    assert found is not None
    assert found.indices == (3, 2, 1)


def test_a_number_that_no_sensor_gives_is_refused_by_its_line(tmp_path):
    for column, name in ((1, "ay"), (5, "gz")):
        table = samples()
        table[7, column] = -1e200
        path = write(tmp_path, "\n".join([NAMES, *lines(table, " ")]))
        with pytest.raises(InputError, match=rf"line 9: column {name} is -1e\+200"):
            read_table(path, ColumnMap(rate_hz=100.0))
