"""The formats a trial is exported to, and the one way to write any of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from imu_rig.errors import DataError, InputError
from imu_rig.exporting.device_data import STAND_IN_NS, TrialData, iso_utc
from imu_rig.exporting.output import Output, Place, Tell


@dataclass(frozen=True)
class Format:
    """One format.

    Attributes
    ----------
    suffix : str
        Of its files, with the dot.
    module, function : str
        Who writes it; loaded only then.
    each : bool
        Whether each device has a file of its own.
    dated : bool
        Whether every sample needs a date.
    needs : str or None
        Package that is not installed with imu-rig; the extra has the format's name.
    """

    suffix: str
    module: str
    function: str
    each: bool = False
    dated: bool = False
    needs: str | None = None


FORMATS = {
    "csv": Format(".csv", "csv_file", "write_csv", each=True),
    "mcap": Format(".mcap", "mcap_file", "write_mcap", dated=True),
    "tlog": Format(".tlog", "tlog_file", "write_tlog", dated=True),
    "mat": Format(".mat", "matlab_file", "write_matlab"),
    "parquet": Format(".parquet", "parquet_file", "write_parquet", each=True, needs="pyarrow"),
    "c3d": Format(".c3d", "c3d_file", "write_c3d", needs="ezc3d"),
}


def choose(to: str | None, output: Path | None) -> str:
    """Return the format that is asked for by name, or by the suffix of the file.

    Raises
    ------
    InputError
        If neither says which.
    """
    known = ", ".join(FORMATS)
    if to is not None:
        if to not in FORMATS:
            raise InputError(f"There is no format {to!r}: give --to one of {known}.")
        return to
    for name, chosen in FORMATS.items():
        if output is not None and output.suffix.lower() == chosen.suffix:
            return name
    raise InputError(
        f"Say which format: --to with one of {known}"
        + (f"; the suffix of {output} is none of them." if output is not None else ".")
    )


def destination(trial: Path, to: str, output: Path | None, *, folder: bool = False) -> Path:
    """Return the file to write: as asked, or named as the trial, in a folder or beside it.

    A name without the suffix of the format gets it. ``folder`` says that ``output`` is one, even
    if it is not there yet.
    """
    suffix = FORMATS[to].suffix
    named = trial.with_suffix(suffix).name
    if output is None:
        return trial.parent / named
    if folder or output.is_dir():
        return output / named
    return output if output.suffix.lower() == suffix else output.with_name(output.name + suffix)


def export_trial(data: TrialData, to: str, path: Path, tell: Tell | None = None) -> Output:
    """Write a trial in a format, all of it or nothing.

    Parameters
    ----------
    data : TrialData
    to : str
        One of `FORMATS`.
    path : Path
        The file; formats with a file for each device put its name after the stem.
    tell : callable, optional
        Told what is being done.

    Returns
    -------
    Output
        The files, and what they do not hold.

    Raises
    ------
    InputError
        A file exists, a package is missing, or the format cannot hold the trial.
    StorageError
        The disk is full or fails.
    """
    write = _writer(to)
    with Output(tell) as output:
        write(data, Place(path, several=len(data.names) > 1), output)
        if not any(summary.samples for summary in data.summaries.values()):
            raise DataError(f"{data.trial.path} holds no samples to export.")
        if data.trial.start_utc_ns is None:
            output.notes.append(
                "Nobody knows at what time of day this trial began: "
                + (
                    f"the times count from {iso_utc(STAND_IN_NS)[:10]}."
                    if FORMATS[to].dated
                    else "the exported times are trial time only, without UTC."
                )
            )
    return output


def _writer(to: str) -> Callable[[TrialData, Place, Output], None]:
    chosen = FORMATS[to]
    try:
        module = import_module(f"imu_rig.exporting.{chosen.module}")
    except ImportError as error:
        if chosen.needs is None or chosen.needs != (error.name or "").partition(".")[0]:
            raise
        raise InputError(
            f"Exporting to {to} needs the package {chosen.needs}: pip install 'imu-rig[{to}]'."
        ) from error
    write: Callable[[TrialData, Place, Output], None] = getattr(module, chosen.function)
    return write
