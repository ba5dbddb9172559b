"""The measured numbers in unknown packets: where each begins, how wide it is, its byte order.

A signal changes little from packet to packet if its bytes are read as they were meant; read in the
wrong order, or across two numbers, it leaps. What each reading costs is how many bits its steps
take; the cheapest way to divide the packet into numbers is the likeliest.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from imu_rig.arrays import AnyArray, ByteArray, FloatArray
from imu_rig.devices.unknown.counting import numbers
from imu_rig.devices.unknown.period import Aligned

# Bits, by which a reading must be worth its while.
FIELD = 1.0
SINGLE = 2.0  # for a number of one byte: rarer than a wrong division into wider ones
PAD = 0.3
OTHER_ORDER = 0.2
FLOAT_BONUS = 3.0

LEAST_SENSIBLE, GREATEST_SENSIBLE = 1e-7, 1e7  # of floating-point measurements
SENSIBLE = 0.98  # share of the packets
ROUGH = 0.5  # of the steps of chance, which the low bytes of a float are like
COUPLED = 0.9  # share of the changes above 16 bits that must be carried from below
ACCEL_SPREAD = 0.04
"""Share by which the magnitude of three numbers may differ to be that of gravity."""

SCALE_TOLERANCE = 0.06
USUAL_SCALES = (256, 512, 1024, 2048, 4096, 8192, 16384)  # counts per g
LEAST_COUNTS = 200.0
GRAVITY_M_S2 = 9.81


@dataclass(frozen=True)
class Part:
    """A stretch of the packet read as one number, or as bytes that stay the same.

    Attributes
    ----------
    at : int
        First byte.
    type : str
        As in `firmware_protocols.fields.TYPE_SIZES`; "pad" for constant bytes.
    size : int
        Bytes.
    byte_order : str
    """

    at: int
    type: str
    size: int
    byte_order: str = "little"


@dataclass(frozen=True)
class Gravity:
    """Three numbers whose magnitude stays the same, at a value that gravity has.

    Attributes
    ----------
    first : int
        Index of the first of the three parts.
    unit : str
        "g" or "m/s2".
    counts_per_unit : float
    """

    first: int
    unit: str
    counts_per_unit: float


def divide(aligned: Aligned, free: set[int]) -> list[Part]:
    """Divide the ``free`` places of the packet into numbers and bytes without change."""
    best: tuple[float, list[Part]] | None = None
    for order in ("little", "big"):
        readings = _Readings(aligned, order)
        cost, parts = 0.0, []
        for stretch in _stretches(free):
            more, found = _cheapest(readings, stretch)
            cost += more
            parts += found
        if best is None or cost < best[0]:
            best = cost, parts
    assert best is not None
    return _signed(aligned, _joined_pads(best[1]))


def unread(free: set[int]) -> list[Part]:
    """Return the ``free`` places without an attempt to read them."""
    return [Part(stretch.start, "pad", len(stretch)) for stretch in _stretches(free)]


def find_gravity(aligned: Aligned, parts: list[Part]) -> Gravity | None:
    """Return which three neighbouring numbers look like an accelerometer, if any do.

    Of a sensor at rest, one axis that reads gravity makes any three numbers around it look so:
    those count first that stand where threes from the beginning of their kind stand.
    """
    best: tuple[tuple[bool, float], Gravity] | None = None
    begin = 0  # of the numbers of one kind side by side
    for first in range(len(parts) - 2):
        if first and not are_alike(parts[first - 1], parts[first]):
            begin = first
        three = parts[first : first + 3]
        if three[0].type not in ("i16", "f32") or not all(
            are_alike(a, b) for a, b in pairwise(three)
        ):
            continue
        columns = [read_part(aligned.rows, part) for part in three]
        size = np.sqrt(sum(column**2 for column in columns))
        usual = float(np.median(size))
        found = _as_gravity(first, usual, three[0].type)
        if found is None:
            continue
        spread = float(np.mean(np.abs(size - usual))) / usual
        merit = (first - begin) % 3 != 0, spread
        if spread <= ACCEL_SPREAD and (best is None or merit < best[0]):
            best = merit, found
    return None if best is None else best[1]


def are_alike(one: Part, other: Part) -> bool:
    """Return whether two parts are numbers of one kind, side by side."""
    kinds = {(part.type, part.byte_order) for part in (one, other)}
    return len(kinds) == 1 and one.at + one.size == other.at


def _as_gravity(first: int, usual: float, kind: str) -> Gravity | None:
    if kind == "f32":
        for unit, size in (("m/s2", GRAVITY_M_S2), ("g", 1.0)):
            if abs(usual / size - 1.0) <= SCALE_TOLERANCE:
                return Gravity(first, unit, 1.0)
        return None
    if usual < LEAST_COUNTS:
        return None
    for scale in USUAL_SCALES:
        if abs(usual / scale - 1.0) <= SCALE_TOLERANCE:
            return Gravity(first, "g", float(scale))
    return None


def read_part(rows: ByteArray, part: Part) -> FloatArray:
    """Return the numbers that a part of every row, shape (n, length), is, shape (n,)."""
    if part.type == "f32":
        return _floats(rows, part.at, part.byte_order)
    raw = numbers(rows, part.at, part.size, part.byte_order)
    if part.type.startswith("u"):
        return raw.astype(np.float64)
    half = 1 << (8 * part.size - 1)
    return np.asarray((raw + half) % (2 * half) - half, np.float64)


def _floats(rows: ByteArray, at: int, order: str) -> FloatArray:
    raw = np.ascontiguousarray(rows[:, at : at + 4])
    with np.errstate(invalid="ignore"):
        return np.asarray(raw.view("<f4" if order == "little" else ">f4")[:, 0], np.float64)


# --- what each reading costs ----------------------------------------------------------------------


class _Readings:
    """Costs of reading some bytes of every packet as one number."""

    def __init__(self, aligned: Aligned, usual_order: str) -> None:
        self.aligned, self.usual_order = aligned, usual_order
        self._steady = aligned.follows
        rows = aligned.rows
        self.constant = (rows == rows[0]).all(axis=0)

    def options(self, at: int, until: int) -> list[tuple[float, Part]]:
        """Return cost and kind of everything that may begin at ``at`` and end by ``until``."""
        if self.constant[at]:
            found = [(PAD, Part(at, "pad", 1))]
        else:
            found = [(SINGLE + self._bits(at, 1, "little"), Part(at, "u8", 1))]
        for order in ("little", "big"):
            penalty = FIELD + (0.0 if order == self.usual_order else OTHER_ORDER)
            if at + 2 <= until and not self.constant[at : at + 2].all():
                bits = penalty + self._bits(at, 2, order)
                found.append((bits, Part(at, "i16", 2, order)))
            if at + 4 > until or self.constant[at : at + 4].all():
                continue
            if self._is_float(at, order):
                bits = penalty + self._bits(at, 4, order) - FLOAT_BONUS
                found.append((bits, Part(at, "f32", 4, order)))
            found += [
                (penalty + self._bits(at, width, order), Part(at, f"i{8 * width}", width, order))
                for width in (3, 4)
                if self._is_wide(at, width, order)
            ]
        return found

    def _steps(self, at: int, width: int, order: str) -> AnyArray:
        difference = np.diff(numbers(self.aligned.rows, at, width, order))[self._steady]
        half = 1 << (8 * width - 1)
        return np.asarray((difference + half) % (2 * half) - half)

    def _bits(self, at: int, width: int, order: str) -> float:
        return float(np.mean(np.log2(1.0 + np.abs(self._steps(at, width, order)))))

    def _is_float(self, at: int, order: str) -> bool:
        size = np.abs(_floats(self.aligned.rows, at, order))
        sensible = (size == 0) | ((size >= LEAST_SENSIBLE) & (size <= GREATEST_SENSIBLE))
        if float(np.mean(sensible)) < SENSIBLE or not size.any():
            return False
        low = at if order == "little" else at + 2
        steps = np.abs(self._steps(low, 2, order))
        moving = steps[self._steps(at, 4, order) != 0]
        return len(moving) > 0 and float(np.mean(moving)) > ROUGH * (1 << 14)

    def _is_wide(self, at: int, width: int, order: str) -> bool:
        """Return whether what lies above 16 bits changes, and only with the bits below."""
        low = at if order == "little" else at + width - 2
        high = at + 2 if order == "little" else at
        top = at + width - 1 if order == "little" else at
        if self.constant[top] and width == 3:
            return False
        above = self._steps(high, width - 2, order)
        if not above.any():
            return False
        whole, below = self._steps(at, width, order), self._steps(low, 2, order)
        return bool(np.mean((whole == below)[above != 0]) >= COUPLED)


def _cheapest(readings: _Readings, stretch: range) -> tuple[float, list[Part]]:
    """Return the cheapest way to divide a stretch, from its end to its beginning."""
    ways: dict[int, tuple[float, Part | None]] = {stretch.stop: (0.0, None)}
    for at in reversed(stretch):
        ways[at] = min(
            (
                (cost + ways[at + part.size][0], part)
                for cost, part in readings.options(at, stretch.stop)
            ),
            key=lambda way: way[0],
        )
    parts, at = [], stretch.start
    while at < stretch.stop:
        part = ways[at][1]
        assert part is not None
        parts.append(part)
        at += part.size
    return ways[stretch.start][0], parts


def _stretches(free: set[int]) -> list[range]:
    found: list[range] = []
    for place in sorted(free):
        if found and found[-1].stop == place:
            found[-1] = range(found[-1].start, place + 1)
        else:
            found.append(range(place, place + 1))
    return found


def _joined_pads(parts: list[Part]) -> list[Part]:
    joined: list[Part] = []
    for part in parts:
        last = joined[-1] if joined else None
        if last is not None and last.type == part.type == "pad" and last.at + last.size == part.at:
            joined[-1] = Part(last.at, "pad", last.size + part.size)
        else:
            joined.append(part)
    return joined


def _signed(aligned: Aligned, parts: list[Part]) -> list[Part]:
    """Take numbers as unsigned that would leap between the ends of a signed range."""
    result = []
    for part in parts:
        if part.type in ("i16", "i24", "i32"):
            half = 1 << (8 * part.size - 1)
            raw = numbers(aligned.rows, part.at, part.size, part.byte_order)
            leaps = [
                int(np.count_nonzero(np.abs(np.diff(value)) > half))
                for value in (raw, (raw + half) % (2 * half))
            ]
            if leaps[0] < leaps[1]:
                part = Part(part.at, f"u{8 * part.size}", part.size, part.byte_order)
        result.append(part)
    return result
