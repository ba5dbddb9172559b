"""The calibration model ``calibrated = K @ raw - b``, its uncertainty and its physical meaning."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray

AXES = ("x", "y", "z")
PARAMETERS = 12
"""Parameters of one sensor: K row by row, then b."""


@dataclass(frozen=True, eq=False)
class Affine:
    """Gain and offset of a three-axis sensor (equation 4 of the jig paper).

    Attributes
    ----------
    K : shape (3, 3)
        Gain: scale, cross-axis terms and the rotation into the output frame, dimensionless
        because ``raw`` is nominally scaled.
    b : shape (3,)
        Offset in the output unit, m/s^2 or rad/s: what ``K @ raw`` shows at zero input.
    covariance : shape (12, 12)
        Covariance of ``[K row by row, b]``. Zero rows belong to what a convention or the solver
        fixed (the lower triangle of an accelerometer in the sensor frame, for one).
    dof : float
        Effective degrees of freedom behind the covariance; a 95 % interval is the standard
        uncertainty times `coverage_factor`.
    """

    K: FloatArray
    b: FloatArray
    covariance: FloatArray
    dof: float = float("inf")

    def __post_init__(self) -> None:
        for name, shape in (("K", (3, 3)), ("b", (3,)), ("covariance", (PARAMETERS,) * 2)):
            value = np.array(getattr(self, name), dtype=float)
            if value.shape != shape:
                raise ValueError(f"{name} must have the shape {shape}, not {value.shape}")
            if not np.all(np.isfinite(value)):
                raise ValueError(f"{name} must be finite")
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    @staticmethod
    def identity() -> Affine:
        """Return the model that changes nothing and is exactly known."""
        return Affine(np.eye(3), np.zeros(3), np.zeros((PARAMETERS, PARAMETERS)))

    @property
    def is_nominal(self) -> bool:
        """Whether it changes nothing, as no calibration from data does."""
        return bool(np.array_equal(self.K, np.eye(3)) and not self.b.any())

    def apply(self, raw: FloatArray) -> FloatArray:
        """Calibrate readings, shape (..., 3)."""
        calibrated: FloatArray = raw @ self.K.T - self.b
        return calibrated

    def undo(self, calibrated: FloatArray) -> FloatArray:
        """Return the raw readings (..., 3) that `apply` turns into ``calibrated``."""
        raw: FloatArray = (calibrated + self.b) @ np.linalg.inv(self.K).T
        return raw

    def rotated(self, Q: FloatArray) -> Affine:
        """Express the output in a frame turned by the orthogonal matrix ``Q`` (3, 3)."""
        J = np.zeros((PARAMETERS, PARAMETERS))
        J[:9, :9] = np.kron(Q, np.eye(3))
        J[9:, 9:] = Q
        return Affine(Q @ self.K, Q @ self.b, J @ self.covariance @ J.T, self.dof)

    def with_bias_covariance(self, covariance: FloatArray) -> Affine:
        """Return the same model with ``covariance`` (3, 3) added to that of b."""
        C = self.covariance.copy()
        C[9:, 9:] += covariance
        return Affine(self.K, self.b, C, self.dof)

    @property
    def K_uncertainty(self) -> FloatArray:
        """Standard uncertainties of the elements of K, shape (3, 3)."""
        return self._standard[:9].reshape(3, 3)

    @property
    def b_uncertainty(self) -> FloatArray:
        """Standard uncertainties of b in the output unit, shape (3,)."""
        return self._standard[9:]

    @property
    def coverage_factor(self) -> float:
        """Student's t factor from standard uncertainty to the half width of a 95 % interval."""
        return student_factor(self.dof)

    @property
    def _standard(self) -> FloatArray:
        sigma: FloatArray = np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))
        return sigma


@dataclass(frozen=True, eq=False)
class PhysicalFigures:
    """What a calibration says about the sensor itself, whatever frame K is expressed in.

    The sensor reads ``raw = S @ (input + b)`` with ``S = inverse(K)``; row i of S is the
    sensitivity of axis i times the unit direction in which that axis senses.

    Attributes
    ----------
    scale_percent : shape (3,)
        How much too much each axis reads per unit of input along its sensing direction [%].
    cross_rad : shape (3,) or (6,)
        Lean of a sensing direction toward another axis of the sensor frame [rad], in the order
        of `cross_names`. Three for an accelerometer, whose own axes define the sensor frame (so
        they are its non-orthogonality); six for a gyroscope.
    cross_names : tuple of str
        Which lean: ``"xy"`` is sensing direction x toward frame axis y.
    bias : shape (3,)
        Reading at zero input, in the input sense [m/s^2 or rad/s].
    scale_percent_u, cross_rad_u, bias_u
        Their standard uncertainties.
    """

    scale_percent: FloatArray
    cross_rad: FloatArray
    cross_names: tuple[str, ...]
    bias: FloatArray
    scale_percent_u: FloatArray
    cross_rad_u: FloatArray
    bias_u: FloatArray

    @property
    def angles(self) -> str:
        """What `cross_rad` is called: of a sensor's own axes, or against another one's."""
        return "non-orthogonality" if len(self.cross_names) == 3 else "cross-axis"


def student_factor(dof: float) -> float:
    """Return the 97.5 % point of Student's t for ``dof`` >= 2 degrees of freedom, within 1 %.

    Fisher's expansion in 1/dof (Abramowitz and Stegun 26.7.5).
    """
    z = 1.959964
    g1 = (z**3 + z) / 4
    g2 = (5 * z**5 + 16 * z**3 + 3 * z) / 96
    g3 = (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384
    g4 = (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / 92160
    n = min(max(dof, 2.0), 1e12)
    return z + g1 / n + g2 / n**2 + g3 / n**3 + g4 / n**4


def sensor_frame(K: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Split ``K = Q @ T`` with Q orthogonal and T upper triangular with a positive diagonal.

    Q turns the sensor frame (this project's convention: the frame in which the accelerometer's K
    is upper triangular) into the frame in which K is expressed; T does not depend on that frame.
    """
    Q, T = np.linalg.qr(K)
    sign = np.where(np.diag(T) < 0, -1.0, 1.0)
    return Q * sign, sign[:, None] * T


def physical_figures(affine: Affine, accel: Affine | None = None) -> PhysicalFigures:
    """Scale, cross-axis leans and bias with standard uncertainties.

    Parameters
    ----------
    affine : Affine
        Accelerometer (without ``accel``) or gyroscope.
    accel : Affine, optional
        The accelerometer of the same unit, whose axes define the sensor frame for a gyroscope.
    """
    gyro = accel is not None
    cross = [(i, j) for i in range(3) for j in range(3) if i != j and (gyro or j > i)]
    parameters = _vector(affine)
    covariance = affine.covariance
    if accel is not None:
        parameters = np.concatenate((parameters, _vector(accel)))
        covariance = np.zeros((2 * PARAMETERS, 2 * PARAMETERS))
        covariance[:PARAMETERS, :PARAMETERS] = affine.covariance
        covariance[PARAMETERS:, PARAMETERS:] = accel.covariance

    def figures(p: FloatArray) -> FloatArray:
        K, b = p[:9].reshape(3, 3), p[9:12]
        frame = p[PARAMETERS : PARAMETERS + 9].reshape(3, 3) if gyro else K
        S = np.linalg.inv(K)
        gain = np.linalg.norm(S, axis=1)
        directions = (S / gain[:, None]) @ sensor_frame(frame)[0]
        return np.concatenate((100.0 * (gain - 1.0), [directions[c] for c in cross], S @ b))

    values = figures(parameters)
    J = differences(figures, parameters)
    sigma = np.sqrt(np.clip(np.diag(J @ covariance @ J.T), 0.0, None))
    end = 3 + len(cross)
    return PhysicalFigures(
        scale_percent=values[:3],
        cross_rad=values[3:end],
        cross_names=tuple(AXES[i] + AXES[j] for i, j in cross),
        bias=values[end:],
        scale_percent_u=sigma[:3],
        cross_rad_u=sigma[3:end],
        bias_u=sigma[end:],
    )


def _vector(affine: Affine) -> FloatArray:
    return np.concatenate((affine.K.ravel(), affine.b))


def differences(function: Callable[[FloatArray], FloatArray], at: FloatArray) -> FloatArray:
    """Return the Jacobian (m, n) of a smooth function (n,) -> (m,), by central differences."""
    columns = []
    for i, value in enumerate(at):
        step = np.zeros_like(at)
        step[i] = 1e-6 * max(1.0, abs(value))
        columns.append((function(at + step) - function(at - step)) / (2 * step[i]))
    return np.stack(columns, axis=1)
