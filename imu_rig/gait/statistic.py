"""How much a foot moves, as one number that is near to its speed while it stands."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.gait.options import StanceOptions
from imu_rig.kernels.rolling import moving_motion
from imu_rig.units import STANDARD_GRAVITY


def motion_statistic(
    t: FloatArray,
    accel: FloatArray,
    gyro: FloatArray,
    window_s: float,
    options: StanceOptions = StanceOptions(),  # noqa: B008  (frozen)
    gravity: float = STANDARD_GRAVITY,
) -> FloatArray:
    """Return the equivalent velocity of a foot.

    ``s^2 = mean((lever |w|)^2 + (settling |f - g u|)^2)`` over a moving window, with ``u`` the
    direction of the mean specific force in it: the statistic of the SHOE detector (Skog et al.,
    IEEE Trans. Biomed. Eng. 57, 2010), with weights that make it a velocity. A foot that rolls on
    the ground moves at its angular rate times its height.

    Parameters
    ----------
    t : shape (n,)
        Times [s], never decreasing.
    accel : shape (n, 3)
        Specific force [m/s^2].
    gyro : shape (n, 3)
        Angular rate without its bias [rad/s].
    window_s : float
        Length of the window, centred on its sample [s].
    options : StanceOptions
        Of which `lever` and `settling_s` are used.
    gravity : float
        [m/s^2]

    Returns
    -------
    shape (n,)
        [m/s]
    """
    return moving_motion(
        t,
        np.asarray(accel, dtype=float),
        np.asarray(gyro, dtype=float),
        0.5 * window_s,
        options.lever,
        options.settling_s,
        gravity,
    )
