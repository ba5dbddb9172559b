"""What a session tells beside the sensor's line: the jig's errors, and how straight a sensor is."""

from __future__ import annotations

from dataclasses import dataclass

from imu_rig.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Estimate:
    """Values with their standard uncertainties, same shape."""

    value: FloatArray
    sigma: FloatArray


@dataclass(frozen=True, eq=False)
class JigEstimate:
    """What a session tells about the jig it ran on.

    Attributes
    ----------
    servo_gain : shape (3,)
        Of pan, tilt and roll: how much more than commanded an axis turns.
    tilt_zero, tilt_skew, roll_skew : shape (1,)
        [rad].
    base : shape (2,)
        Tilt of the base about its level x and y axes [rad].
    mounting : shape (k, 3)
        Rotation vector of the sensor on the plate beyond the nominal one, per mounting [rad].
        The part about the roll axis is as good as the roll servo's zero, which nothing measures.
    roll_axis : shape (k, 3)
        Direction of the roll axis in sensor axes, per mounting; uncertainty per axis [rad].
    level : shape (2,)
        Rotation about the sensor's y and x axes by which it is off level with all servos commanded
        to zero [rad]; what one visit of that pose is uncertain by is in ``level.sigma``.
    repeatability : shape (3,)
        Of the servos, standard deviation [rad].
    wobble : float
        Rotation of a pose beyond the servos, standard deviation per axis [rad].
    deviation : shape (m, 3)
        By how much pan, tilt and roll missed the commanded angle in every still, beyond gain and
        zero [rad]; a slip is in it, an exchanged label is not. Not a number where a still was
        left out.
    commanded : shape (m,)
        Which of the commanded poses each still is, as findings count them.
    """

    servo_gain: Estimate
    tilt_zero: Estimate
    tilt_skew: Estimate
    roll_skew: Estimate
    base: Estimate
    mounting: Estimate
    roll_axis: Estimate
    level: Estimate
    repeatability: FloatArray
    wobble: float
    deviation: FloatArray
    commanded: IntArray


@dataclass(frozen=True, eq=False)
class Straightness:
    """Nonlinearity of the accelerometer.

    Attributes
    ----------
    quadratic, cubic : Estimate, shape (3,)
        Share of 1 g by which an axis errs at 1 g.
    deviation : float
        Root mean square over all attitudes of a reading's deviation from the line, along gravity
        [m/s^2], its own uncertainty taken off.
    """

    quadratic: Estimate
    cubic: Estimate
    deviation: float
