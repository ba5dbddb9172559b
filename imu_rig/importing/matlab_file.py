"""Plain matrices out of a MATLAB file: their shapes first, and nothing else of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.errors import InputError, reason_of
from imu_rig.importing.matlab_elements import (
    DamagedError,
    Variable,
    list_variables,
    read_matrix,
)
from imu_rig.importing.read_table import LARGEST

MAGIC = b"MATLAB 5.0 MAT-file"
NEWER_MAGIC = b"MATLAB 7.3 MAT-file"
MAXIMUM_BYTES = 2_000_000_000
MAXIMUM_ROWS = 10_000_000
MAXIMUM_VARIABLES = 10_000


@dataclass(frozen=True)
class MatlabFile:
    """What a file says it holds.

    Attributes
    ----------
    path : Path
    shapes : dict
        Shape of each matrix of numbers.
    others : tuple of str
        Variables that are none: text, structures, cells, objects, complex numbers.
    variables : dict
        Where each matrix lies.
    """

    path: Path
    shapes: dict[str, tuple[int, ...]]
    others: tuple[str, ...]
    variables: dict[str, Variable]


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
    if begins_with(path, NEWER_MAGIC):
        raise InputError(f"{path} is of MATLAB's version 7.3, which is not read; save it with -v7")
    if path.stat().st_size > MAXIMUM_BYTES:
        raise InputError(f"{path} has more than {MAXIMUM_BYTES // 10**9} GB: cut it up")
    listed: list[Variable] = []
    with _sound(path) as file:
        for variable in list_variables(file):
            listed.append(variable)
            if len(listed) > MAXIMUM_VARIABLES:
                raise InputError(f"{path} holds more than {MAXIMUM_VARIABLES} variables")
    matrices = {v.name: v for v in listed if v.numeric}
    return MatlabFile(
        path,
        {name: v.shape for name, v in matrices.items()},
        tuple(v.name for v in listed if not v.numeric),
        matrices,
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
    with _sound(file.path) as stream:
        matrices = {name: read_matrix(stream, file.variables[name]) for name in columns}
    return {
        name: np.ascontiguousarray(matrix.ravel() if columns[name] == 1 else matrix)
        for name, matrix in matrices.items()
    }


def read_number(file: MatlabFile, name: str) -> float:
    """Read a single number.

    Raises
    ------
    InputError
        If it is a matrix or not finite.
    """
    if file.shapes[name] != (1, 1):
        raise InputError(f"{file.path}: {name} is {_times(file.shapes[name])}, not one number")
    with _sound(file.path) as stream:
        number = float(read_matrix(stream, file.variables[name])[0, 0])
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


@contextmanager
def _sound(path: Path) -> Iterator[BinaryIO]:
    """Open a file whose damage is told in a sentence."""
    try:
        with path.open("rb") as file:
            yield file
    except OSError as error:
        raise InputError(f"{path} could not be read: {reason_of(error)}") from error
    except DamagedError as error:
        raise InputError(
            f"{path} is damaged, or no MATLAB file of version 5 to 7: save it anew"
        ) from error


def _times(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))
