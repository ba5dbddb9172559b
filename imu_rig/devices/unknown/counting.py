"""Numbers in unknown packets that go up from packet to packet: counters and clocks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import BoolArray, ByteArray, FloatArray, IntArray
from imu_rig.devices.unknown.period import Aligned

LEAST_STEPS = 12
STEADY = 0.9  # share of the steps that must agree; the others are losses and damage
WIDEST = 4
ABOUT = 1.1  # as steady as another
NEAR = 0.5  # of the usual step that a step of a clock may differ from it

NICE_TICKS_S = (1e-9, 1e-7, 1e-6, 4e-6, 1e-5, 1 / 32_768, 1e-4, 1 / 1024, 1e-3, 1e-2)
TICK_TOLERANCE = 0.06
"""The rate by which a tick is judged is that of a few seconds by the host's clock."""


@dataclass(frozen=True)
class Going:
    """A number that goes up.

    Attributes
    ----------
    at, width : int
        First of its bytes in the packet, and how many change.
    byte_order : str
        "little" or "big"; "little" too for one byte.
    step : float
        Usual step from packet to packet.
    exact : bool
        Whether every step is that one.
    """

    at: int
    width: int
    byte_order: str
    step: float
    exact: bool

    @property
    def places(self) -> range:
        """Its bytes."""
        return range(self.at, self.at + self.width)


def numbers(rows: ByteArray, at: int, width: int, byte_order: str) -> IntArray:
    """Return the unsigned numbers of ``width`` bytes from ``at`` on, shape (n,), int64."""
    part = rows[:, at : at + width].astype(np.int64)
    if byte_order == "little":
        part = part[:, ::-1]
    result = np.zeros(len(rows), np.int64)
    for column in part.T:
        result = (result << 8) | column
    return result


def steps(aligned: Aligned, at: int, width: int, byte_order: str) -> IntArray:
    """Return how much such a number goes up from row to next row, modulo its width."""
    difference = np.diff(numbers(aligned.rows, at, width, byte_order))[aligned.follows]
    return np.asarray(difference % (1 << (8 * width)))


def find_counter(aligned: Aligned, free: set[int]) -> Going | None:
    """Return the number among the ``free`` places that goes up by one, the widest there is."""
    best: Going | None = None
    for low in sorted(free):
        if not _always(steps(aligned, low, 1, "little"), 1):
            continue
        found = Going(low, 1, "little", 1.0, True)
        for order in ("little", "big"):
            wider = _widened(aligned, free, low, order)
            found = wider if wider.width > found.width else found
        if best is None or found.width > best.width:
            best = found
    return best


def _widened(aligned: Aligned, free: set[int], low: int, order: str) -> Going:
    """Take further bytes as long as they change, and only by what the lower ones carry."""
    at, width = low, 1
    while width < WIDEST:
        more = at + width if order == "little" else at - 1
        begin = at if order == "little" else at - 1
        if more not in free or not _changes(aligned, more):
            break
        taken = steps(aligned, begin, width + 1, order)
        if not _always(taken, 1) or not _carried(aligned, more, taken == 1):
            break
        at, width = begin, width + 1
    return Going(at, width, order, 1.0, True)


def _always(taken: IntArray, step: int) -> bool:
    return len(taken) >= LEAST_STEPS and bool(np.mean(taken == step) >= STEADY)


def _carried(aligned: Aligned, place: int, right: BoolArray) -> bool:
    """Return whether the steps are right where the byte at ``place`` changes, as by a carry."""
    changed = steps(aligned, place, 1, "little") != 0
    return bool(changed.any()) and bool(np.mean(right[changed]) >= STEADY)


def _changes(aligned: Aligned, place: int) -> bool:
    column = aligned.rows[:, place]
    return bool((column != column[0]).any())


def find_clock(aligned: Aligned, free: set[int], rate_hz: float | None = None) -> Going | None:
    """Return the number among the ``free`` places that goes up steadily by more than one.

    Of several readings the steadiest is right: a wrong byte order or a byte too few makes the
    steps uneven. A byte too many at the low end hardly does; a usual tick tells it then, and
    otherwise the narrower reading is taken. Bytes above those that change may belong to the clock
    as well; without them it only turns over sooner.
    """
    readings: list[tuple[float, Going]] = []
    for low in sorted(free):
        if not _changes(aligned, low):
            continue
        for order in ("little", "big"):
            widest = _widest_clock(aligned, free, low, order)
            readings += [] if widest is None else [widest]
    if not readings:
        return None
    steadiest = min(spread for spread, _ in readings)

    def merit(going: Going) -> tuple[bool, int]:
        usual = rate_hz is not None and tick_s(going.step, rate_hz)[1]
        return not usual, going.width

    return min((g for spread, g in readings if spread <= ABOUT * steadiest), key=merit)


def _widest_clock(
    aligned: Aligned, free: set[int], low: int, order: str
) -> tuple[float, Going] | None:
    """Return spread and clock of the widest reading with this low byte whose top byte changes."""
    found = None
    for width in range(2, WIDEST + 1):
        at = low if order == "little" else low - width + 1
        top = at + width - 1 if order == "little" else at
        if not free.issuperset(range(at, at + width)) or not _changes(aligned, top):
            break
        taken = steps(aligned, at, width, order)
        spread, step = _steadiness(taken, width)
        if spread is None or not _carried(aligned, top, np.abs(taken - step) <= NEAR * step):
            continue
        if found is None or spread <= ABOUT * found[0]:
            found = spread, Going(at, width, order, step, spread == 0.0)
    return found


def _steadiness(taken: IntArray, width: int) -> tuple[float | None, float]:
    """Return how much the steps of a clock differ, as a share of the usual one; None for others."""
    if len(taken) < LEAST_STEPS:
        return None, 0.0
    usual = float(np.median(taken))
    if not 2 <= usual < (1 << (8 * width)) / 4:
        return None, usual
    near: FloatArray = np.abs(taken - usual)
    inside = near <= NEAR * usual
    if float(np.mean(inside)) < STEADY:
        return None, usual
    return float(np.std(taken[inside])) / usual, float(np.mean(taken[inside]))


def tick_s(step: float, rate_hz: float) -> tuple[float, bool]:
    """Return one count of a clock [s] and whether that is a usual one, given packets per second."""
    measured = 1.0 / (step * rate_hz)
    nearest = min(NICE_TICKS_S, key=lambda nice: abs(math.log(nice / measured)))
    if abs(nearest / measured - 1.0) <= TICK_TOLERANCE:
        return nearest, True
    return float(f"{measured:.4g}"), False
