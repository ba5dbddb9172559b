"""Weighted least squares of the joint model, with the size of every kind of error from the data.

Each class of rows has a scale of its own, estimated with the solution (Helmert's variance
components, Förstner's simple iteration): ``scale^2 = (sum of squares + 4) / (redundancy + 4)``
around the start value. One common factor could not do it: a servo that errs twice as much as
thought says nothing about the accelerometer's noise.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.calibration.joint_data import BIAS_WALK, JointData
from imu_rig.calibration.joint_model import (
    ACCEL_GAIN,
    ACCEL_OFFSET,
    BASE,
    CLASSES,
    DRIFT,
    EARTH,
    GYRO_GAIN,
    MOUNTING,
    NONLINEARITY,
    ROLL_SKEW,
    ROWS_OF,
    SERVO_GAIN,
    TILT_SKEW,
    TILT_ZERO,
    Attitudes,
    JointState,
    Places,
    Prior,
    System,
    Turned,
    attitudes,
    nominal,
    system,
)
from imu_rig.calibration.magnitude import UPPER
from imu_rig.calibration.model import Affine
from imu_rig.units import DEG, MILLI_G, STANDARD_GRAVITY

SERVO = 0.5 * DEG
"""Repeatability of a hobby servo to start from [rad]."""
HELD = 0.1 * DEG
"""Change of an axis from pose to pose while its servo holds, to start from [rad]."""
WOBBLE = 0.1 * DEG
"""Rotation of a pose that no servo explains: play of bearings, a plate that bends [rad]."""
MOUNTING_SIGMA = 5.0 * DEG
FULL_SCALE = 2.0
"""Range [g] that a data sheet's nonlinearity refers to."""
SHEET_NONLINEARITY = 0.005
"""Error at full scale over full scale that an accelerometer's data sheet allows."""
USUAL_DRIFT = np.array([0.25 * MILLI_G] * 3 + [1e-4] * 2)
"""Change during a session to start from: half a degree of warming at 0.5 mg and 0.02 % each."""
SCALE_DOF = 4.0
"""Weight of the start value of a scale, in observations."""
VARIANCE_FROM = 3
"""Step from which on the scales follow the data: before, residuals show the start, not noise."""
STEPS = 80
"""Most steps; variance components of nearly equal effect settle slowly."""
CONVERGED = 0.003
"""Largest step in standard uncertainties that ends the iteration."""
SETTLED = 0.02
"""Largest relative change of a scale that ends the iteration."""
INTEGRATE_AGAIN = 2e-3
"""Change of the gyroscope's gain that makes the linearized moves worth another integration."""
INTEGRATED = 2e-5
"""The same at the solution: a turn of pi is then right to a thousandth of its noise."""


@dataclass(frozen=True, eq=False)
class JointFit:
    """A converged joint fit of ``r`` rows and ``p`` unknowns.

    Attributes
    ----------
    data : JointData
        What was fitted.
    state : JointState
        The solution.
    places : Places
        Where its unknowns stand in ``covariance``.
    rows : System
        Residuals and derivatives there.
    weight : shape (r,)
        Reciprocal standard deviation of every row, scales included.
    covariance : shape (p, p)
        Of a small step from the solution.
    scales : dict of str to float
        Size of every class of rows over what was assumed.
    redundancy : dict of str to float
        Degrees of freedom behind every scale.
    converged : bool
        Whether the last step was small.
    """

    data: JointData
    state: JointState
    prior: Prior
    places: Places
    rows: System
    weight: FloatArray
    covariance: FloatArray
    scales: dict[str, float]
    redundancy: dict[str, float]
    converged: bool
    turned: Turned = field(repr=False)

    def attitudes(self) -> Attitudes:
        """Attitudes of the poses at the solution."""
        return attitudes(self.data, self.state)

    def dofs(self, directions: FloatArray) -> FloatArray:
        """Effective degrees of freedom (Satterthwaite) of linear figures ``directions (p, k)``."""
        reach = (self.rows.jacobian * self.weight[:, None]) @ (self.covariance @ directions)
        total, spread = np.zeros(reach.shape[1]), np.zeros(reach.shape[1])
        for name, number in ROWS_OF.items():
            part = np.sum(reach[self.rows.kind == number] ** 2, axis=0)
            total += part
            if name != "prior":
                spread += part**2 / (self.redundancy[name] + SCALE_DOF)
        return np.asarray(total**2 / np.maximum(spread, 1e-300))


def default_prior(data: JointData, *, servo: float = SERVO) -> Prior:
    """Assumptions before a session: a nominal sensor of the class, a hobby jig."""
    sigma = np.zeros(MOUNTING)
    sigma[ACCEL_GAIN] = 0.1
    sigma[ACCEL_OFFSET] = 0.2 * STANDARD_GRAVITY
    sigma[GYRO_GAIN] = 0.1
    error = SHEET_NONLINEARITY * FULL_SCALE
    sigma[NONLINEARITY] = np.repeat((error / FULL_SCALE**2, error / FULL_SCALE**3), 3)
    sigma[SERVO_GAIN] = 0.03
    sigma[TILT_ZERO] = 2.0 * DEG
    sigma[[TILT_SKEW, ROLL_SKEW]] = 1.5 * DEG
    sigma[BASE] = 2.0 * DEG
    sigma[EARTH] = data.earth_sigma
    sigma[DRIFT] = USUAL_DRIFT
    return Prior(
        sigma=sigma,
        mounting=MOUNTING_SIGMA,
        servo=np.full((len(data), 3), servo),
        held=HELD,
        wobble=np.full(len(data), WOBBLE),
        walk=BIAS_WALK,
        walk_in_moves=BIAS_WALK,
    )


def start(data: JointData, accel: Affine) -> JointState:
    """Begin with gravity's magnitude, the mounting that fits the labels, a nominal gyroscope.

    Parameters
    ----------
    data : JointData
        The session.
    accel : Affine
        Accelerometer from gravity's magnitude, K upper triangular.
    """
    common = nominal(data)
    common[ACCEL_GAIN], common[ACCEL_OFFSET] = accel.K[UPPER], accel.b
    mounting = np.repeat(np.eye(3)[None], len(data.mountings), axis=0)
    state = JointState(
        common=common,
        base=np.eye(3),
        mounting=mounting,
        deviation=np.zeros((len(data), 3)),
        wobble=np.zeros((len(data), 3)),
        bias=data.gyro.copy() if data.has_gyro else np.zeros((len(data), 3)),
    )
    seen = unit(accel.apply(data.accel))
    told = attitudes(data, state).A[:, 2, :]
    turns = [
        align(seen[data.mounting == k], told[data.mounting == k])
        for k in range(len(data.mountings))
    ]
    return JointState(
        common, state.base, np.array(turns), state.deviation, state.wobble, state.bias
    )


def align(seen: FloatArray, told: FloatArray) -> FloatArray:
    """Rotation R (3, 3) with ``told = R seen`` for most of the unit vectors (m, 3).

    Weighted Kabsch, each vector's weight falling with its angle beyond some degrees.
    """
    weight = np.ones(len(seen))
    R = np.eye(3)
    if len(seen) < 2:
        return R
    for _ in range(8):
        U, _, Vt = np.linalg.svd((told * weight[:, None]).T @ seen)
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        angle = np.arccos(np.clip(np.sum((seen @ R.T) * told, axis=1), -1.0, 1.0))
        weight = np.exp(-(np.clip(angle / max(6.0 * DEG, float(np.median(angle))), 0, 50.0) ** 1.5))
    return np.asarray(R)


def fit_joint(
    data: JointData, prior: Prior, begin: JointState, *, components: bool = True
) -> JointFit:
    """Fit sensor and jig.

    Parameters
    ----------
    data : JointData
        The session.
    prior : Prior
        Assumptions.
    begin : JointState
        Where to start, within some degrees.
    components : bool
        Whether the data judge the size of the errors.
    """
    places = Places.of(data)
    state, scales = begin, np.ones(len(CLASSES))
    redundancy = np.zeros(len(CLASSES))
    turned = Turned.at(data, state)
    converged = False
    for step_number in range(STEPS):
        if np.max(np.abs(state.K - turned.state.K)) > INTEGRATE_AGAIN:
            turned = Turned.at(data, state)
        rows = system(data, state, turned, prior, places)
        weight = 1.0 / (rows.sigma * scales[rows.kind])
        J = rows.jacobian * weight[:, None]
        covariance = _inverse(J.T @ J)
        step = -covariance @ (J.T @ (rows.residual * weight))
        if step_number >= VARIANCE_FROM and components:
            predicted = rows.residual + rows.jacobian @ step
            before = scales
            scales, redundancy = _scales(rows, predicted, J, covariance, scales)
            prior = replace(prior, walk_in_moves=prior.walk * scales[ROWS_OF["walk"]])
            settled = bool(np.max(np.abs(np.log(scales / before))) < SETTLED)
        else:
            settled = not components
        size = float(np.max(np.abs(step) / np.sqrt(np.diag(covariance))))
        state = state.moved(step, places)
        if settled and size < CONVERGED:
            # The last steps must stand on moves that were integrated where they ended.
            converged = bool(np.max(np.abs(state.K - turned.state.K)) < INTEGRATED)
            if converged:
                break
            turned = Turned.at(data, state)
    return _finished(data, prior, state, turned, scales, redundancy, converged)


def _finished(
    data: JointData,
    prior: Prior,
    state: JointState,
    turned: Turned,
    scales: FloatArray,
    redundancy: FloatArray,
    converged: bool,
) -> JointFit:
    places = Places.of(data)
    rows = system(data, state, turned, prior, places)
    weight = 1.0 / (rows.sigma * scales[rows.kind])
    J = rows.jacobian * weight[:, None]
    return JointFit(
        data=data,
        state=state,
        prior=prior,
        places=places,
        rows=rows,
        weight=weight,
        covariance=_inverse(J.T @ J),
        scales=dict(zip(CLASSES, scales.tolist(), strict=True)),
        redundancy=dict(zip(CLASSES, redundancy.tolist(), strict=True)),
        converged=converged,
        turned=turned,
    )


def predict(data: JointData, prior: Prior | None = None) -> JointFit:
    """Return the fit a session is expected to give, before it runs: its covariance is what counts.

    Parameters
    ----------
    data : JointData
        Ideal readings of a protocol, with the noise that is expected.
    prior : Prior, optional
        Assumptions; those of a hobby jig by default.
    """
    prior = prior or default_prior(data)
    state = JointState(
        common=nominal(data),
        base=np.eye(3),
        mounting=np.repeat(np.eye(3)[None], len(data.mountings), axis=0),
        deviation=np.zeros((len(data), 3)),
        wobble=np.zeros((len(data), 3)),
        bias=np.zeros((len(data), 3)),
    )
    ones = np.ones(len(CLASSES))
    turned = Turned.at(data, state)
    return _finished(data, prior, state, turned, ones, np.full(len(CLASSES), np.inf), True)


def _scales(
    rows: System, residual: FloatArray, J: FloatArray, covariance: FloatArray, scales: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Scales and redundancies of the classes after a step."""
    hat = np.sum((J @ covariance) * J, axis=1)
    found, redundancy = np.ones_like(scales), np.zeros_like(scales)
    for name, number in ROWS_OF.items():
        mine = rows.kind == number
        if name == "prior" or not np.any(mine):
            continue
        redundancy[number] = max(0.0, float(np.sum(1.0 - hat[mine])))
        square = float(np.sum((residual[mine] / rows.sigma[mine]) ** 2))
        found[number] = np.sqrt((square + SCALE_DOF) / (redundancy[number] + SCALE_DOF))
    # Short stills cannot show less noise than they hold.
    found[ROWS_OF["accel"]] = max(1.0, found[ROWS_OF["accel"]])
    return found, redundancy


def _inverse(N: FloatArray) -> FloatArray:
    scale = 1.0 / np.sqrt(np.diag(N))
    inverse: FloatArray = np.linalg.inv(N * np.outer(scale, scale)) * np.outer(scale, scale)
    return inverse


def unit(v: FloatArray) -> FloatArray:
    """Vectors (m, 3) of length one."""
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))
