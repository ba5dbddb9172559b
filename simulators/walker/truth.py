"""The truth of a walk as tables of text: what devices felt, sample by sample, strides and turns."""

from __future__ import annotations

import csv
import io
import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.files import whole_file
from imu_rig.units import DEG
from simulators.walker.feet import Phase
from simulators.walker.record import UnitRecord
from simulators.walker.steps import LEFT, Footfall
from simulators.walker.walker import Walker

COLUMNS = (
    "device",
    "place",
    "counter",
    "device_s",
    "t_s",
    *("x_m", "y_m", "z_m"),
    *("vx_ms", "vy_ms", "vz_ms"),
    *("qw", "qx", "qy", "qz"),
    *("fx_ms2", "fy_ms2", "fz_ms2"),
    *("wx_rads", "wy_rads", "wz_rads"),
    *("mean_fx_ms2", "mean_fy_ms2", "mean_fz_ms2"),
    *("mean_wx_rads", "mean_wy_rads", "mean_wz_rads"),
    *("mx_ut", "my_ut", "mz_ut"),
    "pressure_pa",
    "phase",
)
"""Of the table of samples; `docs/simulated-walks.md` describes them."""

STRIDE_COLUMNS = (
    "foot",
    "stride",
    "toe_off_s",
    "contact_s",
    "flat_s",
    "heel_off_s",
    "duration_s",
    "x_m",
    "y_m",
    "z_m",
    "heading_deg",
    "length_m",
    "rise_m",
    "turn_deg",
)
TURN_COLUMNS = ("begin_s", "end_s", "angle_deg")

PHASES = {int(phase): phase.name.lower().replace("_", "-") for phase in Phase}
WAIST_PHASE = ""

ROWS = 2000
WHAT = "the truth of a walk"


def truth_files(path: Path, walker: Walker) -> dict[str, Path]:
    """Return where the truth of a walk goes: samples, and strides and turns if there are any.

    Parameters
    ----------
    path : Path
        Of the table of samples; the others are called NAME-strides.csv and NAME-turns.csv.
    walker : Walker
    """
    there = {"strides": any(len(falls) > 1 for falls in walker.falls), "turns": bool(walker.turns)}
    return {"samples": path} | {
        what: path.with_name(f"{path.stem}-{what}{path.suffix}") for what in there if there[what]
    }


def write_truth(path: Path, walker: Walker, units: Iterable[UnitRecord]) -> list[Path]:
    """Write the table of samples, and beside it those of strides and turns if there are any.

    Parameters
    ----------
    path : Path
        Of the table of samples.
    walker : Walker
    units : of UnitRecord

    Returns
    -------
    list of Path
        The files written; see `truth_files`.

    Raises
    ------
    InputError
        If one exists.
    StorageError
        If one cannot be written.
    """
    tables: dict[str, tuple[Sequence[str], Iterable[Sequence[str]]]] = {
        "samples": (COLUMNS, (row for unit in units for row in sample_rows(unit))),
        "strides": (STRIDE_COLUMNS, stride_rows(walker)),
        "turns": (TURN_COLUMNS, turn_rows(walker)),
    }
    files = truth_files(path, walker)
    for what, file in files.items():
        _write(file, *tables[what])
    return list(files.values())


def sample_rows(unit: UnitRecord) -> Iterator[Sequence[str]]:
    """Yield the rows of one unit."""
    truth, means = unit.truth, unit.means
    numbers = np.column_stack(
        (
            unit.t,
            truth.position,
            truth.velocity,
            truth.attitude,
            truth.force,
            truth.rate,
            means.force,
            means.rate,
            truth.field,
            unit.pressure,
        )
    )
    for first in range(0, len(unit), ROWS):
        rows = slice(first, first + ROWS)
        heads = zip(
            unit.counter[rows].tolist(),
            unit.device_s[rows].tolist(),
            unit.phase[rows].tolist(),
            numbers[rows].tolist(),
            strict=True,
        )
        for counter, device_s, phase, values in heads:
            told = WAIST_PHASE if unit.place == "waist" else PHASES[phase]
            yield (
                unit.name,
                unit.place,
                str(counter),
                f"{device_s:.9f}",
                *(f"{value:.12g}" for value in values),
                told,
            )


def stride_rows(walker: Walker) -> Iterator[Sequence[str]]:
    """Yield the strides of both feet, from one stay on the ground to the next."""
    for falls in walker.falls:
        for number, (fall, after) in enumerate(itertools.pairwise(falls), 1):
            yield _stride(number, fall, after)


def turn_rows(walker: Walker) -> Iterator[Sequence[str]]:
    """Yield the turns."""
    for begin, end, angle in walker.turns:
        yield tuple(map(_text, (begin, end, angle / DEG)))


def stride_lengths(falls: Sequence[Footfall]) -> FloatArray:
    """Return the horizontal lengths of a foot's strides [m]."""
    balls = np.array([fall.ball for fall in falls])
    lengths: FloatArray = np.linalg.norm(np.diff(balls[:, :2], axis=0), axis=1)
    return lengths


def _stride(number: int, fall: Footfall, after: Footfall) -> Sequence[str]:
    dx, dy, dz = (b - a for a, b in zip(fall.ball, after.ball, strict=True))
    duration = after.contact - fall.contact
    values = (
        fall.toe_off,
        after.contact,
        after.flat,
        after.heel_off,
        duration,
        *after.ball,
        after.yaw / DEG,
        math.hypot(dx, dy),
        dz,
        (after.yaw - fall.yaw) / DEG,
    )
    foot = "left" if fall.foot == LEFT else "right"
    return (foot, str(number), *map(_text, values))


def _text(value: float) -> str:
    """Return a number; nothing for what never happens."""
    return f"{value:.9g}" if math.isfinite(value) else ""


def _write(path: Path, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    with whole_file(path, what=WHAT) as file:
        text = io.TextIOWrapper(file, encoding="utf-8", newline="")
        writer = csv.writer(text)
        writer.writerow(columns)
        writer.writerows(rows)
        text.detach()  # writes what is left, and leaves the file open
