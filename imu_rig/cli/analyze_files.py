"""What an analysis of walks writes: tables as CSV, a summary as JSON, in a folder of its own."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from imu_rig.files import whole_file, write_whole

if TYPE_CHECKING:
    from imu_rig.gait.trajectory import FootTrack

TRAJECTORY_COLUMNS = (
    "t_s",
    *("x_m", "y_m", "z_m"),
    *("vx_ms", "vy_ms", "vz_ms"),
    *("qw", "qx", "qy", "qz"),
    "stands",
    *("x_sigma_m", "y_sigma_m", "z_sigma_m"),
    "heading_sigma_deg",
)
ROWS_AT_ONCE = 1 << 16
DECIMALS = (6, *[5] * 3, *[5] * 3, *[7] * 4, 0, *[5] * 3, 4)


def analysis_folder(output: Path | None, what: str, file: Path, names: tuple[str, ...]) -> Path:
    """Make the folder of an analysis; one by the recording's name and the time by default.

    Raises
    ------
    InputError
        As `imu_rig.cli.sessions.new_folder`.
    """
    from imu_rig.cli.sessions import new_folder

    stem = f"{what}-{safe_name(file.stem)}-{datetime.now().astimezone():%Y-%m-%d-%H%M%S}"
    return new_folder(Path(stem) if output is None else output, names)


@contextlib.contextmanager
def removed_on_failure(folder: Path, names: tuple[str, ...]) -> Iterator[None]:
    """Take away what was written into a folder where the rest of it cannot be, or Ctrl-C comes.

    A folder with half of an analysis would be taken for a whole one, and the same command would
    be refused the second time, as nothing is overwritten.
    """
    try:
        yield
    except BaseException:
        for name in names:
            with contextlib.suppress(OSError):
                (folder / name).unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            folder.rmdir()  # stays where it holds anything else
        raise


def safe_name(text: str) -> str:
    """Return a name that any file system takes."""
    return re.sub(r"[^\w.-]+", "-", text).strip("-.") or "walk"


def write_trajectory(path: Path, track: FootTrack) -> None:
    """Write every sample of a trajectory with its uncertainty, which is empty where unknown.

    Raises
    ------
    InputError
        The file exists.
    StorageError
        The disk is full or fails.
    """
    with whole_file(path, what="a trajectory") as file:
        file.write(",".join(TRAJECTORY_COLUMNS).encode() + b"\n")
        for begin in range(0, len(track.trajectory), ROWS_AT_ONCE):
            file.write(_trajectory_rows(track, begin, begin + ROWS_AT_ONCE))


def _trajectory_rows(track: FootTrack, begin: int, end: int) -> bytes:
    import numpy as np

    from imu_rig.exporting.number_text import constant, joined, number_text
    from imu_rig.units import DEG

    part, covariance = track.trajectory[begin:end], track.covariance
    n = len(part)
    columns = [
        part.t[:, None],
        part.position,
        part.velocity,
        part.quaternion,
        track.zero_velocity.still[begin:end, None].astype(float),
    ]
    if covariance is not None:
        samples = np.arange(begin, begin + n)
        sigmas = np.column_stack((covariance.position_sigma, covariance.heading_sigma / DEG))
        columns += [np.interp(samples, covariance.rows, s)[:, None] for s in sigmas.T]
    comma, cells = constant(",", n), []
    for column, decimals in zip(np.concatenate(columns, axis=1).T, DECIMALS, strict=False):
        cells += [number_text(column, decimals), comma]
    unknown = [] if covariance is not None else [constant(",,,,", n)]
    return joined([*cells[:-1], *unknown, constant("\n", n)])


def write_rows(path: Path, head: Sequence[str], rows: Iterable[Sequence[Any]], what: str) -> None:
    """Write a small table; what is not a number is left empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    for row in rows:
        writer.writerow(["" if _is_nan(cell) else cell for cell in row])
    write_whole(path, text.getvalue().encode(), what=what)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write an answer; what is not a number is null."""
    write_whole(path, (json_text(content, indent=1) + "\n").encode(), what="a summary")


def json_text(content: Any, indent: int | None = None) -> str:
    """Return plain values as JSON, with null for what is not a number."""
    return json.dumps(_plain(content), allow_nan=False, indent=indent, ensure_ascii=False)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(inner) for inner in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def _is_nan(value: Any) -> bool:
    return isinstance(value, float) and not math.isfinite(value)
