"""What is shown of packets that nobody knows: what was found in them, and their bytes in rows."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from imu_rig.cli.sheet import Sheet

if TYPE_CHECKING:
    from imu_rig.devices.unknown.analysis import UnknownPackets
    from imu_rig.devices.unknown.counting import Going
    from imu_rig.devices.unknown.fields import Part
    from imu_rig.devices.unknown.variable import VariableFrames

ROWS = 10
MOST_FINDINGS = 40
PLACES_WIDTH = 8
SURENESS_STYLES = {"sure": "green", "guess": "yellow", "same": "dim"}

Finding = tuple[range, str, str, str]
"""Bytes of the packet, mark of two letters, "sure", "guess" or "same", and a sentence."""


def show_unknown(found: UnknownPackets, sheet: Sheet) -> None:
    """Print what was found in packets of one length, then some of them in rows."""
    findings = list(unknown_findings(found))
    sheet.row([("  bytes    mark  how sure  meaning", "dim")])
    for places, mark, sureness, text in findings[:MOST_FINDINGS]:
        shown = f"{places.start}" if len(places) == 1 else f"{places.start}-{places.stop - 1}"
        style = SURENESS_STYLES[sureness]
        sheet.parts([(f"  {shown:<9}{mark:<6}", "bold"), (f"{sureness:<9}", style)], text)
    if len(findings) > MOST_FINDINGS:
        sheet.row([(f"  ... and {len(findings) - MOST_FINDINGS} more", "dim")])
    sheet.blank()
    _rows(found, findings, sheet)


def unknown_findings(found: UnknownPackets) -> Iterator[Finding]:
    """Yield what each part of the packet seems to be, in the order of the packet."""
    listed: list[Finding] = []
    begins = "packets begin here" if found.beginning_sure else "packets may begin here"
    listed.append(
        (
            range(len(found.header)),
            "hh",
            "sure" if found.beginning_sure else "guess",
            f"header {found.header.hex(' ').upper()}: the same in every packet; {begins}",
        )
    )
    if found.counter is not None:
        listed.append(
            (found.counter.places, "nn", "sure", f"counter {_type(found.counter)}, goes up by one")
        )
    if found.clock is not None:
        listed.append((found.clock.places, "tt", "guess", _clock(found)))
    number = 0
    for index, part in enumerate(found.parts):
        places = range(part.at, part.at + part.size)
        if part.type == "pad":
            shown = found.rows[0, part.at : part.at + part.size][:6].tobytes().hex(" ").upper()
            more = " ..." if part.size > 6 else ""
            listed.append((places, "==", "same", f"never changed: {shown}{more}"))
            continue
        number += 1
        mark = f"{number % 100:02d}"
        listed.append((places, mark, "guess", _measured(found, part, index)))
    if found.checksum is not None:
        check = found.checksum
        order = f", {check.byte_order}-endian" if check.size > 1 else ""
        listed.append(
            (
                range(found.length - check.size, found.length),
                "cc",
                "sure",
                f"checksum {check.kind} of byte {check.start} to {found.length - check.size - 1}"
                f"{order}",
            )
        )
    yield from sorted(listed, key=lambda finding: finding[0].start)


def _type(going: Going) -> str:
    order = f", {going.byte_order}-endian" if going.width > 1 else ""
    return f"u{8 * going.width}{order}"


def _clock(found: UnknownPackets) -> str:
    from imu_rig.devices.unknown.counting import tick_s
    from imu_rig.devices.unknown.draft import may_be_wider

    clock = found.clock
    assert clock is not None
    steps = f"clock {_type(clock)}, goes up by {'' if clock.exact else 'about '}{clock.step:.6g}"
    if found.rate_hz is not None:
        tick, usual = tick_s(clock.step, found.rate_hz)
        steps += f": one count is {'' if usual else 'about '}{1e6 * tick:.6g} µs"
    return steps + ("; the byte above may belong to it" if may_be_wider(found, clock) else "")


def _measured(found: UnknownPackets, part: Part, index: int) -> str:
    from imu_rig.devices.unknown.fields import read_part

    values = read_part(found.rows, part)
    low, high = float(values.min()), float(values.max())
    order = f", {part.byte_order}-endian" if part.size > 1 else ""
    text = f"{part.type}{order}, {low:.6g} to {high:.6g}"
    gravity = found.gravity
    if gravity is not None and gravity.first <= index < gravity.first + 3:
        scale = f", {gravity.counts_per_unit:g} per g" if gravity.unit == "g" else " in m/s2"
        text += f"; accelerometer {'xyz'[index - gravity.first]}?{scale}"
    return text


def _rows(found: UnknownPackets, findings: list[Finding], sheet: Sheet) -> None:
    """Print packets one below the other, those of one line marked by what their bytes are."""
    marks = ["  "] * found.length
    for places, mark, _, _ in findings:
        for place in places:
            marks[place] = mark
    per_line = max(8, (sheet.width - PLACES_WIDTH) // 3)
    for first in range(0, found.length, per_line):
        places = range(first, min(first + per_line, found.length))
        if first:
            sheet.blank()
        shown = " ".join(f"{place:2d}" if place < 100 else f"{place % 100:02d}" for place in places)
        sheet.row([(f"  byte  {shown}", "dim")])
        sheet.row([("        " + " ".join(marks[place] for place in places), "bold")])
        for row in found.rows[:ROWS]:
            pieces = [("        ", "")]
            for place in places:
                style = "green" if found.constant[place] else ""
                pieces.append((f"{row[place]:02X}", style))
                pieces.append((" ", ""))
            sheet.row(pieces[:-1])


def show_frames(found: VariableFrames, sheet: Sheet) -> None:
    """Print what was found of frames of variable length."""
    usual = ", ".join(
        f"{length} ({count} times)" for length, count in list(found.lengths.items())[:6]
    )
    sheet.blank()
    sheet.entry("  header", f"{found.header.hex(' ').upper()}, the same in every frame")
    sheet.entry(
        "  length",
        f"byte {found.length_at} of the frame says it; a frame is {found.overhead} bytes longer "
        "than that byte",
    )
    sheet.entry("  frames", f"bytes: {usual}")
    sheet.entry(
        "  next",
        "layout files describe packets of fixed length: if the device can be set to send one kind "
        "only, or few kinds with headers of their own, describe those (docs/own-packets.md).",
    )


def unknown_json(found: UnknownPackets) -> dict[str, Any]:
    """Return the same for programs."""
    return {
        "length": found.length,
        "rate_hz": None if found.rate_hz is None else round(float(found.rate_hz), 3),
        "header": found.header.hex(" ").upper(),
        "beginning_sure": found.beginning_sure,
        "findings": [
            {
                "first": places.start,
                "bytes": len(places),
                "sureness": sureness,
                "meaning": text,
            }
            for places, _, sureness, text in unknown_findings(found)
        ],
    }


def frames_json(found: VariableFrames) -> dict[str, Any]:
    """Return the same for programs."""
    return {
        "header": found.header.hex(" ").upper(),
        "length_at": found.length_at,
        "overhead": found.overhead,
        "lengths": {str(length): count for length, count in found.lengths.items()},
    }
