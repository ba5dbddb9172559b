"""What a live recording looks like on a terminal: pure functions of its status."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from imu_rig.cli.view import BAR_WIDTH, bar
from imu_rig.cli.words import clock, lasting, losses, size, supply
from imu_rig.foreign_text import one_line
from imu_rig.recorder.status import DeviceStatus, RecorderStatus

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table
    from rich.text import Text

SHORT_S, VERY_SHORT_S = 1800.0, 300.0  # that the disk lasts, to be told in yellow and red
NARROW = 100  # columns below which there is less room between columns
FRAME_LINES = 10  # of the screen besides devices and sentences
FEWEST_ROWS = 4
NAMES_IN_LINE = 3
LEAST_NAME = 10
LONGEST_SENTENCE = 400
_SPACE = "free some space now; the recording goes on meanwhile."

_STATE_STYLE = {
    "live": "green",
    "waiting": "yellow",
    "garbled": "red",
    "silent": "red",
    "lost": "red",
}


def plain_line(status: RecorderStatus) -> str:
    """Return one line for a log."""
    rows = status.rows
    live = [d for d in rows if d.state == "live"]
    others = [f"{one_line(d.name, 40)} {d.state}" for d in rows if d.state != "live"]
    others += [f"{one_line(d.name, 40)}: {', '.join(faults_of(d))}" for d in rows if d.faults]
    parts = [
        f"{clock(status.elapsed_s)} {status.state}",
        f"{len(live)} of {len(rows)} live, {sum(d.rate_hz for d in live):.0f} packets/s, "
        f"{sum(d.lost for d in status.devices)} lost",
        size(status.file_bytes),
    ]
    if status.disk_free_bytes is not None:
        parts.append(f"{size(status.disk_free_bytes)} free")
    if others:
        more = [] if len(others) <= NAMES_IN_LINE else [f"{len(others) - NAMES_IN_LINE} more"]
        parts.append(", ".join([*others[:NAMES_IN_LINE], *more]))
    return "; ".join(parts)


def screen(
    status: RecorderStatus, width: int, height: int, *, keys: bool = False, marker: str = ""
) -> RenderableType:
    """Draw a status for a terminal of ``width`` columns and ``height`` lines.

    Parameters
    ----------
    status : RecorderStatus
    width, height : int
    keys : bool
        Whether keys are listened to, and which to tell of.
    marker : str
        Label of the last marker.
    """
    from rich.console import Group
    from rich.text import Text

    room = max(FEWEST_ROWS, height - FRAME_LINES)
    rows = min(len(status.rows), max(FEWEST_ROWS, room * 2 // 3))
    parts: list[RenderableType] = [
        _head(status, width),
        _file(status, marker, width),
        Text(),
        _devices(status.rows, rows, width),
    ]
    sentences = _sentences(status, width, max(2, room - rows))
    if sentences is not None:
        parts += [Text(), sentences]
    if keys:
        words = "space: marker   letter or digit: marker of that name   q: stop"
        parts += [Text(), Text(words, style="dim", no_wrap=True, overflow="ellipsis")]
    return Group(*parts)


def _head(status: RecorderStatus, width: int) -> Text:
    from rich.text import Text

    waiting = sum(d.required and d.state == "waiting" for d in status.devices)
    gone = [d for d in status.rows if d.required and d.state not in ("waiting", "live")]
    words = {
        "starting": ("STARTING", "bold yellow"),
        "waiting": (f"WAITING for {waiting or 'required'} device{'s'[: waiting != 1]}", "bold red"),
        "recording": (
            (f"● RECORDING without {named(gone)}", "bold red")
            if gone
            else ("● RECORDING", "bold green")
        ),
        "stopping": ("STOPPING", "bold yellow"),
        "ended": ("ENDED", "bold"),
    }[status.state]
    line = Text.assemble(words, "   ", clock(status.elapsed_s), no_wrap=True, overflow="ellipsis")
    if status.planned_s is not None:
        done = min(1.0, status.recorded_s / status.planned_s)
        if abs(status.elapsed_s - status.recorded_s) >= 1.0:
            line.append(f"   with all devices {clock(status.recorded_s)}")
        line.append(f" of {clock(status.planned_s)}  ")
        made, left = bar(done, min(BAR_WIDTH, width - line.cell_len - 6))
        line.append(made, "cyan").append(left, "dim cyan")
        line.append(f" {100 * done:3.0f} %")
    return line


def named(devices: list[DeviceStatus]) -> str:
    """Return the name of one device, or the number of several."""
    return one_line(devices[0].name, 24) if len(devices) == 1 else f"{len(devices)} devices"


def _file(status: RecorderStatus, marker: str, width: int) -> Table:
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column(no_wrap=True, overflow="ellipsis", max_width=width - 10)
    path = one_line(str(status.path), 400)
    room = width - 10
    table.add_row("file", Text(path if len(path) <= room else f"…{path[1 - room :]}"))
    disk = Text(size(status.file_bytes), overflow="ellipsis")
    if status.disk_free_bytes is not None:
        disk.append(f"   {size(status.disk_free_bytes)} free")
    if status.disk_left_s is not None:
        style = "red" if status.disk_left_s < VERY_SHORT_S else "yellow"
        disk.append(
            f", lasts {lasting(status.disk_left_s)}", style if status.disk_left_s < SHORT_S else ""
        )
    if status.queue >= 0.01:
        disk.append(
            f"   queue {100 * status.queue:.0f} % of {lasting(status.queue_s)}",
            "red" if status.queue > 0.5 else "yellow",
        )
    else:
        disk.append("   queue empty", "dim")
    if status.unwritten_records:
        disk.append(f"   {status.unwritten_records} not written", "bold red")
    table.add_row("disk", disk)
    last = f"   last: {one_line(marker, 40)}" if marker else ""
    table.add_row("markers", Text(f"{status.markers}{last}"))
    return table


def _devices(devices: tuple[DeviceStatus, ...], rows: int, width: int) -> RenderableType:
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    supplies = any(d.supply for d in devices)
    gap = 1 if width < NARROW else 2
    # widths that hold the figures of a long trial, so that nothing jumps while they grow
    columns: list[tuple[str, Literal["left", "right"], int]] = [
        ("state", "left", 8),
        ("Hz", "right", 7),
        ("lost", "right", 14),
        ("corrupt", "right", 7),
        ("reopened", "right", 8),
        ("supply", "right", 7),
        ("heard", "right", 6),
    ]
    if not supplies:
        columns = [column for column in columns if column[0] != "supply"]
    for left_out in ("reopened", "corrupt", "supply", ""):
        names = width - sum(least + gap for _, _, least in columns) - gap
        if names >= LEAST_NAME:
            break
        columns = [column for column in columns if column[0] != left_out]
    names = max(LEAST_NAME, names)
    table = Table(box=None, padding=(0, gap, 0, 0), pad_edge=False, header_style="dim")
    table.add_column("device", no_wrap=True, overflow="ellipsis", min_width=8, max_width=names)
    for title, justify, least in columns:
        table.add_column(title, justify=justify, no_wrap=True, overflow="ellipsis", min_width=least)
    shown = _chosen(devices, rows)
    for d in shown:
        style = state_style(d)
        rate = f"{d.rate_hz:.1f}" if d.rate_hz and d.state == "live" else "–"
        heard = "never" if d.state == "waiting" and not d.packets else age(d.age_s)
        cells = {
            "state": Text(d.state, style),
            "Hz": Text(rate, "" if rate != "–" else "dim"),
            "lost": Text(losses(d.lost, d.loss), "yellow" if d.lost else ""),
            "corrupt": Text(str(d.corrupt), "yellow" if d.corrupt else ""),
            "reopened": Text(str(d.reconnects), "yellow" if d.reconnects else ""),
            "supply": Text(_supply(d)),
            "heard": Text(heard, "dim" if d.state == "live" else style),
        }
        name = Text(one_line(d.name, 60), "" if d.state == "live" else style)
        table.add_row(name, *(cells[title] for title, _, _ in columns))
    rest = [d for d in devices if d not in shown]
    if not rest:
        return table
    live = sum(d.state == "live" for d in rest)
    return Group(table, Text(f"… {len(rest)} more, {live} of them live", "dim"))


def _chosen(devices: tuple[DeviceStatus, ...], rows: int) -> list[DeviceStatus]:
    """Devices that find room, in their order; those that are not live before all others."""
    if len(devices) <= rows:
        return list(devices)
    by_need = sorted(range(len(devices)), key=lambda i: devices[i].state == "live")
    return [devices[i] for i in sorted(by_need[: rows - 1])]


def state_style(device: DeviceStatus) -> str:
    """Return the style in which the state of a device is told."""
    if device.state == "waiting" and device.required:
        return "bold red"
    return _STATE_STYLE[device.state]


def _sentences(status: RecorderStatus, width: int, most_lines: int) -> Table | None:
    """Say what is wrong, each in a sentence that begins with whose it is."""
    told: list[tuple[str, str]] = []
    if status.problem:
        told.append((status.problem, "red"))
    left_s = None if status.planned_s is None else status.planned_s - status.recorded_s
    if status.disk_left_s is not None:
        if left_s is not None and status.disk_left_s < left_s:
            told.append((f"The disk will be full before the planned end: {_SPACE}", "red"))
        elif status.disk_left_s < VERY_SHORT_S:
            told.append((f"The disk is almost full: {_SPACE}", "red"))
    return sentences([*told, *troubles(status.rows)], width, most_lines)


def troubles(rows: Sequence[DeviceStatus]) -> list[tuple[str, str]]:
    """Say what is wrong with devices, each sentence with its style and only once."""
    told = []
    for d in rows:
        if d.problem:
            device = re.escape(d.name.split("/")[0])
            # a port may have the device's name in its own, as in /dev/waist
            named = re.search(rf"(?<![\w/\\.-]){device}(?![\w\\.-])", d.problem)
            words = d.problem if named else f"{d.name}: {d.problem}"
            told.append((words, "red" if d.required else "yellow"))
        if d.stuck:
            told.append(
                (
                    f"{d.name} sends the same values all the time: its sensor is stuck; switch it "
                    "off and on.",
                    "red",
                )
            )
        if d.faults:
            told.append((f"{d.name} reports: {', '.join(faults_of(d))}.", "yellow"))
    return list(dict.fromkeys(told))


def faults_of(device: DeviceStatus) -> list[str]:
    """Return what a device says is wrong with it, fit for a terminal."""
    return [one_line(fault, 80) for fault in device.faults]


def sentences(told: Sequence[tuple[str, str]], width: int, most_lines: int) -> Table | None:
    """Draw sentences with their styles, as many as find room; None where there are none."""
    from rich.cells import cell_len
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 1))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    lines = 0
    for at, (words, style) in enumerate(told):
        words = one_line(words, LONGEST_SENTENCE)
        lines += 1 + cell_len(words) // (width - 8)
        if at and lines > most_lines:
            table.add_row("", Text(f"… and {len(told) - at} more", "dim"))
            break
        table.add_row(Text("!", style), Text(words, style))
    return table if told else None


def _supply(device: DeviceStatus) -> str:
    if not device.supply:
        return "–"
    _, value, unit = device.supply[0]
    return supply(value, one_line(unit, 4))


def age(seconds: float) -> str:
    """Return how long ago something was."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.0f} h"
