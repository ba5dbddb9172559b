"""What the foot filter reads and what it hands back: plain tuples of arrays and numbers."""

from __future__ import annotations

from typing import NamedTuple

from imu_rig.arrays import FloatArray

STATES = 16
"""Length of the error state. Its parts are the slices below: attitude as a small rotation in
navigation axes [rad], velocity [m/s], height over the floor [m], pivot [m], biases of accelerometer
[m/s^2] and gyroscope [rad/s]."""
ATTITUDE = slice(0, 3)
VELOCITY = slice(3, 6)
HEIGHT = 6
PIVOT = slice(7, 10)
ACCEL_BIAS = slice(10, 13)
GYRO_BIAS = slice(13, 16)


class FootModel(NamedTuple):
    """Physics and noise of a foot sensor, SI units.

    Attributes
    ----------
    gravity : float
        [m/s^2].
    gyro_noise, gyro_motion : float
        Process noise of attitude: density ``sqrt(gyro_noise^2 + (gyro_motion |w|)^2)``, the first
        in rad/s/sqrt(Hz), the second in 1/sqrt(Hz): errors of scale and alignment grow with motion.
    accel_noise, accel_motion : float
        The same of velocity, with ``|f_nav - g|`` in place of ``|w|``; the first in
        m/s^2/sqrt(Hz).
    tilt_prior, velocity_prior : float
        Standard deviations of the first tilt about each horizontal axis [rad] and of the first
        velocity on each axis [m/s]. The first heading is right by definition.
    gyro_bias_prior : shape (3,)
        Standard deviations [rad/s] about zero, sensor axes.
    gyro_bias_walk : float
        Random walk of the gyro bias [rad/s/sqrt(s)].
    accel_bias_prior, accel_bias_walk : float
        The same of the accelerometer [m/s^2] on every axis, and [m/s^2/sqrt(s)].
    pivot_prior : shape (3,)
        From the point about which the standing foot rolls to the sensor [m], sensor axes.
    pivot_sigma : float
        Its standard deviation on each axis [m].
    gate : float
        Innovations beyond so many standard deviations (root mean square over the axes) have the
        variance of their measurement multiplied by the square of the excess ...
    gate_cap : float
        ... but at most by this, so that a filter gone astray always finds back.
    """

    gravity: float
    gyro_noise: float
    gyro_motion: float
    accel_noise: float
    accel_motion: float
    tilt_prior: float
    velocity_prior: float
    gyro_bias_prior: FloatArray
    gyro_bias_walk: float
    accel_bias_prior: float
    accel_bias_walk: float
    pivot_prior: FloatArray
    pivot_sigma: float
    gate: float
    gate_cap: float = 30.0


class FootInputs(NamedTuple):
    """``n`` samples of a foot sensor with what a detector says of each.

    Attributes
    ----------
    dt : shape (n,)
        Time since the sample before [s]; may be 0. ``dt[0]`` counts only when a filter goes on.
    gyro, accel : shape (n, 3)
        Readings in sensor axes [rad/s, m/s^2].
    velocity_sigma : shape (n,)
        Standard deviation of "the sensor moves as if it turned about the pivot" [m/s]; infinite
        (or NaN, or 0) where nothing is said.
    rest_sigma : shape (n,)
        Standard deviation of "the gyro reads its bias" [rad/s]; infinite, NaN or 0 for none.
    floor_sigma : shape (n,)
        Standard deviation of "the sensor is at the floor's height" [m]; the same for none.
    floor_step : shape (n,)
        How far the floor may have moved since the sample before [m], standard deviation. The
        first is the floor's prior.
    q0 : shape (4,)
        First attitude, scalar first, sensor to navigation.
    v0 : shape (3,)
        First velocity [m/s], navigation axes.
    unseen_turn, unseen_velocity : shape (n,) or None
        What gaps and clipped readings add to the uncertainty of the step to this sample: standard
        deviations of its turn [rad] and of its change of velocity [m/s], on each axis. None or 0
        where all was seen.
    """

    dt: FloatArray
    gyro: FloatArray
    accel: FloatArray
    velocity_sigma: FloatArray
    rest_sigma: FloatArray
    floor_sigma: FloatArray
    floor_step: FloatArray
    q0: FloatArray
    v0: FloatArray
    unseen_turn: FloatArray | None = None
    unseen_velocity: FloatArray | None = None


class FootState(NamedTuple):
    """All that a filter knows after a sample: enough to go on with the next one.

    Attributes
    ----------
    quaternion : shape (4,)
    velocity, position : shape (3,)
        Navigation axes [m/s, m].
    height : float
        Over the floor [m]; the floor is where the sensor rests on level ground.
    pivot : shape (3,)
        Sensor axes [m].
    accel_bias, gyro_bias : shape (3,)
        Sensor axes [m/s^2, rad/s].
    covariance : shape (16, 16)
        Of the error state, in the order of the slices above.
    gyro, accel : shape (3,)
        The last readings.
    """

    quaternion: FloatArray
    velocity: FloatArray
    position: FloatArray
    height: float
    pivot: FloatArray
    accel_bias: FloatArray
    gyro_bias: FloatArray
    covariance: FloatArray
    gyro: FloatArray
    accel: FloatArray


class FootStates(NamedTuple):
    """Estimates at ``n`` samples.

    Attributes
    ----------
    quaternion : shape (n, 4)
    velocity, position : shape (n, 3)
        Navigation axes [m/s, m]. The position is the integral of the velocity.
    gyro_bias, accel_bias : shape (n, 3)
        Sensor axes [rad/s, m/s^2]; the first may be read-only.
    floor : shape (n,)
        Height of the sensor at which it would rest on the floor [m].
    pivot : shape (3,)
        [m], sensor axes; at the end of the trial, which is the whole trial's estimate.
    gyro_bias_covariance : shape (3, 3)
        At the end [rad^2/s^2].
    nis : shape (n,)
        Normalized innovation squared of the three velocities, over 3 (1 on average if the noise is
        as modelled); NaN where there was no measurement.
    end : FootState
        Of the forward filter after the last sample.
    """

    quaternion: FloatArray
    velocity: FloatArray
    position: FloatArray
    gyro_bias: FloatArray
    accel_bias: FloatArray
    floor: FloatArray
    pivot: FloatArray
    gyro_bias_covariance: FloatArray
    nis: FloatArray
    end: FootState
