"""What a joint fit says: sensor parameters, the jig's own errors, errors of what was left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from imu_rig import rotation
from imu_rig.arrays import FloatArray, IntArray
from imu_rig.calibration.jig_estimate import Estimate, JigEstimate, Straightness
from imu_rig.calibration.joint_fit import JointFit
from imu_rig.calibration.joint_model import (
    ACCEL_GAIN,
    ACCEL_OFFSET,
    BASE,
    GYRO_GAIN,
    NONLINEARITY,
    ROLL_SKEW,
    ROWS_OF,
    SERVO_GAIN,
    TILT_SKEW,
    TILT_ZERO,
    JointState,
    forces,
)
from imu_rig.calibration.magnitude import UPPER, full_covariance
from imu_rig.calibration.model import PARAMETERS, Affine, differences

SENSOR = np.r_[ACCEL_GAIN, ACCEL_OFFSET, NONLINEARITY]
"""The accelerometer's unknowns: gain, offset, nonlinearity."""
OWN, OTHER = 27.0 / 35.0, 3.0 / 35.0
"""Best line along gravity, over all attitudes, through a cubic share c of one axis: the scale of
that axis grows by 27/35 c and the others' shrink by 3/35 c (x^4 projected on x^2, y^2, z^2)."""
LEVEL = 0.6
"""The same of a quadratic share: a bias of 3/5 of it (projection of x^3 on x)."""


def line_over_one_g(fit: JointFit) -> Affine:
    """Accelerometer as the best line over +-1 g: what a rest in any attitude tests."""

    def line(p: FloatArray) -> FloatArray:
        T = np.zeros((3, 3))
        T[UPPER] = p[:6]
        return _straightened(T, p[6:9], p[9:], fit.data.gravity)

    return _accel(fit, line)


def gain_at_zero(fit: JointFit) -> Affine:
    """Accelerometer's slope at zero input: what small accelerations about it see."""
    return _accel(fit, lambda p: p[:9])


def _straightened(T: FloatArray, o: FloatArray, shares: FloatArray, g: float) -> FloatArray:
    quadratic, cubic = shares[:3], shares[3:]
    s = OWN * cubic - OTHER * (cubic.sum() - cubic)
    line = T * (1.0 - s)
    return np.concatenate((line[UPPER], (1.0 - s) * o + LEVEL * g * quadratic))


def _accel(fit: JointFit, figures: Callable[[FloatArray], FloatArray]) -> Affine:
    p = fit.state.common[SENSOR]
    J = differences(figures, p)
    value = figures(p)
    C = J @ fit.covariance[np.ix_(SENSOR, SENSOR)] @ J.T
    T = np.zeros((3, 3))
    T[UPPER] = value[:6]
    return Affine(T, value[6:], full_covariance(C), _dof(fit, SENSOR, J))


def gyro_model(fit: JointFit) -> Affine:
    """Gyroscope with the mean of its bias over the poses."""
    m, places = len(fit.data), fit.places
    K = fit.state.K
    beta = fit.state.bias.mean(axis=0)
    rows = np.r_[GYRO_GAIN, places.bias]
    D = np.zeros((PARAMETERS, len(rows)))
    D[:9, :9] = np.eye(9)
    D[9:, :9] = np.kron(np.eye(3), beta)
    D[9:, 9:] = np.tile(K, (1, m)) / m
    C = D @ fit.covariance[np.ix_(rows, rows)] @ D.T
    return Affine(K, K @ beta, C, _dof(fit, rows, D))


def _dof(fit: JointFit, columns: IntArray, J: FloatArray) -> float:
    """Typical effective degrees of freedom of figures with slopes J in some unknowns."""
    directions = np.zeros((fit.places.count, len(J)))
    directions[columns] = J.T
    return max(2.0, float(np.median(fit.dofs(directions))))


def straightness(fit: JointFit) -> Straightness:
    """Nonlinearity terms and how far they bend the sensor off its line."""
    value = fit.state.common[NONLINEARITY]
    C = fit.covariance[NONLINEARITY, NONLINEARITY]
    sigma = np.sqrt(np.diag(C))
    # Mean square over the sphere of x^3 - 3/5 x and of x^4 - (27 x^2 - 3 y^2 - 3 z^2) / 35.
    weight = np.repeat((1.0 / 7.0 - 9.0 / 75.0, 64.0 / 11025.0), 3)
    square = float(np.sum(weight * (value**2 - sigma**2)))
    return Straightness(
        Estimate(value[:3], sigma[:3]),
        Estimate(value[3:], sigma[3:]),
        fit.data.gravity * float(np.sqrt(max(0.0, square))),
    )


def jig_estimate(fit: JointFit) -> JigEstimate:
    """Errors of the jig and the frame it gives the sensor."""
    k = len(fit.data.mountings)
    sigma = np.sqrt(np.diag(fit.covariance))
    p = fit.state.common
    scales = np.array([fit.scales[name] for name in ("pan", "tilt", "roll")])
    # The start values; poses that are distrusted carry larger ones.
    repeatability = scales * np.min(fit.prior.servo, axis=0)
    turns = rotation.vector_of_matrix(fit.state.mounting)

    def one(place: int) -> Estimate:
        return Estimate(p[[place]], sigma[[place]])

    skewed = rotation.about_z(p[ROLL_SKEW])
    to_sensor = np.swapaxes(fit.data.mountings @ fit.state.mounting, 1, 2)
    axis = to_sensor @ skewed[:, 0]
    axis_sigma = np.empty((k, 3))
    for i in range(k):
        first = fit.places.mounting.start + 3 * i
        columns = np.r_[first : first + 3, ROLL_SKEW]
        # The roll axis leans by its skew on the plate, which is the y axis' direction there.
        lever = np.column_stack((rotation.skew(axis[i]), to_sensor[i] @ skewed[:, 1]))
        C = fit.covariance[np.ix_(columns, columns)]
        axis_sigma[i] = np.sqrt(np.diag(lever @ C @ lever.T))
    return JigEstimate(
        servo_gain=Estimate(p[SERVO_GAIN], sigma[SERVO_GAIN]),
        tilt_zero=one(TILT_ZERO),
        tilt_skew=one(TILT_SKEW),
        roll_skew=one(ROLL_SKEW),
        base=Estimate(rotation.vector_of_matrix(fit.state.base)[:2], sigma[BASE]),
        mounting=Estimate(turns, sigma[fit.places.mounting].reshape(k, 3)),
        roll_axis=Estimate(axis, axis_sigma),
        level=_level(fit, repeatability),
        repeatability=repeatability,
        wobble=_wobble(fit),
        deviation=fit.state.deviation,
        commanded=np.arange(len(fit.data)),
    )


def _level(fit: JointFit, repeatability: FloatArray) -> Estimate:
    """Lean of the sensor with all servos at zero, in its first mounting."""
    places = fit.places
    columns = np.r_[TILT_ZERO, BASE, places.mounting.start : places.mounting.start + 3]
    nominal = fit.data.mountings[0]

    def lean(change: FloatArray) -> FloatArray:
        base = rotation.to_matrix(rotation.from_rotation_vector(np.append(change[1:3], 0.0)))
        turn = rotation.to_matrix(rotation.from_rotation_vector(change[3:6]))
        tilt = rotation.about_y(fit.state.common[TILT_ZERO] + change[0] + change[6])
        A = base @ fit.state.base @ tilt @ rotation.about_x(change[7])
        up = (A @ nominal @ fit.state.mounting[0] @ turn @ nominal.T)[2]
        return np.array([-up[0], up[1]])

    J = differences(lean, np.zeros(8))
    C = np.zeros((8, 8))
    C[:6, :6] = fit.covariance[np.ix_(columns, columns)]
    C[6, 6], C[7, 7] = repeatability[1] ** 2, repeatability[2] ** 2
    return Estimate(lean(np.zeros(8)), np.sqrt(np.diag(J @ C @ J.T) + _wobble(fit) ** 2))


def _wobble(fit: JointFit) -> float:
    return fit.scales["wobble"] * float(np.min(fit.prior.wobble))


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Magnitude error (m,) of each pose the fit never saw, and its predicted sigma [m/s^2]."""

    error: FloatArray
    sigma: FloatArray


def leave_poses_out(fit: JointFit, line: Affine) -> LeftOut:
    """Take the accelerometer of each pose out of the fit in turn.

    The solution without some rows follows from the one with them:
    ``dx = N^-1 J'(1 - H)^-1 r`` with the rows' own hat matrix H.

    Parameters
    ----------
    fit : JointFit
        The fit with all poses.
    line : Affine
        What `line_over_one_g` makes of it.
    """
    data = fit.data
    weighted = fit.rows.jacobian * fit.weight[:, None]
    residual = fit.rows.residual * fit.weight
    accel = np.flatnonzero(fit.rows.kind == ROWS_OF["accel"]).reshape(-1, 3)
    error, sigma = np.empty(len(data)), np.empty(len(data))
    full = forces(data, fit.state)[0]
    up = full / np.linalg.norm(full, axis=1, keepdims=True)
    bend = np.linalg.norm(line.apply(data.accel), axis=1) - np.linalg.norm(full, axis=1)
    noise = data.accel_sigma * fit.scales["accel"]
    for i, rows in enumerate(accel):
        J = weighted[rows]
        Z = fit.covariance @ J.T
        rest = np.linalg.inv(np.eye(3) - J @ Z)
        step = Z @ (rest @ residual[rows])
        # Only the accelerometer's own unknowns move the magnitude.
        slope = up[i] @ fit.rows.jacobian[rows][:, SENSOR]
        error[i] = np.linalg.norm(full[i]) - data.gravity + slope @ step[SENSOR] + bend[i]
        own = slope @ fit.covariance[np.ix_(SENSOR, SENSOR)] @ slope
        more = slope @ Z[SENSOR] @ rest @ Z[SENSOR].T @ slope
        sigma[i] = np.sqrt(own + more + noise[i] ** 2 + bend[i] ** 2)
    return LeftOut(error, sigma)


def without_move(fit: JointFit, j: int) -> JointState:
    """Return the solution when one move was never seen."""
    rows = np.flatnonzero(fit.rows.kind == ROWS_OF["move"])[3 * j : 3 * j + 3]
    J = fit.rows.jacobian[rows] * fit.weight[rows, None]
    Z = fit.covariance @ J.T
    residual = fit.rows.residual[rows] * fit.weight[rows]
    step = Z @ np.linalg.solve(np.eye(3) - J @ Z, residual)
    return fit.state.moved(step, fit.places)
