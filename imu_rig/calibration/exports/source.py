"""What an export is made of: the models of a certificate and the words that go with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.calibration.certificate import Certificate
from imu_rig.calibration.model import PARAMETERS, Affine, sensor_frame
from imu_rig.errors import InputError
from imu_rig.foreign_text import wrapped
from imu_rig.units import STANDARD_GRAVITY

LINE_WIDTH = 90
DEFAULT_FIELD = 50.0
"""A field of the Earth's size [uT]."""
UNITS = {"accel": "m/s^2", "gyro": "rad/s", "mag": "uT"}
"""Unit of the readings, and so of b, by sensor."""
KINDS = {"accel": "Accelerometer", "gyro": "Gyroscope", "mag": "Magnetometer"}


@dataclass(frozen=True, eq=False)
class Source:
    """A calibration to be exported.

    Attributes
    ----------
    about : tuple of str
        Lines that say whose calibration it is; each is one line of printable characters.
    accel : Affine
        Accelerometer [m/s^2]; its axes are those of all sensors.
    gyro : Affine or None
        Gyroscope [rad/s].
    mag : Affine or None
        Magnetometer [uT].
    gravity : float
        Gravity the accelerometer is scaled to [m/s^2].
    mag_aligned : bool
        Whether the magnetometer's calibrated readings are in the axes of the accelerometer's.
    field : float
        Size of the magnetic field that errors are judged at [uT].
    notes : tuple of str
        What no export holds, one sentence each.
    has_accel : bool
        Whether the accelerometer was calibrated. What is not calibrated is not exported: it would
        take the place of a calibration that the user has.
    """

    about: tuple[str, ...]
    accel: Affine
    gyro: Affine | None = None
    mag: Affine | None = None
    gravity: float = STANDARD_GRAVITY
    mag_aligned: bool = True
    field: float = DEFAULT_FIELD
    notes: tuple[str, ...] = ()
    has_accel: bool = True

    @staticmethod
    def of(certificate: Certificate) -> Source:
        """Take what a certificate holds; its texts come from outside and are made harmless.

        Raises
        ------
        InputError
            Nothing was calibrated.
        """
        device, term, mag = certificate.device, certificate.temperature, certificate.mag
        if not certificate.calibrated:
            raise InputError(
                "No sensor of this certificate was calibrated, so there is nothing to export."
            )
        notes = []
        if not certificate.has_accel:
            notes.append("The accelerometer was not calibrated, so nothing is exported for it.")
        if certificate.gyro is None:
            notes.append("The gyroscope was not calibrated, so nothing is exported for it.")
        if term is not None:
            notes.append(
                f"The calibration holds at {term.reference_c:.1f} degC; how it changes with "
                "temperature is not exported."
            )
        if mag is not None and mag.alignment == "none":
            notes.append(
                "The magnetometer was not aligned: its readings are in its own axes, not in those "
                "of the accelerometer."
            )
        named = f"{device.name or 'a sensor without a name'}"
        if device.serial:
            named += f", serial {device.serial}"
        about = [
            f"Calibration of {named}",
            f"made {certificate.date.isoformat()} by {certificate.software}, "
            f"method {certificate.method}",
        ]
        units = device.device().recorded_units
        if units:
            about.append(f"Recorded units: {units}; raw is that in SI units.")
        elif device.layout:
            about.append(f"Raw is what packets of {device.layout} hold, in SI units.")
        if certificate.has_accel:
            about.append(certificate.gravity.gravity().statement)
        if certificate.warnings:
            about.append(f"Warnings of the certificate: {len(certificate.warnings)}; read them.")
        return Source(
            about=tuple(part for line in (*about, *notes) for part in wrapped(line, LINE_WIDTH)),
            accel=certificate.accel.affine(),
            gyro=None if certificate.gyro is None else certificate.gyro.affine(),
            mag=None if mag is None else mag.affine.affine(),
            mag_aligned=mag is None or mag.alignment != "none",
            field=DEFAULT_FIELD if mag is None else mag.field_ut,
            gravity=certificate.gravity.value,
            notes=tuple(notes),
            has_accel=certificate.has_accel,
        )

    @property
    def sensors(self) -> dict[str, Affine]:
        """The models to export, by the short name of the sensor."""
        accel = self.accel if self.has_accel else None
        models = {"accel": accel, "gyro": self.gyro, "mag": self.mag}
        return {name: model for name, model in models.items() if model is not None}

    def in_sensor_frame(self) -> tuple[Source, float]:
        """Express every output in the sensor's own frame; also return by how much that turns it.

        The frame is that in which the accelerometer's K is upper triangular, and the angle [rad]
        is that between it and the frame of the certificate.
        """
        Q, _ = sensor_frame(self.accel.K)
        angle = float(np.arccos(np.clip((np.trace(Q) - 1.0) / 2.0, -1.0, 1.0)))
        turned = self._of_each(lambda model: model.rotated(Q.T))
        return (turned if self.mag_aligned else replace(turned, mag=self.mag)), angle

    def with_axes(self, P: FloatArray) -> Source:
        """Express raw and calibrated readings in other axes: ``new = P @ old`` (3, 3)."""
        J = np.zeros((PARAMETERS, PARAMETERS))
        J[:9, :9] = np.kron(P, P)
        J[9:, 9:] = P

        def turned(model: Affine) -> Affine:
            covariance = J @ model.covariance @ J.T
            return Affine(P @ model.K @ P.T, P @ model.b, covariance, model.dof)

        return self._of_each(turned)

    def _of_each(self, change: Callable[[Affine], Affine]) -> Source:
        return replace(
            self,
            accel=change(self.accel),
            gyro=None if self.gyro is None else change(self.gyro),
            mag=None if self.mag is None else change(self.mag),
        )
