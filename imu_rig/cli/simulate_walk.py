"""`imu-rig simulate walk`: devices that a person carries, on real ports or at once in a file."""

from __future__ import annotations

import json
import shlex
import sys
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imu_rig.cli.options import Json
from imu_rig.errors import InputError
from imu_rig.foreign_text import one_line

if TYPE_CHECKING:
    from simulators.walker.device import Carried
    from simulators.walker.record import UnitRecord
    from simulators.walker.walker import Walker

DEFAULT_SCENARIO = "straight-50m"
DEFAULT_DEVICES = ("left-foot=mpu9150", "waist=waist-unit")
MOST_DEVICES = 16


@dataclass(frozen=True)
class _Wanted:
    """What the options ask for."""

    walker: Walker
    devices: list[Carried]
    seed: int
    truth: Path | None
    as_json: bool


def walk(
    scenario: Annotated[str, typer.Argument(help="Name of a walk; --list names them all.")] = (
        DEFAULT_SCENARIO
    ),
    device: Annotated[
        list[str] | None,
        typer.Option(
            "--device",
            metavar="NAME=KIND[@PLACE]",
            help="A device and where it is worn: left-foot, right-foot or waist. Several times for "
            "several. KIND is that of the device or its layout. Default: "
            f"{' and '.join(DEFAULT_DEVICES)}.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Which person, building and devices.")] = 1,
    truth: Annotated[
        Path | None,
        typer.Option("--truth", help="CSV file for the truth; strides and turns go beside it."),
    ] = None,
    trial: Annotated[
        Path | None,
        typer.Option("--trial", help="Write a trial file at once, without ports and waiting."),
    ] = None,
    speed: Annotated[
        float, typer.Option("--speed", min=0.1, max=20.0, help="How fast time runs on the ports.")
    ] = 1.0,
    no_wait: Annotated[
        bool, typer.Option("--no-wait", help="Walk at once, not only when all ports are open.")
    ] = False,
    once: Annotated[
        bool, typer.Option("--once", help="End when the walk is over, not at Ctrl-C.")
    ] = False,
    tcp: Annotated[
        bool, typer.Option("--tcp", help="TCP ports (socket://) in place of pseudo-terminals.")
    ] = sys.platform == "win32",
    listed: Annotated[bool, typer.Option("--list", help="Name the walks, and end.")] = False,
    as_json: Json = False,
) -> None:
    """Let a person walk with devices on feet and waist; the truth of it is known exactly."""
    if listed:
        _list(as_json)
        return
    from simulators.walker.record import check_names
    from simulators.walker.walker import Walker

    try:
        devices = [_device(text) for text in device or DEFAULT_DEVICES]
        check_names(devices)
        wanted = _Wanted(Walker(scenario, seed), devices, seed, truth, as_json)
    except ValueError as error:
        raise InputError(f"simulate walk: {error}") from error
    if len(devices) > MOST_DEVICES:
        raise InputError(f"simulate walk: nobody carries more than {MOST_DEVICES} devices.")
    _check_files(wanted, trial)
    if trial is not None:
        _write_trial(wanted, trial)
    else:
        _serve(wanted, speed, waits=not no_wait, once=once, tcp=tcp)


def _check_files(wanted: _Wanted, trial: Path | None) -> None:
    """Refuse names that cannot be written to, before anybody walks."""
    from imu_rig.files import require_new
    from simulators.walker.truth import WHAT, truth_files

    if trial is not None:
        require_new(trial, what="a trial")
    if wanted.truth is None:
        return
    for file in truth_files(wanted.truth, wanted.walker).values():
        require_new(file, what=WHAT)
        if trial is not None and file.absolute() == trial.absolute():
            raise InputError(f"simulate walk: {file} cannot be both trial and truth.")


def _list(as_json: bool) -> None:
    from simulators.walker.scenarios import SCENARIOS

    if as_json:
        sys.stdout.write(json.dumps({s.name: s.title for s in SCENARIOS.values()}) + "\n")
        return
    width = max(map(len, SCENARIOS))
    for scenario in SCENARIOS.values():
        sys.stdout.write(f"{scenario.name:<{width}}  {scenario.title}\n")


def _device(text: str) -> Carried:
    """Read NAME=KIND[@PLACE]; raises ValueError with a sentence."""
    from simulators.imu_kinds import kind_of
    from simulators.walker.device import Carried

    name, equals, rest = text.partition("=")
    kind, at, place = rest.partition("@")
    if not (name and equals and kind) or (at and not place):
        raise ValueError(
            f"--device {one_line(text, 60)!r} is not NAME=KIND[@PLACE], "
            "as in foot=mpu9150@left-foot."
        )
    name, kind, place = (one_line(part.strip(), 40) for part in (name, kind, place))
    carried = Carried(name, kind_of(kind), place or None)
    carried.worn_at()
    return carried


def _serve(wanted: _Wanted, speed: float, *, waits: bool, once: bool, tcp: bool) -> None:
    from imu_rig.cli.signals import stop_on_signals
    from imu_rig.cli.status_line import StatusLine
    from imu_rig.clock import ScaledClock, SystemClock
    from imu_rig.stopping import StopRequest
    from simulators.walker.served import SimulatedWalk

    stop, pause, line = StopRequest(), threading.Event(), StatusLine()
    clock = SystemClock() if speed == 1.0 else ScaledClock(speed)
    with (
        stop_on_signals(stop),
        SimulatedWalk(
            wanted.walker,
            wanted.devices,
            seed=wanted.seed,
            clock=clock,
            transport="tcp" if tcp else "pty",
            waits=waits,
        ) as simulated,
    ):
        _tell_ports(wanted, simulated.ports(), simulated.protocols(), waits=waits)
        while stop.cause is None and not (once and simulated.wait(0)):
            line.show(_how_far(simulated.t_s, wanted.walker.end_s))
            pause.wait(0.1)
        line.close()
        if wanted.truth is not None:
            _write_truth(wanted, simulated.units())


def _how_far(t_s: float | None, end_s: float) -> str:
    if t_s is None:
        return "Standing until every port is open."
    if t_s > end_s:
        return "The walk is over; the person stands until Ctrl-C."
    return f"Walking: {t_s:.0f} of {end_s:.0f} s."


def _tell_ports(
    wanted: _Wanted, ports: dict[str, str], protocols: dict[str, str], *, waits: bool
) -> None:
    if wanted.as_json:
        told = {name: {"port": url, "layout": protocols[name]} for name, url in ports.items()}
        sys.stdout.write(json.dumps(told) + "\n")
        sys.stdout.flush()
        return
    width = max(map(len, ports))
    lines = [f"{name:<{width}}  {url}  {protocols[name]}" for name, url in ports.items()]
    begins = "It begins when all ports are open." if waits else "It begins now."
    options = [
        "--device " + shlex.quote(f"{name}={url},layout={protocols[name]}")
        for name, url in ports.items()
    ]
    lines += [
        "",
        "In another terminal, for example:",
        f"  imu-rig record {' '.join(options)}",
        "",
        f"{wanted.walker.scenario.title}: {wanted.walker.end_s:.0f} s.",
        f"{begins} Ctrl-C ends it.",
    ]
    sys.stdout.write("\n".join(lines) + "\n")
    sys.stdout.flush()


def _write_trial(wanted: _Wanted, path: Path) -> None:
    from imu_rig.cli.walk_trial import introduce, write_walk
    from imu_rig.cli.working import Working
    from simulators.walker.record import record_walk

    name = wanted.walker.scenario.name
    with Working(f"Walking {name}") as working:
        records = record_walk(wanted.walker, wanted.devices, wanted.seed, introduce=introduce)
        working.now(f"Writing {path}")
        write_walk(path, f"Simulated walk {name}, seed {wanted.seed}", records)
    told: dict[str, Any] = {
        "trial": str(path),
        "duration_s": wanted.walker.end_s,
        "devices": {
            name: {"layout": record.protocol, "samples": len(record.units[0])}
            for name, record in records.items()
        },
    }
    if wanted.truth is not None:
        _write_truth(wanted, [unit for record in records.values() for unit in record.units])
    if wanted.as_json:
        sys.stdout.write(json.dumps(told) + "\n")
    else:
        sys.stdout.write(f"{path}: {wanted.walker.end_s:.0f} s of {', '.join(records)}.\n")


def _write_truth(wanted: _Wanted, units: Iterable[UnitRecord]) -> None:
    from simulators.walker.truth import write_truth

    assert wanted.truth is not None
    written = write_truth(wanted.truth, wanted.walker, units)
    _talk(f"The truth is in {', '.join(map(str, written))}.")


def _talk(text: str) -> None:
    sys.stderr.write(text + "\n")
    sys.stderr.flush()
