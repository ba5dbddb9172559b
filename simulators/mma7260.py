"""The MMA7260QT: an accelerometer with analogue outputs, and the converter that reads it.

Each axis is a voltage: half the supply at rest without gravity, and so many millivolts per g as
the two pins g-Select say. Both are in proportion to the supply, so a converter whose reference is
the same supply counts alike at any voltage. The output ends a little before ground and supply.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from firmware_protocols.unconfirmed import (
    MMA7260_BANDWIDTH_HZ,
    MMA7260_G_SELECT,
    MMA7260_NOISE_UG,
    MMA7260_SWING_V,
)
from imu_rig.arrays import FloatArray, IntArray

NOMINAL_SUPPLY_V = 3.3
"""What the millivolts per g of the data sheet are for."""


@dataclass(frozen=True)
class Mma7260:
    """One accelerometer at a setting of its pins.

    Attributes
    ----------
    g_select : int
        g-Select2 and g-Select1 as one number, 0 to 3: +-1.5, 2, 4 or 6 g.
    supply_v : float
        2.2 to 3.6.
    asleep : bool
        Whether the pin Sleep is low: all outputs at ground.
    """

    g_select: int
    supply_v: float = NOMINAL_SUPPLY_V
    asleep: bool = False

    def __post_init__(self) -> None:
        if self.g_select not in MMA7260_G_SELECT:
            raise ValueError(f"g-Select is 0 to 3, not {self.g_select}.")

    @property
    def range_g(self) -> float:
        """Nominal end of the range [g]."""
        return MMA7260_G_SELECT[self.g_select][0]

    @property
    def volts_per_g(self) -> float:
        """Nominal sensitivity at this supply."""
        millivolts = MMA7260_G_SELECT[self.g_select][1]
        return millivolts * 1e-3 * self.supply_v / NOMINAL_SUPPLY_V

    @property
    def end_g(self) -> float:
        """Where the output ends [g], somewhat beyond the nominal range."""
        return (self.supply_v / 2.0 - MMA7260_SWING_V) / self.volts_per_g

    def volts(self, accel_g: FloatArray) -> FloatArray:
        """Return the outputs for readings in g, any shape."""
        if self.asleep:
            return np.zeros_like(accel_g)
        free = self.supply_v / 2.0 + accel_g * self.volts_per_g
        return np.clip(free, MMA7260_SWING_V, self.supply_v - MMA7260_SWING_V)


@dataclass(frozen=True)
class Converter:
    """An analogue-to-digital converter.

    Attributes
    ----------
    bits : int
    reference_v : float
        The voltage of one count more than the greatest.
    """

    bits: int = 12
    reference_v: float = NOMINAL_SUPPLY_V

    def counts(self, volts: FloatArray) -> IntArray:
        """Return the nearest counts; beyond the ends, those of the ends."""
        whole = np.rint(volts * (1 << self.bits) / self.reference_v)
        return np.clip(whole, 0, (1 << self.bits) - 1).astype(np.int64)


def counts_per_g(g_select: int, bits: int, reference_v: float, supply_v: float) -> float:
    """Return how many counts of a converter one g is, nominally."""
    return Mma7260(g_select, supply_v).volts_per_g * (1 << bits) / reference_v


def noise_mg(bandwidth_hz: float) -> float:
    """Return the standard deviation [mg] of one reading behind a filter of one pole."""
    return MMA7260_NOISE_UG * 1e-3 * math.sqrt(bandwidth_hz * math.pi / 2.0)


def sampled_noise_ug(sample_hz: float, bandwidth_hz: float = MMA7260_BANDWIDTH_HZ[0]) -> float:
    """Return the noise density [ug per root hertz] of readings at a rate below the bandwidth.

    A converter that samples without averaging folds all the noise of the bandwidth into half its
    rate.
    """
    return noise_mg(bandwidth_hz) * 1e3 / math.sqrt(sample_hz / 2.0)
