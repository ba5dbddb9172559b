"""How much a foot moves, as one number that is near to its speed while it stands."""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.gait.options import StanceOptions
from imu_rig.kernels.rolling import moving_mean
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
    columns = np.empty((len(t), 5))
    columns[:, :3] = accel
    columns[:, 3] = np.einsum("ij,ij->i", accel, accel)
    columns[:, 4] = np.einsum("ij,ij->i", gyro, gyro)
    mean = moving_mean(t, columns, 0.5 * window_s)
    size = np.sqrt(np.einsum("ij,ij->i", mean[:, :3], mean[:, :3]))
    # |f - g u|^2 on average, multiplied out.
    force = np.maximum(mean[:, 3] - 2.0 * gravity * size + gravity**2, 0.0)
    rate = np.maximum(mean[:, 4], 0.0)
    square = options.lever**2 * rate + options.settling_s**2 * force
    return np.asarray(np.sqrt(square))
