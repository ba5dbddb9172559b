"""How much a target that cannot hold a whole calibration falsifies."""

from __future__ import annotations

from dataclasses import dataclass

from imu_rig.units import DEG, MILLI_G

LEAST_ACCEL = 0.01 * MILLI_G
LEAST_TURN = 0.001 * DEG
LEAST_FIELD = 1e-5
"""What is less is the rounding of a parameter."""


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
        names = (
            (self.accel, LEAST_ACCEL, "cross terms of the accelerometer"),
            (self.turn, LEAST_TURN, "gains and cross terms of the gyroscope"),
            (self.field, LEAST_FIELD, "the turn of the magnetometer's axes"),
        )
        return tuple(words for size, least, words in names if size is not None and size > least)

    @property
    def words(self) -> str:
        """``readings at rest by up to 18.3 mg, a 90 deg turn by up to 1.92 deg``.

        What only a parameter's rounding falsifies is left out.
        """
        sizes = (
            (self.accel, LEAST_ACCEL, MILLI_G, "readings at rest by up to {:.3g} mg"),
            (self.turn, LEAST_TURN, DEG, "a 90 deg turn by up to {:.3g} deg"),
            (self.field, LEAST_FIELD, 0.01, "the magnetic field by up to {:.3g} %"),
        )
        parts = [
            words.format(size / unit)
            for size, least, unit, words in sizes
            if size is not None and size > least
        ]
        return ", ".join(parts) or "nothing"

    def figures(self) -> dict[str, float]:
        """Return the same in units of people, for JSON."""
        found = {
            "accel_mg": None if self.accel is None else self.accel / MILLI_G,
            "turn_90_deg": None if self.turn is None else self.turn / DEG,
            "field_percent": None if self.field is None else 100 * self.field,
        }
        return {name: value for name, value in found.items() if value is not None}
