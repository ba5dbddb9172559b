"""`imu-rig info`: what a trial file or a certificate holds, and whether it is whole."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imu_rig.cli.certificate import write_page
from imu_rig.cli.options import Json
from imu_rig.cli.terminal import fitted
from imu_rig.errors import ImuRigError, InputError
from imu_rig.foreign_text import one_line, printable

if TYPE_CHECKING:
    from imu_rig.calibration.result import DeviceInfo
    from imu_rig.recording.reader import Trial

CERTIFICATE_SUFFIX = ".json"
ABOUT_FILE = ("file", "ended", "damage", "SHA-256")


def info(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Trial files and certificates.")
    ],
    as_json: Json = False,
) -> None:
    """Tell what files hold. With --json, each is an object on a line of its own."""
    worst: ImuRigError | None = None
    for number, file in enumerate(files):
        if number and not as_json:
            sys.stdout.write("\n")
        try:
            _tell(file, as_json=as_json)
        except ImuRigError as error:
            if len(files) == 1:
                raise
            worst = worst or error
            if as_json:
                answer = {"file": str(file), "error": str(error), "exit_code": error.exit_code}
                sys.stdout.write(json.dumps(answer) + "\n")
            sys.stderr.write(fitted(f"imu-rig: {error}") + "\n")
    if worst is not None:
        raise typer.Exit(worst.exit_code)


def _tell(file: Path, *, as_json: bool) -> None:
    from imu_rig.calibration.certificate import load_certificate
    from imu_rig.recording.reader import open_trial

    if file.suffix == CERTIFICATE_SUFFIX:
        write_page(file, load_certificate(file), as_json=as_json)
        return
    trial = open_trial(file)
    facts = _trial_facts(trial)
    if as_json:
        sys.stdout.write(json.dumps(facts, allow_nan=False) + "\n")
        return
    about_file = {name: facts.pop(name) for name in ABOUT_FILE}
    about_file["damage"] = about_file["damage"]["in all"]
    if trial.damage.records_lost or trial.damage.bytes_skipped:
        about_file["repair"] = f"imu-rig repair {shlex.quote(str(file))} saves what is sound"
    if "devices" in facts:
        from imu_rig.cli.recorded_trial import recorded_lines

        lines = [*_lines(about_file, 0), "", *recorded_lines(facts)]
    else:
        lines = _lines({**about_file, **facts}, 0)
    for line in lines:
        sys.stdout.write(line + "\n")


def _trial_facts(trial: Trial) -> dict[str, Any]:
    from imu_rig.cli.recorded_trial import is_recorded, recorded_facts
    from imu_rig.cli.sessions import damage_of
    from imu_rig.session.history import is_session, read_session

    damage = damage_of(trial)
    facts: dict[str, Any] = {
        "file": str(trial.path),
        "ended": trial.ended or _without_end(trial),
        "damage": {
            "records lost": damage.records_lost,
            "bytes skipped": damage.bytes_skipped,
            "bytes of a torn end": damage.tail_bytes,
            "records repeated": damage.records_repeated,
            "records out of order": damage.records_reordered,
            "header": "one of two copies damaged" if damage.header_damaged else "whole",
            "in all": str(damage),
        },
        "SHA-256": trial.sha256,
    }
    if is_recorded(trial):
        return {**facts, **recorded_facts(trial)}
    facts["sources"] = {name: _source_facts(trial, name) for name in trial.sources}
    if is_session(trial):
        session = read_session(trial)
        facts["session"] = {
            "sensor": f"{session.device} {session.serial}".strip(),
            "protocol": f"{session.protocol.name} ({session.protocol.title})",
            "jig": session.jig.name,
            "finished": f"{len(session.finished)} of {len(session.protocol.steps)} stops",
            "recoveries": session.recoveries,
            "notices": list(session.notices),
        }
    return facts


def _without_end(trial: Trial) -> str:
    from imu_rig.recording.storage import is_being_written

    if is_being_written(trial.path):
        return "not yet: it is being recorded"
    return "no end record: the recorder was killed or lost power"


def _source_facts(trial: Trial, name: str) -> dict[str, Any]:
    source = trial.sources[name]
    wire = trial.wire(name)
    facts: dict[str, Any] = {"kind": source.kind, "bytes received": len(wire.data)}
    if name in trial.imus:
        block, problem = trial.imu(name), trial.time_problem(name)
        if problem is not None:
            facts["wrong times"] = problem
        facts["samples"] = len(block)
        if len(block) > 1:
            span = float(block.t[-1] - block.t[0])
            facts["duration"] = f"{span:.2f} s"
            facts["rate"] = f"{(len(block) - 1) / span:.2f} Hz"
            if block.counter is not None:
                facts["lost"] = int(block.counter[-1] - block.counter[0]) + 1 - len(block)
    return facts


def _lines(facts: dict[str, Any], indent: int) -> list[str]:
    lines = []
    pad = "  " * indent
    for key, value in facts.items():
        key = printable(key)
        if isinstance(value, dict):
            lines += [f"{pad}{key}", *_lines(value, indent + 1)]
        elif isinstance(value, list):
            lines += [f"{pad}{key}: none"] if not value else [f"{pad}{key}"]
            lines += [f"{pad}  - {printable(str(item))}" for item in value]
        else:
            text = "-" if value is None else printable(str(value))
            lines.append(f"{pad}{key:{max(1, 26 - 2 * indent)}}{text}")
    return lines


def require_one_imu(trial: Trial, name: str | None) -> str:
    """Name of the trial's sensor: the one asked for, or the only one there is.

    Raises
    ------
    InputError
        If there is none by that name, or several to choose from.
    """
    sensors = trial.imus
    named = ", ".join(one_line(sensor) for sensor in sensors) or "none"
    if name is not None:
        if name not in sensors:
            raise InputError(f"{trial.path} has no sensor '{name}' (it has {named}).")
        return name
    if len(sensors) != 1:
        raise InputError(
            f"{trial.path} holds {len(sensors)} sensors ({named}): name one with --sensor."
        )
    return sensors[0]


def recorded_device(trial: Trial, name: str) -> DeviceInfo:
    """Return what a trial says of its sensor ``name``."""
    from imu_rig.calibration.result import DeviceInfo
    from imu_rig.session.history import IMU_SOURCE, is_session, read_session
    from imu_rig.session.recheck import device_of

    if is_session(trial) and name == IMU_SOURCE:
        return device_of(read_session(trial))
    layout = trial.source(name).descriptor.get("layout", {}).get("name", "")
    return DeviceInfo(name=name, layout=layout)
