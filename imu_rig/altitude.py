"""Altitude of a pressure and pressure at an altitude, in the air of the standard atmosphere.

Altitude here is that above the level where the pressure is the reference pressure. Weather moves
that level by tens of metres from day to day: only differences over minutes mean anything.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

SEA_LEVEL_PA = 101325.0
"""Pressure of the standard atmosphere at sea level."""

STANDARD_EXPONENT = 0.190263
"""R L / g of dry air, with the specific gas constant R = 287.053 J/(kg K)."""

STANDARD_LAPSE_PER_M = 2.25577e-5
"""L / T0: 6.5 K per km from 288.15 K on."""

PAPER_SEA_LEVEL_PA = 101300.0
PAPER_EXPONENT = 0.19
PAPER_LAPSE_PER_M = 2.2558e-5
"""What the published method for step length on slopes computes with."""


def altitude(pressure_pa: npt.ArrayLike, reference_pa: float = SEA_LEVEL_PA) -> FloatArray:
    """Return the altitude [m] of each pressure [Pa], by the standard atmosphere.

    Parameters
    ----------
    pressure_pa : any shape
        Not negative; NaN stays NaN.
    reference_pa : float
        Pressure at altitude 0.
    """
    return _altitude(pressure_pa, reference_pa, STANDARD_EXPONENT, STANDARD_LAPSE_PER_M)


def pressure_at(altitude_m: npt.ArrayLike, reference_pa: float = SEA_LEVEL_PA) -> FloatArray:
    """Return the pressure [Pa] at each altitude [m]: the inverse of :func:`altitude`."""
    return _pressure(altitude_m, reference_pa, STANDARD_EXPONENT, STANDARD_LAPSE_PER_M)


def paper_altitude(pressure_pa: npt.ArrayLike) -> FloatArray:
    """Return the altitude [m] of each pressure [Pa] as the published method computes it.

    ``(1 - (p / 1013 mbar)**0.19) / 2.2558e-5``; within 0.14 % of :func:`altitude` in slope.
    """
    return _altitude(pressure_pa, PAPER_SEA_LEVEL_PA, PAPER_EXPONENT, PAPER_LAPSE_PER_M)


def paper_pressure_at(altitude_m: npt.ArrayLike) -> FloatArray:
    """Return the pressure [Pa] at each altitude [m]: the inverse of :func:`paper_altitude`."""
    return _pressure(altitude_m, PAPER_SEA_LEVEL_PA, PAPER_EXPONENT, PAPER_LAPSE_PER_M)


def _altitude(
    pressure_pa: npt.ArrayLike, reference_pa: float, exponent: float, lapse_per_m: float
) -> FloatArray:
    ratio = np.asarray(pressure_pa, dtype=np.float64) / reference_pa
    with np.errstate(invalid="ignore"):  # below nothing there is no altitude
        result: FloatArray = (1.0 - ratio**exponent) / lapse_per_m
    return result


def _pressure(
    altitude_m: npt.ArrayLike, reference_pa: float, exponent: float, lapse_per_m: float
) -> FloatArray:
    warmth = 1.0 - lapse_per_m * np.asarray(altitude_m, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        result: FloatArray = reference_pa * warmth ** (1.0 / exponent)
    return result
