"""Sensor and jig as one model: attitudes from imperfect servos, residuals, analytic derivatives.

Attitude of a pose, sensor to navigation axes:
``A = B Rz(pan) Rx(a) Ry(tilt) Rx(-a) Rz(b) Rx(roll) Rz(-b) N M W`` with the base ``B`` (tilted
about level axes), the skews ``a`` and ``b``, the nominal and the actual mounting ``N M``, and a
small wobble ``W`` of every pose. An angle is ``(1 + gain) commanded + zero + deviation`` with one
deviation per pose and axis. Zeros of pan and roll, the tilt axis' heading and the roll axis'
elevation cannot be told from base, mounting and tilt zero: they are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imu_rig import rotation
from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.calibration.joint_data import JointData
from imu_rig.calibration.magnitude import UPPER
from imu_rig.calibration.moves import integrate_with_slopes

ACCEL_GAIN = slice(0, 6)
ACCEL_OFFSET = slice(6, 9)
GYRO_GAIN = slice(9, 18)
NONLINEARITY = slice(18, 24)
SERVO_GAIN = slice(24, 27)
TILT_ZERO = 27
TILT_SKEW = 28
ROLL_SKEW = 29
BASE = slice(30, 32)
EARTH = slice(32, 35)
G_SENSITIVITY = slice(35, 44)
DRIFT = slice(44, 49)
MOUNTING = 49
"""Where the mountings begin, three numbers each; deviations, wobbles and biases of the poses
follow."""
CLASSES = (
    "accel",
    "rest",
    "walk",
    "move",
    "pan",
    "tilt",
    "roll",
    "held",
    "wobble",
    "drift",
    "prior",
)
"""Kinds of rows, each with a size of its own."""
ROWS_OF = {name: number for number, name in enumerate(CLASSES)}
DISTRUSTED = 1.0
"""Standard deviation beyond which a servo's angle counts for nothing [rad]."""


@dataclass(frozen=True, eq=False)
class JointState:
    """Values of all unknowns over ``m`` poses and ``k`` mountings.

    Attributes
    ----------
    common : shape (49,)
        The unknowns common to all poses, in the order of the slices of this module. The
        accelerometer's upper triangular gain T and offset o [m/s^2]: ``force = T (raw - g s) - o``
        with the nonlinearity ``s``, quadratic and cubic share of 1 g; the gyroscope's gain K;
        gains of the servos, zero of tilt, the two skews [rad]; base (kept as a matrix instead);
        rotation of the Earth [rad/s]; g-sensitivity row by row [rad/s per g, raw]; drift from begin
        to end of the accelerometer's raw offset [m/s^2], of its gain and of the gyroscope's [1].
    base : shape (3, 3)
        Base of the jig to navigation axes.
    mounting : shape (k, 3, 3)
        What each mounting turns beyond its nominal rotation.
    deviation : shape (m, 3)
        Of the servos' angles from their lines [rad].
    wobble : shape (m, 3)
        Small rotation of every pose, sensor axes [rad].
    bias : shape (m, 3)
        Raw bias of the gyroscope [rad/s].
    """

    common: FloatArray
    base: FloatArray
    mounting: FloatArray
    deviation: FloatArray
    wobble: FloatArray
    bias: FloatArray

    @property
    def T(self) -> FloatArray:
        """Accelerometer gain at zero input (3, 3), upper triangular."""
        T = np.zeros((3, 3))
        T[UPPER] = self.common[ACCEL_GAIN]
        return T

    @property
    def K(self) -> FloatArray:
        """Gyroscope gain (3, 3)."""
        return self.common[GYRO_GAIN].reshape(3, 3)

    def moved(self, step: FloatArray, where: Places) -> JointState:
        """Return the state after a step of all unknowns."""
        common = self.common + step[: len(self.common)]
        turn = np.append(step[BASE], 0.0)
        m = len(self.bias)
        return replace(
            self,
            common=common,
            base=_small(turn) @ self.base,
            mounting=self.mounting @ _small(step[where.mounting].reshape(-1, 3)),
            deviation=self.deviation + step[where.deviation].reshape(m, 3),
            wobble=self.wobble + step[where.wobble].reshape(m, 3),
            bias=self.bias + step[where.bias].reshape(m, 3),
        )


@dataclass(frozen=True)
class Places:
    """Where the unknowns of mountings and poses stand in the vector of all."""

    mounting: slice
    deviation: slice
    wobble: slice
    bias: slice
    count: int

    @staticmethod
    def of(data: JointData) -> Places:
        """Lay out the unknowns of a session."""
        m, a = len(data), MOUNTING
        b = a + 3 * len(data.mountings)
        c, d, e = b + 3 * m, b + 6 * m, b + 9 * m
        return Places(slice(a, b), slice(b, c), slice(c, d), slice(d, e), e)


@dataclass(frozen=True, eq=False)
class System:
    """Residuals (r,) and their derivatives (r, p), each row with its class and start sigma."""

    residual: FloatArray
    jacobian: FloatArray
    sigma: FloatArray
    kind: IntArray


@dataclass(frozen=True, eq=False)
class Turned:
    """Rotations (n, 4) of the moves by the gyroscope at ``state``, and their slopes (n, 3, 15)."""

    state: JointState
    q: FloatArray
    slope: FloatArray

    @staticmethod
    def at(data: JointData, state: JointState) -> Turned:
        """Integrate the moves."""
        q, slope = integrate_with_slopes(data.moves, state.K, offsets(data, state))
        return Turned(state, q, slope)

    def moved_to(self, data: JointData, state: JointState) -> FloatArray:
        """Rotations (n, 4) for another state nearby, to first order."""
        first, last = data.moves.first, data.moves.last
        change = (offsets(data, state) - offsets(data, self.state)) if len(first) else state.bias
        gain = (state.K - self.state.K).ravel()
        turn = self.slope[:, :, :9] @ gain
        turn += np.einsum("nij,nj->ni", self.slope[:, :, 9:12], change[first])
        turn += np.einsum("nij,nj->ni", self.slope[:, :, 12:], change[last])
        warmer = state.common[DRIFT][4] * _lateness(data)[last]
        turn += self.slope[:, :, :9] @ state.K.ravel() * warmer[:, None]
        return rotation.multiply(self.q, rotation.from_rotation_vector(turn))


@dataclass(frozen=True, eq=False)
class Attitudes:
    """Attitudes (m, 3, 3) and how they turn, in sensor axes, with each angle (m, 3)."""

    A: FloatArray
    pan: FloatArray
    tilt: FloatArray
    roll: FloatArray
    tilt_skew: FloatArray
    roll_skew: FloatArray
    wobble: FloatArray


def attitudes(data: JointData, state: JointState) -> Attitudes:
    """Attitudes of all poses and their derivatives with respect to the jig."""
    p = state.common
    angles = data.angles * (1.0 + p[SERVO_GAIN]) + state.deviation
    a, b = p[TILT_SKEW], p[ROLL_SKEW]
    panned = state.base @ rotation.about_z(angles[:, 0])
    before_tilt = panned @ rotation.about_x(a)
    tilted = before_tilt @ rotation.about_y(angles[:, 1] + p[TILT_ZERO])
    arm = tilted @ rotation.about_x(-a)
    before_roll = arm @ rotation.about_z(b)
    rolled = before_roll @ rotation.about_x(angles[:, 2])
    mounted = (data.mountings @ state.mounting)[data.mounting]
    wobble = rotation.to_matrix(rotation.from_rotation_vector(state.wobble))
    A = rolled @ rotation.about_z(-b) @ mounted @ wobble
    back = np.swapaxes(A, 1, 2)

    def seen(axis: FloatArray) -> FloatArray:
        axes = np.broadcast_to(axis, (len(data), 3))
        return np.asarray(np.einsum("mij,mj->mi", back, axes))

    return Attitudes(
        A=A,
        pan=seen(state.base[:, 2]),
        tilt=seen(before_tilt[:, :, 1]),
        roll=seen(before_roll[:, :, 0]),
        tilt_skew=seen(panned[:, :, 0] - tilted[:, :, 0]),
        roll_skew=seen(arm[:, :, 2] - rolled[:, :, 2]),
        wobble=wobble,
    )


def offsets(data: JointData, state: JointState) -> FloatArray:
    """Raw rate of the gyroscope at rest without the Earth's rotation, (m, 3) [rad/s]."""
    G = state.common[G_SENSITIVITY].reshape(3, 3)
    return np.asarray(state.bias + data.force @ G.T / data.gravity)


def forces(data: JointData, state: JointState) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Calibrated specific force of all poses (m, 3), the linearized readings, and inputs in g."""
    p, g = state.common, data.gravity
    T, o = state.T, p[ACCEL_OFFSET]
    u = (data.accel @ T.T - o) / g
    quadratic, cubic = p[NONLINEARITY][:3], p[NONLINEARITY][3:]
    straight = data.accel - g * (quadratic * u**2 + cubic * u**3)
    late = _lateness(data)[:, None]
    drift = p[DRIFT][:3] * late + p[DRIFT][3] * late * data.accel
    return (straight - drift) @ T.T - o, straight, u


def system(
    data: JointData, state: JointState, turned: Turned, prior: Prior, places: Places
) -> System:
    """Residuals and derivatives at a state.

    Rows in turn: three per pose of the accelerometer against gravity, three of the resting
    gyroscope, three of its bias from pose to pose, three per move of the rotation between the
    attitudes at its ends, then deviations, wobbles and priors.
    """
    where = attitudes(data, state)
    blocks = [_accel_rows(data, state, where, places)]
    if data.has_gyro:
        blocks.append(_rest_rows(data, state, where, places))
        blocks.append(_walk_rows(data, state, prior, places))
        blocks.append(_move_rows(data, state, where, turned, prior, places))
    blocks += _latent_rows(data, state, prior, places)
    blocks.append(_prior_rows(data, state, prior, places))
    return System(
        residual=np.concatenate([b.residual for b in blocks]),
        jacobian=np.concatenate([b.jacobian for b in blocks]),
        sigma=np.concatenate([b.sigma for b in blocks]),
        kind=np.concatenate([b.kind for b in blocks]),
    )


@dataclass(frozen=True, eq=False)
class Prior:
    """What is assumed before the session, as standard deviations (0 keeps an unknown fixed).

    Attributes
    ----------
    sigma : shape (49,)
        Of the common unknowns about `nominal`.
    mounting : float
        Of each mounting's rotation [rad].
    servo : shape (m, 3)
        Of the servos' deviations where they were driven [rad]; a large one distrusts that pose's
        label.
    held : float
        Of what a deviation changes by from pose to pose while its servo is not driven [rad].
    wobble : shape (m,)
        Of each pose's wobble, per axis [rad].
    walk : float
        Random walk of the gyroscope's bias [rad/s per sqrt(s)].
    walk_in_moves : float
        The same as the rotations of the moves feel it between their ends.
    """

    sigma: FloatArray
    mounting: float
    servo: FloatArray
    held: float
    wobble: FloatArray
    walk: float
    walk_in_moves: float


def _accel_rows(data: JointData, state: JointState, where: Attitudes, places: Places) -> System:
    m, g, T = len(data), data.gravity, state.T
    force, straight, u = forces(data, state)
    up = g * where.A[:, 2, :]
    J = np.zeros((m, 3, places.count))
    for column, (row, element) in enumerate(zip(*UPPER, strict=True)):
        J[:, row, column] = straight[:, element]
    J[:, :, ACCEL_OFFSET] = -np.eye(3)
    start = NONLINEARITY.start
    J[:, :, start : start + 3] = -g * T * (u**2)[:, None, :]
    J[:, :, start + 3 : start + 6] = -g * T * (u**3)[:, None, :]
    late = _lateness(data)[:, None, None]
    J[:, :, DRIFT.start : DRIFT.start + 3] = -late * T
    J[:, :, DRIFT.start + 3] = -late[:, :, 0] * (data.accel @ T.T)
    # Turning the sensor by d moves gravity in its axes by up x d.
    _add_attitude(J, -rotation.skew(up), state, data, where, places, np.arange(m))
    return System(
        (force - up).ravel(),
        J.reshape(3 * m, -1),
        np.repeat(data.accel_sigma, 3),
        np.full(3 * m, ROWS_OF["accel"]),
    )


def _rest_rows(data: JointData, state: JointState, where: Attitudes, places: Places) -> System:
    m, p = len(data), state.common
    inverse = np.linalg.inv(state.K)
    seen = inverse @ np.swapaxes(where.A, 1, 2)
    residual = data.gyro - offsets(data, state) - seen @ p[EARTH]
    J = np.zeros((m, 3, places.count))
    J[:, :, EARTH] = -seen
    _add_g_sensitivity(J, data, -np.broadcast_to(np.eye(3), (m, 3, 3)), np.arange(m))
    bias = J[:, :, places.bias].reshape(m, 3, m, 3)
    bias[np.arange(m), :, np.arange(m), :] = -np.eye(3)
    J[:, :, places.bias] = bias.reshape(m, 3, 3 * m)
    return System(
        residual.ravel(),
        J.reshape(3 * m, -1),
        data.gyro_sigma.ravel(),
        np.full(3 * m, ROWS_OF["rest"]),
    )


def _walk_rows(data: JointData, state: JointState, prior: Prior, places: Places) -> System:
    steps = len(data) - 1
    rows = np.arange(3 * steps)
    J = np.zeros((3 * steps, places.count))
    J[rows, places.bias.start + rows] = -1.0
    J[rows, places.bias.start + rows + 3] = 1.0
    sigma = prior.walk * np.sqrt(np.diff(data.t))
    return System(
        np.diff(state.bias, axis=0).ravel(),
        J,
        np.repeat(sigma, 3),
        np.full(3 * steps, ROWS_OF["walk"]),
    )


def _move_rows(
    data: JointData,
    state: JointState,
    where: Attitudes,
    turned: Turned,
    prior: Prior,
    places: Places,
) -> System:
    first, last = data.moves.first, data.moves.last
    n, T = len(first), data.moves.duration
    q = turned.moved_to(data, state)
    earth = rotation.to_matrix(rotation.from_rotation_vector(T[:, None] * state.common[EARTH]))
    begin, end = where.A[first], where.A[last]
    between = np.swapaxes(begin, 1, 2) @ earth @ end
    misfit = np.swapaxes(rotation.to_matrix(q), 1, 2) @ between
    residual = rotation.vector_of_matrix(misfit)
    J = np.zeros((n, 3, places.count))
    J[:, :, GYRO_GAIN] = -turned.slope[:, :, :9]
    J[:, :, DRIFT.start + 4] = (
        -(turned.slope[:, :, :9] @ state.K.ravel()) * _lateness(data)[last][:, None]
    )
    J[:, :, EARTH] = np.swapaxes(end, 1, 2) * T[:, None, None]
    eye = np.broadcast_to(np.eye(3), (n, 3, 3))
    _add_attitude(J, eye, state, data, where, places, last)
    _add_attitude(J, -np.swapaxes(between, 1, 2), state, data, where, places, first)
    bias = J[:, :, places.bias].reshape(n, 3, len(data), 3)
    rows = np.arange(n)
    for slope, pose in ((turned.slope[:, :, 9:12], first), (turned.slope[:, :, 12:], last)):
        bias[rows, :, pose, :] -= slope
        _add_g_sensitivity(J, data, -slope, pose)
    J[:, :, places.bias] = bias.reshape(n, 3, -1)
    # A bias that is known at both ends still walks in between.
    sigma = np.sqrt(data.move_sigma**2 + prior.walk_in_moves**2 * T**3 / 12.0)
    return System(
        residual.ravel(),
        J.reshape(3 * n, -1),
        np.repeat(sigma, 3),
        np.full(3 * n, ROWS_OF["move"]),
    )


def driven(data: JointData, prior: Prior) -> BoolArray:
    """Servos (m, 3) that were driven on the way to each pose, and so err anew there."""
    anew = np.ones((len(data), 3), dtype=bool)
    same = (np.abs(np.diff(data.angles, axis=0)) < 1e-9) & (np.diff(data.mounting) == 0)[:, None]
    trusted = prior.servo < DISTRUSTED
    anew[1:] = ~(same & trusted[1:] & trusted[:-1])
    return anew


def _latent_rows(data: JointData, state: JointState, prior: Prior, places: Places) -> list[System]:
    m = len(state.bias)
    anew = driven(data, prior)
    blocks = []
    for axis, name in enumerate(("pan", "tilt", "roll")):
        place = places.deviation.start + 3 * np.arange(m) + axis
        J = np.zeros((m, places.count))
        J[np.arange(m), place] = 1.0
        residual = state.deviation[:, axis].copy()
        rests = np.flatnonzero(~anew[:, axis])
        residual[rests] -= state.deviation[rests - 1, axis]
        J[rests, place[rests - 1]] = -1.0
        sigma = np.where(anew[:, axis], prior.servo[:, axis], prior.held)
        kind = np.where(anew[:, axis], ROWS_OF[name], ROWS_OF["held"])
        blocks.append(System(residual, J, sigma, kind))
    J = np.zeros((3 * m, places.count))
    J[np.arange(3 * m), places.wobble.start + np.arange(3 * m)] = 1.0
    sigma = np.repeat(prior.wobble, 3)
    blocks.append(System(state.wobble.ravel(), J, sigma, np.full(3 * m, ROWS_OF["wobble"])))
    return blocks


def _prior_rows(data: JointData, state: JointState, prior: Prior, places: Places) -> System:
    value = state.common - nominal(data)
    value[BASE] = rotation.vector_of_matrix(state.base)[:2]
    turn = rotation.vector_of_matrix(state.mounting).ravel()
    residual = np.concatenate((value, turn, state.bias.ravel()))
    count = len(value) + len(turn)
    J = np.zeros((len(residual), places.count))
    J[np.arange(count), np.arange(count)] = 1.0
    J[count + np.arange(3 * len(data)), places.bias.start + np.arange(3 * len(data))] = 1.0
    sigma = np.concatenate(
        (
            np.maximum(prior.sigma, 1e-12),
            np.full(len(turn), prior.mounting),
            # Keeps the bias of a gyroscope that takes no part in place.
            np.full(3 * len(data), 1.0),
        )
    )
    kind = np.full(len(residual), ROWS_OF["prior"])
    kind[DRIFT] = ROWS_OF["drift"]
    return System(residual, J, sigma, kind)


def nominal(data: JointData) -> FloatArray:
    """Return the common unknowns (49,) of a nominal sensor on a perfect jig."""
    p = np.zeros(MOUNTING)
    p[ACCEL_GAIN] = np.eye(3)[UPPER]
    p[GYRO_GAIN] = np.eye(3).ravel()
    p[EARTH] = data.earth_mean
    return p


def _add_attitude(
    J: FloatArray,
    lever: FloatArray,
    state: JointState,
    data: JointData,
    where: Attitudes,
    places: Places,
    pose: IntArray,
) -> None:
    """Add ``lever (n, 3, 3) @ d attitude of pose (n,)`` to the rows J (n, 3, p)."""
    rows = np.arange(len(pose))

    def turned(axis: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("nij,nj->ni", lever, axis[pose]))

    servos = (turned(where.pan), turned(where.tilt), turned(where.roll))
    for axis, column in enumerate(servos):
        J[:, :, SERVO_GAIN.start + axis] += column * data.angles[pose, axis, None]
        J[rows, :, places.deviation.start + 3 * pose + axis] += column
    J[:, :, TILT_ZERO] += servos[1]
    J[:, :, TILT_SKEW] += turned(where.tilt_skew)
    J[:, :, ROLL_SKEW] += turned(where.roll_skew)
    back = lever @ np.swapaxes(where.A[pose], 1, 2)
    J[:, :, BASE] += back[:, :, :2]
    mounting = lever @ np.swapaxes(where.wobble[pose], 1, 2)
    for axis in range(3):
        J[rows, :, places.mounting.start + 3 * data.mounting[pose] + axis] += mounting[:, :, axis]
        J[rows, :, places.wobble.start + 3 * pose + axis] += lever[:, :, axis]


def _add_g_sensitivity(J: FloatArray, data: JointData, lever: FloatArray, pose: IntArray) -> None:
    """Add ``lever @ d offsets`` of the g-sensitivity to the rows J (n, 3, p)."""
    force = data.force[pose] / data.gravity
    product = lever[:, :, :, None] * force[:, None, None, :]
    J[:, :, G_SENSITIVITY] += product.reshape(len(pose), 3, 9)


def _lateness(data: JointData) -> FloatArray:
    """Place of each pose in the session, from -1/2 to 1/2, shape (m,)."""
    span = float(data.t[-1] - data.t[0])
    return np.asarray((data.t - 0.5 * (data.t[-1] + data.t[0])) / max(span, 1e-9))


def _small(turn: FloatArray) -> FloatArray:
    return rotation.to_matrix(rotation.from_rotation_vector(turn))
