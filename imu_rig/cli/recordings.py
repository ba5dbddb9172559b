"""Recordings that a command is given: a trial file, a table with options, another's format."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from imu_rig.errors import InputError

if TYPE_CHECKING:
    from imu_rig.blocks import ImuBlock
    from imu_rig.importing.column_map import ColumnMap
    from imu_rig.recording.reader import Trial


@dataclass(frozen=True)
class TableOptions:
    """What the options of a command say about a table; see `imu_rig.cli.options`."""

    map_file: Path | None = None
    columns: str | None = None
    rate: float | None = None
    accel: str | None = None
    gyro: str | None = None
    time: str | None = None
    accel_unit: str | None = None
    gyro_unit: str | None = None
    mag_unit: str | None = None
    time_unit: str | None = None
    mag: str | None = None

    def column_map(self) -> ColumnMap:
        """Return the columns and units: those of the map file where no option says otherwise."""
        from imu_rig.importing.column_map import ColumnMap, load_column_map

        stated = ColumnMap() if self.map_file is None else load_column_map(self.map_file)
        return stated.updated(
            columns=self.columns,
            rate_hz=self.rate,
            accel=self.accel,
            gyro=self.gyro,
            mag=self.mag,
            time=self.time,
            accel_unit=self.accel_unit,
            gyro_unit=self.gyro_unit,
            mag_unit=self.mag_unit,
            time_unit=self.time_unit,
        )


def open_if_trial(file: Path, table: TableOptions) -> Trial | None:
    """Open a trial file, saying on stderr what it has lost; None where ``file`` is none.

    A trial is known by its name or, under another name, by how it begins.

    Raises
    ------
    InputError
        If options for a table were given with a trial file, or it cannot be read, or is a
        certificate.
    """
    from imu_rig.recording.format import SUFFIX

    if file.suffix == ".json":
        _refuse_certificate(file)
    if file.suffix != SUFFIX and not _begins_like_a_trial(file):
        return None
    from imu_rig.cli.sessions import warn_of_damage
    from imu_rig.recording.reader import open_trial

    if any(option is not None for option in astuple(table)):
        raise InputError(f"{file} knows its columns, units and rate: leave those options out.")
    trial = open_trial(file)
    warn_of_damage(trial)
    return trial


def _begins_like_a_trial(file: Path) -> bool:
    from imu_rig.recording.format import MAGIC

    return file.is_file() and _head(file).startswith(MAGIC)


def _head(file: Path) -> bytes:
    try:
        with file.open("rb") as stream:
            return stream.read(200)
    except OSError:
        return b""  # told by who reads it


def _refuse_certificate(file: Path) -> None:
    if b'"imu-rig/certificate"' in _head(file):
        raise InputError(
            f"{file} is a certificate, not a recording: imu-rig certificate show {file} shows it."
        )


def read_block(file: Path, table: TableOptions, sensor: str | None = None) -> tuple[ImuBlock, str]:
    """Read a table or another program's recording; return its samples and its SHA-256."""
    from imu_rig.importing.formats import read_imu

    return read_imu(file, table.column_map(), sensor), digest_of(file)


def digest_of(file: Path) -> str:
    """Return the SHA-256 of a file; of a folder, that of its files' in the order of their names."""
    import hashlib

    from imu_rig.importing.formats import files_of
    from imu_rig.importing.trial_file import file_digest

    if not file.is_dir():
        return file_digest(file)
    digests = [file_digest(inside) for inside in files_of(file)]
    return hashlib.sha256("".join(digests).encode()).hexdigest()
