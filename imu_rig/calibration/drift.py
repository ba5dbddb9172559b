"""What of a sensor drifted since its certificate, parameter by parameter.

A check of a few poses cannot repeat a calibration. It can correct one: the certificate's
parameters with their covariance, loosened by what such sensors do from day to day, are the prior
of a small linear update. The change is judged by the scatter it would have if nothing had
drifted: the certificate's own uncertainty and the noise of the check.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.calibration.direction import direction_residuals, gravity_directions
from imu_rig.calibration.earth import EARTH_RATE
from imu_rig.calibration.model import (
    AXES,
    PARAMETERS,
    Affine,
    PhysicalFigures,
    physical_figures,
    sensor_frame,
)
from imu_rig.calibration.verification import Checks, Scatter, as_normal, excess, pose_errors
from imu_rig.units import DEG, MILLI_G

DAY_ACCEL_BIAS = 2.5 * MILLI_G
DAY_ACCEL_GAIN = 1e-3
DAY_GYRO_BIAS = 0.2 * DEG
DAY_GYRO_GAIN = 2e-3
"""What sensors of this class drift from day to day, as a standard deviation: 2 to 3 mg of bias
measured on consumer sensors; 0.02 % of scale per degC over 5 degC by data sheet; a gyroscope's
bias 0.03 deg/s per degC, its gain 0.15 to 0.2 % measured."""
DAY_LEAN = 5e-4
"""The same of the directions in which axes sense [rad]."""
WITHIN_DAYS = 1.2
"""A change up to so many of these standard deviations is called usual: 3 mg of bias."""
DRIFTED = 3.0
"""A change as improbable as a normal deviate of this size is called a drift."""
DETERMINED = 0.5
"""A parameter counts as determined where the check leaves less than this of its prior."""
ANOTHER_SENSOR = 8.0
"""A change of so many day-to-day deviations is hardly the same sensor's."""


@dataclass(frozen=True)
class DriftRow:
    """Change of one parameter since the certificate.

    Attributes
    ----------
    sensor, quantity, axis : str
        ``"accelerometer"`` or ``"gyroscope"``; ``"bias"`` or ``"scale"``; x, y or z.
    certified, change : float
        Value in the certificate and change since [m/s^2, rad/s, or 1 for a scale].
    sigma : float
        Standard deviation that ``change`` has if nothing drifted.
    sigmas : float
        The change in these standard deviations.
    significant : bool
        Whether the change is more than chance.
    day_to_day : float
        Standard deviation of such changes from day to day in sensors of this class.
    determined : bool
        Whether the check determines the parameter.
    """

    sensor: Literal["accelerometer", "gyroscope"]
    quantity: Literal["bias", "scale"]
    axis: str
    certified: float
    change: float
    sigma: float
    sigmas: float
    significant: bool
    day_to_day: float
    determined: bool

    @property
    def drifted(self) -> bool:
        """Whether the parameter is known to have changed."""
        return self.determined and self.significant

    @property
    def usual(self) -> bool:
        """Whether the change is within what sensors of this class do from day to day."""
        return abs(self.change) <= WITHIN_DAYS * self.day_to_day

    @property
    def name(self) -> str:
        """Such as ``"accelerometer bias x"``."""
        return f"{self.sensor} {self.quantity} {self.axis}"


@dataclass(frozen=True, eq=False)
class _Update:
    """A linear update: the new value, and the covariances of its change and of what is left."""

    now: Affine
    by_chance: FloatArray
    left: FloatArray


def day_to_day_accel(accel: Affine) -> Affine:
    """Return an accelerometer's calibration as it holds on another day."""
    Q, _ = sensor_frame(accel.K)
    loose = np.zeros(PARAMETERS)
    for i in range(3):
        for j in range(i, 3):
            loose[3 * i + j] = DAY_ACCEL_GAIN if i == j else DAY_LEAN
    loose[9:] = DAY_ACCEL_BIAS
    return _loosened(accel.rotated(Q.T), loose).rotated(Q)


def day_to_day_gyro(gyro: Affine) -> Affine:
    """Return a gyroscope's calibration as it holds on another day."""
    gain = np.where(np.eye(3) > 0, DAY_GYRO_GAIN, DAY_LEAN).ravel()
    return _loosened(gyro, np.concatenate((gain, np.full(3, DAY_GYRO_BIAS))))


def drift(
    accel: Affine, gyro: Affine | None, checks: Checks, gravity: float, scatter: Scatter
) -> tuple[DriftRow, ...]:
    """Estimate what changed since a calibration.

    Parameters
    ----------
    accel, gyro : Affine
        The calibration.
    checks : Checks
        What was measured now; every still in it is a check.
    gravity : float
        Magnitude of gravity [m/s^2].
    scatter : Scatter
        What left-out poses and moves of the fit were off by.
    """
    if not len(checks.stills):
        return ()
    update = _update_accel(accel, checks, gravity, scatter)
    before = physical_figures(accel)
    rows = _rows("accelerometer", accel, day_to_day_accel(accel), update, before)
    if gyro is None:
        return tuple(rows)
    now = Affine(update.now.K, update.now.b, update.left, accel.dof)
    turned = _update_gyro(now, gyro, checks, scatter)
    before = physical_figures(gyro, accel)
    rows += _rows("gyroscope", gyro, day_to_day_gyro(gyro), turned, before, accel)
    return tuple(rows)


def _update_accel(accel: Affine, checks: Checks, gravity: float, scatter: Scatter) -> _Update:
    stills = checks.stills
    error, J, noise = pose_errors(accel, stills.accel_mean, stills.accel_cov, gravity)
    chance = noise + np.einsum("ia,ab,ib->i", J, accel.covariance, J)
    noise = noise + excess(scatter.accel, chance)
    return _update(accel, day_to_day_accel(accel), error, J, np.diag(noise))


def _update_gyro(accel: Affine, gyro: Affine, checks: Checks, scatter: Scatter) -> _Update:
    track, moves = checks.track, checks.moves
    # At rest the reading is the bias and the rotation of the Earth, whose direction is not known.
    rest = np.concatenate((np.kron(np.eye(3), track.mean), -np.eye(3)), axis=1)
    error = gyro.apply(track.mean)
    noise = gyro.K @ np.diag(track.mean_sigma**2) @ gyro.K.T + np.eye(3) * EARTH_RATE**2 / 3.0
    if not len(moves):
        return _update(gyro, day_to_day_gyro(gyro), error, rest, noise)
    where = gravity_directions(checks.stills, moves, accel, track)
    residual, by_gain, by_accel = direction_residuals(moves, where, accel, track, gyro.K)
    count = residual.size
    J = np.zeros((count + 3, PARAMETERS))
    J[:count, :9] = by_gain.reshape(count, 9)
    J[count:] = rest
    R = np.zeros((count + 3, count + 3))
    R[count:, count:] = noise
    # An accelerometer that errs misleads several moves at once.
    A = by_accel.reshape(count, PARAMETERS)
    common = A @ accel.covariance @ A.T
    gains = J[:count] @ gyro.covariance @ J[:count].T
    chance = np.diag(common + gains).reshape(-1, 2).mean(axis=1) + where.variance
    R[:count, :count] = common + np.diag(
        np.repeat(where.variance + excess(scatter.turn, chance), 2)
    )
    return _update(gyro, day_to_day_gyro(gyro), np.concatenate((residual.ravel(), error)), J, R)


def _update(
    certified: Affine, today: Affine, error: FloatArray, J: FloatArray, R: FloatArray
) -> _Update:
    prior = today.covariance
    S = J @ prior @ J.T + R
    gain = np.linalg.solve(S, J @ prior).T
    change = -gain @ error
    by_chance = gain @ (J @ certified.covariance @ J.T + R) @ gain.T
    left = prior - gain @ S @ gain.T
    K = certified.K + change[:9].reshape(3, 3)
    return _Update(Affine(K, certified.b + change[9:], by_chance, certified.dof), by_chance, left)


def _rows(
    sensor: Literal["accelerometer", "gyroscope"],
    certified: Affine,
    today: Affine,
    update: _Update,
    before: PhysicalFigures,
    frame: Affine | None = None,
) -> list[DriftRow]:
    fixed = None if frame is None else Affine(frame.K, frame.b, np.zeros((PARAMETERS,) * 2))
    now = physical_figures(update.now, fixed)
    left = physical_figures(Affine(update.now.K, update.now.b, update.left), fixed)
    prior = physical_figures(Affine(certified.K, certified.b, today.covariance), fixed)
    accel = sensor == "accelerometer"
    day_bias = DAY_ACCEL_BIAS if accel else DAY_GYRO_BIAS
    day_gain = DAY_ACCEL_GAIN if accel else DAY_GYRO_GAIN
    columns: list[tuple[Literal["bias", "scale"], float, tuple[FloatArray, ...]]] = [
        ("bias", day_bias, (before.bias, now.bias, now.bias_u, left.bias_u, prior.bias_u)),
        (
            "scale",
            day_gain,
            (
                before.scale_percent / 100.0,
                now.scale_percent / 100.0,
                now.scale_percent_u / 100.0,
                left.scale_percent_u / 100.0,
                prior.scale_percent_u / 100.0,
            ),
        ),
    ]
    rows = []
    for quantity, day, (then, value, sigma, remaining, known) in columns:
        for i, axis in enumerate(AXES):
            change = float(value[i] - then[i])
            z = abs(change) / float(sigma[i]) if sigma[i] > 0 else 0.0
            rows.append(
                DriftRow(
                    sensor=sensor,
                    quantity=quantity,
                    axis=axis,
                    certified=float(then[i]),
                    change=change,
                    sigma=float(sigma[i]),
                    sigmas=z,
                    significant=as_normal(z, certified.dof) > DRIFTED,
                    day_to_day=day,
                    determined=bool(remaining[i] < DETERMINED * known[i]),
                )
            )
    return rows


def _loosened(affine: Affine, sigma: FloatArray) -> Affine:
    return Affine(affine.K, affine.b, affine.covariance + np.diag(sigma**2), affine.dof)
