"""What `demo` and `calibrate` share: run a session, solve it, write certificate and report."""

from __future__ import annotations

import os
import shlex
import sys
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from imu_rig.cli.hands import TerminalHands
from imu_rig.cli.live import SessionView
from imu_rig.cli.signals import stop_on_signals
from imu_rig.cli.summary import json_text, result_lines
from imu_rig.errors import AnotherSensor, InputError, SessionStopped, reason_of
from imu_rig.session.progress import Hands, Progress, ignore
from imu_rig.stopping import StopRequest

if TYPE_CHECKING:
    from imu_rig.calibration.certificate import Certificate
    from imu_rig.calibration.gravity import Gravity
    from imu_rig.calibration.result import CalibrationResult
    from imu_rig.clock import Clock
    from imu_rig.recording.reader import Trial
    from imu_rig.recording.scan import Damage
    from imu_rig.report.facts import Truth
    from imu_rig.session.run import SessionSetup

TRIAL_NAME = "session.imu-trial"
CERTIFICATE_NAME = "certificate.json"
REPORT_NAME = "report.html"


def new_folder(
    output: Path | None, names: tuple[str, ...] = (TRIAL_NAME, CERTIFICATE_NAME, REPORT_NAME)
) -> Path:
    """Make the folder of a session; one named by date and time where none was asked for.

    Raises
    ------
    InputError
        If the folder holds a file of one of ``names`` already, or cannot be made.
    """
    folder = output or Path(f"imu-rig-{datetime.now().astimezone():%Y-%m-%d-%H%M%S}")
    try:
        for name in names:
            if os.path.lexists(folder / name):
                raise InputError(
                    f"{folder / name} exists already and is never overwritten: name another "
                    "--output."
                )
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise InputError(
            f"The folder {folder} cannot be made ({reason_of(error)}): name another --output."
        ) from error
    return folder


def run_in_view(
    setup: SessionSetup,
    trial: Path,
    clock: Clock,
    *,
    resume: bool,
    quiet: bool,
    ports: str,
    watch: Callable[[Progress], None] = ignore,
    hands: Hands | None = None,
    ask: bool = True,
    opening: Sequence[str] = (),
) -> None:
    """Run a session with its live view; signals park the jig and close the file.

    ``opening`` are lines to show once the devices answer, so that no mistake comes after them.

    ``ports`` are the options by which a stopped session finds its hardware again. ``hands`` turn
    the sensor over where its mounting changes; by default a person at the terminal is asked,
    unless ``ask`` says not to.

    Raises
    ------
    SessionStopped
        With the words to resume by, if anything of the session can be kept.
    """
    from imu_rig.session.run import run_session

    stop = StopRequest()
    view = SessionView(quiet=quiet)
    untold = deque(opening)

    def observe(progress: Progress) -> None:
        while untold and progress.state != "connecting":
            view.notify(untold.popleft())
        watch(progress)
        view.observe(progress)

    try:
        with view, stop_on_signals(stop, view.notify), _removed_if_empty(trial.parent):
            run_session(
                setup,
                trial,
                clock,
                resume=resume,
                stop=stop,
                hands=hands or (TerminalHands(view.notify) if ask else None),
                observe=observe,
                notify=view.notify,
            )
    except AnotherSensor:
        raise  # how to go on would be how to go on with the wrong one
    except SessionStopped as error:
        raise type(error)(f"{error} {_what_next(trial, ports)}") from error


def _what_next(trial: Path, ports: str) -> str:
    from imu_rig.recording.reader import open_trial
    from imu_rig.session.history import read_session

    session = read_session(open_trial(trial))
    if session.protocol.only_checks:
        return "A check takes less than a minute, so begin it anew."
    if not session.visits:
        return f"No pose was finished, so begin anew; what was received is kept in {trial}."
    return (
        f"{len(session.finished)} of {len(session.protocol.steps)} stops are kept in {trial}; go "
        f"on with: imu-rig calibrate --resume {shlex.quote(str(trial))} {ports}"
    )


@contextmanager
def _removed_if_empty(folder: Path) -> Iterator[None]:
    """Remove a session's folder in which nothing was begun."""
    try:
        yield
    finally:
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()


def damage_of(trial: Trial) -> Damage:
    """Return what a trial file has lost; the record that is being written now is not lost."""
    from imu_rig.recording.storage import is_being_written

    if trial.damage.tail_bytes and trial.ended is None and is_being_written(trial.path):
        return replace(trial.damage, tail_bytes=0)
    return trial.damage


def warn_of_damage(trial: Trial) -> None:
    """Say on stderr what a trial file has lost, and that more of it may come."""
    damage = damage_of(trial)
    if damage:
        sys.stderr.write(f"{trial.path} is damaged: {damage}.\n")
    if trial.ended is None:
        sys.stderr.write(
            f"{trial.path} has no end record: it is being recorded, or was cut off. What it holds "
            "now is taken.\n"
        )


def finish(
    trial: Path,
    folder: Path,
    *,
    method: str,
    gravity: Gravity,
    as_json: bool,
    truth: Truth | None = None,
) -> None:
    """Solve a finished session, write its certificate and report, and print the figures."""
    from imu_rig.calibration.certificate import certificate_of
    from imu_rig.recording.reader import open_trial
    from imu_rig.session.solve import solve_session

    opened = open_trial(trial)
    result = solve_session(opened, method=method, gravity=gravity)
    certificate = certificate_of(result, recording=(trial.name, opened.sha256))
    files = write_results(folder, result, certificate, trial=opened, truth=truth)
    show(result, certificate, {"trial": str(trial), **files}, as_json=as_json, truth=truth)


def write_results(
    folder: Path,
    result: CalibrationResult,
    certificate: Certificate,
    *,
    trial: Trial | None = None,
    truth: Truth | None = None,
) -> dict[str, str]:
    """Write certificate and report into ``folder`` and return their paths by name."""
    from imu_rig.cli.session_summary import session_summary
    from imu_rig.report.calibration import calibration_report, write_report
    from imu_rig.session.history import is_session

    certificate_path, report_path = folder / CERTIFICATE_NAME, folder / REPORT_NAME
    certificate.save(certificate_path)
    summary = session_summary(trial) if trial is not None and is_session(trial) else None
    html = calibration_report(
        result,
        certificate=certificate,
        session=summary,
        truth=truth,
        certificate_file=CERTIFICATE_NAME,
    )
    write_report(report_path, html)
    return {"certificate": str(certificate_path), "report": str(report_path)}


def show(
    result: CalibrationResult,
    certificate: Certificate,
    files: Mapping[str, str],
    *,
    as_json: bool,
    truth: Truth | None = None,
) -> None:
    """Print a result on stdout, as text or as one JSON object."""
    if as_json:
        sys.stdout.write(json_text(certificate, files, truth) + "\n")
        return
    for line in result_lines(result, truth, reported="report" in files):
        sys.stdout.write(line + "\n")
    if files:
        sys.stdout.write("\n")
    for name, path in files.items():
        sys.stdout.write(f"  {name:12}{path}\n")
