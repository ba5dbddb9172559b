"""How fast MAVLink is decoded, beside pymavlink's own parser in the same run.

``python tests/benchmarks/test_mavlink_speed.py`` prints the figures; 5 MB/s are asked for.
``pytest tests/benchmarks/test_mavlink_speed.py --benchmark-enable`` gives the statistics.
"""

import time

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from firmware_protocols.known import load_protocol

SECONDS = 200  # of a flight controller's talk
PARSER_BYTES = 300_000  # as much of it as pymavlink's parser gets
CHUNKS = {"64 KiB": 65_536, "live, 120 bytes": 120}

HIGHRES = load_protocol("mavlink-highres")


def make_stream(seconds=SECONDS):
    """What PX4 sends over USB: 100 inertial messages per second and what else there is."""
    rng = np.random.default_rng(0)
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    frames = []

    def say(message):
        frames.append(bytes(message.pack(sender)))
        sender.seq = (sender.seq + 1) % 256

    for k in range(100 * seconds):
        if k % 100 == 0:
            say(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3))
        say(
            mavlink.MAVLink_highres_imu_message(
                10_000 * k, *rng.normal(size=9).tolist(), 1013.25, 0.0, 0.0, 31.0, 0x1FFF
            )
        )
        if k % 2 == 0:
            say(mavlink.MAVLink_attitude_message(10 * k, *rng.normal(size=6).tolist()))
        if k % 10 == 0:
            say(mavlink.MAVLink_scaled_pressure_message(10 * k, 1013.25, 0.0, 2500))
    return b"".join(frames)


def decode(stream, chunk_bytes):
    decoder = HIGHRES.decoder()
    return sum(
        len(decoder.feed(stream[at : at + chunk_bytes])["imu"])
        for at in range(0, len(stream), chunk_bytes)
    )


def parse(stream):
    """What one would write with pymavlink."""
    messages = mavlink.MAVLink(None).parse_buffer(bytearray(stream))
    return sum(1 for message in messages if message.get_type() == "HIGHRES_IMU")


@pytest.fixture(scope="module")
def stream():
    return make_stream(20)


@pytest.mark.parametrize("name", CHUNKS)
def test_decode(benchmark, stream, name):
    assert benchmark(decode, stream, CHUNKS[name]) == 2000
    benchmark.extra_info["bytes"] = len(stream)


def test_parse_with_pymavlink(benchmark, stream):
    cut = stream[:PARSER_BYTES]
    assert benchmark(parse, cut) == decode(cut, len(cut))


def main(repeats=5):
    """Print megabytes per second of every case, the best of some repeats, taken in turns."""
    stream = make_stream()
    cases = {
        f"decoder, chunks of {name}": (stream, lambda s, n=size: decode(s, n))
        for name, size in CHUNKS.items()
    }
    cases["pymavlink's parser"] = stream[:PARSER_BYTES], parse
    best = dict.fromkeys(cases, 0.0)
    for _ in range(repeats):
        for name, (given, work) in cases.items():
            start = time.perf_counter()
            work(given)
            best[name] = max(best[name], len(given) / (time.perf_counter() - start) / 1e6)
    for name, rate in best.items():
        print(f"{name:36s} {rate:7.2f} MB/s  {rate / best[list(best)[-1]]:5.1f} x")


if __name__ == "__main__":
    main()
