"""`imu-rig devices`: the ports of this machine with what speaks on them; one of them examined."""

from __future__ import annotations

import json
import math
import shlex
import sys
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imu_rig.cli.autopilot import autopilot
from imu_rig.cli.options import Json, Quiet
from imu_rig.cli.terminal import fitted
from imu_rig.errors import DeviceError, InputError, PortError

if TYPE_CHECKING:
    from firmware_protocols.protocol import DeviceProtocol
    from imu_rig.cli.sheet import Sheet
    from imu_rig.devices.listening import Heard
    from imu_rig.devices.survey import Finding, Surveyed

INDENT = 12
DRAFT_INDENT = 27
LONGEST_S = 600.0
USUAL_BAUD = 115_200
MOST_LAYOUT_FILES = 200
DRAFT_NAME = "my-device"
TEXT_LINES = 5
HEX_BYTES = 64
MOST_DAMAGED = 0.01
BOARDS_RESET = (
    "Opening a port resets boards of the Arduino kind: they are silent for a second or two then; "
    "listen longer with --seconds."
)

app = typer.Typer(help="List the ports with what speaks on them.", invoke_without_command=True)
app.command()(autopilot)

Seconds = Annotated[float, typer.Option("--seconds", "-s", help="How long to listen.")]
Baud = Annotated[
    int | None,
    typer.Option("--baud", help="Baud rate; by default 115200, then others where that is noise."),
]
LayoutFiles = Annotated[
    list[str] | None,
    typer.Option("--layout", help="A layout file to recognize too; repeat it for several."),
]
LayoutFolder = Annotated[
    Path | None, typer.Option("--layouts", help="Folder of layout files to recognize too.")
]


@app.callback()
def devices(
    context: typer.Context,
    port: Annotated[
        list[str] | None,
        typer.Option("--port", help="A port that the system does not list; may be repeated."),
    ] = None,
    seconds: Seconds = 1.5,
    baud: Baud = None,
    fast: Annotated[bool, typer.Option("--fast", help="List only; open nothing.")] = False,
    probe: Annotated[
        bool,
        typer.Option(
            "--probe",
            help="Ask silent ports whether they are a Maestro; clears its register of errors.",
        ),
    ] = False,
    layout: LayoutFiles = None,
    layouts: LayoutFolder = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """List the serial ports of this machine, and listen to each for what speaks on it."""
    if context.invoked_subcommand is not None:
        return
    from imu_rig.cli.status_line import StatusLine
    from imu_rig.devices.survey import survey

    _check(seconds, baud)
    known = _protocols(layout or (), layouts)
    with closing(StatusLine(quiet=quiet, silent_s=1.0)) as line:
        found = survey(
            port or (),
            seconds=None if fast else seconds,
            baud=baud,
            protocols=known,
            probe=probe,
            progress=line.show,
        )
    if as_json:
        sys.stdout.write(json.dumps({"ports": [_json(one) for one in found]}) + "\n")
        return
    _print(found, fast=fast)


@app.command()
def identify(
    port: Annotated[str, typer.Argument(help="Port, as `imu-rig devices` lists it, or any URL.")],
    seconds: Seconds = 3.0,
    baud: Baud = None,
    write: Annotated[
        Path | None,
        typer.Option("--write", "-w", help="Write a draft of the layout file; never overwrites."),
    ] = None,
    layout: LayoutFiles = None,
    layouts: LayoutFolder = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Listen to one port and say what speaks there, or what its bytes are made of."""
    from imu_rig.cli.status_line import StatusLine
    from imu_rig.devices.survey import find_out
    from imu_rig.files import require_new

    _check(seconds, baud)
    if write is not None:
        require_new(write, what="a layout file")
    known = _protocols(layout or (), layouts)
    with closing(StatusLine(quiet=quiet, silent_s=1.0)) as line:
        finding = find_out(port, seconds, baud, known, progress=line.show)
    if not finding.heard.opened:
        raise PortError(finding.says)
    address = _address(port)
    written = _write_draft(finding, write) if write is not None else None
    trouble = _trouble(port, finding) if finding.state in ("silent", "noise", "closed") else None
    if as_json:
        told = {**_finding_json(finding, address), "port": port, "draft": written}
        sys.stdout.write(json.dumps({**told, "error": trouble}) + "\n")
    else:
        _print_finding(port, address, finding, written)
    if trouble is not None:
        sys.stderr.write(fitted(f"imu-rig: {trouble}") + "\n")
        raise typer.Exit(DeviceError.exit_code)


def _check(seconds: float, baud: int | None) -> None:
    if not (math.isfinite(seconds) and 0.1 <= seconds <= LONGEST_S):
        raise InputError(f"--seconds must be between 0.1 and {LONGEST_S:.0f}.")
    if baud is not None and not 50 <= baud <= 20_000_000:
        raise InputError(f"--baud {baud} is no baud rate: take one such as 115200.")


def _protocols(named: Iterable[str], folder: Path | None) -> dict[str, DeviceProtocol]:
    """Return the built-in protocols and those of files; bad files of the folder are told."""
    from firmware_protocols.fields import LayoutError
    from firmware_protocols.known import builtin_protocols, load_protocol
    from imu_rig.foreign_text import one_line

    known = dict(builtin_protocols())
    for name in named:
        try:
            known[name] = load_protocol(name)
        except LayoutError as error:
            raise InputError(str(error)) from error
    if folder is None:
        return known
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder of layout files.")
    for path in sorted(folder.glob("*.toml"))[:MOST_LAYOUT_FILES]:
        try:
            known[str(path)] = load_protocol(path)
        except LayoutError as error:
            sys.stderr.write(f"imu-rig: not looked for: {one_line(str(error))}\n")
    return known


def _address(port: str) -> str:
    """Return by what a port is found again after its number has changed."""
    from imu_rig.devices.ports import usb_address
    from imu_rig.devices.survey import stable_names

    return usb_address(port) or stable_names().get(port) or port


def _command(address: str, layout: str | None, baud: int, name: str = "imu") -> str:
    """Return a command that records the device."""
    device = f"{name}={address}"
    if layout is not None:
        device += f",layout={layout}"
    if baud != USUAL_BAUD:
        device += f",baud={baud}"
    return f"imu-rig record --device {shlex.quote(device)}"


# --- all ports ------------------------------------------------------------------------------------


def _print(found: list[Surveyed], *, fast: bool) -> None:
    from imu_rig.cli.sheet import Sheet

    sheet = Sheet(INDENT)
    if not found:
        sheet.head("No serial port is there now.")
        sheet.entry(
            "",
            "Plug a device in, bind a Bluetooth one (imu-rig doctor says how), or name a simulated "
            "port with --port.",
        )
        return
    for one in found:
        words = one.port.description if one.port.description else ""
        kind = f"{one.kind}, " if one.kind and words else one.kind
        sheet.head(one.port.url, f"  {kind}{words}".rstrip())
        _print_port(one, sheet)
        sheet.blank()
    if not fast and any(one.finding.state == "silent" for one in found):
        sheet.remark(BOARDS_RESET)


def _print_port(one: Surveyed, sheet: Sheet) -> None:
    from imu_rig.devices.listening import baud_matters

    finding = one.finding
    if one.address != one.port.url:
        sheet.entry("  address", one.address)
    if one.stable_name is not None and one.stable_name != one.address:
        sheet.entry("  name", one.stable_name)
    if finding.state == "listed":
        style, words = ("", "may be opened") if one.may_open else ("red", "may not be opened")
        sheet.entry("  access", words, style)
        return
    at = f" at {finding.heard.baud} baud" if baud_matters(one.port.url) else ""
    if finding.recognized is not None:
        sheet.entry("  speaks", f"{_recognized_words(finding)}{at}", "green")
        command = _command(one.address, finding.recognized.name, finding.heard.baud)
        sheet.command(command, "  record")
    elif finding.state == "silent":
        more = ", as a Maestro does until it is asked (--probe)" if one.port.is_maestro else ""
        sheet.entry("  silent", f"nothing came{at}{more}", "dim")
    elif finding.state == "closed":
        sheet.entry("  closed", finding.says, "red")
    else:
        style = "green" if finding.state == "known" and "Maestro" in finding.says else "yellow"
        sheet.entry("  it", f"{finding.says}{at}", style)
        _print_commands(finding, one.address, sheet)
    if finding.state in ("unknown", "noise", "text"):
        command = f"imu-rig devices identify {shlex.quote(one.port.url)}"
        sheet.command(command, "  see")


def _print_commands(finding: Finding, address: str, sheet: Sheet) -> None:
    """Print how a device can be recorded that has to be asked for measurements."""
    for layout in finding.layouts:
        first = layout == finding.layouts[0]
        command = _command(address, layout, finding.heard.baud)
        sheet.command(command, "  record" if first else "  or")


def _recognized_words(finding: Finding) -> str:
    assert finding.recognized is not None
    rates = [
        f"{name + ' ' if name else ''}{_per_second(rate)}"
        for name, rate in finding.rates_hz.items()
    ]
    return f"{finding.recognized.name}: {', '.join(rates)}"


def _per_second(rate: float | None) -> str:
    if rate is None:
        return "too few packets for a rate"
    return "nothing" if rate == 0 else f"{rate:.1f} packets/s"


def _json(one: Surveyed) -> dict[str, Any]:
    return {
        "port": one.port.url,
        "description": one.port.description,
        "kind": one.kind,
        "stable_name": one.stable_name,
        "usb": one.usb,
        "vendor": None if one.port.vendor is None else f"{one.port.vendor:04X}",
        "product": None if one.port.product is None else f"{one.port.product:04X}",
        "serial_number": one.port.serial_number,
        "may_open": one.may_open,
        **_finding_json(one.finding, one.address),
    }


def _finding_json(finding: Finding, address: str) -> dict[str, Any]:
    from imu_rig.cli.unknown_view import frames_json, unknown_json

    heard = finding.heard
    found: dict[str, Any] = {
        "address": address,
        "state": finding.state,
        "says": finding.says,
        "baud": heard.baud,
        "bytes": heard.total,
        "bytes_per_s": _rounded(heard.bytes_per_s),
        "layout": None,
        "streams": {},
        "record": None,
        "layouts_to_try": list(finding.layouts),
    }
    if finding.recognized is not None:
        found["layout"] = finding.recognized.name
        found["lost"] = finding.recognized.lost
        found["streams"] = {name: _rounded(rate) for name, rate in finding.rates_hz.items()}
        found["record"] = _command(address, found["layout"], heard.baud)
    if finding.kinds:
        found["packets"] = [unknown_json(kind) for kind in finding.kinds]
    if finding.frames is not None:
        found["frames"] = frames_json(finding.frames)
    return found


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(float(value), 3)


# --- one port -------------------------------------------------------------------------------------


def _print_finding(port: str, address: str, finding: Finding, written: str | None) -> None:
    from imu_rig.cli.sheet import Sheet
    from imu_rig.cli.unknown_view import show_frames, show_unknown
    from imu_rig.devices.listening import baud_matters

    sheet = Sheet(DRAFT_INDENT if finding.kinds else INDENT)
    heard = finding.heard
    at = f" at {heard.baud} baud" if baud_matters(port) else ""
    rate = f", {heard.bytes_per_s:.0f} a second" if heard.bytes_per_s else ""
    sheet.head(port, f"  {heard.total} bytes{rate}{at}")
    if finding.recognized is not None:
        sheet.entry("  speaks", _recognized_words(finding), "green")
        sheet.entry("  title", finding.recognized.protocol.title)
        if finding.recognized.lost:
            sheet.entry("  lost", f"{finding.recognized.lost} packets by their counter", "yellow")
        damaged = 1.0 - finding.recognized.share
        if damaged > MOST_DAMAGED:
            sheet.entry(
                "  damage", f"{100 * damaged:.0f} % of the bytes belong to no packet", "yellow"
            )
        command = _command(address, finding.recognized.name, heard.baud)
        sheet.command(command, "  record")
        return
    if finding.state in ("silent", "closed"):
        return
    if finding.kinds:
        sheet.row([("  sends packets that no layout known here describes.", "yellow")])
        for number, kind in enumerate(finding.kinds, start=1):
            named = f"Kind {number}: " if len(finding.kinds) > 1 else ""
            often = f", {kind.rate_hz:.1f} a second" if kind.rate_hz else ""
            sheet.blank()
            sheet.row([(f"  {named}{kind.length} bytes{often}", "bold")])
            show_unknown(kind, sheet)
        sheet.blank()
        _print_draft(port, address, finding, written, sheet)
        return
    sheet.entry("  it", finding.says, "yellow")
    _print_commands(finding, address, sheet)
    if finding.frames is not None:
        show_frames(finding.frames, sheet)
    elif finding.state == "text":
        for line in _text_lines(heard):
            sheet.command(line)
    elif finding.state == "noise":
        sheet.entry("  bytes", heard.data[:HEX_BYTES].hex(" ").upper())


def _print_draft(
    port: str, address: str, finding: Finding, written: str | None, sheet: Sheet
) -> None:
    from imu_rig.foreign_text import printable

    if written is None:
        words = "A draft of its layout file, to name its numbers in:"
        baud = "" if finding.heard.baud == USUAL_BAUD else f" --baud {finding.heard.baud}"
        command = f"imu-rig devices identify {shlex.quote(port)}{baud} --write {DRAFT_NAME}.toml"
    else:
        words = f"Wrote {written}: name its numbers, then"
        command = _command(address, written, finding.heard.baud)
    sheet.row([(f"  {printable(words)}", "")])
    sheet.row([(f"    {printable(command)}", "cyan")])


def _text_lines(heard: Heard) -> list[str]:
    from imu_rig.devices.recognize import without_escapes
    from imu_rig.foreign_text import one_line

    lines = without_escapes(heard.data[:4096]).splitlines()
    return [one_line(line, 80) for line in lines[1 : TEXT_LINES + 1] if line.strip()]


def _write_draft(finding: Finding, path: Path) -> str:
    """Write a layout file for unknown packets and return its name.

    Raises
    ------
    InputError
        If there is nothing to describe, or the file exists.
    """
    import re

    from imu_rig.devices.unknown.draft import draft_layout
    from imu_rig.files import write_whole

    if not finding.kinds:
        found = "it is known already" if finding.recognized is not None else finding.says
        raise InputError(f"No layout file was written: {found}.")
    name = re.sub(r"[^A-Za-z0-9._-]+", "-", path.stem).strip("-._")[:64] or DRAFT_NAME
    text = draft_layout(finding.kinds, name)
    write_whole(path, text.encode(), what="a layout file")
    return str(path)


def _trouble(port: str, finding: Finding) -> str:
    if finding.state == "silent":
        return (
            f"{port} sends nothing: check the device's power and that it sends by itself. "
            f"{BOARDS_RESET}"
        )
    if finding.state == "closed":
        return finding.says
    return f"{port} {finding.says}."
