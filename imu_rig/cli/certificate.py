"""`imu-rig certificate`: show one, compare two, export one to other programs."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imu_rig.cli.options import Json

if TYPE_CHECKING:
    from imu_rig.calibration.certificate import Certificate

app = typer.Typer(no_args_is_help=True, help="Show, compare and export calibration certificates.")


@app.command("show")
def show(
    file: Annotated[Path, typer.Argument(help="A certificate.")],
    as_json: Json = False,
) -> None:
    """Show parameters, uncertainties and errors."""
    from imu_rig.calibration.certificate import load_certificate

    write_page(file, load_certificate(file), as_json=as_json)


@app.command("compare")
def compare(
    first: Annotated[Path, typer.Argument(help="A certificate, the older one as a rule.")],
    second: Annotated[Path, typer.Argument(help="Another certificate of the same sensor.")],
    any_device: Annotated[
        bool, typer.Option("--any-device", help="Compare two different sensors all the same.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Tell what drifted between two certificates."""
    from imu_rig.calibration.certificate import load_certificate
    from imu_rig.calibration.compare import compare as compare_certificates
    from imu_rig.cli.certificate_page import comparison_figures, comparison_lines

    one, other = load_certificate(first), load_certificate(second)
    found = compare_certificates(one, other, any_device=any_device)
    if as_json:
        sys.stdout.write(json.dumps(comparison_figures(found), allow_nan=False) + "\n")
        return
    for line in comparison_lines(one, other, found):
        sys.stdout.write(line + "\n")


@app.command("export")
def export(
    file: Annotated[Path, typer.Argument(help="A certificate.")],
    to: Annotated[str, typer.Option("--to", help="px4, ardupilot, c, numpy, matlab or csv.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write.")],
    nearest: Annotated[
        bool,
        typer.Option("--nearest", help="Export an approximation where not all can be stored."),
    ] = False,
    device_id: Annotated[
        list[str] | None,
        typer.Option(
            help="Id of the sensor in the autopilot; accel=, gyro= or mag= before it says which."
        ),
    ] = None,
    slot: Annotated[
        int, typer.Option(help="Which of the autopilot's sensors, counted from 0.")
    ] = 0,
    axes: Annotated[
        str, typer.Option(help='The autopilot\'s axes by those of the recording, as "x,-y,-z".')
    ] = "x,y,z",
    as_json: Json = False,
) -> None:
    """Write it for an autopilot, as code or as table."""
    from imu_rig.calibration.certificate import load_certificate
    from imu_rig.calibration.exports import AUTOPILOTS, export_certificate
    from imu_rig.calibration.exports.matlab import runs_as
    from imu_rig.calibration.exports.options import ExportOptions, parse_device_ids
    from imu_rig.errors import InputError
    from imu_rig.files import write_whole

    autopilot = nearest or device_id or slot or axes != "x,y,z"
    if autopilot and to not in AUTOPILOTS:
        raise InputError(
            f"--nearest, --device-id, --slot and --axes are for {' and '.join(AUTOPILOTS)}, not "
            f"for {to}."
        )
    if to == "matlab" and not runs_as(output.stem):
        raise InputError(
            f"MATLAB runs no script named {output.name!r}: use letters, digits and underscores, "
            "and no word of its language."
        )
    options = ExportOptions(
        nearest=nearest,
        device_ids=parse_device_ids(device_id or []),
        slot=slot,
        axes_text=axes,
        name=_identifier(output.stem),
    )
    done = export_certificate(load_certificate(file), to, options)
    write_whole(output, done.text.encode(), what="an export")
    lost = done.loss.figures() if done.loss.lost else {}
    if as_json:
        summary = {"file": str(output), "to": to, "lost": lost, "notes": list(done.notes)}
        sys.stdout.write(json.dumps(summary) + "\n")
        return
    sys.stdout.write(f"{output} holds the calibration for {to}.\n")
    if lost:
        sys.stderr.write(
            f"It is an approximation that falsifies {done.loss.words}. "
            f"Lost: {', '.join(done.loss.lost)}.\n"
        )
    for note in done.notes:
        sys.stderr.write(note + "\n")


def write_page(file: Path, certificate: Certificate, *, as_json: bool) -> None:
    """Print the one page there is of a certificate, or its figures as JSON."""
    from imu_rig.cli.certificate_page import certificate_figures, certificate_lines

    if as_json:
        answer = {"file": str(file), **certificate_figures(certificate)}
        sys.stdout.write(json.dumps(answer, allow_nan=False) + "\n")
        return
    for line in certificate_lines(certificate):
        sys.stdout.write(line + "\n")


def _identifier(stem: str) -> str:
    """Make a name for code of the name of a file."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", stem)
    return name if re.match(r"[A-Za-z]", name) else f"imu_{name}"
