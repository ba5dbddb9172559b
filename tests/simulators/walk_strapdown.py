"""Integrates force and rate to a trajectory, as well as 400 samples per second allow."""

from collections.abc import Callable

import numpy as np
from scipy.interpolate import make_interp_spline

from imu_rig.arrays import FloatArray
from imu_rig.rotation import from_rotation_vector, multiply, rotate
from simulators.sampling import Means
from simulators.walker.sensor import SensorMotion

SUBSTEPS = 4
Curve = Callable[[FloatArray], FloatArray]


def of_means(means: Means, begin: SensorMotion, gravity: float) -> tuple[FloatArray, FloatArray]:
    """Return positions (n + 1, 3) and attitudes (n + 1, 4) by the increments of equal intervals.

    The sums of the increments are the integrals of rate and force on the sensor's axes, known
    exactly at the ends of the intervals; the curves between them are splines.
    """
    period = float(means.duration[0])
    t = period * np.arange(len(means) + 1)
    curves = []
    for mean in (means.rate, means.force):
        sums = np.vstack((np.zeros(3), np.cumsum(mean * period, axis=0)))
        curves.append(make_interp_spline(t, sums, k=5).derivative())
    return _integrated(curves[0], curves[1], t, begin, gravity)


def of_points(motion: SensorMotion, gravity: float) -> tuple[FloatArray, FloatArray]:
    """Return the same by values at equally spaced moments."""
    t = motion.t - motion.t[0]
    rate, force = (make_interp_spline(t, values, k=5) for values in (motion.rate, motion.force))
    return _integrated(rate, force, t, motion, gravity)


def _integrated(
    rate: Curve, force: Curve, t: FloatArray, begin: SensorMotion, gravity: float
) -> tuple[FloatArray, FloatArray]:
    step = (t[1] - t[0]) / SUBSTEPS
    edges = step * np.arange((len(t) - 1) * SUBSTEPS + 1)
    # Magnus' series to the fourth order, by the rates at Gauss' two nodes.
    middle, aside = edges[:-1] + 0.5 * step, step * np.sqrt(3.0) / 6.0
    early, late = rate(middle - aside), rate(middle + aside)
    turned = 0.5 * step * (early + late) + np.sqrt(3.0) / 12.0 * step**2 * np.cross(early, late)
    attitude = np.vstack((begin.attitude[:1], from_rotation_vector(turned)))
    reach = 1
    while reach < len(attitude):  # products of all from the first on
        attitude[reach:] = multiply(attitude[:-reach], attitude[reach:])
        reach *= 2
    moved = rotate(attitude, force(edges)) - (0.0, 0.0, gravity)
    position = make_interp_spline(edges, moved, k=5).antiderivative(2)
    straight = begin.position[0] + begin.velocity[0] * t[:, np.newaxis]
    return straight + position(t), attitude[::SUBSTEPS]
