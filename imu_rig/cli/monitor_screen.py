"""What watched devices look like on a terminal: pure functions of their status."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imu_rig.cli.record_screen import age, faults_of, named, sentences, state_style, troubles
from imu_rig.cli.view import BAR_WIDTH, bar
from imu_rig.cli.words import clock, losses, supply
from imu_rig.foreign_text import one_line
from imu_rig.monitor.status import MonitorStatus, Reading
from imu_rig.recorder.status import DeviceStatus

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.text import Text

FRAME_LINES = 5  # of the screen besides streams and sentences
LEAST_NAME, LONGEST_NAME = 9, 28
NAMES_IN_LINE = 3
FAR_BEHIND_S = 0.5
PLAIN_WIDTH = 100
HUGE = 1e7  # written with a power of ten from here on

COLUMNS = (
    ("state", 8, "left"),
    ("Hz", 7, "right"),
    ("lost", 13, "right"),
    ("CRC", 6, "right"),
    ("reopened", 8, "right"),
    ("lag", 7, "right"),
    ("heard", 6, "right"),
)
LEFT_OUT_FIRST = ("reopened", "heard", "lag", "CRC")
NUMBER_WIDTHS = {"g": 7, "deg/s": 7, "uT": 7}


def plain_line(status: MonitorStatus) -> str:
    """Return one line for a log."""
    rows = status.rows
    live = [row for row in rows if row.state == "live"]
    others = [f"{one_line(r.name, 40)} {_state(r)}" for r in rows if _state(r) != "live"]
    faults = [f"{one_line(r.name, 40)}: {', '.join(faults_of(r))}" for r in rows if r.faults]
    parts = [
        f"{clock(status.elapsed_s)} watching",
        f"{len(live)} of {len(rows)} live, {sum(r.rate_hz for r in live):.0f} packets/s, "
        f"{sum(d.lost for d in status.devices)} lost",
    ]
    for told in (others, faults):
        if told:
            more = [] if len(told) <= NAMES_IN_LINE else [f"{len(told) - NAMES_IN_LINE} more"]
            parts.append(", ".join([*told[:NAMES_IN_LINE], *more]))
    return "; ".join(parts)


def plain_table(status: MonitorStatus, width: int = PLAIN_WIDTH) -> list[str]:
    """Return the table as lines of text, all of it."""
    lines = _table(status, width, most_lines=10_000)
    return [line.plain.rstrip() for line in lines]


def screen(status: MonitorStatus, width: int, height: int) -> RenderableType:
    """Draw a status for a terminal of ``width`` columns and ``height`` lines."""
    from rich.console import Group
    from rich.text import Text

    room = max(4, height - FRAME_LINES)
    told = [words for words in troubles(status.rows) if " reports: " not in words[0]]
    kept = min(2 * len(told), room // 3)
    parts: list[RenderableType] = [
        _head(status, width),
        Text(),
        *_table(status, width, room - kept),
    ]
    below = sentences(told, width, max(2, kept))
    if below is not None:
        parts += [Text(), below]
    return Group(*parts)


def _head(status: MonitorStatus, width: int) -> Text:
    from rich.text import Text

    gone = [row for row in status.rows if row.required and row.state != "live"]
    words = (
        (f"● WATCHING without {named(gone)}", "bold red") if gone else ("● WATCHING", "bold green")
    )
    line = Text.assemble(words, "   ", clock(status.elapsed_s), no_wrap=True, overflow="ellipsis")
    if status.planned_s is not None:
        done = min(1.0, status.elapsed_s / status.planned_s)
        line.append(f" of {clock(status.planned_s)}  ")
        made, left = bar(done, min(BAR_WIDTH, width - line.cell_len - 6))
        line.append(made, "cyan").append(left, "dim cyan")
    return line


def _table(status: MonitorStatus, width: int, most_lines: int) -> list[Text]:
    """Return the lines of the table; values and then streams are left out where room is short."""
    from rich.text import Text

    rows = list(status.rows)
    columns = list(COLUMNS)
    for left_out in (*LEFT_OUT_FIRST, ""):
        names = width - sum(wide + 1 for _, wide, _ in columns)
        if names >= LEAST_NAME + 6 or not left_out:
            break
        columns = [column for column in columns if column[0] != left_out]
    longest = max((Text(_name(row)).cell_len for row in rows), default=6)
    names = max(LEAST_NAME, min(names, longest, LONGEST_NAME))
    titles = Text("device".ljust(names), "dim", no_wrap=True)
    for title, wide, side in columns:
        titles.append(" " + (title.ljust(wide) if side == "left" else title.rjust(wide)))
    blocks = [
        [_row(row, names, columns), *_below(row, status.readings.get(row.name, ()), width)]
        for row in rows
    ]
    if 1 + sum(map(len, blocks)) > most_lines:
        blocks = [block[: 2 if row.faults else 1] for row, block in zip(rows, blocks, strict=True)]
    shown: list[Text] = [titles]
    order = sorted(range(len(rows)), key=lambda i: rows[i].state == "live")
    fit: set[int] = set()
    used = 1
    for index in order:
        if used + len(blocks[index]) > most_lines - (len(fit) + 1 < len(rows)):
            break
        fit.add(index)
        used += len(blocks[index])
    for index, block in enumerate(blocks):
        if index in fit:
            shown += block
    if len(fit) < len(rows):
        rest = [row for index, row in enumerate(rows) if index not in fit]
        live = sum(row.state == "live" for row in rest)
        shown.append(Text(f"… {len(rest)} more, {live} of them live", "dim"))
    return shown


def _row(row: DeviceStatus, names: int, columns: list[tuple[str, int, str]]) -> Text:
    from rich.text import Text

    style = "red" if row.stuck else state_style(row)
    live = row.state == "live"
    rate = f"{row.rate_hz:.1f}" if row.rate_hz and live else "–"
    never = row.state == "waiting" and not row.packets
    cells = {
        "state": (_state(row), style),
        "Hz": (rate, "" if rate != "–" else "dim"),
        "lost": (losses(row.lost, row.loss), "yellow" if row.lost else ""),
        "CRC": (str(row.corrupt), "yellow" if row.corrupt else ""),
        "reopened": (str(row.reconnects), "yellow" if row.reconnects else ""),
        "lag": (
            f"{1000 * row.lag_s:.0f} ms" if live else "–",
            "yellow" if row.lag_s > FAR_BEHIND_S else "" if live else "dim",
        ),
        "heard": ("never" if never else age(row.age_s), "dim" if live else style),
    }
    name = Text(_name(row), "bold" if live and not row.stuck else style, no_wrap=True)
    name.truncate(names, overflow="ellipsis", pad=True)
    line = Text(no_wrap=True, overflow="ellipsis").append_text(name)
    for title, wide, side in columns:
        words, how = cells[title]
        cell = Text(words, how)
        cell.truncate(wide, overflow="ellipsis")
        line.append(" ")
        gap = " " * (wide - cell.cell_len)
        if side == "left":
            line.append_text(cell).append(gap)
        else:
            line.append(gap).append_text(cell)
    return line


def _below(row: DeviceStatus, readings: tuple[Reading, ...], width: int) -> list[Text]:
    """Return what stands under a row: faults, and the newest values."""
    from rich.text import Text

    lines = []
    if row.faults:
        words = "  ! " + ", ".join(faults_of(row))
        lines.append(Text(words, "red", no_wrap=True, overflow="ellipsis"))
    if row.state != "live":
        return lines
    supplies = [f"{one_line(name, 20)} {supply(value, unit)}" for name, value, unit in row.supply]
    line = ""
    for words in [*map(_value, readings), *supplies]:
        if line and len(line) + 3 + len(words) > width:
            lines.append(Text(line, "dim" if row.stuck else "", no_wrap=True))
            line = ""
        line += ("  " if not line else "   ") + words
    if line:
        lines.append(Text(line, "dim" if row.stuck else "", no_wrap=True, overflow="ellipsis"))
    return lines


def _value(reading: Reading) -> str:
    """Return a quantity in so many columns that nothing jumps while it changes."""
    quantity, numbers = reading
    sign = "+" if quantity.count > 1 else ""
    wide = NUMBER_WIDTHS.get(quantity.unit, 0)
    texts = [_number(number, sign, wide, quantity.decimals) for number in numbers]
    unit = one_line(quantity.spoken_unit, 12)
    known = quantity.unit in (*NUMBER_WIDTHS, "hPa", "degC")
    name = "" if known else f"{one_line(quantity.title, 24)} "
    return f"{name}{' '.join(texts)} {unit}".rstrip()


def _number(number: float, sign: str, wide: int, decimals: int) -> str:
    if not math.isfinite(number):
        return f"{'–':>{wide}}"
    kind = f".{decimals}f" if abs(number) < HUGE else ".2g"
    return f"{number:{sign}{wide}{kind}}"


def _state(row: DeviceStatus) -> str:
    return "stuck" if row.stuck else row.state


def _name(row: DeviceStatus) -> str:
    return one_line(row.name, 60)
