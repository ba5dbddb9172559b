"""What a stretch of received bytes is, if it is not what was expected."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from firmware_protocols.decoder import StreamDecoder
from firmware_protocols.known import builtin_protocols
from firmware_protocols.layout import PacketLayout
from firmware_protocols.protocol import DeviceProtocol
from imu_rig.arrays import IntArray

MIN_BYTES = 64
"""Fewer tell nothing."""

MIN_PACKETS = 3
SHARE_IN_ROW = 0.8
"""Of the packets found, how many must follow each other without a gap to be more than chance."""
SHARE_OF_BYTES = 0.5
SHARE_OF_TEXT = 0.95


def recognize(
    data: bytes, layouts: Mapping[str, PacketLayout] | None = None
) -> PacketLayout | None:
    """Return the layout that ``data`` are packets of, among ``layouts`` (default: built in).

    Where several fit, the one that explains most of the bytes with the longest header and a
    checksum wins.
    """
    best: tuple[tuple[bool, int, int], PacketLayout] | None = None
    for layout in (builtin_protocols() if layouts is None else layouts).values():
        if not isinstance(layout, PacketLayout):
            continue
        ends = StreamDecoder(layout).feed(data).end
        covered = len(ends) * layout.length
        if not _in_rows(ends, layout) or covered < SHARE_OF_BYTES * len(data):
            continue
        merit = (layout.checksum is not None, len(layout.header), covered)
        if best is None or merit > best[0]:
            best = merit, layout
    return None if best is None else best[1]


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
    if len(data) < MIN_BYTES:
        return (
            f"sends only {len(data)} bytes, too few to recognize: check that it is set to send "
            "continuously"
        )
    if any(len(packets) for packets in protocol.decoder().feed(data).values()):
        return (
            "sent sound packets a moment ago and has fallen silent or sends damaged ones now: "
            "check its power, its cable or Bluetooth link"
        )
    other = recognize(data)
    if other is not None:
        return f"sends packets of the layout {other.name}: use that layout"
    values = np.frombuffer(data, np.uint8)
    different = np.unique(values)
    if len(different) <= 2:
        shown = " and ".join(f"{v:02X}" for v in different.tolist())
        return (
            f"sends nothing but the byte {shown}: the baud rate ({baud}) is wrong or the line is "
            "not connected"
        )
    if isinstance(protocol, PacketLayout):
        distance = _usual_distance(_positions(data, protocol.header))
        if distance == protocol.length:
            return (
                f"sends packets with the header and length of {protocol.name} but another "
                "checksum: correct the checksum in the layout file"
            )
        if distance is not None:
            return (
                f"sends the header of {protocol.name} every {distance} bytes where the layout has "
                f"{protocol.length}: its firmware sends other packets; describe them in a layout "
                "file"
            )
    printable = np.isin(values, [9, 10, 13]) | ((values >= 32) & (values < 127))
    if printable.mean() >= SHARE_OF_TEXT:
        begin = data[:40].decode("ascii", errors="replace").split("\r")[0].split("\n")[0]
        return f"sends text ({begin!r}), not packets: set it to its binary mode"
    return (
        f"sends bytes without any packet known here: the baud rate ({baud}) is wrong, this is "
        "another device's port, or its packets are yet to be described in a layout file"
    )


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
