"""Two certificates of one sensor side by side: what drifted between them.

What is compared are figures of the sensor itself (scale, angles between axes, bias), in which the
frame that a calibration is expressed in has no part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.calibration.accuracy import TURN_ANGLE, TURN_DURATION_S
from imu_rig.calibration.certificate import Certificate
from imu_rig.calibration.model import AXES, Affine, PhysicalFigures, physical_figures, sensor_frame
from imu_rig.errors import InputError
from imu_rig.foreign_text import one_line
from imu_rig.units import DEG, MILLI_G

DRIFTED = 3.0
"""Difference, in its own standard deviations, from which on a parameter counts as drifted."""
SAME_GRAVITY = 1e-7
UNCERTAIN = 1e-12
"""A standard uncertainty below belongs to what was fixed, not estimated."""


@dataclass(frozen=True)
class Difference:
    """One parameter in two certificates, in the unit of people.

    Attributes
    ----------
    sensor, name, unit : str
        ``accelerometer``, ``scale x``, ``%``.
    first, second : float
        The two values.
    change : float
        ``second - first``.
    sigma : float
        Standard uncertainty of the change; 0 where one of the two was fixed, not estimated.
    """

    sensor: str
    name: str
    unit: str
    first: float
    second: float
    change: float
    sigma: float

    @property
    def deviations(self) -> float | None:
        """Change in its own standard deviations; None where there is no uncertainty."""
        return None if self.sigma < UNCERTAIN else self.change / self.sigma

    @property
    def drifted(self) -> bool:
        """Whether the change is more than chance explains."""
        return self.deviations is not None and abs(self.deviations) > DRIFTED


@dataclass(frozen=True)
class Comparison:
    """Two certificates compared.

    Attributes
    ----------
    differences : tuple of Difference
        One per parameter that both have.
    reading : float
        Largest difference of a reading at rest when the second is used in place of the first
        [m/s^2].
    turn : float or None
        The same of a turn by 90 deg in 1.5 s [rad].
    notes : tuple of str
        What limits the comparison, one sentence each.
    """

    differences: tuple[Difference, ...]
    reading: float
    turn: float | None
    notes: tuple[str, ...]

    @property
    def drifted(self) -> tuple[Difference, ...]:
        """Parameters that changed by more than chance explains."""
        return tuple(d for d in self.differences if d.drifted)


def compare(first: Certificate, second: Certificate, *, any_device: bool = False) -> Comparison:
    """Compare two certificates of one sensor.

    Parameters
    ----------
    first, second : Certificate
        The older one first, as a rule.
    any_device : bool
        Whether certificates of two devices may be compared.

    Raises
    ------
    InputError
        Certificates of different serial numbers.
    """
    notes = _about_devices(first, second, any_device)
    if first.method != second.method:
        notes.append(
            "They were solved by different methods, whose conventions and uncertainties differ."
        )
    factor, about_gravity = _common_gravity(first, second)
    notes += about_gravity
    if (
        first.recording is not None
        and second.recording is not None
        and first.recording.sha256 == second.recording.sha256
    ):
        notes.append(
            "Both were solved from one recording, so that their errors are not independent and "
            "the deviations say less."
        )
    accel = (first.accel.affine(), _scaled(second.accel.affine(), factor))
    differences = _differences("accelerometer", MILLI_G, "mg", *map(physical_figures, accel))
    turn = None
    if first.gyro is not None and second.gyro is not None:
        gyro = (first.gyro.affine(), second.gyro.affine())
        figures = [physical_figures(g, a) for g, a in zip(gyro, accel, strict=True)]
        differences += _differences("gyroscope", DEG, "deg/s", *figures)
        own = [_in_own_frame(g, a) for g, a in zip(gyro, accel, strict=True)]
        turn = _largest(own[0], own[1], TURN_ANGLE, TURN_DURATION_S)
    elif (first.gyro is None) != (second.gyro is None):
        notes.append("Only one of them has a gyroscope.")
    if first.mag is not None and second.mag is not None:
        if first.mag.alignment == "none" or second.mag.alignment == "none":
            notes.append("The magnetometers are not compared: one of them was not aligned.")
        else:
            mag = (first.mag.affine.affine(), second.mag.affine.affine())
            figures = [physical_figures(m, a) for m, a in zip(mag, accel, strict=True)]
            differences += _differences("magnetometer", 1.0, "uT", *figures)
            if not (first.mag.field_known and second.mag.field_known):
                notes.append(
                    "The size of a magnetometer's scale is relative without a known field."
                )
    own = [_in_own_frame(a, a) for a in accel]
    reading = _largest(own[0], own[1], first.gravity.value, 1.0)
    return Comparison(tuple(differences), reading, turn, tuple(notes))


def _about_devices(first: Certificate, second: Certificate, any_device: bool) -> list[str]:
    one, other = first.device, second.device
    if one.serial and other.serial and one.serial != other.serial:
        if not any_device:
            raise InputError(
                f"the certificates are of two devices, serial {one_line(one.serial, 40)!r} and "
                f"{one_line(other.serial, 40)!r}: give two of one device, or --any-device to "
                "compare all the same"
            )
        return ["They are of two devices: differences are no drift."]
    if not (one.serial and other.serial):
        return ["A serial number is missing, so nobody knows whether they are of one device."]
    if one.name != other.name:
        return ["The serial numbers agree and the names of the device do not."]
    return []


def _common_gravity(first: Certificate, second: Certificate) -> tuple[float, list[str]]:
    """Return what brings the second to the gravity of the first, and what to say of it."""
    ratio = first.gravity.value / second.gravity.value
    if first.gravity.known and second.gravity.known:
        return 1.0, []
    note = (
        "Local gravity is not known to both: accelerometer scales and biases compare if both were "
        "recorded at one place, and are up to 0.3 % apart otherwise."
    )
    if abs(ratio - 1.0) < SAME_GRAVITY:
        return 1.0, [note]
    return ratio, [
        note,
        f"They are scaled to {first.gravity.value:.5f} and {second.gravity.value:.5f} m/s^2; the "
        "second was brought to the first.",
    ]


def _scaled(affine: Affine, factor: float) -> Affine:
    return Affine(factor * affine.K, factor * affine.b, factor**2 * affine.covariance, affine.dof)


def _in_own_frame(affine: Affine, accel: Affine) -> Affine:
    Q, _ = sensor_frame(accel.K)
    return affine.rotated(Q.T)


def _largest(first: Affine, second: Affine, size: float, duration_s: float) -> float:
    """Largest difference of what two models make of one raw reading, over all directions."""
    S = np.linalg.inv(first.K)
    gain = np.linalg.norm(second.K @ S - np.eye(3), 2) * size
    offset = np.linalg.norm(second.K @ S @ first.b - second.b)
    return float(gain + offset * duration_s)


def _differences(
    sensor: str, bias_unit: float, bias_name: str, first: PhysicalFigures, second: PhysicalFigures
) -> list[Difference]:
    groups: list[tuple[str, tuple[str, ...], float, str, str]] = [
        ("scale", AXES, 1.0, "%", "scale_percent"),
        (first.angles, first.cross_names, 1e-3, "mrad", "cross_rad"),
        ("bias", AXES, bias_unit, bias_name, "bias"),
    ]
    found = []
    for title, names, unit, unit_name, attribute in groups:
        one, other = _values(first, attribute) / unit, _values(second, attribute) / unit
        u, v = (_values(figures, f"{attribute}_u") / unit for figures in (first, second))
        sigma = np.where(np.minimum(u, v) < UNCERTAIN, 0.0, np.hypot(u, v))
        for i, name in enumerate(names):
            found.append(
                Difference(
                    sensor=sensor,
                    name=f"{title} {name}",
                    unit=unit_name,
                    first=float(one[i]),
                    second=float(other[i]),
                    change=float(other[i] - one[i]),
                    sigma=float(sigma[i]),
                )
            )
    return found


def _values(figures: PhysicalFigures, attribute: str) -> FloatArray:
    return np.asarray(getattr(figures, attribute), dtype=float)
