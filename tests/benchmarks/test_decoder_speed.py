"""How fast packets are decoded from memory, beside the plain loop that one would write first.

Those of one layout beside the loop, then every built-in protocol in chunks of 64 KiB.

``python tests/benchmarks/test_decoder_speed.py`` prints all figures and their ratios in one run;
``pytest tests/benchmarks/test_decoder_speed.py --benchmark-enable`` gives the statistics.
"""

import struct
import sys
import time
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from firmware_protocols.decoder import StreamDecoder
from firmware_protocols.known import builtin_protocols
from firmware_protocols.layout import Field, PacketLayout, load_layout
from firmware_protocols.packets import encode

sys.path.append(str(Path(__file__).parent.parent / "firmware_protocols"))
from fuzz_harness import packets_of

NUMBER = 1_000_000
LOOP_NUMBER = 50_000  # as many of them as the plain loop gets
CHUNK_BYTES = 65_536
PROTOCOL_BYTES = 20_000_000  # of every built-in protocol
FAST_MB_S, VARIABLE_MB_S = 50.0, 5.0  # asked of framings of fixed and of variable length

CHECKED = load_layout("mpu9150-28")
UNCHECKED = replace(CHECKED, checksum=None, fields=(*CHECKED.fields, Field("rest", "u16")))

PACKET = struct.Struct("<2sBBI3h3h3hH")
CRC_TABLE = []
for byte in range(256):
    register = byte << 8
    for _ in range(8):
        register = (register << 1 ^ 0x1021 if register & 0x8000 else register << 1) & 0xFFFF
    CRC_TABLE.append(register)


def make_stream(number=NUMBER):
    rng = np.random.default_rng(0)
    index = np.arange(number)
    return encode(
        CHECKED,
        {
            "seq": index % 256,
            "status": 0,
            "time": index * 10_000 % 2**32,
            "accel": rng.integers(-32768, 32768, (number, 3)),
            "gyro": rng.integers(-32768, 32768, (number, 3)),
            "mag": rng.integers(-4096, 4096, (number, 3)),
        },
    )


def decode(layout, stream, chunk_bytes):
    decoder = StreamDecoder(layout)
    view = memoryview(stream)
    return [
        decoder.feed(view[at : at + chunk_bytes]).rows for at in range(0, len(view), chunk_bytes)
    ]


def plain_loop(stream, *, check):
    """Unpack one packet after the other, resynchronizing by one byte."""
    packets = []
    position = 0
    while position + 28 <= len(stream):
        fields = PACKET.unpack_from(stream, position)
        good = fields[0] == b"\xa5\x5a"
        if good and check:
            register = 0xFFFF
            for byte in stream[position : position + 26]:
                register = (register << 8 & 0xFFFF) ^ CRC_TABLE[register >> 8 ^ byte]
            good = register == fields[-1]
        if good:
            packets.append(fields)
            position += 28
        else:
            position += 1
    return packets


CASES = {
    "decoder, one call, CRC": (NUMBER, lambda s: decode(CHECKED, s, len(s))),
    "decoder, 64 KiB chunks, CRC": (NUMBER, lambda s: decode(CHECKED, s, CHUNK_BYTES)),
    "decoder, one call, no CRC": (NUMBER, lambda s: decode(UNCHECKED, s, len(s))),
    "struct loop, table CRC": (LOOP_NUMBER, lambda s: [plain_loop(s, check=True)]),
    "struct loop, no CRC": (LOOP_NUMBER, lambda s: [plain_loop(s, check=False)]),
}
"""Number of packets, and what decodes them into a list of sequences of packets."""


@pytest.fixture(scope="module")
def whole_stream():
    return make_stream()


@pytest.mark.parametrize("name", CASES)
def test_decode(benchmark, whole_stream, name):
    number, decode_all = CASES[name]
    stream = whole_stream[: 28 * number]
    parts = benchmark(decode_all, stream)
    assert sum(len(part) for part in parts) == number
    last = parts[-1][-1]
    assert (PACKET.pack(*last) if isinstance(last, tuple) else last.tobytes()) == stream[-28:]
    benchmark.extra_info["packets"] = number


@lru_cache(maxsize=1)
def protocol_stream(name, size):
    """Return whole packets of a protocol, and how many."""
    protocol = builtin_protocols()[name]
    first = packets_of(protocol, 1)[0]
    some = packets_of(protocol, min(size, 1_000_000) // len(first) + 1)
    times = max(1, size // sum(map(len, some)))
    return b"".join(some) * times, len(some) * times


def decode_protocol(name, stream, chunk_bytes=CHUNK_BYTES):
    """Return how many rows the protocol's decoder makes of a stream."""
    decoder = builtin_protocols()[name].quick_decoder()  # the packets are without heartbeats
    view = memoryview(stream)
    return sum(
        len(packets)
        for at in range(0, len(view), chunk_bytes)
        for packets in decoder.feed(view[at : at + chunk_bytes]).values()
    )


@pytest.mark.parametrize("name", builtin_protocols())
def test_decode_protocol(benchmark, name):
    size = PROTOCOL_BYTES if benchmark.enabled else 100_000
    stream, number = protocol_stream(name, size)
    assert benchmark(decode_protocol, name, stream) == number
    benchmark.extra_info["megabytes"] = len(stream) / 1e6


def print_protocols(repeats):
    """Print how fast each built-in protocol is decoded, the best of some repeats."""
    print()
    for name, protocol in builtin_protocols().items():
        stream, number = protocol_stream(name, PROTOCOL_BYTES)
        best = min(_seconds(decode_protocol, name, stream) for _ in range(repeats))
        rate = len(stream) / best / 1e6
        is_fixed = isinstance(protocol, PacketLayout) or protocol.to_dict()["kind"] == "interleaved"
        asked = FAST_MB_S if is_fixed else VARIABLE_MB_S
        verdict = "" if rate >= asked else "  TOO SLOW"
        print(
            f"{name:18s} {rate:7.1f} MB/s, {asked:g} asked  "
            f"{number / best / 1e6:6.2f} million packets/s{verdict}"
        )


def _seconds(work, *given):
    start = time.perf_counter()
    work(*given)
    return time.perf_counter() - start


def main(repeats=7):
    """Print packets per second of every case, the best of some repeats, taken in turns."""
    stream = make_stream()
    best = dict.fromkeys(CASES, 0.0)
    for _ in range(repeats):
        for name, (number, decode_all) in CASES.items():
            given = stream[: 28 * number]
            start = time.perf_counter()
            parts = decode_all(given)
            best[name] = max(best[name], number / (time.perf_counter() - start))
            del parts
    slowest = best["struct loop, table CRC"]
    for name, rate in best.items():
        print(f"{name:30s} {rate / 1e6:7.2f} million packets/s  {rate / slowest:6.1f} x")
    print_protocols(repeats=3)


if __name__ == "__main__":
    main()
