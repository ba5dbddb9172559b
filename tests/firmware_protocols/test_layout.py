"""Packet layouts as files and plain data: what they say, what is refused, with which sentence."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocols.checksums import SIZES
from firmware_protocols.known import builtin_protocols, load_protocol, protocol_from_dict
from firmware_protocols.layout import (
    DEFAULT_LAYOUT_NAME,
    MAX_FILE_BYTES,
    TYPE_SIZES,
    Checksum,
    Field,
    LayoutError,
    PacketLayout,
    load_layout,
)
from firmware_protocols.rows import RATES_HZ, TICKS_S

SMALL = """
name = "lab-7"
title = "A lab's own packet"
header = "7E"
counter = "n"

[[fields]]
name = "n"
type = "u16"
byte_order = "big"

[[fields]]
name = "accel"
type = "i16"
count = 3
unit = "g"
counts_per_unit = 2048

[checksum]
kind = "sum8"
start = 1
"""


@pytest.fixture
def load(tmp_path):
    def load_text(text):
        path = tmp_path / "lab.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load_layout(path)

    return load_text


def names(letters, greatest):
    return st.text(letters, min_size=1, max_size=greatest)


@st.composite
def layouts(draw):
    """Any layout that is allowed."""
    orders = st.none() | st.sampled_from(["little", "big"])
    positive = st.floats(min_value=1e-9, max_value=1e9)
    printable = st.characters(exclude_categories=["C", "Z"]) | st.just(" ")
    fields = []
    for name in draw(st.lists(names("abcxyz_09", 8), min_size=1, max_size=6, unique=True)):
        kind = draw(st.sampled_from(sorted(TYPE_SIZES)))
        count = draw(st.integers(1, 5))
        signs = [draw(st.sampled_from("+-")) + axis for axis in draw(st.permutations("xyz"))]
        fields.append(
            Field(
                name=f"f{name}",
                type=kind,
                count=count,
                byte_order=draw(orders),
                unit=draw(st.sampled_from(["", "g", "deg/s", "uT"])),
                counts_per_unit=draw(positive) * draw(st.sampled_from([1, -1])),
                zero=draw(st.floats(-1e6, 1e6)),
                axes=tuple(signs) if count == 3 and draw(st.booleans()) else None,
            )
        )
    counting = [f.name for f in fields if f.type in ("u8", "u16", "u24", "u32") and f.count == 1]
    header = draw(st.binary(min_size=1, max_size=4))
    checksum = None
    if draw(st.booleans()):
        checksum = Checksum(draw(st.sampled_from(sorted(SIZES))), len(header), draw(orders))
    return PacketLayout(
        name=draw(names("abcXYZ019", 10)),
        title=draw(st.text(printable, max_size=30)),
        byte_order=draw(st.sampled_from(["little", "big"])),
        header=header,
        fields=tuple(fields),
        checksum=checksum,
        counter=draw(st.sampled_from(counting)) if counting else None,
        clock=draw(st.sampled_from(counting)) if counting else None,
        clock_tick_s=draw(st.floats(*TICKS_S)),
        rate_hz=draw(st.none() | st.floats(*RATES_HZ)),
    )


@settings(max_examples=50)
@given(layouts())
def test_plain_data_and_a_file_hold_the_whole_layout(layout):
    again = PacketLayout.from_dict(json.loads(json.dumps(layout.to_dict())))
    assert again == layout
    assert again.dtype == layout.dtype
    assert PacketLayout.from_dict(tomllib.loads(layout.to_toml())) == layout


def test_a_layout_is_written_and_loaded_with_any_title(load):
    layout = replace(load_layout(DEFAULT_LAYOUT_NAME), title="dots " + 100 * "." + ' "\\ µ°')
    assert load(layout.to_toml()) == layout


@pytest.mark.parametrize("letter", ["\x1b", "\n", "\x7f", "\ud800", "\u202e", "\u2028", "\xa0"])
def test_what_a_screen_would_obey_is_no_text_of_a_layout(letter):
    """Of every text that a person may choose freely, in a file or in a program."""
    layout, text = load_layout(DEFAULT_LAYOUT_NAME), f"a{letter}b"
    with pytest.raises(LayoutError, match="title holds letters that cannot be printed"):
        replace(layout, title=text)
    with pytest.raises(LayoutError, match="field 'a': unit holds letters that cannot be printed"):
        Field("a", "u8", unit=text)
    with pytest.raises(LayoutError, match=r"the fault 'a.*b' holds letters that cannot") as caught:
        Field("a", "u8", faults=((text, 1),))
    assert str(caught.value).isprintable()
    for described in ({"kind": "mavlink"}, {"kind": "xsens-mti", "outputs": ["4020"]}):
        with pytest.raises(LayoutError, match="title holds letters that cannot be printed"):
            protocol_from_dict({**described, "name": "x", "title": text})


@settings(max_examples=30)
@given(layouts())
def test_row_type_has_no_gaps(layout):
    assert layout.dtype.itemsize == layout.length
    at = len(layout.header)
    for field in layout.fields:
        assert layout.dtype.fields[field.name][1] == at
        at += TYPE_SIZES[field.type] * field.count
    assert layout.length == at + (SIZES[layout.checksum.kind] if layout.checksum else 0)


def test_default_layout_is_the_28_byte_packet():
    layout = load_layout(DEFAULT_LAYOUT_NAME)
    offsets = {name: place[1] for name, place in layout.dtype.fields.items()}
    assert layout.header == b"\xa5\x5a"
    assert layout.length == 28
    assert offsets == {
        "header": 0,
        "seq": 2,
        "status": 3,
        "time": 4,
        "accel": 8,
        "gyro": 14,
        "mag": 20,
        "checksum": 26,
    }
    assert (layout.counter, layout.clock, layout.clock_tick_s) == ("seq", "time", 1e-6)
    assert layout.rate_hz == 100
    assert layout.field("accel").counts_per_unit == 4096
    assert layout.field("gyro").counts_per_unit == 32.8
    assert layout.field("mag").counts_per_unit == 1 / 0.3
    assert layout.field("mag").axes == ("+y", "+x", "-z")


def test_built_in_layouts_go_by_their_own_names():
    assert DEFAULT_LAYOUT_NAME in builtin_protocols()
    for name, protocol in builtin_protocols().items():
        assert protocol.name == name
        assert protocol.to_dict() == load_protocol(name).to_dict()


def test_headers_of_built_in_layouts_differ():
    """Otherwise nothing could tell which of them a device speaks."""
    headers = [p.header for p in builtin_protocols().values() if isinstance(p, PacketLayout)]
    assert len(set(headers)) == len(headers)


def test_layout_from_a_file(load):
    layout = load(SMALL)
    assert layout.length == 1 + 2 + 6 + 1
    assert layout.dtype["n"] == np.dtype(">u2")
    assert layout.dtype["accel"] == np.dtype(("<i2", (3,)))
    assert layout.checksum == Checksum("sum8", start=1)
    assert layout.clock is None
    assert layout.rate_hz is None
    assert layout.has("n")
    assert not layout.has("gyro")


def test_checksum_none_is_none(load):
    assert load(SMALL.replace("sum8", "none")).checksum is None


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('title = "A', 'titel = "A', "the layout: the key 'titel' is not known .known: barometer"),
        ('name = "lab-7"', "", "the layout: the key 'name' is missing"),
        ('name = "lab-7"', "name = 7", "the layout: name must be text"),
        ('name = "lab-7"', 'name = "../lab"', "name '../lab' cannot be used"),
        ('header = "7E"', "", "header must have 1 to 64 bytes"),
        ('header = "7E"', 'header = ""', "header must have 1 to 64 bytes"),
        ('header = "7E"', 'header = "7"', "header '7' is not hexadecimal"),
        ('header = "7E"', f'header = "{"7E" * 65}"', "header must have 1 to 64 bytes"),
        ('header = "7E"', f'header = "7E{" " * 300}x"', "header '7E .* is not hexadecimal"),
        ('counter = "n"', 'counter = "m"', "counter names the field 'm', which is not among"),
        ('counter = "n"', 'counter = "accel"', "counter names .*must be one unsigned integer"),
        ('counter = "n"', 'clock = "accel"', "clock names .*must be one unsigned integer"),
        ('counter = "n"', "clock_tick_s = 0", "clock_tick_s must be a number from 1e-12"),
        ('counter = "n"', "clock_tick_s = true", "clock_tick_s must be a number"),
        ('counter = "n"', "clock_tick_s = 1e308", "clock_tick_s must be a number from .* to 10000"),
        ('counter = "n"', "rate_hz = -1", "rate_hz must be a number from 0.0001 to 1000000"),
        ('counter = "n"', "rate_hz = nan", "rate_hz must be a number from"),
        ('counter = "n"', "rate_hz = 5e-324", "rate_hz must be a number from"),
        ('counter = "n"', "rate_hz = 1e308", "rate_hz must be a number from"),
        ('counter = "n"', f"rate_hz = 1{'0' * 400}", "rate_hz is too large a number"),
        ('counter = "n"', f"rate_hz = 1{'0' * 9000}", "not a TOML file"),
        ('counter = "n"', 'byte_order = "middle"', "byte order 'middle' must be"),
        ('type = "u16"', 'type = "u17"', "field 'n': type 'u17' is not known"),
        ('type = "u16"', "", "field 'n': the key 'type' is missing"),
        ('type = "u16"', 'type = "u16"\nscale = 1', "field 'n': the key 'scale' is not known"),
        ('byte_order = "big"', 'byte_order = "pdp"', "field 'n': byte order 'pdp'"),
        ('name = "n"', 'name = "accel"', "field 'accel' is there twice"),
        ('name = "n"', 'name = "header"', "field name 'header' cannot be used"),
        ('name = "n"', 'name = "N 1"', "field name 'N 1' cannot be used"),
        ('name = "n"', "", "field 1: the key 'name' is missing"),
        ("count = 3", "count = 0", "field 'accel': count must be 1 to 4096"),
        ("count = 3", "count = 3.0", "field 'accel': count must be a whole number"),
        ("count = 3", "count = true", "field 'accel': count must be a whole number"),
        ("count = 3", "count = 2048", "the packet has 4100 bytes"),
        ("count = 3", 'count = 3\naxes = ["+x"]', "field 'accel': axes must name x, y and z"),
        ("count = 3", 'count = 3\naxes = ["+x","+y","+y"]', "field 'accel': axes must name"),
        ("count = 3", 'count = 3\naxes = [1, 2, 3]', "field 'accel': axes must be a list of texts"),
        ("count = 3", 'count = 4\naxes = ["+x","+y","+z"]', "field 'accel': axes must name"),
        ('unit = "g"', "unit = 1", "field 'accel': unit must be text"),
        ("2048", "0", "field 'accel': counts_per_unit must be a finite number other than 0"),
        ("2048", "inf", "field 'accel': counts_per_unit must be a finite"),
        ("2048", '"2048"', "field 'accel': counts_per_unit must be a number"),
        ("2048", "1\nzero = nan", "field 'accel': zero must be a finite number"),
        ('kind = "sum8"', 'kind = "sum9"', "checksum: kind 'sum9' is not known, take none or one"),
        ('kind = "sum8"', "", "checksum: the key 'kind' is missing"),
        ("start = 1", "start = 9", "checksum: start must be 0 to 8"),
        ("start = 1", "start = -1", "checksum: start must be 0 to 8"),
        ("start = 1", "end = 1", "checksum: the key 'end' is not known"),
        ('[checksum]\nkind = "sum8"\nstart = 1', "[[checksum]]", "checksum must be a table"),
        (SMALL, 'name = "a"\nheader = "7E"', "fields must list 1 to 256 fields"),
        (SMALL, 'name = "a"\nheader = "7E"\nfields = 1', "fields must be a list"),
        (SMALL, 'name = "a"\nheader = "7E"\nfields = [1]', "field 1 must be a table"),
        (SMALL, f'name = "a"\nheader = "7E"\nfields = [{"1," * 257}]', "fields must list 1 to 256"),
        (SMALL, "name = ", "this is not a TOML file"),
        (SMALL, "a=" + "[" * 60_000, "this is not a TOML file"),
        (SMALL, b"\xff\xfe", "this is not a TOML file"),
        (SMALL, "#" * (MAX_FILE_BYTES + 1), "a layout file may have 65536 bytes"),
    ],
)  # fmt: skip
def test_mistakes_are_named(load, old, new, sentence):
    text = new if isinstance(new, bytes) else SMALL.replace(old, new, 1)
    assert text != SMALL
    with pytest.raises(LayoutError, match=rf"(?s)lab\.toml: .*{sentence}") as caught:
        load(text)
    assert len(str(caught.value)) < 700


HUGE = (1 << 20_000) - 1
"""A number with more digits than Python writes."""


@pytest.mark.parametrize(
    ("field", "sentence"),
    [
        ({"faults": {"low": HUGE}}, "bit .* of 'low' is not 0 to 15"),
        ({"flags": {"low": -HUGE}}, "bit .* of 'low' is not 0 to 15"),
        ({"scale_by": "a", "scales": {"4": None}}, "scales: 4 must be a number"),
        ({"scale_by": "a", "scales": {"--5": 1.0}}, "by a whole number, not by '--5'"),
        ({"scale_by": "a", "scales": {"\u00b2": 1.0}}, "by a whole number"),
        ({"count": HUGE}, "count must be 1 to 4096"),
        ({"zero": HUGE}, "zero is too large"),
        ({"low_bits": HUGE}, "low_bits must be 1 to 16"),
        ({"type": [HUGE]}, "type must be text"),
    ],
    ids=range(9),
)
def test_values_that_cannot_be_worked_with_are_refused_in_words(field, sentence):
    data = {"name": "x", "header": "A5", "fields": [{"name": "a", "type": "u16", **field}]}
    with pytest.raises(LayoutError, match=sentence) as caught:
        PacketLayout.from_dict(data)
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("kind", [HUGE, [HUGE], {"a": HUGE}], ids=["number", "list", "table"])
def test_a_kind_that_cannot_be_shown_is_refused_in_words(kind):
    with pytest.raises(LayoutError, match=r"the kind \(a value too long to show"):
        protocol_from_dict({"kind": kind})


def test_blanks_between_the_bytes_of_a_header_are_nothing():
    data = {"name": "x", "header": f"A5{' ' * 300}62", "fields": [{"name": "a", "type": "u16"}]}
    assert PacketLayout.from_dict(data).header == b"\xa5\x62"


@pytest.mark.parametrize(
    ("name", "meant"),
    [("xsens-mit", "xsens-mti"), ("mavlink_highres", "mavlink-highres"), ("baro.toml", "baro-16")],
)
def test_a_misspelt_name_is_asked_back(name, meant):
    with pytest.raises(LayoutError, match=rf"did you mean {meant}\? built in: adis16405-36"):
        load_protocol(name)


def test_missing_file_is_named_with_what_there_is(tmp_path):
    with pytest.raises(LayoutError, match=r"nowhere\.toml: there is no such .*mpu9150-28"):
        load_layout(tmp_path / "nowhere.toml")
    with pytest.raises(LayoutError) as caught:
        load_layout("shoe" * 10_000)
    assert "did you mean" not in str(caught.value)
    with pytest.raises(LayoutError, match="no built-in layout of that name"):
        load_layout("mpu9150-29")
    with pytest.raises(LayoutError):
        load_layout("mpu\0")
    with pytest.raises(LayoutError, match="there is no such layout file"):
        load_layout(tmp_path)


def test_a_longest_packet_is_allowed():
    field = Field("samples", "u8", count=4095)
    layout = PacketLayout(
        name="long", title="", byte_order="little", header=b"\x01", fields=(field,)
    )
    assert layout.length == 4096
    with pytest.raises(LayoutError, match="4097 bytes"):
        replace(layout, checksum=Checksum("sum8"))


def test_unknown_field_is_named_with_what_there_is():
    with pytest.raises(LayoutError, match=r"no field 'wheel' \(fields: seq, status, time"):
        load_layout(DEFAULT_LAYOUT_NAME).field("wheel")


def test_limits_belong_to_integers():
    assert Field("a", "i24").limits == (-(2**23), 2**23 - 1)
    assert Field("a", "u32").limits == (0, 2**32 - 1)
    with pytest.raises(LayoutError, match="no integer limits"):
        assert Field("a", "f32").limits


KEYS = [
    *["name", "title", "byte_order", "header", "fields", "checksum", "counter", "clock", "type"],
    *["clock_tick_s", "rate_hz", "count", "unit", "counts_per_unit", "zero", "axes", "kind"],
    *["start", "x"],
]
SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=5),
    st.sampled_from(["a", "u8", "i16", "big", "crc32", "7E", "+x"]),
)
TREES = st.recursive(
    SCALARS,
    lambda t: st.lists(t, max_size=4) | st.dictionaries(st.sampled_from(KEYS), t, max_size=6),
    max_leaves=8,
)


@settings(max_examples=60)
@given(st.dictionaries(st.sampled_from(KEYS), TREES, max_size=6))
def test_arbitrary_data_are_a_layout_or_a_layout_error(data):
    try:
        layout = PacketLayout.from_dict(data)
    except LayoutError:
        return
    assert layout.dtype.itemsize == layout.length <= 4096


@given(st.data())
def test_damaged_data_are_a_layout_or_a_layout_error(data):
    """One value of a good layout replaced by anything."""
    table = load_layout(DEFAULT_LAYOUT_NAME).to_dict()
    inner = data.draw(st.sampled_from([table, table["checksum"], *table["fields"]]))
    inner[data.draw(st.sampled_from(KEYS))] = data.draw(TREES)
    try:
        layout = PacketLayout.from_dict(table)
    except LayoutError:
        return
    assert layout.dtype.itemsize == layout.length <= 4096
