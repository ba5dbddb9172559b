"""`imu-rig verify`: a sensor held against its certificate, on a jig or from a recording."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imu_rig.cli.hardware import (
    DEFAULT_BAUD,
    Baud,
    Hardware,
    ImuPort,
    JigFile,
    LayoutFile,
    MaestroCrc,
    MaestroDevice,
    MaestroPort,
    Seed,
    Simulate,
    Speed,
    StreamName,
)
from imu_rig.cli.options import (
    AccelColumns,
    AccelUnit,
    Columns,
    Gravity_,
    GyroColumns,
    GyroUnit,
    Height,
    Json,
    Latitude,
    MagUnit,
    MapFile,
    Quiet,
    Rate,
    SensorName,
    Serial,
    TimeColumn,
    TimeUnit,
    gravity_from,
    named,
)
from imu_rig.cli.recordings import TableOptions, open_if_trial, read_block
from imu_rig.errors import NOT_VERIFIED_EXIT, InputError

if TYPE_CHECKING:
    from imu_rig.calibration.certificate import Certificate
    from imu_rig.calibration.gravity import Gravity
    from imu_rig.calibration.recheck import Recheck
    from imu_rig.calibration.result import DeviceInfo
    from imu_rig.calibration.verification import Limits
    from imu_rig.recording.reader import Trial

TRIAL_NAME = "check.imu-trial"
REPORT_NAME = "check.html"


def verify(
    certificate: Annotated[Path, typer.Argument(help="The sensor's certificate.")],
    file: Annotated[
        Path | None,
        typer.Argument(help="A recording of it by hand or on a jig, in place of a new check."),
    ] = None,
    imu: ImuPort = None,
    maestro: MaestroPort = None,
    jig: JigFile = None,
    protocol: Annotated[
        str | None, typer.Option(help="Protocol of check poses: check (default) or a TOML file.")
    ] = None,
    layout: LayoutFile = None,
    stream: StreamName = None,
    baud: Baud = DEFAULT_BAUD,
    maestro_device: MaestroDevice = None,
    maestro_crc: MaestroCrc = False,
    simulate: Simulate = False,
    speed: Speed = 1.0,
    seed: Seed = 1,
    map_file: MapFile = None,
    columns: Columns = None,
    rate: Rate = None,
    accel: AccelColumns = None,
    gyro: GyroColumns = None,
    time: TimeColumn = None,
    accel_unit: AccelUnit = None,
    gyro_unit: GyroUnit = None,
    mag_unit: MagUnit = None,
    time_unit: TimeUnit = None,
    name: SensorName = "",
    serial: Serial = "",
    gravity: Gravity_ = None,
    latitude: Latitude = None,
    height: Height = None,
    limit_mg: Annotated[
        float | None, typer.Option(help="Largest error of gravity's size in a pose [mg].")
    ] = None,
    limit_deg: Annotated[
        float | None, typer.Option(help="Largest error of gravity's direction after a move [deg].")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Compare with the certificate of another device.")
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", parser=named, metavar="PATH", help="Folder for recording and report."
        ),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Check a sensor against its certificate: within limits, and what drifted.

    With ports (or --simulate) a jig takes it through nine poses in less than a minute; a FILE is
    any recording of it in which it was held still in several attitudes. Exit code 0: within
    limits; 7: beyond them, or not enough was measured to tell.
    """
    from imu_rig.calibration.certificate import load_certificate
    from imu_rig.cli import sessions

    certified = load_certificate(certificate)
    asked = gravity_from(gravity, latitude, height)
    hardware = Hardware(
        imu, maestro, jig, layout, baud, maestro_device, maestro_crc, simulate, seed, stream=stream
    )
    table = TableOptions(
        map_file, columns, rate, accel, gyro, time, accel_unit, gyro_unit, mag_unit, time_unit
    )
    wanted = _Wanted(certified, asked, limit_mg, limit_deg, name, serial, force=force)
    files: dict[str, str] = {}
    folder: Path | None = None
    if file is not None:
        if simulate or imu is not None or maestro is not None or protocol is not None:
            raise InputError(f"Give either {file} or hardware to check the sensor on, not both.")
        found = _of_file(file, table, wanted)
        if output is not None:
            folder = sessions.new_folder(output, (REPORT_NAME,))
        recording = file.name
    else:
        hardware.require_ports()
        hardware.require_one_kind()
        folder = sessions.new_folder(output, (TRIAL_NAME, REPORT_NAME))
        trial = folder / TRIAL_NAME
        found = _on_jig(hardware, protocol, wanted, trial, speed=speed, quiet=quiet)
        files["trial"] = str(trial)
        recording = TRIAL_NAME
    if folder is not None:
        from imu_rig.report.page import write_report
        from imu_rig.report.verification import verification_page

        page = verification_page(
            certified,
            found,
            certificate_file=certificate.name,
            recording=recording,
            date=datetime.now(UTC),
        )
        write_report(folder / REPORT_NAME, page)
        files["report"] = str(folder / REPORT_NAME)
    _show(found, files, as_json=as_json)
    if not found.verification.passed:
        raise typer.Exit(NOT_VERIFIED_EXIT)


class _Wanted:
    """What a sensor is to be held against, and whether it is the right one."""

    def __init__(
        self,
        certificate: Certificate,
        gravity: Gravity,
        limit_mg: float | None,
        limit_deg: float | None,
        name: str,
        serial: str,
        *,
        force: bool,
    ) -> None:
        self.certificate, self.gravity = certificate, gravity
        self.name, self.serial = name, serial
        self._limits = (limit_mg, limit_deg)
        self._force = force
        if any(limit is not None and not 0 < limit < 1000 for limit in self._limits):
            raise InputError("--limit-mg and --limit-deg must be above 0 and below 1000.")

    def limits(self, stated: Limits) -> Limits:
        """Return limits with those of the options in place of ``stated`` ones."""
        from imu_rig.units import DEG, MILLI_G

        mg, deg = self._limits
        if mg is not None:
            stated = replace(stated, accel=mg * MILLI_G)
        return stated if deg is None else replace(stated, turn=deg * DEG)

    def told_of(self, digest: str, found: Recheck) -> Recheck:
        """Add a word where the recording is the very one that the certificate was made from."""
        recording = self.certificate.recording
        if recording is None or recording.sha256 != digest:
            return found
        note = (
            "This is the recording that the certificate was made from, so it proves nothing: "
            "check the sensor by a new one."
        )
        return replace(found, notes=(note, *found.notes))

    def require_same_device(self, device: DeviceInfo) -> None:
        """Refuse a sensor that the certificate is not of, unless that was asked for."""
        from imu_rig.calibration.recheck import other_device
        from imu_rig.calibration.result import DeviceInfo

        stated = DeviceInfo(self.name or device.name, self.serial or device.serial, device.layout)
        difference = other_device(self.certificate.device, stated)
        if difference is None:
            return
        if not self._force:
            raise InputError(
                f"{difference[0].upper()}{difference[1:]}; take its own certificate, or --force "
                "to compare all the same."
            )
        sys.stderr.write(f"Compared all the same: {difference}.\n")


def _of_file(file: Path, table: TableOptions, wanted: _Wanted) -> Recheck:
    from imu_rig.calibration.recheck import recheck
    from imu_rig.calibration.result import DeviceInfo
    from imu_rig.calibration.verification import Limits
    from imu_rig.session.history import is_session

    trial = open_if_trial(file, table)
    if trial is not None and is_session(trial):
        return wanted.told_of(trial.sha256, _of_session(trial, wanted))
    if trial is not None:
        from imu_rig.cli.info import recorded_device, require_one_imu

        sensor = require_one_imu(trial, None)
        wanted.require_same_device(recorded_device(trial, sensor))
        block, digest = trial.imu_in_time(sensor), trial.sha256
    else:
        wanted.require_same_device(DeviceInfo())
        block, digest = read_block(file, table)
    found = recheck(
        wanted.certificate, block, limits=wanted.limits(Limits()), gravity=wanted.gravity
    )
    return wanted.told_of(digest, found)


def _of_session(trial: Trial, wanted: _Wanted) -> Recheck:
    from imu_rig.session.history import read_session
    from imu_rig.session.recheck import device_of, recheck_session
    from imu_rig.session.solve import limits_of

    session = read_session(trial)
    wanted.require_same_device(device_of(session))
    return recheck_session(
        trial,
        session,
        wanted.certificate,
        limits=wanted.limits(limits_of(session.protocol.limits)),
        gravity=wanted.gravity,
    )


def _on_jig(
    hardware: Hardware,
    protocol: str | None,
    wanted: _Wanted,
    trial: Path,
    *,
    speed: float,
    quiet: bool,
) -> Recheck:
    from contextlib import ExitStack

    from imu_rig.cli import sessions
    from imu_rig.clock import Clock, SystemClock
    from imu_rig.recording.reader import open_trial
    from imu_rig.session.protocol import CHECK_PROTOCOL, load_protocol

    device = wanted.certificate.device
    setup = hardware.setup(
        load_protocol(protocol or CHECK_PROTOCOL),
        wanted.name or device.name or "imu",
        wanted.serial or device.serial,
    )
    setup.plan()
    from imu_rig.calibration.result import DeviceInfo

    wanted.require_same_device(DeviceInfo(setup.device, setup.serial, setup.layout.name))
    with ExitStack() as stack:
        clock: Clock = SystemClock()
        simulated = None
        if hardware.simulate:
            from imu_rig.cli.simulated import simulated_session

            simulated = stack.enter_context(
                simulated_session(setup, seed=hardware.seed, speed=speed)
            )
            clock, setup = simulated.clock, simulated.setup
        sessions.run_in_view(
            setup,
            trial,
            clock,
            resume=False,
            quiet=quiet,
            ports=hardware.options,
            hands=simulated,
        )
    return _of_session(open_trial(trial), wanted)


def _show(found: Recheck, files: dict[str, str], *, as_json: bool) -> None:
    if as_json:
        from imu_rig.calibration.certificate_parts import VerificationEntry

        entry = VerificationEntry.of(found.verification)
        content = {
            "passed": found.verification.passed,
            "verification": None if entry is None else entry.model_dump(mode="json"),
            "drift": [
                {**asdict(row), "drifted": row.drifted, "usual": row.usual} for row in found.drift
            ],
            "notes": list(found.notes),
            "files": files,
        }
        sys.stdout.write(json.dumps(content, allow_nan=False) + "\n")
        return
    for line in recheck_lines(found, reported="report" in files):
        sys.stdout.write(line + "\n")
    for kind, path in files.items():
        sys.stdout.write(f"  {kind:12}{path}\n")


def recheck_lines(found: Recheck, *, reported: bool) -> list[str]:
    """Lines that tell how a sensor does against its certificate."""
    from imu_rig.calibration.recheck import UNITS
    from imu_rig.cli.summary import paragraph, verification_lines

    lines = verification_lines(found.verification, reported=reported)
    if found.drift:
        lines += [
            "",
            f"  {'':25}{'certificate':>11}{'change':>9}{'std. dev.':>10}{'ratio':>7}{'usual':>7}",
        ]
    for row in found.drift:
        unit, name = UNITS[row.sensor, row.quantity]
        label = f"  {row.name + f' [{name}]':26}"
        if not row.determined:
            lines.append(f"{label}{row.certified / unit:>10.3f}  not determined by this check")
            continue
        mark = "" if not row.drifted else "  drifted" if row.usual else "  DRIFTED"
        lines.append(
            f"{label}{row.certified / unit:>10.3f}{row.change / unit:>+9.3f}"
            f"{row.sigma / unit:>10.3f}{row.sigmas:>7.1f}{row.day_to_day / unit:>7.2f}{mark}"
        )
    for note in found.notes:
        lines += ["", *paragraph(note, mark="! ")]
    return [*lines, ""]
