"""Plain matrices out of a MATLAB file: their shapes first, and nothing else of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.errors import InputError, reason_of
from imu_rig.importing.read_table import LARGEST

MAGIC = b"MATLAB 5.0 MAT-file"
NEWER_MAGIC = b"MATLAB 7.3 MAT-file"
MAXIMUM_BYTES = 2_000_000_000
MAXIMUM_ROWS = 10_000_000
MAXIMUM_VARIABLES = 10_000
_NUMBERS = frozenset(
    [
        *("double", "single", "logical"),
        *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)),
    ]
)


@dataclass(frozen=True)
class MatlabFile:
    """What a file says it holds.

    Attributes
    ----------
    path : Path
    shapes : dict
        Shape of each matrix of numbers.
    others : tuple of str
        Variables that are none: text, structures, cells, objects.
    """

    path: Path
    shapes: dict[str, tuple[int, ...]]
    others: tuple[str, ...]


def begins_with(path: Path, *magics: bytes) -> bool:
    """Whether a file begins with one of some bytes.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return file.read(max(map(len, magics))).startswith(magics)
    except OSError as error:
        raise InputError(f"{path} could not be read: {reason_of(error)}") from error


def is_matlab_file(path: Path) -> bool:
    """Whether a file begins like one of MATLAB's of version 5 to 7.3."""
    return begins_with(path, MAGIC, NEWER_MAGIC)


def open_matlab(path: Path) -> MatlabFile:
    """List the variables of a file without reading them.

    Raises
    ------
    InputError
        A file of version 7.3, a damaged or a huge one.
    """
    from scipy.io import whosmat

    if begins_with(path, NEWER_MAGIC):
        raise InputError(f"{path} is of MATLAB's version 7.3, which is not read; save it with -v7")
    if path.stat().st_size > MAXIMUM_BYTES:
        raise InputError(f"{path} has more than {MAXIMUM_BYTES // 10**9} GB: cut it up")
    try:
        listed = whosmat(str(path), appendmat=False)
    except Exception as error:  # a damaged file makes the parser raise almost anything
        raise _damaged(path) from error
    if len(listed) > MAXIMUM_VARIABLES:
        raise InputError(f"{path} holds more than {MAXIMUM_VARIABLES} variables")
    return MatlabFile(
        path,
        {name: tuple(shape) for name, shape, kind in listed if kind in _NUMBERS},
        tuple(name for name, _, kind in listed if kind not in _NUMBERS),
    )


def read_matrices(file: MatlabFile, columns: Mapping[str, int]) -> dict[str, FloatArray]:
    """Read matrices of as many rows as samples.

    Parameters
    ----------
    file : MatlabFile
    columns : mapping
        Name of each to its number of columns; 1 also takes a row of numbers.

    Returns
    -------
    dict
        Shapes (n, columns), or (n,) for one column.

    Raises
    ------
    InputError
        Naming the matrix of another shape, or of another number of rows than the first.
    """
    from scipy.io import loadmat

    rows: int | None = None
    for name, count in columns.items():
        shape = file.shapes[name]
        vector = count == 1 and len(shape) == 2 and 1 in shape
        length = max(shape) if vector else shape[0]
        if not vector and (len(shape) != 2 or shape[1] != count):
            raise InputError(
                f"{file.path}: {name} is {_times(shape)}, not n x {count} with a row for each "
                "sample"
            )
        if not 2 <= length <= MAXIMUM_ROWS:
            raise InputError(
                f"{file.path}: {name} has {length} rows; 2 to {MAXIMUM_ROWS // 10**6} million "
                "can be read"
            )
        if rows is not None and length != rows:
            raise InputError(
                f"{file.path}: {name} has {length} rows, {next(iter(columns))} {rows}; every "
                "matrix needs one for each sample"
            )
        rows = length
    return {
        name: np.ascontiguousarray(matrix.reshape(-1, columns[name]), dtype=np.float64)
        if columns[name] > 1
        else np.ascontiguousarray(matrix.ravel(), dtype=np.float64)
        for name, matrix in _load(file, columns, loadmat).items()
    }


def read_number(file: MatlabFile, name: str) -> float:
    """Read a single number.

    Raises
    ------
    InputError
        If it is a matrix or not finite.
    """
    from scipy.io import loadmat

    if file.shapes[name] != (1, 1):
        raise InputError(f"{file.path}: {name} is {_times(file.shapes[name])}, not one number")
    number = float(_load(file, {name: 1}, loadmat)[name].ravel()[0])
    if not np.isfinite(number):
        raise InputError(f"{file.path}: {name} is {number}, which is no number")
    return number


def require_finite(path: Path, name: str, matrix: FloatArray) -> None:
    """Refuse NaN, infinity and what no sensor gives, by the row they are in.

    Raises
    ------
    InputError
        Naming the row, from 1 as MATLAB counts.
    """
    usable = np.abs(matrix) <= LARGEST
    wrong = np.flatnonzero(~usable.reshape(len(matrix), -1).all(axis=1))
    if len(wrong):
        raise InputError(
            f"{path}: row {wrong[0] + 1} of {name} holds what is no reading (NaN, infinite or "
            f"enormous), and {len(wrong) - 1} rows more; cut such rows out"
        )


def require_increasing(path: Path, name: str, t: FloatArray) -> None:
    """Refuse times that stand still or go back, by the row they are in.

    Raises
    ------
    InputError
        Naming the row, from 1 as MATLAB counts.
    """
    wrong = np.flatnonzero(np.diff(t) <= 0)
    if len(wrong):
        row = int(wrong[0]) + 1
        raise InputError(
            f"{path}: row {row + 1} of {name} is {t[row]:.10g} after {t[row - 1]:.10g}; time must "
            "increase, so cut the file there"
        )


def _load(file: MatlabFile, names: Mapping[str, int], loadmat: Any) -> dict[str, Any]:
    try:
        content = loadmat(str(file.path), appendmat=False, variable_names=list(names))
        found = {name: content[name] for name in names}
    except Exception as error:  # as above
        raise _damaged(file.path) from error
    for name, matrix in found.items():
        numeric = isinstance(matrix, np.ndarray) and matrix.dtype.kind in "fiub"
        if not numeric or matrix.shape != file.shapes[name]:
            raise InputError(f"{file.path}: {name} is no matrix of real numbers")
    return found


def _damaged(path: Path) -> InputError:
    return InputError(f"{path} is damaged, or no MATLAB file of version 5 to 7: save it anew")


def _times(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))
