"""What a stretch of received bytes is: packets of a known protocol, or what else."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from firmware_protocols.known import builtin_protocols
from firmware_protocols.layout import PacketLayout
from firmware_protocols.protocol import DeviceProtocol
from imu_rig.arrays import IntArray
from imu_rig.devices.known_messages import known_messages
from imu_rig.foreign_text import one_line

MIN_BYTES = 64
"""Fewer tell nothing."""

MIN_PACKETS = 3
SHARE_IN_ROW = 0.8
"""Of the packets found, how many must follow each other without a gap to be more than chance."""
SHARE_OF_BYTES = 0.5
SHARE_OF_TEXT = 0.95
UNPROVEN_SHARE = 0.9
"""Of the bytes, what packets of several kinds without checksums must make up."""

LONGEST_TEXT = 40
ESCAPES = re.compile(rb"\x1b(?:\[[0-?]*[ -/]*[@-~]|[@-Z\\-_])")
"""What terminals take for colours: logs of boards are full of it."""

UNREADABLE = "\N{REPLACEMENT CHARACTER}"


@dataclass(frozen=True)
class Recognized:
    """Packets of a known protocol.

    Attributes
    ----------
    name : str
        By which the protocol is known.
    protocol : DeviceProtocol
    packets : dict of str to int
        How many were heard of each stream; none of some, perhaps.
    share : float
        Of all bytes, those that belong to whole packets or to other messages of the protocol.
    lost : int
        Packets that are missing by the counters.
    """

    name: str
    protocol: DeviceProtocol
    packets: dict[str, int]
    share: float
    lost: int


def recognize(
    data: bytes, protocols: Mapping[str, DeviceProtocol] | None = None
) -> DeviceProtocol | None:
    """Return the protocol that ``data`` are packets of, among ``protocols`` (default: built in)."""
    found = find_protocol(data, protocols)
    return None if found is None else found.protocol


def find_protocol(
    data: bytes, protocols: Mapping[str, DeviceProtocol] | None = None
) -> Recognized | None:
    """Return the protocol that ``data`` are packets of, and what was heard of it.

    Where several fit, the one that explains most of the bytes wins, then the one with more of its
    streams in them, a checksum, the longer header, more packets.
    """
    best: tuple[tuple[object, ...], Recognized] | None = None
    for name, protocol in (builtin_protocols() if protocols is None else protocols).items():
        found = _fit(data, name, protocol)
        if found is None:
            continue
        header = len(protocol.header) if isinstance(protocol, PacketLayout) else 0
        merit = (
            protocol.proves_packets,
            round(found.share, 1),
            sum(number > 0 for number in found.packets.values()),
            header,
            sum(found.packets.values()),
        )
        if best is None or merit > best[0]:
            best = merit, found
    return None if best is None else best[1]


def _fit(data: bytes, name: str, protocol: DeviceProtocol) -> Recognized | None:
    decoder = protocol.quick_decoder()
    streams = decoder.feed(data)
    packets = {stream: len(streams.get(stream, ())) for stream in protocol.streams}
    if sum(packets.values()) < MIN_PACKETS or not data:
        return None
    covered = len(data) - decoder.stats.skipped_bytes - decoder.pending
    share = max(0.0, covered / max(1, len(data) - decoder.pending))
    if share < SHARE_OF_BYTES:
        return None
    if isinstance(protocol, PacketLayout):
        if not _in_rows(streams[""].end, protocol):
            return None
    elif not protocol.proves_packets and share < UNPROVEN_SHARE:
        return None
    return Recognized(name, protocol, packets, share, decoder.stats.lost)


def explain(data: bytes, protocol: DeviceProtocol, baud: int) -> str:
    """Say in half a sentence what is wrong with bytes in place of packets, and what to do.

    Parameters
    ----------
    data : bytes
        A second or so of what was received.
    protocol : DeviceProtocol
        What was expected.
    baud : int
        Baud rate in use, for the advice.
    """
    if any(len(packets) for packets in protocol.quick_decoder().feed(data).values()):
        return (
            "sent sound packets a moment ago and has fallen silent or sends damaged ones now: "
            "check its power, its cable or Bluetooth link"
        )
    return explain_unknown(data, baud, protocol)


def explain_unknown(
    data: bytes,
    baud: int | None,
    expected: DeviceProtocol | None = None,
    protocols: Mapping[str, DeviceProtocol] | None = None,
) -> str:
    """Say in half a sentence what bytes are that hold no packets of what was expected, if anything.

    Parameters
    ----------
    data : bytes
        A second or so of what was received.
    baud : int or None
        Baud rate in use, for the advice; None where it has no meaning.
    expected : DeviceProtocol, optional
    protocols : mapping, optional
        What to recognize; built-in ones by default.
    """
    spoken = find_protocol(data, protocols)
    if spoken is not None:
        return f"sends packets of the layout {spoken.name}: use that layout"
    messages = known_messages(data)
    if messages is not None:
        return messages.says
    if len(data) < MIN_BYTES:
        return (
            f"sends only {len(data)} bytes, too few to recognize: check that it is set to send "
            "continuously"
        )
    values = np.frombuffer(data, np.uint8)
    different = np.unique(values)
    if len(different) <= 2:
        shown = " and ".join(f"{v:02X}" for v in different.tolist())
        wrong = "" if baud is None else f"the baud rate ({baud}) is wrong or "
        return f"sends nothing but the byte {shown}: {wrong}the line is not connected"
    if isinstance(expected, PacketLayout):
        distance = _usual_distance(_positions(data, expected.header))
        if distance == expected.length:
            return (
                f"sends packets with the header and length of {expected.name} but another "
                "checksum: correct the checksum in the layout file"
            )
        if distance is not None:
            return (
                f"sends the header of {expected.name} every {distance} bytes where the layout has "
                f"{expected.length}: its firmware sends other packets; describe them in a layout "
                "file"
            )
    text = text_in(data)
    if text is not None:
        return f"sends text ({text!r}), not packets: set it to its binary mode"
    wrong = "" if baud is None else f"the baud rate ({baud}) is wrong, "
    return (
        f"sends bytes without any packet known here: {wrong}this is another device's port, or its "
        "packets are yet to be described in a layout file"
    )


def text_in(data: bytes) -> str | None:
    """Return a line of the text that ``data`` are; None if they are none."""
    text = without_escapes(data)
    sound = sum(c in "\t\r\n" or (c.isprintable() and c != UNREADABLE) for c in text)
    if len(data) < MIN_BYTES or sound < SHARE_OF_TEXT * len(text) or not text:
        return None
    lines = text[: 10 * LONGEST_TEXT].splitlines()
    whole = lines[1:-1] or lines
    return one_line(max(whole, key=len) if whole else "", LONGEST_TEXT)


def without_escapes(data: bytes) -> str:
    """Return bytes as text, without what sets colours in it."""
    return ESCAPES.sub(b"", data).decode("utf-8", errors="replace")


def _in_rows(ends: IntArray, layout: PacketLayout) -> bool:
    # a short header without a checksum is met by chance
    least = MIN_PACKETS if layout.checksum or len(layout.header) > 1 else 2 * MIN_PACKETS
    if len(ends) < least:
        return False
    return bool(np.mean(np.diff(ends) == layout.length) >= SHARE_IN_ROW)


def _positions(data: bytes, header: bytes) -> list[int]:
    found, at = [], data.find(header)
    while at >= 0:
        found.append(at)
        at = data.find(header, at + 1)
    return found


def _usual_distance(positions: list[int]) -> int | None:
    """Return the distance at which most headers follow each other; None if there is none."""
    if len(positions) <= MIN_PACKETS:
        return None
    distances, counts = np.unique(np.diff(positions), return_counts=True)
    usual = int(np.argmax(counts))
    share = int(counts[usual]) / (len(positions) - 1)
    return int(distances[usual]) if share >= SHARE_OF_BYTES else None
