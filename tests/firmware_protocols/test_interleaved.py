"""Several kinds of packets on one port: the rule, every chunking, and each stream for itself."""

from __future__ import annotations

import contextlib
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocols.checksums import checksum
from firmware_protocols.fields import Checksum, Field, LayoutError
from firmware_protocols.interleaved import InterleavedProtocol, from_dict
from firmware_protocols.interleaved_framing import Kinds, find_many, find_short
from firmware_protocols.known import load_protocol, protocol_from_dict
from firmware_protocols.layout import PacketLayout
from firmware_protocols.packets import counts, encode


def tiny(name, header, count, check=None, counter=None):
    return PacketLayout(
        name=name,
        title="",
        byte_order="big",
        header=header,
        fields=(Field("n", "u8"), *([Field("rest", "u8", count=count)] if count else [])),
        counter=counter,
        checksum=None if check is None else Checksum(check),
    )


def of(*layouts):
    return InterleavedProtocol("tiny", "", tuple((x.name, x) for x in layouts))


TINY = {
    "two checked": of(tiny("a", b"\x01", 2, "sum8"), tiny("b", b"\x02", 0, "xor8")),
    "two bare": of(tiny("a", b"\x01", 2), tiny("b", b"\x02", 0)),
    "one of each": of(tiny("a", b"\x01\x01", 0), tiny("b", b"\x01\x02", 3, "sum8")),
    "long headers": of(tiny("a", b"\x00\x01\x00", 0), tiny("b", b"\x00\x02", 4)),
    "three": of(
        tiny("a", b"\x01", 3, "sum8"), tiny("b", b"\x02\x00", 2, "xor8"), tiny("c", b"\x02\x02", 0)
    ),
    "one alone": of(tiny("a", b"\x01\x02", 2, "sum8")),
}
"""Headers and checksums that random bytes of 0, 1 and 2 often meet."""

TINY_STREAMS = st.binary(max_size=60).map(lambda data: bytes(b % 3 for b in data))

TWO = of(
    tiny("a", b"\xa5\x62\x01", 20, "crc16-ccitt-false", "n"),
    tiny("b", b"\xa5\x62\x02", 31, "crc16-ccitt-false", "n"),
)


def expected(protocol, stream):
    """Packets, corrupt headers, skipped bytes and decided bytes, by the rule as it is written."""
    headers = [(layout.header, name, layout) for name, layout in protocol.layouts]
    packets, corrupt, skipped = [], 0, 0
    position, packet_end = 0, None
    while position < len(stream):
        rest = stream[position:]
        if not any(h.startswith(rest[: len(h)]) for h, _, _ in headers):
            position, skipped = position + 1, skipped + 1
            continue
        found = [entry for entry in headers if rest.startswith(entry[0])]
        if not found or len(rest) < found[0][2].length:
            break
        _, name, layout = found[0]
        packet, after = rest[: layout.length], rest[layout.length :]
        if layout.checksum:
            good = checksum(layout.checksum.kind, packet[:-1]) == packet[-1]
        elif position == packet_end or any(after.startswith(h) for h, _, _ in headers):
            good = True
        elif any(h.startswith(after[: len(h)]) for h, _, _ in headers):
            break
        else:
            good = False
        if good:
            position = packet_end = position + layout.length
            packets.append((position, name, packet))
        else:
            position, skipped, corrupt = position + 1, skipped + 1, corrupt + 1
    return packets, corrupt, skipped, position


def decode(protocol, stream, cuts=()):
    """Feed the stream cut at the given places; packets of all streams in the order of the wire."""
    decoder = protocol.decoder()
    packets = []
    for start, stop in pairwise([0, *sorted(cuts), len(stream)]):
        for name, fed in decoder.feed(stream[start:stop]).items():
            assert fed.rows.dtype == protocol.streams[name].dtype
            rows = [(row.tobytes(), name) for row in fed.rows]
            packets += [(end, *row[::-1]) for end, row in zip(fed.end.tolist(), rows, strict=True)]
        assert decoder.pending < protocol.longest + 3
    return sorted(packets), decoder


def packets_of(protocol, name, number, seed=0):
    layout = protocol.streams[name]
    rest = np.random.default_rng(seed).integers(0, 256, (number, layout.field("rest").count))
    data = encode(layout, {"n": np.arange(number) % 256, "rest": rest})
    return [data[at : at + layout.length] for at in range(0, len(data), layout.length)]


@pytest.mark.parametrize("name", TINY)
@settings(max_examples=60)
@given(stream=TINY_STREAMS, cuts=st.lists(st.integers(0, 60), max_size=8))
def test_decoder_follows_the_rule_in_any_chunking(name, stream, cuts):
    protocol = TINY[name]
    packets, corrupt, skipped, decided = expected(protocol, stream)
    cuts = [c for c in cuts if c <= len(stream)]
    for places in ((), cuts, range(1, len(stream)), [len(stream) // 2]):
        got, decoder = decode(protocol, stream, places)
        assert got == packets
        assert decoder.stats.good == len(packets)
        assert decoder.stats.corrupt == corrupt
        assert decoder.stats.skipped_bytes == skipped
        assert decoder.pending == len(stream) - decided


@pytest.mark.parametrize("name", TINY)
@settings(max_examples=80)
@given(stream=TINY_STREAMS, in_sync=st.booleans())
def test_array_form_and_plain_form_find_the_same(name, stream, in_sync):
    kinds = Kinds(tuple(layout for _, layout in TINY[name].layouts))
    short = find_short(kinds, stream, in_sync=in_sync)
    many = find_many(kinds, stream, in_sync=in_sync)
    assert many.starts.tolist() == short.starts.tolist()
    assert many.kinds.tolist() == short.kinds.tolist()
    assert (many.decided, many.corrupt) == (short.decided, short.corrupt)


@settings(max_examples=8)
@given(seed=st.integers(0, 2**32), cuts=st.lists(st.integers(0, 6000), max_size=12))
def test_a_damaged_stream_is_the_same_in_any_chunking(seed, cuts):
    rng = np.random.default_rng(seed)
    mixed = packets_of(TWO, "a", 50, seed) + packets_of(TWO, "b", 50, seed)
    mixed = [mixed[i] for i in rng.permutation(len(mixed))]
    for at in rng.choice(len(mixed), 30, replace=False).tolist():
        packet, place = mixed[at], int(rng.integers(1, 24))
        mixed[at] = [
            packet[:place],
            packet[:place] + b"\xa5\x62" + packet[place:],
            b"\xa5\x62\x01" * place + packet,
            rng.bytes(place) + packet,
        ][int(rng.integers(4))]
    stream = b"".join(mixed)
    whole, decoder = decode(TWO, stream)
    cuts = [c for c in cuts if c <= len(stream)]
    for places in (cuts, [len(stream) // 2], range(1, len(stream))):
        again, other = decode(TWO, stream, places)
        assert again == whole
        assert other.stats == decoder.stats
        assert other.pending == decoder.pending


def test_every_intact_packet_comes_through_in_its_stream():
    first, second = packets_of(TWO, "a", 5000, 1), packets_of(TWO, "b", 500, 2)
    mixed = []
    for i, packet in enumerate(first):
        mixed += [packet] + ([second[i // 10]] if i % 10 == 0 else [])
    stream = b"".join(mixed)
    decoder = TWO.decoder()
    got = decoder.feed(stream)

    assert got["a"].rows.tobytes() == b"".join(first)
    assert got["b"].rows.tobytes() == b"".join(second)
    assert sorted([*got["a"].end, *got["b"].end]) == np.cumsum([len(p) for p in mixed]).tolist()
    assert decoder.stats.good == 5500
    assert (decoder.stats.lost, decoder.stats.skipped_bytes) == (0, 0)


def test_what_one_stream_loses_is_counted_once():
    first, second = packets_of(TWO, "a", 300), packets_of(TWO, "b", 300)
    mixed = [p for i in range(300) for p in ([first[i]] * (i % 5 > 0 or i < 2) + [second[i]])]
    decoder = TWO.decoder()
    got = decoder.feed(b"".join(mixed))

    assert decoder.stats.lost == 59
    assert counts(TWO.streams["b"], got["b"].rows, "n").tolist() == [i % 256 for i in range(300)]


def test_a_stream_longer_than_a_piece_is_one_stream():
    first, second = packets_of(TWO, "a", 30_000), packets_of(TWO, "b", 30_000)
    stream = b"".join(p for pair in zip(first, second, strict=True) for p in pair)
    got = TWO.decoder().feed(stream)

    assert got["a"].rows.dtype == TWO.streams["a"].dtype
    assert got["a"].rows.tobytes() == b"".join(first)
    assert got["b"].rows.tobytes() == b"".join(second)


def test_headers_everywhere_stay_cheap_and_give_no_packet():
    stream = b"\xa5\x62\x01\xa5\x62\x02" * 100_000
    decoder = TWO.decoder()
    got = decoder.feed(stream)

    assert sum(map(len, got.values())) <= 10  # of 200 000 tries with odds of 1 in 65536
    assert decoder.stats.skipped_bytes + decoder.pending > len(stream) - 400


def test_noise_gives_no_packet_and_keeps_nothing():
    decoder = TWO.decoder()
    rng = np.random.default_rng(3)
    for _ in range(40):
        assert decoder.feed(rng.bytes(50_000)) == {}
        assert decoder.pending < TWO.longest
    assert decoder.stats.skipped_bytes + decoder.pending == 2_000_000


def test_after_a_cut_no_packet_lies_on_both_sides():
    packet = packets_of(TWO, "a", 1)[0]
    decoder = TWO.decoder()
    decoder.feed(packet[:10])
    decoder.cut()

    assert decoder.feed(packet[10:]) == {}
    assert len(decoder.feed(packet)["a"]) == 1


@pytest.mark.parametrize("begun", [b"", b"\x00"])
def test_a_whole_packet_stays_at_a_cut_whatever_has_come_of_the_next_header(begun):
    protocol = TINY["long headers"]
    whole = b"\x00\x01\x00\x07"
    decoder = protocol.decoder()
    decoder.feed(whole + begun)
    decoder.cut()
    got = decoder.feed(whole + b"\x00\x01\x00")["a"]

    assert got.rows["n"].tolist() == [7, 7]
    assert got.end.tolist() == [4 + len(begun), 8 + len(begun)]
    assert decoder.stats.skipped_bytes == len(begun)


class TestDescription:
    DATA = {
        "kind": "interleaved",
        "name": "pair",
        "title": "A pair",
        "byte_order": "big",
        "counter": "seq",
        "fields": [{"name": "seq", "type": "u8"}],
        "checksum": {"kind": "sum8"},
        "streams": [
            {"name": "foot", "header": "A5 01", "rate_hz": 50.0},
            {"name": "waist", "header": "A5 02", "byte_order": "little", "rate_hz": 25.0},
        ],
    }

    def without(self, *path, **changed):
        data = {**self.DATA, **changed}
        for key in path:
            del data[key]
        return data

    def test_what_stands_above_the_streams_is_true_of_each(self):
        protocol = from_dict(self.DATA)

        assert list(protocol.streams) == ["foot", "waist"]
        assert [s.byte_order for s in protocol.streams.values()] == ["big", "little"]
        assert protocol.bytes_per_s == 75 * 4
        assert protocol.packets_per_s == 75
        assert protocol.longest == 4
        assert protocol.proves_packets

    def test_plain_data_and_a_file_give_the_same_again(self, tmp_path):
        protocol = from_dict(self.DATA)
        file = tmp_path / "pair.toml"
        file.write_text(protocol.to_toml())

        assert protocol_from_dict(protocol.to_dict()) == protocol
        assert load_protocol(file) == protocol

    @pytest.mark.parametrize(
        ("second", "words"),
        [
            ("A5 01", "stream 'waist': its header is that of stream 'foot'"),
            ("A5 01 07", "stream 'waist': its header begins with that of stream 'foot'"),
            ("A5", "stream 'foot': its header begins with that of stream 'waist'"),
        ],
    )
    def test_headers_that_cannot_be_told_apart_are_refused(self, second, words):
        streams = [self.DATA["streams"][0], {"name": "waist", "header": second}]
        with pytest.raises(LayoutError, match=words):
            from_dict(self.without(streams=streams))

    def test_a_mistake_in_a_stream_names_the_file_and_the_stream(self):
        streams = [{"name": "foot", "header": "A5 01", "clock": "time"}]
        with pytest.raises(LayoutError, match=r"^my\.toml: stream 'foot': clock names the field"):
            protocol_from_dict(self.without(streams=streams), source="my.toml")

    @pytest.mark.parametrize(
        ("changed", "words"),
        [
            ({"streams": []}, "1 to 16 streams"),
            ({"streams": [{}] * 17}, "1 to 16 streams"),
            ({"streams": ["foot"]}, "stream 1 must be a table"),
            ({"streams": [{"header": "A5"}]}, "stream 1 must be a table"),
            ({"streams": [{"name": "foot"}]}, "stream 'foot': header must have"),
            ({"streams": [{"name": "Foot/2", "header": "A5"}]}, "stream name 'Foot/2'"),
            ({"streams": [{"name": "foot", "header": "A5", "kind": "x"}]}, "key 'kind'"),
            ({"streams": {"name": "foot"}}, "streams must be a list"),
            ({"title": "a\u2028b"}, "title holds letters that cannot be printed"),
            ({"streams": [DATA["streams"][0]] * 2}, "stream 'foot' is there twice"),
            ({"speed": 3}, "the key 'speed' is not known"),
            ({"name": 3}, "name must be text"),
            ({"name": "a pair"}, "^name 'a pair' cannot be used"),
            ({"title": 3}, "title must be text"),
        ],
    )
    def test_what_cannot_be_used_is_refused(self, changed, words):
        with pytest.raises(LayoutError, match=words):
            from_dict(self.without(**changed))

    @settings(max_examples=40)
    @given(
        st.dictionaries(
            st.sampled_from(["name", "title", "streams", "fields", "header", "checksum", "clock"]),
            st.recursive(
                st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
                lambda inner: (
                    st.lists(inner, max_size=3)
                    | st.dictionaries(
                        st.sampled_from(["name", "header", "type", "kind", "x"]), inner, max_size=3
                    )
                ),
                max_leaves=8,
            ),
        )
    )
    def test_nonsense_is_refused_in_words(self, changed):
        with contextlib.suppress(LayoutError):
            from_dict({**self.DATA, **changed})

    def test_many_long_headers_are_told_apart(self):
        streams = [
            {"name": f"s{i}", "header": " ".join(["A5"] * 63 + [f"{i:02X}"])} for i in range(16)
        ]
        protocol = from_dict(self.without(streams=streams))
        sent = [encode(layout, {"seq": [i]}) for i, (_, layout) in enumerate(protocol.layouts)]
        stream = b"".join(sent * 20)
        got = protocol.decoder().feed(b"\xa5" * 200 + stream)

        assert [len(packets) for packets in got.values()] == [20] * 16
