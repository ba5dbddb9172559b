"""Columns of numbers as text, many rows at once.

A text column is a table of bytes, one line for each row and as wide as its longest text; a byte 0
stands for none. Columns are put side by side and the zeros dropped at the end, so no number is
ever a Python object: this writes ten times as fast as formatting one by one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from imu_rig.arrays import FloatArray, IntArray

Bytes = npt.NDArray[np.uint8]

SIGNIFICANT = 10
"""Digits that the largest value of a column gets: it is rounded by a billionth of it at most."""
LARGEST, SMALLEST = 1e15, 1e-5
"""Columns whose largest value is beyond these are written with an exponent, which is slow."""
JUDGED = 200
_DIGITS = np.frombuffer("".join(f"{n:04d}" for n in range(10_000)).encode(), np.uint32)


def decimals_of(values: FloatArray) -> int | None:
    """Return how many decimals a column needs; None where only an exponent will do.

    As many as give the largest value `SIGNIFICANT` digits, without those that are 0 in every
    value, as in whole numbers, short decimals and their sums.
    """
    finite = values[np.isfinite(values)]
    largest = float(np.abs(finite).max(initial=0.0))
    if largest == 0.0:
        return 0
    if not SMALLEST <= largest < LARGEST:
        return None
    most = max(0, SIGNIFICANT - 1 - math.floor(math.log10(largest)))
    for decimals in range(most):
        if all(_enough(part, decimals, most) for part in (finite[:JUDGED], finite)):
            return decimals
    return most


def _enough(values: FloatArray, decimals: int, most: int) -> bool:
    """Whether all digits from ``decimals`` to ``most`` places behind the point are 0."""
    return not np.any(np.rint(values * 10.0**most) % 10.0 ** (most - decimals))


def number_text(values: FloatArray, decimals: int | None) -> Bytes:
    """Write numbers with a fixed number of decimals, as `decimals_of` gives it.

    What is not finite reads ``nan``, ``inf`` or ``-inf``.
    """
    if decimals is None:
        return words(values)
    odd = ~np.isfinite(values)
    safe = np.where(odd, 0.0, values) if odd.any() else values
    table = integer_text(np.rint(safe * 10.0**decimals).astype(np.int64), decimals)
    if odd.any():
        texts = words(values[odd])
        wider = max(0, texts.shape[1] - table.shape[1])
        table = np.pad(table, ((0, 0), (0, wider)))
        table[odd] = 0
        table[odd, : texts.shape[1]] = texts
    return table


def integer_text(numbers: IntArray, decimals: int = 0) -> Bytes:
    """Write whole numbers with the decimal point ``decimals`` places from their end."""
    size = np.abs(numbers)
    longest = max(decimals + 1, len(str(int(size.max(initial=0)))))
    groups = -(-longest // 4)
    digits = np.empty((len(numbers), groups), np.uint32)
    rest = size
    for group in range(groups - 1, -1, -1):
        higher = rest // 10_000
        digits[:, group] = _DIGITS[rest - 10_000 * higher]
        rest = higher
    text = digits.view(np.uint8)[:, 4 * groups - longest :]
    whole = longest - decimals
    point = 1 if decimals else 0
    table = np.empty((len(numbers), 1 + longest + point), np.uint8)
    table[:, 0] = np.where(numbers < 0, ord("-"), 0)
    table[:, 1 : 1 + whole] = text[:, :whole]
    for place in range(whole - 1):  # zeros before the first digit are none
        table[:, 1 + place] *= size >= 10 ** (longest - 1 - place)
    if decimals:
        table[:, 1 + whole] = ord(".")
        table[:, 2 + whole :] = text[:, whole:]
    return table


def utc_text(utc_us: IntArray) -> Bytes:
    """Write microseconds since 1970 as ``2026-05-04T12:00:00.000000Z``."""
    seconds = utc_us // 1_000_000
    each, which = np.unique(seconds, return_inverse=True)
    dates = np.datetime_as_string(each.astype("datetime64[s]")).astype("S19")
    micros = integer_text(utc_us - 1_000_000 * seconds + 1_000_000)[:, 2:]
    table = np.empty((len(utc_us), dates.itemsize + 8), np.uint8)
    table[:, :-8] = dates.view(np.uint8).reshape(len(dates), dates.itemsize)[which]
    table[:, -8] = ord(".")
    table[:, -7:-1] = micros
    table[:, -1] = ord("Z")
    return table


def words(values: FloatArray) -> Bytes:
    """Write numbers one by one, as short as they are exact."""
    table = np.array([repr(value).encode() for value in values.tolist()], bytes)
    return table.view(np.uint8).reshape(len(table), table.itemsize)


def constant(text: str, count: int) -> Bytes:
    """Return the same text for every row."""
    data = np.frombuffer(text.encode(), np.uint8)
    return np.broadcast_to(data, (count, len(data)))


def joined(columns: Sequence[Bytes]) -> bytes:
    """Put columns side by side and return all rows as one text."""
    table = np.concatenate(columns, axis=1)
    return bytes(table[table != 0])


def rows(columns: Sequence[Bytes]) -> list[bytes]:
    """Put columns side by side and return each row."""
    table = np.concatenate(columns, axis=1)
    there = table != 0
    data = table[there].tobytes()
    stops = np.cumsum(there.sum(axis=1)).tolist()
    return [data[a:b] for a, b in zip([0, *stops[:-1]], stops, strict=True)] if stops else []
