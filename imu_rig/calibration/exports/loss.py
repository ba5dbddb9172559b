"""How much a target that cannot hold a whole calibration falsifies."""

from __future__ import annotations

from dataclasses import dataclass

from imu_rig.units import DEG, MILLI_G


@dataclass(frozen=True)
class Loss:
    """Worst error against the whole calibration, None where a sensor is not exported.

    Attributes
    ----------
    accel : float or None
        Of a reading at rest, over all attitudes [m/s^2].
    turn : float or None
        Of a turn by 90 deg in 1.5 s, over all axes [rad].
    field : float or None
        Of the measured field, over all directions, as a part of the field.
    """

    accel: float | None = None
    turn: float | None = None
    field: float | None = None

    @property
    def lost(self) -> tuple[str, ...]:
        """What is lost beyond the rounding of a parameter's value, in words."""
        sizes = {
            "cross terms of the accelerometer": (self.accel, 0.01 * MILLI_G),
            "gains and cross terms of the gyroscope": (self.turn, 0.001 * DEG),
            "the turn of the magnetometer's axes": (self.field, 1e-5),
        }
        return tuple(
            words for words, (size, least) in sizes.items() if size is not None and size > least
        )

    @property
    def words(self) -> str:
        """``readings at rest by up to 18.3 mg, a 90 deg turn by up to 1.92 deg``."""
        parts = []
        if self.accel is not None:
            parts.append(f"readings at rest by up to {self.accel / MILLI_G:.3g} mg")
        if self.turn is not None:
            parts.append(f"a 90 deg turn by up to {self.turn / DEG:.3g} deg")
        if self.field is not None:
            parts.append(f"the magnetic field by up to {100 * self.field:.3g} %")
        return ", ".join(parts)

    def figures(self) -> dict[str, float]:
        """Return the same in units of people, for JSON."""
        found = {
            "accel_mg": None if self.accel is None else self.accel / MILLI_G,
            "turn_90_deg": None if self.turn is None else self.turn / DEG,
            "field_percent": None if self.field is None else 100 * self.field,
        }
        return {name: value for name, value in found.items() if value is not None}
