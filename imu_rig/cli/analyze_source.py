"""Recordings of walks: which of their sensors are on feet, and calibrated by what."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from imu_rig.cli.recordings import TableOptions, digest_of, open_if_trial
from imu_rig.errors import DataError, InputError
from imu_rig.foreign_text import one_line

if TYPE_CHECKING:
    from imu_rig.blocks import ImuBlock
    from imu_rig.calibration.certificate import Certificate
    from imu_rig.recording.reader import Trial
    from imu_rig.reference.reference import Reference

ON_A_FOOT = re.compile(r"foot|feet|shoe|boot|instep|ankle|heel|toe", re.IGNORECASE)
NOT_ON_A_FOOT = re.compile(r"waist|hip|back|belt|chest|head|wrist|hand|thigh", re.IGNORECASE)
SIDE = re.compile(r"left|right", re.IGNORECASE)
MOST_FEET = 2


@dataclass(frozen=True)
class Calibrating:
    """What the options say about certificates; see `imu_rig.cli.analyze_options`."""

    files: tuple[str, ...] = ()
    raw: bool = False
    any_device: bool = False

    def check(self) -> None:
        """Refuse contradictions before anything is read."""
        if self.raw and self.files:
            raise InputError("Give either --raw or --certificate, not both.")

    def file_for(self, sensor: str, among: Sequence[str]) -> Path | None:
        """Return the certificate's file of a sensor among those of a recording."""
        found: list[str] = []
        for given in self.files:
            name, equals, path = given.partition("=")
            if equals and name in among:
                found += [path] if name == sensor else []
            elif len(among) == 1:
                found.append(given)
            else:
                raise InputError(
                    f"--certificate {one_line(given, 60)!r} does not say whose it is: write "
                    f"SENSOR=FILE, with SENSOR one of {_listed(among)}."
                )
        if len(found) > 1:
            raise InputError(f"{one_line(sensor)} cannot have {len(found)} certificates: give one.")
        return Path(found[0]) if found else None


@dataclass(frozen=True, eq=False)
class WalkRecording:
    """What one sensor on a foot recorded.

    Attributes
    ----------
    file : Path
    sha256 : str
    sensor : str
        Its name.
    raw : ImuBlock
        As recorded, in SI units.
    certificate : Certificate or None
        To calibrate it with.
    certified_by : str
        Where the certificate is from; empty without one.
    reference : Reference or None
        Optical positions in the same file.
    """

    file: Path
    sha256: str
    sensor: str
    raw: ImuBlock
    certificate: Certificate | None = None
    certified_by: str = ""
    reference: Reference | None = None

    @cached_property
    def block(self) -> ImuBlock:
        """The samples, calibrated where there is a certificate."""
        if self.certificate is None:
            return self.raw
        from imu_rig.calibration.certificate import apply_certificate

        return apply_certificate(self.certificate, self.raw)

    @property
    def calibration(self) -> str:
        """A sentence for people."""
        if self.certificate is None:
            return "Not calibrated: nominal scales."
        done = " and ".join(
            {"accel": "accelerometer", "gyro": "gyroscope", "mag": "magnetometer"}[name]
            for name in self.certificate.calibrated
            if name != "mag"
        )
        return f"Calibrated ({done}) by {one_line(self.certified_by)}."


def read_walk(
    file: Path, table: TableOptions, sensors: Sequence[str], calibrating: Calibrating
) -> list[WalkRecording]:
    """Read the sensors on feet of a trial, a table or another program's recording.

    Raises
    ------
    InputError
        As their readers; or no such sensor, several to choose from, a certificate of another
        sensor.
    DataError
        No gyroscope, or times that cannot be right.
    """
    trial = open_if_trial(file, table)
    if trial is not None:
        return _of_trial(trial, sensors, calibrating)
    return _of_foreign(file, table, sensors, calibrating)


def choose_feet(file: Path, there: Sequence[str], wanted: Sequence[str]) -> list[str]:
    """Return the sensors to analyse: those asked for, the only one, or those called after feet.

    Raises
    ------
    InputError
        If one is not there, or the names do not tell which are on feet.
    """
    for name in wanted:
        if name not in there:
            raise InputError(
                f"{file} has no inertial sensor {one_line(name)!r} (it has {_listed(there)})."
            )
    if wanted:
        chosen = list(dict.fromkeys(wanted))
    elif len(there) == 1:
        chosen = list(there)
    else:
        chosen = [n for n in there if ON_A_FOOT.search(n) and not NOT_ON_A_FOOT.search(n)]
        if not chosen and _left_and_right(there):
            chosen = list(there)
    if not 1 <= len(chosen) <= MOST_FEET:
        raise InputError(
            f"{file} holds {len(there)} inertial sensors ({_listed(there)}): name the one on a "
            "foot with --sensor, or two for both feet."
        )
    return chosen


def _left_and_right(there: Sequence[str]) -> bool:
    """Whether there are two sensors, told apart by the side only: as ``left_sensor``."""
    if len(there) != MOST_FEET or any(NOT_ON_A_FOOT.search(name) for name in there):
        return False
    first, second = (SIDE.sub("*", name) for name in there)
    return first == second and "*" in first and len({name.lower() for name in there}) == MOST_FEET


def _of_trial(
    trial: Trial, sensors: Sequence[str], calibrating: Calibrating
) -> list[WalkRecording]:
    chosen = choose_feet(trial.path, trial.imus, sensors)
    recordings = []
    for name in chosen:
        certificate, source = _certificate_in_trial(trial, name, chosen, calibrating)
        block = trial.imu_in_time(name)
        _require_gyro(trial.path, name, block)
        recordings.append(WalkRecording(trial.path, trial.sha256, name, block, certificate, source))
    return recordings


def _certificate_in_trial(
    trial: Trial, name: str, chosen: Sequence[str], calibrating: Calibrating
) -> tuple[Certificate | None, str]:
    if calibrating.raw:
        return None, ""
    given = calibrating.file_for(name, chosen)
    if given is not None:
        from imu_rig.calibration.certificate import load_certificate
        from imu_rig.cli.export import require_same_device
        from imu_rig.cli.info import recorded_device

        certificate = load_certificate(given)
        device = recorded_device(trial, name)
        require_same_device(certificate, device, any_device=calibrating.any_device)
        return certificate, given.name
    if trial.kept_certificate(name) is None:
        return None, ""
    return trial.certificate(name), "the certificate in the trial"


def _of_foreign(
    file: Path, table: TableOptions, sensors: Sequence[str], calibrating: Calibrating
) -> list[WalkRecording]:
    from imu_rig.calibration.certificate import load_certificate
    from imu_rig.importing.formats import is_table, load_foreign, read_imu
    from imu_rig.importing.tables import find_sensors

    columns, reference = table.column_map(), None
    several = bool(columns.sensors)
    if is_table(file, columns) or several:
        # What a magnetometer says is not used here, so that nobody need state its unit.
        columns = columns.updated(mag_unit=columns.mag_unit or "uT")
        several = several or (columns.accel is None and len(find_sensors(file, columns)) > 1)
        if not several and sensors:
            raise InputError(f"{file} is a table of one sensor: leave --sensor out.")
        if not several:
            blocks = {file.stem: replace(read_imu(file, columns), mag=None)}
    if several or not is_table(file, columns):
        recording = load_foreign(file, columns=columns)
        chosen = choose_feet(file, recording.sensors, sensors)
        for name in chosen:
            if "gyro" not in recording.streams[name].values:
                raise DataError(_no_gyro(file, name))
        blocks = {name: recording.imu(name) for name in chosen}
        reference = recording.reference
    digest = digest_of(file)
    found = []
    for name, block in blocks.items():
        _require_gyro(file, name, block)
        given = calibrating.file_for(name, list(blocks))
        certificate = None if given is None else load_certificate(given)
        source = "" if given is None else given.name
        found.append(WalkRecording(file, digest, name, block, certificate, source, reference))
    return found


def _require_gyro(file: Path, name: str, block: ImuBlock) -> None:
    if len(block) == 0:
        raise DataError(f"{file} holds no sample of {one_line(name)}: record it anew.")
    if not block.gyro.any():
        raise DataError(_no_gyro(file, name))


def _no_gyro(file: Path, name: str) -> str:
    return (
        f"{file}: {one_line(name)} has no gyroscope, and without one nobody knows which way the "
        "foot moved: record with a sensor that has both, or name another with --sensor."
    )


def _listed(names: Sequence[str]) -> str:
    return ", ".join(one_line(name) for name in names) or "none"
