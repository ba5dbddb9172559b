"""A sensor held against its certificate, on another day: still within limits, and what drifted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.certificate import Certificate
from imu_rig.calibration.certificate_parts import DeviceEntry, StagesEntry
from imu_rig.calibration.drift import (
    ANOTHER_SENSOR,
    DriftRow,
    day_to_day_accel,
    day_to_day_gyro,
    drift,
)
from imu_rig.calibration.gravity import Gravity
from imu_rig.calibration.readings import require_readings
from imu_rig.calibration.result import DeviceInfo, ErrorStages, ErrorSummary
from imu_rig.calibration.stills import find_stills, gaps
from imu_rig.calibration.temperature import believable
from imu_rig.calibration.verification import Limits, Scatter, Verification, checks_of, verify
from imu_rig.errors import InputError
from imu_rig.units import DEG, MILLI_G

OTHER_TEMPERATURE_C = 3.0
"""Difference of the sensor's temperature that is worth a word."""
NO_KNOWLEDGE = 100.0
"""Variance of a parameter, SI, that no calibration of a working sensor leaves."""
UNITS = {
    ("accelerometer", "bias"): (MILLI_G, "mg"),
    ("gyroscope", "bias"): (DEG, "deg/s"),
    ("accelerometer", "scale"): (0.01, "%"),
    ("gyroscope", "scale"): (0.01, "%"),
}
"""Unit in which a person reads a parameter, by sensor and quantity."""


@dataclass(frozen=True, eq=False)
class Recheck:
    """How a sensor does against its certificate.

    Attributes
    ----------
    verification : Verification
        Every check against the limits, the predictions with day-to-day drift allowed for.
    drift : tuple of DriftRow
        What changed, against the certificate's own uncertainty.
    notes : tuple of str
        Sentences about drift, temperature and gravity.
    """

    verification: Verification
    drift: tuple[DriftRow, ...]
    notes: tuple[str, ...]


def recheck(
    certificate: Certificate,
    block: ImuBlock,
    windows: Sequence[tuple[float, float]] | FloatArray | None = None,
    names: tuple[str, ...] = (),
    *,
    limits: Limits | None = None,
    gravity: Gravity | None = None,
    mounting: tuple[int, ...] = (),
) -> Recheck:
    """Judge a recording of stills and moves against a certificate.

    Parameters
    ----------
    certificate : Certificate
        What the sensor was when it was calibrated.
    block : ImuBlock
        The recording, nominally scaled as the certificate's was.
    windows : shape (m, 2), optional
        Begin and end of every still [s], settling cut off; found automatically if not given.
    names : tuple of str, optional
        A name per window.
    limits : Limits, optional
        Largest errors with which the sensor passes.
    gravity : Gravity, optional
        Local gravity; that of the certificate by default.
    mounting : tuple of int, optional
        Mounting of the sensor in every window.

    Raises
    ------
    DataError
        No still interval, or samples that are not numbers.
    InputError
        Gravity of a place that the certificate's scale does not know, or a certificate that knows
        nothing.
    """
    block = require_readings(block)
    block, odd = believable(block)
    local = _gravity(certificate, gravity)
    limits = limits or Limits()
    if windows is None:
        found = find_stills(block)
        windows = np.stack((found.t0, found.t1), axis=1)
    spans = np.asarray(windows, dtype=float).reshape(-1, 2)
    names = names or tuple(f"pose {i + 1}" for i in range(len(spans)))
    every = np.ones(len(spans), dtype=bool)
    checks = checks_of(block, spans, names, every, limits, mounting=mounting)
    accel = certificate.accel.affine()
    gyro = None if certificate.gyro is None else certificate.gyro.affine()
    for sensor in (accel, gyro):
        if sensor is not None and np.max(np.diag(sensor.covariance)) > NO_KNOWLEDGE:
            raise InputError(
                "The certificate's uncertainties are larger than any sensor's errors, so nothing "
                "can be held against it: calibrate the sensor anew."
            )
    turns = bool(np.any(np.ptp(block.gyro, axis=0) > 0))
    scatter = Scatter.of(_stages(certificate.accel_errors), _stages(certificate.gyro_errors))
    verification = verify(
        day_to_day_accel(accel),
        None if gyro is None else day_to_day_gyro(gyro),
        checks if turns else checks.without_moves(),
        local.value,
        limits=limits,
        scatter=scatter,
    )
    changes = drift(accel, gyro if turns else None, checks, local.value, scatter)
    notes = _sentences(changes) + _unknown(changes) + _circumstances(certificate, block, turns)
    return Recheck(verification, changes, (*notes, *odd))


def other_device(certificate: DeviceEntry, device: DeviceInfo) -> str | None:
    """Say why a recording is not of the sensor that a certificate is of; None if it may be.

    What either does not state contradicts nothing; of a name and a serial number, the latter
    decides.
    """
    if certificate.layout and device.layout and certificate.layout != device.layout:
        return (
            f"the certificate is for packets of layout {certificate.layout}, and the recording's "
            f"are of {device.layout}: their raw values are scaled in another way"
        )
    pairs = (
        ("serial number", certificate.serial, device.serial),
        ("name", certificate.name, device.name),
    )
    for what, certified, found in pairs:
        if certified and found:
            if certified == found:
                return None
            return f"the certificate is of the sensor with {what} {certified}, this is {found}"
    return None


def _gravity(certificate: Certificate, given: Gravity | None) -> Gravity:
    certified = certificate.gravity.gravity()
    if given is None or not given.known:
        return certified
    if not certified.known:
        raise InputError(
            "The certificate is scaled to standard gravity, because local gravity was not given "
            "when it was made: check the sensor at the same place, without --gravity and "
            "--latitude, or calibrate it anew with them."
        )
    return given


def _stages(entry: StagesEntry) -> ErrorStages:
    held = entry.held_out
    if held is None:
        return ErrorStages()
    return ErrorStages(
        held_out=ErrorSummary(held.count, held.rms, held.median, held.maximum),
    )


def _sentences(changes: tuple[DriftRow, ...]) -> list[str]:
    drifted = [row for row in changes if row.drifted]
    much, usual = [r for r in drifted if not r.usual], [r for r in drifted if r.usual]
    notes = []
    if much:
        notes.append(
            f"Drifted more than sensors of this class do from day to day: {_changes(much)}; "
            "calibrate again."
        )
    if usual:
        notes.append(
            "Drifted within what sensors of this class do from day to day: " + _changes(usual) + "."
        )
    if any(row.determined and abs(row.change) > ANOTHER_SENSOR * row.day_to_day for row in changes):
        notes.append("A sensor hardly changes so much: is this the one the certificate is of?")
    return notes


def _changes(rows: list[DriftRow]) -> str:
    words = []
    for row in rows:
        unit, name = UNITS[row.sensor, row.quantity]
        words.append(
            f"{row.name} by {row.change / unit:+.2g} {name} ({row.sigmas:.0f} standard deviations)"
        )
    return ", ".join(words)


def _unknown(changes: tuple[DriftRow, ...]) -> list[str]:
    free = [row.name for row in changes if not row.determined]
    if not free:
        return []
    return [
        f"The check does not tell whether these changed: {', '.join(free)}; hold the sensor with "
        "each axis up and down, and turn it by 90 degrees or more about each axis while level."
    ]


def _circumstances(certificate: Certificate, block: ImuBlock, turns: bool) -> list[str]:
    notes = []
    if certificate.gyro is None:
        notes.append("The certificate holds no gyroscope; only the accelerometer was checked.")
    elif not turns:
        notes.append("The recording's gyroscope shows nothing; it was not checked.")
    # a sensor may send its temperature with some of its samples only
    sent = None if block.temperature is None else block.temperature[np.isfinite(block.temperature)]
    if certificate.temperature_c is not None and sent is not None and len(sent):
        then, now = np.mean(certificate.temperature_c), float(np.mean(sent))
        if abs(now - then) > OTHER_TEMPERATURE_C:
            notes.append(
                f"The sensor was at {then:.0f} degC when it was calibrated and is at {now:.0f} "
                "degC now: part of a change may be the temperature's."
            )
    if not certificate.gravity.known:
        notes.append(
            "Local gravity is not known, so a change of scale holds only at the place of the "
            "calibration."
        )
    holes = len(gaps(block.t))
    if holes:
        notes.append(f"The recording has {holes} gap{'' if holes == 1 else 's'} in its samples.")
    return notes
