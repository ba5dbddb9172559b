"""`imu-rig replay`: the devices of a recording on real ports, for any program to open."""

from __future__ import annotations

import contextlib
import json
import math
import queue
import shlex
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imu_rig.cli.options import Quiet
from imu_rig.cli.status_line import StatusLine
from imu_rig.cli.words import clock, size
from imu_rig.errors import InputError

if TYPE_CHECKING:
    from imu_rig.recording.contents import Source
    from imu_rig.recording.reader import Trial
    from imu_rig.recording.replay import RecordedWires
    from imu_rig.stopping import StopRequest
    from simulators.replay import Replay, ReplayStatus

LOOK_S = 0.02
STOPPED_EXIT = 130
FASTEST = 1000.0
MOST_SHOWN = 6  # sources with figures of their own
NAME_WIDTH = 16

STEP_HELP = "Enter sends the next piece, a number of seconds and Enter all until then, q ends."


def replay(
    file: Annotated[Path, typer.Argument(help="A trial file.")],
    source: Annotated[
        list[str] | None,
        typer.Option("--source", "-s", help="Which device; all by default. Repeat for several."),
    ] = None,
    tcp: Annotated[
        bool, typer.Option("--tcp", help="TCP ports (socket://) in place of pseudo-terminals.")
    ] = sys.platform == "win32",
    speed: Annotated[float, typer.Option("--speed", help="Times as fast as recorded.")] = 1.0,
    fast: Annotated[bool, typer.Option("--fast", help="As fast as the programs read.")] = False,
    step: Annotated[bool, typer.Option("--step", help=f"By hand: {STEP_HELP}")] = False,
    no_wait: Annotated[
        bool,
        typer.Option(
            "--no-wait",
            help="Begin at once; what no program reads is lost, as of a real device.",
        ),
    ] = False,
    loop: Annotated[bool, typer.Option("--loop", help="Begin anew at the end.")] = False,
    unplug: Annotated[
        bool,
        typer.Option("--unplug-in-gaps", help="Take a port away where the trial was unplugged."),
    ] = False,
    folder: Annotated[
        Path | None,
        typer.Option("--folder", help="Where the pseudo-terminals' names go, to stay the same."),
    ] = None,
    longest_silence: Annotated[
        float, typer.Option("--longest-silence", help="Shorten longer ones to this [s].")
    ] = 600.0,
    quiet: Quiet = False,
    as_json: Annotated[
        bool,
        typer.Option("--json", help="Ports first and the result last, a JSON object each."),
    ] = False,
) -> None:
    """Put the devices of a trial on ports again, byte for byte and in time.

    It begins when every port has been opened, and ends by taking the ports away.
    """
    from imu_rig.cli.sessions import warn_of_damage
    from imu_rig.cli.signals import stop_on_signals
    from imu_rig.cli.working import Working
    from imu_rig.clock import SteppedClock, SystemClock
    from imu_rig.recording.reader import open_trial
    from imu_rig.recording.replay import RecordedWires
    from imu_rig.stopping import StopRequest
    from imu_rig.testing import FAST, replay_of

    _check(speed, longest_silence, fast=fast, step=step)
    folder = folder and folder.absolute()
    with contextlib.ExitStack() as stack:
        with Working(f"Reading {file}"):
            trial = open_trial(file)
            wires = RecordedWires(trial, source or (), longest_silence_s=longest_silence)
        warn_of_damage(trial)
        for note in wires.notes:
            _say(note)
        stop = StopRequest()
        stack.enter_context(stop_on_signals(stop))
        player = stack.enter_context(
            replay_of(
                wires,
                speed=FAST if fast else speed,
                clock=SteppedClock() if step else SystemClock(),
                transport="tcp" if tcp else "pty",
                wait=not no_wait,
                loop=loop,
                unplug_in_gaps=unplug,
                folder=folder,
            )
        )
        layouts = stack.enter_context(_layout_files(wires, folder))
        _introduce(trial, wires, player.ports(), layouts, waits=not no_wait, as_json=as_json)
        view = _Progress(wires, quiet=quiet)
        if step:
            _step_by_hand(player, stop, view)
        else:
            while stop.cause is None and not player.wait(LOOK_S):
                view.show(player.status)
        status = player.status
        view.close()
    _conclude(status, as_json=as_json)
    if status.state != "ended" and not loop:
        raise typer.Exit(STOPPED_EXIT)


def _check(speed: float, longest_silence: float, *, fast: bool, step: bool) -> None:
    if not 0 < speed <= FASTEST:
        raise InputError(
            f"--speed must be above 0 and at most {FASTEST:g}, not {speed:g}; --fast goes as fast "
            "as the programs read."
        )
    if sum((fast, step, speed != 1.0)) > 1:
        raise InputError("Give only one of --speed, --fast and --step.")
    if not (math.isfinite(longest_silence) and longest_silence > 0):
        raise InputError(f"--longest-silence {longest_silence:g} is no number of seconds above 0.")


# --- what to open, and with what -------------------------------------------------------------


@contextlib.contextmanager
def _layout_files(wires: RecordedWires, folder: Path | None) -> Iterator[dict[str, str]]:
    """Yield the word by which `imu-rig record` finds each source's layout, by source.

    A layout that is not built in is written to a file, in the ports' folder where one was named.
    """
    from firmware_protocols.known import builtin_protocols, protocol_from_dict
    from firmware_protocols.layout import LayoutError

    builtin = {name: layout.to_dict() for name, layout in builtin_protocols().items()}
    words: dict[str, str] = {}
    with contextlib.ExitStack() as stack:
        for number, source in enumerate(wires.sources, 1):
            values = source.descriptor.get("layout")
            if not isinstance(values, dict):
                continue
            try:
                layout = protocol_from_dict(values)
            except LayoutError:
                continue
            name = next((n for n, known in builtin.items() if known == layout.to_dict()), None)
            if name is None:
                if folder is None:
                    made = tempfile.TemporaryDirectory(prefix="imu-rig-")
                    folder = Path(stack.enter_context(made))
                path = folder / f"layout-{number}.toml"
                path.write_text(layout.to_toml(), encoding="utf-8")
                stack.callback(path.unlink, missing_ok=True)
                name = str(path)
            words[source.name] = name
        yield words


def _record_command(
    sources: Sequence[Source], ports: dict[str, str], layouts: dict[str, str]
) -> list[str]:
    """Return the words of an `imu-rig record` that reads these ports."""
    words = ["imu-rig", "record"]
    jigs = [source for source in sources if source.kind == "servo"]
    for number, source in enumerate(sources, 1):
        if source.name in layouts:
            name = source.name
            if any(c in name for c in ",=") or not name.isprintable() or name[0] in "./":
                name = f"device {number}"
            words += ["--device", f"{name}={ports[source.name]},layout={layouts[source.name]}"]
    if len(jigs) == 1:
        words += ["--maestro", ports[jigs[0].name]]
    return words if len(words) > 2 else []


def _introduce(
    trial: Trial,
    wires: RecordedWires,
    ports: dict[str, str],
    layouts: dict[str, str],
    *,
    waits: bool,
    as_json: bool,
) -> None:
    """Print what to open."""
    from imu_rig.foreign_text import one_line
    from imu_rig.session.history import IMU_SOURCE, MAESTRO_SOURCE, is_session

    duration_s = wires.duration_ns / 1e9
    record = _record_command(wires.sources, ports, layouts)
    if as_json:
        answer = {
            "trial": str(trial.path),
            "duration_s": duration_s,
            "ports": ports,
            "layouts": layouts,
            "answering": list(wires.answering),
            "record": record,
        }
        sys.stdout.write(json.dumps(answer, allow_nan=False) + "\n")
        sys.stdout.flush()
        return
    names = {source.name: one_line(source.name) for source in wires.sources}
    width = max(len(name) for name in names.values())
    for source in wires.sources:
        what = layouts.get(source.name)
        tail = f"   layout {what}" if what else "   answers requests as recorded"
        if not what and source.name not in wires.answering:
            tail = "   bytes of no known layout"
        sys.stdout.write(f"{names[source.name]:{width}}   {ports[source.name]}{tail}\n")
    commands = [shlex.join(record)] if record else []
    if is_session(trial) and {IMU_SOURCE, MAESTRO_SOURCE} <= set(ports):
        commands.append(
            f"imu-rig calibrate --imu {shlex.quote(ports[IMU_SOURCE])} "
            f"--maestro {shlex.quote(ports[MAESTRO_SOURCE])}"
        )
    every = "the port is" if len(ports) == 1 else f"all {len(ports)} ports are"
    fewer = "" if len(ports) == 1 else " (fewer: --source)"
    begins = f"It begins when {every} open{fewer}." if waits else "It begins now."
    if commands:
        sys.stdout.write("\nIn another terminal, for example:\n")
        for command in commands:
            sys.stdout.write(f"  {one_line(command, 4000)}\n")
    sys.stdout.write(f"\n{clock(duration_s, 1)} to replay. {begins} Ctrl-C ends it.\n")
    sys.stdout.flush()


# --- while it runs ---------------------------------------------------------------------------


def _step_by_hand(player: Replay, stop: StopRequest, view: _Progress) -> None:
    """Serve the ports and move on by what is typed, until the end, q or a signal."""
    from imu_rig.foreign_text import one_line

    lines: queue.Queue[str | None] = queue.Queue()
    threading.Thread(target=_read_lines, args=(lines,), name="stdin", daemon=True).start()
    _say(STEP_HELP)
    while stop.cause is None and player.status.state != "ended":
        if player.status.state == "waiting":
            player.wait_for_clients(0)
        else:
            player.step(0)
        try:
            line = lines.get(timeout=LOOK_S)
        except queue.Empty:
            view.show(player.status)
            continue
        if line is None or line.strip().lower() in ("q", "quit"):
            return
        seconds = _seconds(line)
        absent = player.status.without_client
        if player.status.state == "waiting" and absent:
            _say(f"Nobody has opened the port of {', '.join(map(one_line, absent))} yet.")
        elif seconds is None:
            _say(STEP_HELP)
        elif line.strip():
            player.step(seconds)
        else:
            player.step_to_next()
        view.show(player.status, now=True)


def _read_lines(lines: queue.Queue[str | None]) -> None:
    with contextlib.suppress(OSError, ValueError):
        for line in sys.stdin:
            lines.put(line)
    lines.put(None)


def _seconds(line: str) -> float | None:
    """Seconds that a line asks for, 0 for an empty one, None for what is no number."""
    try:
        seconds = float(line.strip().removesuffix("s") or 0)
    except ValueError:
        return None
    return seconds if math.isfinite(seconds) and seconds >= 0 else None


class _Progress:
    """How far a replay is, on stderr; what it waits for is told at once."""

    def __init__(self, wires: RecordedWires, *, quiet: bool) -> None:
        self._duration_s = wires.duration_ns / 1e9
        self._line = StatusLine(quiet=quiet)
        self._told: tuple[str, tuple[str, ...]] = ("waiting", ())

    def show(self, status: ReplayStatus, *, now: bool = False) -> None:
        state = status.state, tuple(status.without_client)
        # a replay that is held up now and then fills no log
        told = state == self._told or "waiting" not in (status.state, self._told[0])
        self._line.show(_line(status, self._duration_s), now=now or not told)
        self._told = state

    def close(self) -> None:
        self._line.close()


def _line(status: ReplayStatus, duration_s: float) -> str:
    """One line: where it is, what was sent, and what it waits for."""
    from imu_rig.foreign_text import one_line

    def listed(names: Sequence[str]) -> str:
        shown = [one_line(name, NAME_WIDTH) for name in names[:MOST_SHOWN]]
        more = len(names) - len(shown)
        return ", ".join(shown) + (f" and {more} more" if more else "")

    absent = listed(status.without_client)
    if status.state == "waiting":
        return f"waiting for somebody to open {absent}" if absent else "every port is open"
    loops = f" in round {status.loops + 1}" if status.loops else ""
    line = f"{clock(status.t_s, 1)} of {clock(duration_s, 1)}{loops}"
    sent = [
        f"{one_line(name, NAME_WIDTH)} {size(count)}"
        for name, count in list(status.sent.items())[:MOST_SHOWN]
    ]
    if len(status.sent) > MOST_SHOWN:
        sent = [f"{size(sum(status.sent.values()))} sent to {len(status.sent)} ports"]
    line += "  " + "  ".join(sent)
    if status.state == "ending":
        line += "  everything sent, until it is read"
    elif status.state == "held":
        line += f"  waiting for {absent or 'a program that is behind'}"
    elif status.without_client:
        line += f"  nobody reads {absent}"
    return line


def _conclude(status: ReplayStatus, *, as_json: bool) -> None:
    from imu_rig.foreign_text import one_line

    lost = {name: count for name, count in status.lost.items() if count}
    if lost:
        names = ", ".join(repr(one_line(name)) for name in list(lost)[:MOST_SHOWN])
        more = f" and {len(lost) - MOST_SHOWN} more" if len(lost) > MOST_SHOWN else ""
        _say(f"{size(sum(lost.values()))} of {names}{more} were lost: nobody had the port open.")
    if as_json:
        answer = {
            "state": status.state,
            "t_s": status.t_s,
            "rounds": status.loops + 1,
            "sent": status.sent,
            "lost": status.lost,
        }
        sys.stdout.write(json.dumps(answer, allow_nan=False) + "\n")
        return
    word = "Replayed to the end" if status.state == "ended" else f"Ended at {clock(status.t_s, 1)}"
    sys.stdout.write(f"{word}: {size(sum(status.sent.values()))} sent.\n")


def _say(sentence: str) -> None:
    sys.stderr.write(sentence + "\n")
    sys.stderr.flush()
