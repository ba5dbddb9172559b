"""Gyroscope bias at every still: what wanders with time, what differs from pose to pose.

Neither the mean over all stills nor each still on its own is right for every sensor. The means of
the stills are modelled as a random walk plus a scatter from pose to pose plus their own noise;
the sizes of walk and scatter are those that make the data most likely.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.units import DEG

WALKS = np.concatenate(([0.0], np.geomspace(1e-4, 0.2, 12) * DEG))
"""Candidates of the random walk [rad/s per sqrt(s)]; 0.004 deg/s/sqrt(s) is 0.1 deg/s in 600 s."""
SCATTERS = np.concatenate(([0.0], np.geomspace(5e-4, 0.5, 12) * DEG))
"""Candidates of the scatter from pose to pose [rad/s]: acceleration sensitivity, earth rate."""
START_VARIANCE = (20.0 * DEG) ** 2


@dataclass(frozen=True, eq=False)
class BiasTrack:
    """Raw gyroscope bias over a session.

    Attributes
    ----------
    at_stills : shape (m, 3)
        Estimated wandering bias at every still [rad/s].
    mean : shape (3,)
        Its mean over the stills [rad/s].
    mean_sigma : shape (3,)
        Standard uncertainty of ``mean`` [rad/s].
    local_sigma : float
        Typical standard uncertainty of ``at_stills`` [rad/s].
    walk : float
        Random walk [rad/s per sqrt(s)].
    scatter : float
        Scatter from pose to pose [rad/s].
    """

    at_stills: FloatArray
    mean: FloatArray
    mean_sigma: FloatArray
    local_sigma: float
    walk: float
    scatter: float


def track_bias(t: FloatArray, means: FloatArray, sems: FloatArray) -> BiasTrack:
    """Estimate the bias from the mean rates of the stills.

    Parameters
    ----------
    t : shape (m,)
        Middle of each still [s].
    means, sems : shape (m, 3)
        Mean raw rates and their standard errors [rad/s].
    """
    walk, scatter = _most_likely(t, means, sems)
    since = t - t[0]
    prior = walk**2 * np.minimum(since[:, None], since[None, :]) + START_VARIANCE
    level = means.mean(axis=0)
    at_stills = np.empty_like(means)
    mean_sigma, local = np.empty(3), np.empty(3)
    for axis in range(3):
        noise = np.diag(sems[:, axis] ** 2 + scatter**2)
        gain = np.linalg.solve(prior + noise, prior).T
        at_stills[:, axis] = level[axis] + gain @ (means[:, axis] - level[axis])
        # (I - G) P would cancel against the wide start; G N is the same and does not.
        posterior = gain @ noise
        mean_sigma[axis] = np.sqrt(posterior.mean())
        local[axis] = np.sqrt(np.diag(posterior).mean())
    return BiasTrack(
        at_stills, at_stills.mean(axis=0), mean_sigma, float(local.max()), walk, scatter
    )


def _most_likely(t: FloatArray, means: FloatArray, sems: FloatArray) -> tuple[float, float]:
    """Walk and scatter of the greatest likelihood: a scalar Kalman filter over a grid of both."""
    if len(t) < 3:
        return 0.0, 0.0
    walk = (WALKS**2)[:, None, None]
    scatter = (SCATTERS**2)[None, :, None]
    value = np.broadcast_to(means[0], (len(WALKS), len(SCATTERS), 3))
    variance = sems[0] ** 2 + scatter + 0.0 * walk
    cost = np.zeros((len(WALKS), len(SCATTERS)))
    for k in range(1, len(t)):
        variance = variance + walk * (t[k] - t[k - 1])
        total = variance + scatter + sems[k] ** 2
        surprise = means[k] - value
        cost += np.sum(np.log(total) + surprise**2 / total, axis=-1)
        gain = variance / total
        value = value + gain * surprise
        variance = variance * (1.0 - gain)
    i, j = np.unravel_index(int(np.argmin(cost)), cost.shape)
    return float(WALKS[i]), float(SCATTERS[j])
