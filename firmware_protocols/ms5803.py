"""The MS5803 barometer: its PROM, its commands, and pressure from what its converter counts.

The chip sends two 24-bit counts, D1 of pressure and D2 of temperature. Eight 16-bit words of its
PROM, different in every chip, turn them into pressure and temperature. The arithmetic is that of
whole numbers, and every division rounds down (a shift to the right); C drivers that round towards
zero differ by at most one count below 20 degC. The four members of the family differ in shifts
and in the correction for cold and heat; the shifts of one on the counts of another give a
pressure that is wrong by a factor.

Sources: application note AN520 of the maker for the CRC and the commands; for the 02BA the
public drivers ``millerlp/MS5803_02`` and ``ControlEverythingCommunity/MS5803-02BA`` and the
data sheets of the sister parts MS5607-02BA and MS5837-02BA; for the others
``millerlp/MS5803_01``, ``_05`` and ``_14`` with ``NorthernWidget/MS5803``. What those leave open
is in :mod:`firmware_protocols.unconfirmed`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from firmware_protocols.unconfirmed import MS5803_01BA_COLD_SENS, MS5803_01BA_HOT_SENS

IntArray = npt.NDArray[np.int64]
FloatArray = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

PROM_WORDS = 8
MAX_COUNT = 2**24 - 1
"""The greatest D1 or D2."""

RESET = 0x1E
CONVERT_D1 = 0x40
CONVERT_D2 = 0x50
ADC_READ = 0x00
PROM_READ = 0xA0
"""Command of PROM word 0; word i is at ``PROM_READ + 2 * i``."""

OVERSAMPLING = (256, 512, 1024, 2048, 4096)
"""Oversampling ratios; the i-th adds ``2 * i`` to a convert command."""


@dataclass(frozen=True)
class Term:
    """A correction ``factor * x**2 / 2**shift`` of whole numbers, its size rounded down."""

    factor: int = 0
    shift: int = 0

    def of(self, squared: IntArray) -> IntArray:
        """Return the correction for x squared."""
        size: IntArray = (squared * abs(self.factor)) >> self.shift
        return size if self.factor >= 0 else -size


@dataclass(frozen=True)
class SecondOrder:
    """The correction of one range of temperature, of x = dT for t2 and x = TEMP - from for others.

    Attributes
    ----------
    t2, off2, sens2 : Term
        What is taken from temperature, offset and sensitivity.
    """

    t2: Term = Term()
    off2: Term = Term()
    sens2: Term = Term()


@dataclass(frozen=True)
class Variant:
    """What one member of the family computes with.

    Attributes
    ----------
    name : str
        As in the type: MS5803-NAME.
    off, tco, sens, tcs : int
        Shifts: ``OFF = C2 * 2**off + C4 * dT / 2**tco`` and
        ``SENS = C1 * 2**sens + C3 * dT / 2**tcs``.
    count_pa : int
        One count of the computed pressure [Pa].
    cold, very_cold, warm, hot : SecondOrder
        Below 20 degC; in addition below -15 degC; from 20 degC on; in addition above 45 degC.
    """

    name: str
    off: int
    tco: int
    sens: int
    tcs: int
    count_pa: int
    cold: SecondOrder
    very_cold: SecondOrder
    warm: SecondOrder = SecondOrder()
    hot: SecondOrder = SecondOrder()


VARIANTS = {
    variant.name: variant
    for variant in (
        Variant(
            "01BA",
            off=16,
            tco=7,
            sens=15,
            tcs=8,
            count_pa=1,
            cold=SecondOrder(Term(1, 31), Term(3), Term(7, 3)),
            very_cold=SecondOrder(sens2=Term(MS5803_01BA_COLD_SENS)),
            hot=SecondOrder(sens2=Term(*MS5803_01BA_HOT_SENS)),
        ),
        Variant(
            "02BA",
            off=17,
            tco=6,
            sens=16,
            tcs=7,
            count_pa=1,
            cold=SecondOrder(Term(1, 31), Term(61, 4), Term(2)),
            very_cold=SecondOrder(off2=Term(20), sens2=Term(12)),
        ),
        Variant(
            "05BA",
            off=18,
            tco=5,
            sens=17,
            tcs=7,
            count_pa=1,
            cold=SecondOrder(Term(3, 33), Term(3, 3), Term(7, 3)),
            very_cold=SecondOrder(sens2=Term(3)),
        ),
        Variant(
            "14BA",
            off=16,
            tco=7,
            sens=15,
            tcs=8,
            count_pa=10,
            cold=SecondOrder(Term(3, 33), Term(3, 1), Term(5, 3)),
            very_cold=SecondOrder(off2=Term(7), sens2=Term(4)),
            warm=SecondOrder(Term(7, 37), Term(1, 4)),
        ),
    )
}
"""Every member that can be computed with, by its name."""


@dataclass(frozen=True)
class Intermediate:
    """What the data sheets print between counts and pressure; shapes (n,), whole numbers.

    Attributes
    ----------
    dt : IntArray
        D2 less the count of 20 degC.
    temp : IntArray
        Temperature [0.01 degC], corrected.
    off, sens : IntArray
        Offset and sensitivity, corrected.
    """

    dt: IntArray
    temp: IntArray
    off: IntArray
    sens: IntArray


def compensate(
    variant: str, prom: npt.ArrayLike, d1: npt.ArrayLike, d2: npt.ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return pressure and temperature of counts, exactly as the data sheet computes them.

    Any input gives an answer: no whole number of 24 bits can overflow 64, and greater ones are no
    readings.

    Parameters
    ----------
    variant : str
        One of :data:`VARIANTS`.
    prom : shape (n, 8) or (8,)
        PROM words that go with each pair of counts, 0 to 65535.
    d1, d2 : shape (n,)
        Counts of pressure and of temperature, 0 to 2**24 - 1.

    Returns
    -------
    pressure, temperature : shape (n,)
        [Pa] and [degC]; NaN where the PROM is not sound or D1 or D2 is no reading.
    """
    words = np.atleast_2d(np.asarray(prom, dtype=np.int64))
    d1, d2 = np.atleast_1d(np.asarray(d1, np.int64)), np.atleast_1d(np.asarray(d2, np.int64))
    between = intermediate(variant, words, d2)
    unit = VARIANTS[variant].count_pa
    pressure = _pressure_counts(d1, between).astype(np.float64) * unit
    temperature = between.temp / 100.0
    unusable = ~prom_is_sound(words) | ~is_reading(d1) | ~is_reading(d2)
    pressure[unusable] = np.nan
    temperature[unusable] = np.nan
    return pressure, temperature


def is_reading(raw: npt.ArrayLike) -> Flags:
    """Return whether each D1 or D2, shape (n,), is one that the chip gives.

    0 is what it answers when no conversion was finished; 24 bits hold nothing above
    :data:`MAX_COUNT`, though a field of a packet may.
    """
    numbers = np.asarray(raw, dtype=np.int64)
    within: Flags = (numbers > 0) & (numbers <= MAX_COUNT)
    return within


def intermediate(variant: str, prom: npt.ArrayLike, d2: npt.ArrayLike) -> Intermediate:
    """Return temperature, offset and sensitivity of temperature counts; see :func:`compensate`."""
    kind = VARIANTS[variant]
    words = np.atleast_2d(np.asarray(prom, dtype=np.int64))
    c1, c2, c3, c4, c5, c6 = words[:, 1:7].T
    dt = np.atleast_1d(np.asarray(d2, np.int64)) - (c5 << 8)
    temp = 2000 + ((dt * c6) >> 23)
    off = (c2 << kind.off) + ((c4 * dt) >> kind.tco)
    sens = (c1 << kind.sens) + ((c3 * dt) >> kind.tcs)
    t2, off2, sens2 = (np.zeros_like(temp) for _ in range(3))
    for applies, order, origin in (
        (temp < 2000, kind.cold, 2000),
        (temp < -1500, kind.very_cold, -1500),
        (temp >= 2000, kind.warm, 2000),
        (temp > 4500, kind.hot, 4500),
    ):
        if order == SecondOrder() or not applies.any():
            continue
        away = np.where(applies, temp - origin, 0) ** 2
        t2 += order.t2.of(np.where(applies, dt, 0) ** 2)
        off2 += order.off2.of(away)
        sens2 += order.sens2.of(away)
    return Intermediate(dt, temp - t2, off - off2, sens - sens2)


def counts_for(
    variant: str, prom: npt.ArrayLike, pressure_pa: npt.ArrayLike, temperature_degc: npt.ArrayLike
) -> tuple[IntArray, IntArray]:
    """Return the counts D1, D2 that a chip gives: the inverse of :func:`compensate`.

    Temperature is met to 0.01 degC (0.02 where two roundings meet), pressure to one count of the
    variant, rounded to the nearest; what 24 bits cannot hold stays at their ends.

    Parameters
    ----------
    variant : str
        One of :data:`VARIANTS`.
    prom : shape (8,)
        PROM of the one chip.
    pressure_pa, temperature_degc : shape (n,)
        Finite.

    Returns
    -------
    d1, d2 : shape (n,), int64, 1 to 2**24 - 1
    """
    words = np.asarray(prom, dtype=np.int64)
    kind = VARIANTS[variant]
    temp = np.atleast_1d(np.rint(np.asarray(temperature_degc) * 100.0)).astype(np.int64)
    pressure = np.atleast_1d(np.rint(np.asarray(pressure_pa) / kind.count_pa)).astype(np.int64)
    low, high = np.ones_like(temp), np.full_like(temp, MAX_COUNT)
    while bool((low < high).any()):  # temperature rises with D2, yet not along a straight line
        middle = (low + high) >> 1
        warmer = intermediate(variant, words, middle).temp >= temp
        high = np.where(warmer, middle, high)
        low = np.where(warmer, low, np.minimum(middle + 1, high))
    between = intermediate(variant, words, low)
    sens = np.maximum(between.sens, 1)  # a PROM of nonsense
    numerator = ((pressure << 15) + between.off) << 21
    d1 = -(-numerator // sens)  # rounded up: the first count that reaches the pressure
    return np.clip(d1, 1, MAX_COUNT), low


def prom_crc(prom: npt.ArrayLike) -> IntArray:
    """Return the CRC-4 of PROM words, shape (n, 8) or (8,); the CRC's own byte counts as 0."""
    words = np.atleast_2d(np.asarray(prom, dtype=np.int64)) & 0xFFFF
    eight_shifts = _eight_shifts()
    rest = np.zeros(len(words), dtype=np.int64)
    for place in range(2 * PROM_WORDS - 1):
        byte = words[:, place >> 1] >> (0 if place & 1 else 8) & 0xFF
        rest = eight_shifts[rest ^ byte]
    return eight_shifts[rest] >> 12


def with_crc(prom: npt.ArrayLike) -> IntArray:
    """Return one PROM, shape (8,), with the low byte of its last word set to its CRC."""
    words = np.array(prom, dtype=np.int64)
    words[7] = (words[7] & 0xFF00) | prom_crc(words)[0]
    return words


def prom_is_sound(prom: npt.ArrayLike) -> Flags:
    """Return for each PROM, shape (n, 8) or (8,), whether it can be computed with.

    Its CRC must hold and none of C1 to C6 may be 0: a line that is always low reads as words of 0,
    and their CRC holds.
    """
    words = np.atleast_2d(np.asarray(prom, dtype=np.int64))
    if len(words) > 1 and bool((words == words[0]).all()):
        return np.repeat(prom_is_sound(words[0]), len(words))
    sound: Flags = (words[:, 7] & 0xF) == prom_crc(words)
    sound &= (words[:, 1:7] != 0).all(axis=1)
    return sound


def _pressure_counts(d1: IntArray, between: Intermediate) -> IntArray:
    result: IntArray = (((d1 * between.sens) >> 21) - between.off) >> 15
    return result


@cache
def _eight_shifts() -> IntArray:
    """Return what eight steps of the CRC make of every 16-bit rest."""
    rest = np.arange(1 << 16, dtype=np.int64)
    for _ in range(8):
        rest = (rest << 1) ^ np.where(rest & 0x8000, 0x3000, 0)
        rest &= 0xFFFF
    return rest
