"""Products of 3x3 blocks written out: tuples of nine numbers, row by row, and vectors of three.

Loops over three rows cost more than what they do; tuples become registers. A square matrix of
which only the upper triangle is kept is an array (16, 16).
"""

from __future__ import annotations

from imu_rig.arrays import FloatArray
from imu_rig.kernels.compiled import inlined
from imu_rig.kernels.strapdown import Matrix, Vector


@inlined
def block(P: FloatArray, i: int, j: int) -> Matrix:
    """Read the block whose first element is ``P[i, j]``."""
    return (
        P[i, j],
        P[i, j + 1],
        P[i, j + 2],
        P[i + 1, j],
        P[i + 1, j + 1],
        P[i + 1, j + 2],
        P[i + 2, j],
        P[i + 2, j + 1],
        P[i + 2, j + 2],
    )


@inlined
def block_transposed(P: FloatArray, i: int, j: int) -> Matrix:
    """Read the transpose of the block whose first element is ``P[i, j]``."""
    return (
        P[i, j],
        P[i + 1, j],
        P[i + 2, j],
        P[i, j + 1],
        P[i + 1, j + 1],
        P[i + 2, j + 1],
        P[i, j + 2],
        P[i + 1, j + 2],
        P[i + 2, j + 2],
    )


@inlined
def diagonal(P: FloatArray, i: int) -> Matrix:
    """Read a symmetric block on the diagonal from its upper triangle."""
    return (
        P[i, i],
        P[i, i + 1],
        P[i, i + 2],
        P[i, i + 1],
        P[i + 1, i + 1],
        P[i + 1, i + 2],
        P[i, i + 2],
        P[i + 1, i + 2],
        P[i + 2, i + 2],
    )


@inlined
def add_block(P: FloatArray, i: int, j: int, M: Matrix) -> None:
    """Add to the block whose first element is ``P[i, j]``."""
    P[i, j] += M[0]
    P[i, j + 1] += M[1]
    P[i, j + 2] += M[2]
    P[i + 1, j] += M[3]
    P[i + 1, j + 1] += M[4]
    P[i + 1, j + 2] += M[5]
    P[i + 2, j] += M[6]
    P[i + 2, j + 1] += M[7]
    P[i + 2, j + 2] += M[8]


@inlined
def add_diagonal(P: FloatArray, i: int, M: Matrix, S: Matrix) -> None:
    """Add ``M + M' + S``, ``S`` symmetric, to the upper triangle of a block on the diagonal."""
    P[i, i] += 2.0 * M[0] + S[0]
    P[i, i + 1] += M[1] + M[3] + S[1]
    P[i, i + 2] += M[2] + M[6] + S[2]
    P[i + 1, i + 1] += 2.0 * M[4] + S[4]
    P[i + 1, i + 2] += M[5] + M[7] + S[5]
    P[i + 2, i + 2] += 2.0 * M[8] + S[8]


@inlined
def transpose(M: Matrix) -> Matrix:
    """Return the transpose."""
    return (M[0], M[3], M[6], M[1], M[4], M[7], M[2], M[5], M[8])


@inlined
def scaled(s: float, M: Matrix) -> Matrix:
    """Return a multiple."""
    return (
        s * M[0], s * M[1], s * M[2], s * M[3], s * M[4], s * M[5], s * M[6], s * M[7], s * M[8],
    )  # fmt: skip


@inlined
def plus(A: Matrix, B: Matrix) -> Matrix:
    """Return a sum."""
    return (
        A[0] + B[0], A[1] + B[1], A[2] + B[2], A[3] + B[3], A[4] + B[4], A[5] + B[5],
        A[6] + B[6], A[7] + B[7], A[8] + B[8],
    )  # fmt: skip


@inlined
def times(A: Matrix, B: Matrix) -> Matrix:
    """Return ``A B``."""
    return (
        A[0] * B[0] + A[1] * B[3] + A[2] * B[6],
        A[0] * B[1] + A[1] * B[4] + A[2] * B[7],
        A[0] * B[2] + A[1] * B[5] + A[2] * B[8],
        A[3] * B[0] + A[4] * B[3] + A[5] * B[6],
        A[3] * B[1] + A[4] * B[4] + A[5] * B[7],
        A[3] * B[2] + A[4] * B[5] + A[5] * B[8],
        A[6] * B[0] + A[7] * B[3] + A[8] * B[6],
        A[6] * B[1] + A[7] * B[4] + A[8] * B[7],
        A[6] * B[2] + A[7] * B[5] + A[8] * B[8],
    )


@inlined
def crossed(a: Vector, B: Matrix) -> Matrix:
    """Return ``[a]x B``: the cross product of ``a`` with each column."""
    return (
        a[1] * B[6] - a[2] * B[3],
        a[1] * B[7] - a[2] * B[4],
        a[1] * B[8] - a[2] * B[5],
        a[2] * B[0] - a[0] * B[6],
        a[2] * B[1] - a[0] * B[7],
        a[2] * B[2] - a[0] * B[8],
        a[0] * B[3] - a[1] * B[0],
        a[0] * B[4] - a[1] * B[1],
        a[0] * B[5] - a[1] * B[2],
    )


@inlined
def column(P: FloatArray, i: int, j: int) -> Vector:
    """Read three elements downwards."""
    return (P[i, j], P[i + 1, j], P[i + 2, j])


@inlined
def row(P: FloatArray, i: int, j: int) -> Vector:
    """Read three elements to the right."""
    return (P[i, j], P[i, j + 1], P[i, j + 2])


@inlined
def add_column(P: FloatArray, i: int, j: int, v: Vector) -> None:
    """Add to three elements downwards."""
    P[i, j] += v[0]
    P[i + 1, j] += v[1]
    P[i + 2, j] += v[2]


@inlined
def applied(M: Matrix, v: Vector) -> Vector:
    """Return ``M v``."""
    return (
        M[0] * v[0] + M[1] * v[1] + M[2] * v[2],
        M[3] * v[0] + M[4] * v[1] + M[5] * v[2],
        M[6] * v[0] + M[7] * v[1] + M[8] * v[2],
    )


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """Return ``a x b``."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@inlined
def sum3(a: Vector, b: Vector) -> Vector:
    """Return ``a + b``."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@inlined
def less(a: Vector, b: Vector) -> Vector:
    """Return ``a - b``."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@inlined
def mean(a: Vector, b: Vector) -> Vector:
    """Return the mean of two vectors."""
    return (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2]))
