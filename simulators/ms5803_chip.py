"""An MS5803 barometer as its bus sees it: commands in, bytes out.

The host starts a conversion, waits, and reads the result once; a read too early or a second one
gives 0. Its counts are those that the chip's own PROM turns back into the pressure and temperature
of the air, with the noise of the oversampling.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from firmware_protocols.ms5803 import (
    ADC_READ,
    CONVERT_D1,
    CONVERT_D2,
    OVERSAMPLING,
    PROM_READ,
    PROM_WORDS,
    RESET,
    VARIANTS,
    IntArray,
    counts_for,
    with_crc,
)
from firmware_protocols.unconfirmed import (
    MS5803_EARLY_READ,
    MS5803_LONGEST_CONVERSION_S,
    MS5803_PRESSURE_NOISE_PA,
    MS5803_RESET_S,
    MS5803_TEMPERATURE_NOISE_C,
)
from imu_rig.arrays import FloatArray

TYPICAL_CONVERSION_S = {256: 0.5e-3, 512: 1.1e-3, 1024: 2.1e-3, 2048: 4.1e-3, 4096: 8.22e-3}

TYPICAL_PROMS = {
    "01BA": (40127, 36924, 23317, 23282, 33464, 28312),
    "02BA": (46372, 43981, 29059, 27842, 31553, 28165),
    "05BA": (46546, 42845, 29751, 29457, 32745, 29059),
    "14BA": (46546, 42845, 29751, 29457, 32745, 29059),
}
"""C1 to C6 as the data sheets print them; of the 05BA, for which none was at hand, the 14BA's."""

COEFFICIENT_SPREAD = 0.02

Air = Callable[[float], tuple[float, float]]
"""Pressure [Pa] and temperature [degC] of the air at a time [s]."""


def typical_prom(variant: str = "02BA") -> IntArray:
    """Return the PROM of a data sheet, shape (8,)."""
    return with_crc([0, *TYPICAL_PROMS[variant], 0])


def draw_prom(rng: np.random.Generator, variant: str = "02BA") -> IntArray:
    """Draw the PROM of one chip, shape (8,): near the typical one, with a right CRC."""
    spread = rng.uniform(1.0 - COEFFICIENT_SPREAD, 1.0 + COEFFICIENT_SPREAD, 6)
    coefficients = np.rint(np.array(TYPICAL_PROMS[variant]) * spread).astype(np.int64)
    return with_crc([int(rng.integers(1 << 16)), *coefficients, int(rng.integers(1 << 8)) << 8])


class Ms5803Chip:
    """One chip on an I2C bus.

    Parameters
    ----------
    prom : shape (8,)
        Its true coefficients.
    rng : numpy Generator
        For noise.
    variant : str
        One of :data:`firmware_protocols.ms5803.VARIANTS`.
    air : callable, optional
        Only needed where conversions are started by command.
    """

    def __init__(
        self,
        prom: IntArray,
        rng: np.random.Generator,
        variant: str = "02BA",
        air: Air | None = None,
    ) -> None:
        if variant not in VARIANTS:
            raise ValueError(f"there is no MS5803-{variant}; take one of {', '.join(VARIANTS)}.")
        self.variant = variant
        self.prom = np.array(prom, dtype=np.int64)
        self._true_prom = self.prom.copy()
        self._rng = rng
        self._air = air
        self._slowness = float(rng.uniform())  # from the typical to the longest conversion
        self._ready_s = 0.0
        self._result: int | None = None
        self._answer = b""

    def damage_prom(self, word: int, bit: int) -> None:
        """Let a bit of the PROM read wrong from now on; the sensor itself stays as it is."""
        self.prom[word] ^= 1 << bit

    def conversion_s(self, oversampling: int) -> float:
        """Return how long this chip takes for a conversion."""
        typical, longest = (
            TYPICAL_CONVERSION_S[oversampling],
            MS5803_LONGEST_CONVERSION_S[oversampling],
        )
        return typical + self._slowness * (longest - typical)

    def command(self, byte: int, now_s: float) -> None:
        """Take a command byte; all but the one that asks for the result end a conversion."""
        busy = now_s < self._ready_s
        self._answer = b""
        if byte == ADC_READ:
            result = MS5803_EARLY_READ if busy or self._result is None else self._result
            self._result = None
            self._answer = result.to_bytes(3, "big")
            return
        self._result = None
        if byte == RESET:
            self._ready_s = now_s + MS5803_RESET_S
        elif PROM_READ <= byte < PROM_READ + 2 * PROM_WORDS and byte % 2 == 0:
            word = 0 if busy else int(self.prom[(byte - PROM_READ) // 2])
            self._answer = word.to_bytes(2, "big")
        elif byte & 0xE0 == CONVERT_D1 and byte & 0x0F in range(0, 2 * len(OVERSAMPLING), 2):
            self._convert(byte & 0xF0, OVERSAMPLING[(byte & 0x0F) // 2], now_s)

    def read(self, number: int) -> bytes:
        """Return the answer to the last command; bytes that it does not have are 0."""
        answer, self._answer = self._answer, b""
        return answer[:number].ljust(number, b"\0")

    def counts(
        self, pressure: FloatArray, temperature: FloatArray, oversampling: int = 4096
    ) -> tuple[IntArray, IntArray]:
        """Return D1 and D2, shape (n,), for pressures [Pa] and temperatures [degC], with noise."""
        noise = self._rng.standard_normal((len(pressure), 2))
        noise *= (
            MS5803_PRESSURE_NOISE_PA[oversampling],
            MS5803_TEMPERATURE_NOISE_C[oversampling],
        )
        return counts_for(
            self.variant, self._true_prom, pressure + noise[:, 0], temperature + noise[:, 1]
        )

    def _convert(self, which: int, oversampling: int, now_s: float) -> None:
        if self._air is None:
            raise ValueError("this chip is in no air; give it one.")
        pressure, temperature = self._air(now_s)
        d1, d2 = self.counts(np.array([pressure]), np.array([temperature]), oversampling)
        self._result = int(d2[0] if which == CONVERT_D2 else d1[0])
        self._ready_s = now_s + self.conversion_s(oversampling)
