"""Noise, torn packets and damaged recordings for every built-in protocol.

Nothing may raise, nothing may come out that was not sent beyond what the checksum's odds allow,
whatever arrived whole must come out, and what waits to be decided must stay small.

``python tests/firmware_protocols/fuzz_harness.py`` feeds 10 MB of each kind to each protocol, or
``--mb`` as many, to all or to those named; the suite does the same with less.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from firmware_protocols.interleaved import InterleavedProtocol
from firmware_protocols.known import builtin_protocols
from firmware_protocols.layout import PacketLayout
from firmware_protocols.packets import encode
from firmware_protocols.protocol import DeviceProtocol

sys.path.insert(0, str(Path(__file__).parent))  # as pytest does

MOST_PENDING = 4096
"""No protocol may hold back more bytes than this."""

CHUNK_BYTES = 65_536
SLOW_PACKETS = 500  # of protocols whose packets take long to make; then they repeat
DAMAGED_SHARE = 0.2

Rng = np.random.Generator


@dataclass(frozen=True)
class Stream:
    """Bytes to be decoded, and where packets end that are whole in them."""

    data: bytes
    ends: np.ndarray


@dataclass(frozen=True)
class Outcome:
    """What came of a stream.

    Attributes
    ----------
    packets, false, missing : int
        Packets that came out, those of them that nobody sent, and whole ones that did not.
    tries : int
        Places at which chance could have made a packet.
    pending : int
        Most bytes that waited to be decided.
    seconds : float
    """

    packets: int
    false: int
    missing: int
    tries: int
    pending: int
    seconds: float


def fixed_packets(layout: PacketLayout, number: int, rng: Rng) -> list[bytes]:
    """Packets of a fixed layout with anything in their fields; the counter counts."""
    rows = np.frombuffer(rng.bytes(number * layout.length), dtype=layout.dtype).copy()
    if layout.counter is not None and layout.field(layout.counter).bits != 24:
        bits = layout.field(layout.counter).bits
        rows[layout.counter] = np.arange(number) % (1 << bits)
    data = encode(layout, rows)
    return [data[at : at + layout.length] for at in range(0, len(data), layout.length)]


def interleaved_packets(protocol: Any, number: int, rng: Rng) -> list[bytes]:
    """Packets of every stream in any order, those of each in theirs."""
    waiting = [iter(fixed_packets(layout, number, rng)) for _, layout in protocol.layouts]
    return [next(waiting[which]) for which in rng.integers(len(waiting), size=number)]


def xsens_packets(protocol: Any, number: int, rng: Rng) -> list[bytes]:
    """Messages of the protocol's configuration with anything in their items."""
    from firmware_protocols.xsens import MTDATA2
    from firmware_protocols.xsens_data import size_of
    from firmware_protocols.xsens_frames import Mid, encode_message

    made = []
    for _ in range(number):
        if protocol.format == MTDATA2:
            items = ((identifier, size_of(identifier)) for identifier in protocol.outputs)
            data = b"".join(
                identifier.to_bytes(2, "big") + bytes([size]) + rng.bytes(size)
                for identifier, size in items
            )
            made.append(encode_message(Mid.MT_DATA2, data))
        else:
            made.append(encode_message(Mid.MT_DATA, rng.bytes(protocol.data_bytes)))
    return made


def mavlink_packets(protocol: Any, number: int, rng: Rng) -> list[bytes]:
    """Inertial messages of the first sensor with anything else in their fields."""
    from mavlink_writer import Writer, random_fields

    write = Writer()
    message = getattr(write.dialect, f"MAVLink_{protocol.message.lower()}_message")
    made = []
    for _ in range(number):
        fields = dict(zip(message.fieldnames, random_fields(message, rng), strict=True))
        fields.update({"id": 0} if "id" in fields else {})
        made.append(write(protocol.message, *fields.values()))
    return made


MAKERS: dict[str | None, tuple[Callable[[Any, int, Rng], list[bytes]], int]] = {
    "interleaved": (interleaved_packets, 16),
    "xsens-mti": (xsens_packets, 8),
    "mavlink": (mavlink_packets, 16),
}
"""For every kind of description: what makes packets, each a row, and the bits of the checksum."""


def packets_of(protocol: DeviceProtocol, number: int, seed: int = 0) -> list[bytes]:
    """Good packets of a protocol; those that take long to make repeat."""
    rng = np.random.default_rng(seed)
    if isinstance(protocol, PacketLayout):
        return fixed_packets(protocol, number, rng)
    maker, _ = MAKERS[protocol.to_dict()["kind"]]
    few = number if isinstance(protocol, InterleavedProtocol) else min(number, SLOW_PACKETS)
    pool = maker(protocol, few, rng)
    return [pool[index % few] for index in range(number)]


def checksum_bits(protocol: DeviceProtocol) -> int | None:
    """Bits of the weakest checksum; None where packets have none."""
    if not protocol.proves_packets:
        return None
    if isinstance(protocol, PacketLayout):
        assert protocol.checksum is not None
        return 8 * protocol.checksum.size
    return MAKERS[protocol.to_dict()["kind"]][1]


def noise(protocol: DeviceProtocol, size: int, rng: Rng) -> Stream:
    """Bytes of nothing."""
    del protocol
    return Stream(rng.bytes(size), np.empty(0, dtype=np.int64))


def torn(protocol: DeviceProtocol, size: int, rng: Rng) -> Stream:
    """Beginnings of packets, one after the other: as many tries for chance as there can be.

    Three bytes are missing at least: a single one may be what the next packet begins with.
    """
    pool = packets_of(protocol, 500, int(rng.integers(1 << 30)))
    pieces, length = [], 0
    while length < size:
        packet = pool[int(rng.integers(len(pool)))]
        piece = packet[: int(rng.integers(1, len(packet) - 2))]
        pieces.append(piece)
        length += len(piece)
    return Stream(b"".join(pieces), np.empty(0, dtype=np.int64))


def damaged(protocol: DeviceProtocol, size: int, rng: Rng) -> Stream:
    """A recording with flipped bits, bursts, missing, added and repeated bytes."""
    first = packets_of(protocol, 1)
    packets = packets_of(protocol, size // len(first[0]) + 1, int(rng.integers(1 << 30)))
    pieces, ends, length = [], [], 0
    hurt = rng.random(len(packets)) < DAMAGED_SHARE
    for packet, harmed in zip(packets, hurt.tolist(), strict=True):
        piece = mutated(packet, rng) if harmed else packet
        pieces.append(piece)
        length += len(piece)
        if piece.endswith(packet):
            ends.append(length)
    return Stream(b"".join(pieces), np.array(ends, dtype=np.int64))


def mutated(packet: bytes, rng: Rng) -> bytes:
    """Damage a packet in one of five ways."""
    place = int(rng.integers(len(packet)))
    match int(rng.integers(5)):
        case 0:
            flipped = bytearray(packet)
            for bit in rng.integers(0, 8 * len(packet), int(rng.integers(1, 9))).tolist():
                flipped[bit // 8] ^= 1 << bit % 8
            return bytes(flipped)
        case 1:
            burst = rng.bytes(int(rng.integers(1, len(packet))))[: len(packet) - place]
            return packet[:place] + burst + packet[place + len(burst) :]
        case 2:
            return packet[:place] + packet[place + int(rng.integers(1, 6)) :]
        case 3:
            return packet[:place] + rng.bytes(int(rng.integers(1, 40))) + packet[place:]
        case _:
            return packet[:place] + packet


STREAMS = {"noise": noise, "torn": torn, "damaged": damaged}


def decode(protocol: DeviceProtocol, stream: Stream, chunk_bytes: int = CHUNK_BYTES) -> Outcome:
    """Decode a stream in chunks and see what came of it."""
    decoder = protocol.quick_decoder()  # the packets are without heartbeats
    view = memoryview(stream.data)
    ends: list[np.ndarray] = []
    pending = 0
    start_s = time.perf_counter()
    for at in range(0, len(view), chunk_bytes):
        for name, packets in decoder.feed(view[at : at + chunk_bytes]).items():
            assert packets.rows.dtype == protocol.streams[name].dtype
            assert len(packets.rows) == len(packets.end)
            ends.append(packets.end)
        pending = max(pending, decoder.pending)
    seconds = time.perf_counter() - start_s
    found = np.sort(np.concatenate(ends)) if ends else np.empty(0, dtype=np.int64)
    stats = decoder.stats
    waits = stream.ends <= len(stream.data) - decoder.pending
    return Outcome(
        packets=len(found),
        false=len(np.setdiff1d(found, stream.ends)),
        missing=len(np.setdiff1d(stream.ends[waits], found)),
        tries=stats.corrupt + stats.good,
        pending=pending,
        seconds=seconds,
    )


def allowed_false(protocol: DeviceProtocol, tries: int) -> float:
    """So many packets chance may make: the mean and six sigma of a Poisson distribution."""
    bits = checksum_bits(protocol)
    if bits is None:
        return math.inf
    mean = tries / 2**bits
    return mean + 6 * math.sqrt(mean) + 6


def check(protocol: DeviceProtocol, outcome: Outcome) -> None:
    """Fail if something came out, went missing or waited that must not."""
    allowed = allowed_false(protocol, outcome.tries)
    assert outcome.false <= allowed, f"{outcome.false} false packets, {allowed:.1f} allowed"
    assert outcome.pending <= MOST_PENDING, f"{outcome.pending} bytes waited"
    if math.isfinite(allowed):
        # A false packet hides the true ones that it overlaps.
        shortest = min(len(packet) for packet in packets_of(protocol, 20))
        hidden = allowed * (MOST_PENDING // shortest + 2)
        assert outcome.missing <= hidden, f"{outcome.missing} whole packets went missing"


def main() -> None:
    """Fuzz and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("names", nargs="*", help="protocols; all unless named")
    parser.add_argument("--mb", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    warnings.simplefilter("error")
    size = round(given.mb * 1e6)
    print(
        f"{'protocol':18s} {'stream':8s} {'MB':>6s} {'packets':>9s} {'whole':>9s} {'missing':>8s} "
        f"{'false':>6s} {'allowed':>8s} {'tries':>9s} {'waiting':>8s} {'MB/s':>7s}"
    )
    for name, protocol in builtin_protocols().items():
        if given.names and name not in given.names:
            continue
        for number, (kind, make) in enumerate(STREAMS.items()):
            rng = np.random.default_rng([given.seed, number])
            stream = make(protocol, size, rng)
            outcome = decode(protocol, stream)
            speed = len(stream.data) / outcome.seconds / 1e6
            print(
                f"{name:18s} {kind:8s} {len(stream.data) / 1e6:6.1f} {outcome.packets:9d} "
                f"{len(stream.ends):9d} {outcome.missing:8d} {outcome.false:6d} "
                f"{allowed_false(protocol, outcome.tries):8.1f} {outcome.tries:9d} "
                f"{outcome.pending:8d} {speed:7.1f}",
                flush=True,
            )
            check(protocol, outcome)


if __name__ == "__main__":
    main()
