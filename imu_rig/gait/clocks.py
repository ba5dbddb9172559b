"""How far times and gain of the gyroscope are from fitting the accelerometer, told by the strides.

A gyroscope that comes late, or times that were made with a wrong sample rate, spoil every stride
alike and leave nothing that a zero-velocity update would notice: only the length is wrong. But
strides that are integrated from rest to rest then end with a velocity, which tells both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imu_rig.gait.axes import StrideSample
from imu_rig.gait.grade import SensorGrade
from imu_rig.gait.trajectory import Footfalls, Trajectory, TrajectoryCovariance

FEWEST = 4
"""Strides that tell it: three velocities each for two numbers."""

DELAY_S, STEP, ROUNDS = 0.008, 0.01, 4

LATE_PRIOR_S, SCALE_PRIOR = 0.03, 0.1
"""Beyond these a clock or a sample rate is rarely wrong."""

LEAST_LEFT = 0.03
"""Velocities at the ends of strides are as uncertain as this [m/s] at least: feet never quite rest.
"""

RESTS = 0.005
"""Gravity at rest is read so well [1]: feet creep."""

SURE = 2.0
"""What exceeds this many of its standard uncertainties is believed: mistakes of times are rare."""

SCALE_KNOWN = 0.0002
"""Sample rates are known so well before [1], if nobody made a mistake: those of crystals."""

FORCE_DOUBT, FORCE_TOLD = 0.17, 0.02
"""An accelerometer that is off at rest has a bias, mostly. In one case of sixteen it is taken for a
wrong scale, which makes strides wrong by 0.7 of it: the root of both [1]. Below the second [1]
gains are as usual."""

LENGTH_PER_S = 3.0
"""A stride comes out shorter or longer by this share per second that the gyroscope is late: in
simulated walks by 2 to 3.5 thousandths per millisecond."""

LENGTH_POWER = 2.5
"""Lengths go with the square of time, and a little more, as the foot is turned too far as well."""

TOLD = 0.02
"""Distances that may be wrong by this share are worth a word."""


@dataclass(frozen=True)
class ClockAgreement:
    """How well strides would end at rest with the gyroscope's clock or gain corrected.

    Attributes
    ----------
    late_s, late_sigma_s : float
        By which the gyroscope is late against the accelerometer, and its standard uncertainty [s].
    gain, gain_sigma : float
        What its readings, or all intervals of time, would have to be multiplied by: about 1.
    """

    late_s: float
    late_sigma_s: float
    gain: float
    gain_sigma: float


@dataclass(frozen=True)
class ClockDoubt:
    """What the strides leave of an error of clock or gain beyond what the sensor's axes explain.

    Attributes
    ----------
    late_s : float
        Standard uncertainty of the gyroscope's time [s], with the sign of what was found.
    gain : float
        The same of what readings or intervals should be multiplied by, less 1.
    force : float
        Share by which a wrong scale of the accelerometer may change lengths.
    """

    late_s: float = 0.0
    gain: float = 0.0
    force: float = 0.0

    @property
    def of_times(self) -> float:
        """Standard uncertainty of a length by clock and gain, as a share of it."""
        by_gain = (1.0 + abs(self.gain)) ** LENGTH_POWER - 1.0
        return float(np.hypot(LENGTH_PER_S * self.late_s, by_gain))

    @property
    def of_length(self) -> float:
        """Standard uncertainty of a length that comes of it all, as a share of it."""
        return float(np.hypot(self.of_times, self.force))

    @property
    def notes(self) -> tuple[str, ...]:
        """What the reader of a result should know."""
        if self.of_times < TOLD:
            return ()
        causes = []
        if LENGTH_PER_S * abs(self.late_s) >= 0.5 * TOLD:
            way = "later" if self.late_s > 0.0 else "earlier"
            causes.append(f"about {1e3 * abs(self.late_s):.0f} ms {way} than the accelerometer")
        if LENGTH_POWER * abs(self.gain) >= 0.5 * TOLD:
            way = "little" if self.gain > 0.0 else "much"
            causes.append(
                f"about {100.0 * abs(self.gain):.0f} % too {way} (or the sample rate is wrong by "
                "that)"
            )
        return (
            "gyroscope and accelerometer contradict each other: the former seems to read "
            f"{' and '.join(causes)}; distances may be wrong by {100.0 * self.of_times:.0f} %: "
            "check the times, or calibrate the sensor",
        )


def compare_clocks(
    strides: StrideSample, grade: SensorGrade, gravity: float
) -> ClockAgreement | None:
    """Find by how much gyroscope and accelerometer are apart in time, and the former's gain.

    Both change what is left at the end of a stride linearly, as long as they are small; so do
    errors of gains, axes and the accelerometer's bias, which are as large as the grade says. Least
    squares over the strides, with these as priors, give what is left for the clocks.

    Parameters
    ----------
    strides : StrideSample
        With the gyroscope's bias as it was found.
    grade : SensorGrade
        After what the sensor showed.
    gravity : float
        True [m/s^2]: what was read at rest tells of the accelerometer's gain and bias.

    Returns
    -------
    ClockAgreement or None
        None of too few strides.
    """
    if len(strides) < FEWEST:
        return None
    dt = float(np.median(np.diff(strides.parts[0][0].t)))
    delay = max(1, round(DELAY_S / max(dt, 1e-6)))
    eye = np.eye(3)[np.newaxis]
    # The first as it is, then another gain, then each element of the gyroscope's matrix.
    elements = np.eye(9).reshape(9, 3, 3)
    left = strides.left(eye + STEP * np.concatenate((0.0 * eye, eye, elements)))
    now = left[0]
    slopes = [(strides.left(eye, delay) - strides.left(eye, -delay))[0] / (2 * delay * dt)]
    slopes += list((left[1:] - now) / STEP)
    straight = np.vstack((np.eye(3), np.zeros(3)))
    for element in np.eye(12).reshape(12, 4, 3):
        changed = strides.left(eye, force=straight + STEP * element)[0]
        slopes.append((changed - now) / STEP)
    design = np.stack([slope.ravel() for slope in slopes], axis=1)
    up = strides.up()
    at_rest = np.concatenate((np.zeros(11), np.outer(up, up).ravel() * gravity, up))
    prior = np.concatenate(
        (
            [LATE_PRIOR_S, SCALE_PRIOR],
            np.full(9, grade.gyro_matrix),
            np.full(9, grade.accel_matrix),
            np.full(3, grade.accel_bias),
        )
    )
    design, at_rest = design * prior, at_rest * prior / (RESTS * gravity)
    known = np.eye(len(prior)) + np.outer(at_rest, at_rest)
    wanted = at_rest * (gravity - strides.gravity) / (RESTS * gravity)
    noise = np.full(len(now), max(LEAST_LEFT, float(np.median(np.linalg.norm(now, axis=1)))))
    for _ in range(ROUNDS):
        each = np.repeat(noise, 3)
        weighed = design / each[:, np.newaxis]
        spread = np.linalg.inv(weighed.T @ weighed + known)
        found = spread @ (weighed.T @ (-now.ravel() / each) + wanted)
        size = np.linalg.norm(now + (design @ found).reshape(now.shape), axis=1)
        # The sum of sizes, not of squares: some strides hold a stumble or a wrong rest.
        usual = max(LEAST_LEFT, float(np.median(size)))
        noise = np.sqrt(usual * np.maximum(size, usual))
    found, sigma = prior * found, prior * np.sqrt(np.diag(spread))
    return ClockAgreement(-float(found[0]), float(sigma[0]), 1.0 + float(found[1]), float(sigma[1]))


def clock_doubt(
    clocks: ClockAgreement | None, grade: SensorGrade, misfit: float = 0.0
) -> ClockDoubt:
    """Return how wrong clock and gain may be.

    What was found beyond its own uncertainty is believed possible; the rest is as usual.

    Parameters
    ----------
    clocks : ClockAgreement or None
    grade : SensorGrade
    misfit : float
        By which part of gravity the accelerometer errs at rest.
    """
    force = FORCE_DOUBT * misfit if misfit > FORCE_TOLD else 0.0
    if clocks is None:
        return ClockDoubt(force=force)
    return ClockDoubt(
        _left(clocks.late_s, clocks.late_sigma_s, grade.late_s),
        _left(clocks.gain - 1.0, clocks.gain_sigma, SCALE_KNOWN),
        force,
    )


def _left(found: float, noise: float, prior: float) -> float:
    """Return by how much a number exceeds what it may be by nature, or its uncertainty, signed."""
    prior = float(np.hypot(prior, max(0.0, abs(found) - SURE * noise)))
    share = prior**2 / max(prior**2 + noise**2, 1e-30)
    return float(np.copysign(np.hypot(share * found, np.sqrt(share) * noise), found))


def with_doubt(
    covariance: TrajectoryCovariance, doubt: ClockDoubt, trajectory: Trajectory, falls: Footfalls
) -> TrajectoryCovariance:
    """Return the covariance with an error of scale added, which all strides have in common."""
    share = doubt.of_length
    if share == 0.0:
        return covariance
    rows = covariance.rows
    off = np.zeros((len(rows), 9))
    off[:, 3:6] = share * trajectory.velocity[rows]
    off[:, 6:9] = share * (trajectory.position[rows] - trajectory.position[rows[0]])
    moved = share * np.diff(trajectory.position[falls.quietest], axis=0)
    common = covariance.common
    return replace(
        covariance,
        values=covariance.values + off[:, :, np.newaxis] * off[:, np.newaxis, :],
        strides=covariance.strides + moved[:, :, np.newaxis] * moved[:, np.newaxis, :],
        common=None
        if common is None
        else np.concatenate((common, moved[:, np.newaxis, :]), axis=1),
    )
