"""A draft of the layout file for unknown packets, for a person to finish.

Every line of it says in a comment whether it is certain or a guess. It loads as it is and decodes
the bytes that it was made of.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Sequence
from itertools import pairwise

from firmware_protocols.layout import PacketLayout
from firmware_protocols.rows import RATES_HZ, TICKS_S
from imu_rig.devices.unknown.analysis import UnknownPackets
from imu_rig.devices.unknown.counting import Going, tick_s
from imu_rig.devices.unknown.fields import Part, are_alike

COUNTER_WIDTHS = {1: "u8", 2: "u16", 3: "u24", 4: "u32"}


def draft_layout(kinds: Sequence[UnknownPackets], name: str) -> str:
    """Return the text of a layout file.

    Parameters
    ----------
    kinds : sequence of UnknownPackets
        One; or several kinds of packets that take turns, each of which becomes a stream.
    name : str
        Name of the layout.
    """
    heard = " and ".join(f"{len(found.rows)} packets of {found.length} bytes" for found in kinds)
    lines = [
        f"# A draft, made by listening to {heard}.",
        '# "sure" was true of all of them; "guess" is likely and yours to check. Name what',
        "# you know: accel, gyro and mag (three numbers each, with unit and counts_per_unit),",
        "# temperature, pressure. How: docs/own-packets.md.",
        "",
        f"name = {json.dumps(name)}",
        'title = "Draft: what is this device?"',
    ]
    if len(kinds) == 1:
        return "\n".join(lines + _described(kinds[0], "")) + "\n"
    lines.append('kind = "interleaved" # several kinds of packets, told apart by their headers')
    for number, found in enumerate(kinds, start=1):
        lines += ["", "[[streams]]", f'name = "kind{number}" # yours to choose']
        lines += _described(found, "streams.")
    return "\n".join(lines) + "\n"


def drafted_layout(found: UnknownPackets) -> PacketLayout:
    """Return the layout that such a draft describes."""
    return PacketLayout.from_dict(tomllib.loads(draft_layout([found], "drafted")))


def _described(found: UnknownPackets, table: str) -> list[str]:
    """Return the lines of one kind of packets, whose tables have that beginning."""
    order = _usual_order(found)
    lines = [
        f"byte_order = {json.dumps(order)} # guess: by which signals are smoothest",
        f'header = "{found.header.hex(" ").upper()}" # {_header_words(found)}',
    ]
    entries: list[tuple[int, list[str]]] = []
    if found.counter is not None:
        lines.append('counter = "seq" # sure: goes up by one')
        entries.append((found.counter.at, _going("seq", found.counter, order, found)))
    if found.clock is not None:
        lines.append(f'clock = "time" # {_clock_words(found.clock)}')
        lines.append(_tick_line(found, found.clock))
        entries.append((found.clock.at, _going("time", found.clock, order, found)))
    if found.rate_hz is not None:
        rate_hz = _within(found.rate_hz, RATES_HZ)
        lines.append(f"rate_hz = {rate_hz:.4g} # as heard: put in the nominal rate")
    entries += _measured(found, order)
    for _, entry in sorted(entries):
        lines += ["", f"[[{table}fields]]", *entry]
    if found.checksum is not None:
        check = found.checksum
        lines += ["", f"[{table}checksum] # sure: holds in the packets heard"]
        lines.append(f'kind = "{check.kind}"')
        if check.start:
            lines.append(f"start = {check.start}")
        if check.size > 1 and check.byte_order != order:
            lines.append(f'byte_order = "{check.byte_order}"')
    return lines


def _header_words(found: UnknownPackets) -> str:
    same = "the same in every packet"
    if found.beginning_sure:
        return f"sure: {same}, and packets begin here"
    return f"{same}; a guess that packets begin here"


def _usual_order(found: UnknownPackets) -> str:
    votes = [part.byte_order for part in found.parts if part.type not in ("pad", "u8")]
    for going in (found.counter, found.clock):
        if going is not None and going.width > 1:
            votes.append(going.byte_order)
    if not votes and found.checksum is not None:
        votes = [found.checksum.byte_order]
    return "big" if votes.count("big") > len(votes) / 2 else "little"


def _clock_words(clock: Going) -> str:
    exactly = f"always goes up by {clock.step:.6g}" if clock.exact else ""
    return f"{exactly or f'goes up by about {clock.step:.6g}'} from packet to packet"


def _tick_line(found: UnknownPackets, clock: Going) -> str:
    if found.rate_hz is None:
        return "clock_tick_s = 1e-6 # guess: seconds per count are not known"
    tick, usual = tick_s(clock.step, found.rate_hz)
    words = "guess: fits the rate" if usual else "measured: not exact"
    return f"clock_tick_s = {_within(tick, TICKS_S)!r} # {words}"


def _within(value: float, limits: tuple[float, float]) -> float:
    """Return what a layout may hold: the times of a capture may be nonsense."""
    return min(max(value, limits[0]), limits[1])


def may_be_wider(found: UnknownPackets, going: Going) -> bool:
    """Return whether the byte above a counter or clock never changed and could be part of it."""
    above = going.at + going.width if going.byte_order == "little" else going.at - 1
    inside = len(found.header) <= above < found.length
    return going.width < max(COUNTER_WIDTHS) and inside and bool(found.constant[above])


def _going(name: str, going: Going, order: str, found: UnknownPackets) -> list[str]:
    wider = may_be_wider(found, going)
    words = f"sure to count in {going.width} byte{'s'[: going.width != 1]}"
    if wider:
        words += "; perhaps wider, by the byte beside it that did not change"
    lines = [f'name = "{name}" # {words}', f'type = "{COUNTER_WIDTHS[going.width]}"']
    if going.width > 1 and going.byte_order != order:
        lines.append(f'byte_order = "{going.byte_order}"')
    return lines


def _measured(found: UnknownPackets, order: str) -> list[tuple[int, list[str]]]:
    """Return the other fields, three equal ones together where they may be axes."""
    entries, index, number, same = [], 0, 0, 0
    while index < len(found.parts):
        part = found.parts[index]
        if part.type == "pad":
            same += 1
            shown = bytes(found.rows[0, part.at : part.at + part.size])[:8].hex(" ").upper()
            more = " ..." if part.size > 8 else ""
            entries.append(
                (
                    part.at,
                    [
                        f'name = "same{same}" # did not change: {shown}{more}',
                        'type = "pad"',
                        f"count = {part.size}",
                    ],
                )
            )
            index += 1
            continue
        gravity = found.gravity
        count = 3 if _are_axes(found, index) else 1
        if gravity is not None and gravity.first == index:
            name = 'name = "accel" # guess: the magnitude of the three stays that of gravity'
        else:
            number += 1
            name = f'name = "raw{number}"'
        lines = [name, f'type = "{part.type}"']
        if count > 1:
            lines.append(f"count = {count}")
        if part.size > 1 and part.byte_order != order:
            lines.append(f'byte_order = "{part.byte_order}"')
        if gravity is not None and gravity.first == index:
            lines.append(f'unit = "{gravity.unit}" # guess')
            if gravity.counts_per_unit != 1.0:
                lines.append(f"counts_per_unit = {gravity.counts_per_unit} # guess")
        entries.append((part.at, lines))
        index += count
    return entries


def _are_axes(found: UnknownPackets, index: int) -> bool:
    """Return whether three numbers from here on are likely the axes of one sensor."""
    run = _run(found.parts, index)
    if found.gravity is not None:
        first = found.gravity.first
        if first == index:
            return True
        if index < first < index + run:
            return (first - index) % 3 == 0
    return run >= 3 and (run % 3 == 0 or run > 3)


def _run(parts: list[Part], index: int) -> int:
    """Return how many parts of one kind stand side by side from here on."""
    run = 1
    for before, part in pairwise(parts[index:]):
        if not are_alike(before, part):
            break
        run += 1
    return run
