"""Asks the residuals of a joint fit for effects that the model left out: score tests.

A term that the data do not call for would only widen every interval; one that they do call for
would make them lie. So the term joins the fit when its score is beyond chance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.calibration.chance import chi_square_tail
from imu_rig.calibration.findings import Finding
from imu_rig.calibration.joint_fit import USUAL_DRIFT, JointFit
from imu_rig.calibration.joint_model import DRIFT, G_SENSITIVITY, NONLINEARITY, ROWS_OF, Prior
from imu_rig.units import DEG, MILLI_G

CHANCE = 1e-4
"""Probability of calling for a term that is not there."""
DRIFT_CHANCE = 1e-3
STRONG_DRIFT = 2.0
"""Usual changes beyond which a change is worth a sentence."""
STRONG = 4.0
"""Standard uncertainties beyond what a data sheet allows that make a nonlinearity a fault."""
G_SIGMA = 0.2 * DEG
"""Twice what a data sheet of the class states [rad/s per g]."""


def g_sensitivity_shows(fit: JointFit) -> bool:
    """Whether the gyroscope's bias follows the direction of gravity."""
    return fit.data.has_gyro and _probability(fit, G_SENSITIVITY) < CHANCE


def with_g_sensitivity(prior: Prior) -> Prior:
    """Let the g-sensitivity take part."""
    sigma = prior.sigma.copy()
    sigma[G_SENSITIVITY] = G_SIGMA
    return replace(prior, sigma=sigma)


def _probability(fit: JointFit, terms: slice) -> float:
    """Probability of a score as large as this one by chance alone."""
    rows = fit.rows.kind != ROWS_OF["prior"]
    weighted = fit.rows.jacobian * fit.weight[:, None]
    X = np.where(rows[:, None], weighted[:, terms], 0.0)
    reach = weighted.T @ X
    information = X.T @ X - reach.T @ fit.covariance @ reach
    score = X.T @ (fit.rows.residual * fit.weight)
    value, vectors = np.linalg.eigh(information)
    seen = value > 1e-9 * max(float(value.max()), 1e-300)
    statistic = float(np.sum((vectors.T @ score)[seen] ** 2 / value[seen]))
    return chi_square_tail(statistic, int(seen.sum()))


def g_sensitivity_finding(G: FloatArray) -> Finding:
    """Say how strongly a gyroscope feels force, G (3, 3) [rad/s per g]."""
    worst = np.unravel_index(int(np.argmax(np.abs(G))), (3, 3))
    size = float(np.abs(G[worst])) / DEG
    axis = "xyz"[int(worst[0])]
    return Finding(
        "g-sensitivity",
        f"The gyroscope's bias follows specific force, by up to {size:.2f} deg/s per g (axis "
        f"{axis}); the fit took it into account, but a bias that is set at rest in one attitude is "
        "off by that much in another.",
        axis=axis,
        size=size,
    )


def drift_findings(fit: JointFit) -> tuple[Finding, ...]:
    """Say how much the sensor changed, if that is more than one that is warm does."""
    drift = fit.state.common[DRIFT]
    C = fit.covariance[DRIFT, DRIFT]
    improbable = chi_square_tail(float(drift @ np.linalg.solve(C, drift)), len(drift))
    beyond = np.abs(drift) > STRONG_DRIFT * USUAL_DRIFT
    if improbable > DRIFT_CHANCE or not np.any(beyond):
        return ()
    worst = int(np.argmax(np.abs(drift[:3])))
    size = float(drift[worst]) / MILLI_G
    return (
        Finding(
            "warm-up",
            f"The sensor changed during the session: the accelerometer by up to {abs(size):.2f} mg "
            f"(axis {'xyz'[worst]}) in bias and {abs(drift[3]) * 100:.3f} % in scale, the "
            f"gyroscope by {abs(drift[4]) * 100:.3f} % in scale, as one that warms up does; the "
            "certificate states the middle of the session: let the sensor warm up first.",
            axis="xyz"[worst],
            size=size,
        ),
    )


def nonlinearity_findings(fit: JointFit) -> tuple[Finding, ...]:
    """Say which axes of the accelerometer bend more than a data sheet allows."""
    value = fit.state.common[NONLINEARITY]
    sigma = np.sqrt(np.diag(fit.covariance)[NONLINEARITY])
    excess = np.abs(value) - fit.prior.sigma[NONLINEARITY]
    found = []
    for i in np.flatnonzero(excess > STRONG * sigma).tolist():
        axis, order = "xyz"[i % 3], ("quadratic", "cubic")[i // 3]
        found.append(
            Finding(
                "nonlinear",
                f"Axis {axis} of the accelerometer is not linear: a {order} part of "
                f"{value[i] * 1e3:+.2f} mg at 1 g (standard uncertainty {sigma[i] * 1e3:.2f}); the "
                "certificate's gain is the best line over +-1 g.",
                axis=axis,
                size=float(value[i] * 1e3),
            )
        )
    return tuple(found)
