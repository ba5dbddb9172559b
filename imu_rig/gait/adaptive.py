"""Our detector of zero velocity: a threshold that follows every stride."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.gait.footfalls import runs
from imu_rig.gait.options import StanceOptions
from imu_rig.gait.statistic import motion_statistic
from imu_rig.gait.zero_velocity import ZeroVelocity
from imu_rig.kernels.rolling import moving_level, moving_minimum
from imu_rig.units import STANDARD_GRAVITY


def lookahead_s(options: StanceOptions = StanceOptions()) -> float:  # noqa: B008  (frozen)
    """Return how much later data [s] what is said of a sample depends on."""
    later = max(options.quiet_s + options.sprint_stride_s, options.level_s)
    return later + 0.5 * options.window_s


def detect_stance(
    t: FloatArray,
    accel: FloatArray,
    gyro: FloatArray,
    options: StanceOptions = StanceOptions(),  # noqa: B008  (frozen)
    gravity: float = STANDARD_GRAVITY,
) -> ZeroVelocity:
    """Tell when a foot stands, and how surely, sample by sample.

    What is said of a piece of a recording is the same as of the whole, but for `lookahead_s` at
    its ends.

    Parameters
    ----------
    t : shape (n,)
        Times [s], never decreasing.
    accel, gyro : shape (n, 3)
        [m/s^2], and [rad/s] without bias.
    options : StanceOptions
    gravity : float
        [m/s^2]
    """
    motion = motion_statistic(t, accel, gyro, options.window_s, options, gravity)
    statistic = motion
    fast = moving_level(t, motion, options.sprint_stride_s) > options.sprint_level
    if fast.any():
        quick = motion_statistic(t, accel, gyro, options.sprint_window_s, options, gravity)
        statistic = np.where(fast, quick, motion)
    quietest = moving_minimum(t, statistic, options.quiet_s)
    threshold = stride_threshold(quietest, moving_level(t, motion, options.level_s), options)
    return stance(statistic, threshold, options)


def stride_threshold(quietest: FloatArray, level: FloatArray, options: StanceOptions) -> FloatArray:
    """Return below what motion a foot stands, for each sample.

    The geometric middle between the quietest moment of the stride and the level of its motion,
    within bounds. Who stands is quieter than any stance between strides: beside a stand the share
    `quiet_share` of the level takes the place of the quietest moment. In a sprint even that exceeds
    the bounds; it counts all the same, as long as it is a good deal quieter than the rest of the
    stride.

    Parameters
    ----------
    quietest, level : shape (n,)
        The least motion and the root mean square of all in the strides around a sample [m/s].
    options : StanceOptions

    Returns
    -------
    shape (n,)
        [m/s]
    """
    in_stride = np.maximum(quietest, options.quiet_share * level)
    middle = np.clip(np.sqrt(in_stride * level), options.lowest, options.highest)
    sprint = np.minimum(options.sprint_ratio * quietest, options.sprint_share * level)
    return np.asarray(np.maximum(middle, np.minimum(sprint, options.sprint_highest)))


def stance(
    statistic: FloatArray,
    threshold: FloatArray,
    options: StanceOptions = StanceOptions(),  # noqa: B008  (frozen)
) -> ZeroVelocity:
    """Return when a foot stands, and how surely, by its motion and the threshold [m/s], (n,).

    The uncertainty grows with the motion, and more so towards the threshold, so that the edges of
    a stance count little.
    """
    still = statistic < threshold
    sigma = np.full(len(statistic), np.inf)
    moved = statistic[still]
    nearness = np.square(np.square(moved / threshold[still]))
    sigma[still] = np.hypot(options.trust * moved, options.floor) * np.sqrt(1.0 + nearness)
    return ZeroVelocity(still, sigma, statistic, threshold)


def settled(
    zero_velocity: ZeroVelocity,
    t: FloatArray,
    options: StanceOptions = StanceOptions(),  # noqa: B008  (frozen)
) -> ZeroVelocity:
    """Return the same without the begin and the end of every long stand.

    Between strides a foot comes to rest and leaves it at once. Who stands, or slides a sensor over
    a table, moves off so gently that it shows only after a while, and comes to rest likewise.

    Parameters
    ----------
    zero_velocity : ZeroVelocity
    t : shape (n,)
        Times [s], never decreasing.
    options : StanceOptions
    """
    still = zero_velocity.still.copy()
    first, last = runs(still)
    for a, b in zip(first, last, strict=True):
        if t[b] - t[a] < options.stand_s:
            continue
        if a > 0:
            still[a : np.searchsorted(t, t[a] + options.gentle_s)] = False
        if b < len(t) - 1:
            still[np.searchsorted(t, t[b] - options.gentle_s, side="right") : b + 1] = False
    sigma = np.where(still, zero_velocity.sigma, np.inf)
    return replace(zero_velocity, still=still, sigma=sigma)


def zero_velocity(
    block: ImuBlock,
    options: StanceOptions = StanceOptions(),  # noqa: B008  (frozen)
    *,
    gravity: float = STANDARD_GRAVITY,
) -> ZeroVelocity:
    """Find when a foot stands, without a threshold of its own for a person or a speed.

    What `smooth_foot` does by default: `detect_stance` and `settled`.

    Parameters
    ----------
    block : ImuBlock
        Of a foot; the gyroscope's bias should have been taken off (`stills.rough_gyro_bias`).
    options : StanceOptions
    gravity : float
        [m/s^2]

    Returns
    -------
    ZeroVelocity
    """
    found = detect_stance(block.t, block.accel, block.gyro, options, gravity)
    return settled(found, block.t, options)
