"""The gravity a calibration is scaled to, and normal gravity from latitude and height."""

from __future__ import annotations

import math
from dataclasses import dataclass

from imu_rig.errors import InputError
from imu_rig.units import STANDARD_GRAVITY

PLAUSIBLE = (9.70, 9.90)
"""Gravity anywhere on the Earth's surface lies inside [m/s^2]."""


@dataclass(frozen=True)
class Gravity:
    """Magnitude of local gravity and where the figure comes from.

    Attributes
    ----------
    value : float
        Magnitude [m/s^2].
    source : str
        ``"standard"`` (assumed), ``"given"`` or the latitude and height it was computed from.
    known : bool
        Whether the figure is local; if not, scales are relative to standard gravity.
    latitude_deg : float or None
        Latitude, where it was given: it tells how the Earth's rotation points.
    """

    value: float = STANDARD_GRAVITY
    source: str = "standard"
    known: bool = False
    latitude_deg: float | None = None

    @staticmethod
    def given(value: float) -> Gravity:
        """Local gravity as the user states it [m/s^2]."""
        if not PLAUSIBLE[0] <= value <= PLAUSIBLE[1]:
            raise InputError(
                f"gravity {value:g} m/s^2 is not possible on the Earth's surface; give a value "
                f"from {PLAUSIBLE[0]} to {PLAUSIBLE[1]} m/s^2, or latitude and height"
            )
        return Gravity(value, "given", known=True)

    @staticmethod
    def at(latitude_deg: float, height_m: float = 0.0) -> Gravity:
        """Take normal gravity at a place; see `normal_gravity`."""
        value = normal_gravity(latitude_deg, height_m)
        source = f"WGS-84 at {latitude_deg:g} deg, {height_m:g} m"
        return Gravity(value, source, known=True, latitude_deg=latitude_deg)

    @property
    def statement(self) -> str:
        """One sentence for a report."""
        if self.known:
            return f"Scaled to local gravity {self.value:.5f} m/s^2 ({self.source})."
        return (
            f"Scaled to standard gravity {self.value:.5f} m/s^2: local gravity was not given and "
            "differs by up to 0.3 %, and so may every accelerometer scale and bias."
        )


def normal_gravity(latitude_deg: float, height_m: float = 0.0) -> float:
    """WGS-84 normal gravity [m/s^2] at a geodetic latitude and a height above the ellipsoid.

    Somigliana's closed formula with the height term to second order (NGA.STND.0036, 4-1 and 4-3).

    Raises
    ------
    InputError
        A latitude outside -90..90 deg or a height outside -500..9000 m.
    """
    if not -90.0 <= latitude_deg <= 90.0:
        raise InputError(f"latitude {latitude_deg:g} deg is not between -90 and 90")
    if not -500.0 <= height_m <= 9000.0:
        raise InputError(f"height {height_m:g} m is not between -500 and 9000")
    a, flattening = 6378137.0, 1.0 / 298.257223563
    equator, k, e2, m = 9.7803253359, 0.00193185265241, 0.00669437999014, 0.00344978650684
    sine2 = math.sin(math.radians(latitude_deg)) ** 2
    surface = equator * (1.0 + k * sine2) / math.sqrt(1.0 - e2 * sine2)
    linear = 2.0 / a * (1.0 + flattening + m - 2.0 * flattening * sine2) * height_m
    return surface * (1.0 - linear + 3.0 * height_m**2 / a**2)
