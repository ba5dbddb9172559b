"""Foot motion by a forward and a backward filter, combined step by step.

Suh and Chee, "Foot Motion Estimation Smoother using Inertial Sensors". A step runs from the middle
of one zero-velocity interval to the middle of the next. Over each, an indirect Kalman filter runs
forwards from where the last step ended, and one backwards from the attitude that gravity shows at
the end; eqs. (18)-(24) weigh the two.

The method takes the readings for calibrated: it estimates no sensor errors, and its covariance
knows of white noise only.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError, InputError
from imu_rig.gait.trajectory import Trajectory
from imu_rig.gait.triad import triad
from imu_rig.gait.zero_velocity import ZeroVelocity
from imu_rig.kernels.two_filter import run_filter
from imu_rig.rotation import about_z, conjugate, multiply, normalize, skew, to_matrix
from imu_rig.units import DEG, STANDARD_GRAVITY

JOINED_S = 0.1
"""Two zero-velocity intervals closer than this are one stay of the foot: no step is so short."""
SHORTEST_S = 0.05
"""A stay shorter than this starts no step; its samples are measurements all the same."""
LEVEL_S = 0.1
"""Gravity shows the attitude at the end of a step by the mean over so long on either side."""
GAP_S, GAP_SAMPLES = 0.1, 4.0
"""A hole in a swing that is longer, in seconds and in sample intervals, cannot be bridged: a foot
turns by 50 degrees in 0.1 s."""
UNKNOWN_M, UNKNOWN_MS, UNKNOWN_YAW = 10.0, 10.0, 1.0
"""Uncertainties of what the backward filter does not know at its start [m, m/s, rad]."""
KNOWN = 1e-6
"""Uncertainty of what is so by definition: place and yaw at the start [m, rad]."""


@dataclass(frozen=True)
class TwoFilterOptions:
    """What the two-filter smoother takes for true.

    Attributes
    ----------
    gravity : float
        At the place of the walk [m/s^2].
    gyro_noise, accel_noise : float
        White noise densities [rad/s and m/s^2 per root Hz]. Those of a data sheet would claim that
        a foot in swing is measured as well as one at rest; these hold what a scale error of some
        per mille makes of a swing. Three times more or less changes the way of a foot by 1 mm.
    velocity_sigma : float or None
        Of the velocity of a standing foot [m/s]; None: as the detector says.
    height_sigma : float or None
        Of the height of a standing foot [m]. None where the ground is not level: stairs, slopes.
    correlated_s : float
        These two errors last so long [s], the time in which a foot rolls on; the weight of the
        measurements follows time, not the number of samples.
    tilt_sigma : float
        Of the vertical as the accelerometer of a standing foot shows it [rad].
    magnetometer : bool
        Whether the magnetic field, where the block has one, tells yaw. Close to a floor with iron
        in it that is worse than no field: over a minute a calibrated gyroscope errs by less.
    yaw_sigma : float
        Of magnetic north during one stay of the foot [rad]. The iron of a building errs alike
        in all samples of a stay: together they weigh as one.
    """

    gravity: float = STANDARD_GRAVITY
    gyro_noise: float = 0.1 * DEG
    accel_noise: float = 0.05
    velocity_sigma: float | None = 0.01
    height_sigma: float | None = 0.01
    correlated_s: float = 0.05
    tilt_sigma: float = 1.0 * DEG
    magnetometer: bool = False
    yaw_sigma: float = 15.0 * DEG

    def __post_init__(self) -> None:
        """Check that every uncertainty is positive.

        Raises
        ------
        InputError
        """
        for name in ("gravity", "gyro_noise", "accel_noise", "velocity_sigma", "height_sigma",
                     "correlated_s", "tilt_sigma", "yaw_sigma"):  # fmt: skip
            value = getattr(self, name)
            if value is not None and not 0.0 < value < math.inf:
                raise InputError(f"{name} is {value:g}; give a positive number.")


@dataclass(frozen=True, eq=False)
class Estimate:
    """A motion with the covariance of its errors.

    Attributes
    ----------
    trajectory : Trajectory
    covariance : shape (n, 9, 9)
        Of the errors of attitude (a small rotation in navigation axes [rad]), velocity [m/s] and
        position [m], in this order.
    """

    trajectory: Trajectory
    covariance: FloatArray

    def turned(self, yaw: float) -> Estimate:
        """Return the same in axes in which all is turned by ``yaw`` [rad] about z."""
        J = np.kron(np.eye(3), about_z(yaw))
        return Estimate(self.trajectory.turned(yaw), J @ self.covariance @ J.T)


@dataclass(frozen=True, eq=False)
class StepSmoothing:
    """What the two filters say of a foot, each by itself and together.

    Attributes
    ----------
    boundaries : shape (m + 1,)
        Samples of the block where its ``m`` steps meet, with the first and the last sample of all.
        The estimates hold the samples from the first boundary to the last, both included.
    still : shape (n,)
        Whether the foot rests, of those samples.
    forward : Estimate
        Of the forward filter. It starts every step where the smoother ended the one before.
    backward : Estimate
        Of the backward filter before the measurement at each sample. It knows no place: at the end
        of a step it is where the forward filter ended.
    smoothed : Estimate
    """

    boundaries: IntArray
    still: BoolArray
    forward: Estimate
    backward: Estimate
    smoothed: Estimate

    @property
    def steps(self) -> IntArray:
        """First and last row of every step in the estimates, shape (m, 2)."""
        rows = self.boundaries - self.boundaries[0]
        return np.column_stack((rows[:-1], rows[1:]))

    def turned(self, yaw: float) -> StepSmoothing:
        """Return the same in axes in which all is turned by ``yaw`` [rad] about z."""
        return replace(
            self,
            forward=self.forward.turned(yaw),
            backward=self.backward.turned(yaw),
            smoothed=self.smoothed.turned(yaw),
        )


def smooth_steps(
    block: ImuBlock,
    zero_velocity: ZeroVelocity,
    options: TwoFilterOptions = TwoFilterOptions(),
) -> StepSmoothing:
    """Estimate the motion of a foot step by step with the two-filter smoother.

    The result begins at the origin, with navigation x along magnetic north, or, without a
    magnetometer, along the sensor's x axis. It takes 3 kB of memory per sample.

    Parameters
    ----------
    block : ImuBlock
        Calibrated, with the gyroscope's bias removed.
    zero_velocity : ZeroVelocity
        Of every sample of the block.
    options : TwoFilterOptions

    Raises
    ------
    DataError
        If the foot never rests, or samples are missing in a swing.
    """
    t = np.ascontiguousarray(block.t, dtype=float)
    gyro = np.ascontiguousarray(block.gyro, dtype=float)
    accel = np.ascontiguousarray(block.accel, dtype=float)
    stays = find_stays(zero_velocity.still, t)
    if not len(stays) or stays[-1, 1] == stays[0, 0]:
        raise DataError(
            "no zero-velocity interval was found, so nothing tells where the foot stands; check "
            "that the sensor is on a foot and the units of its readings."
        )
    boundaries = _boundaries(stays, t)
    whole = slice(int(boundaries[0]), int(boundaries[-1]) + 1)
    _check(t[whole], gyro[whole], accel[whole], zero_velocity.still[whole])
    field = _field(block, options)
    variances = _variances(zero_velocity, t, field, options)
    noise = np.array((options.gyro_noise, options.accel_noise, options.gravity))

    n = len(t)
    forward, backward, smoothed = (np.zeros((n, 10)) for _ in range(3))
    P_f, P_b, P_s = (np.zeros((n, 9, 9)) for _ in range(3))
    arrays = (forward, backward, smoothed, P_f, P_b, P_s)
    levels = [_standing(accel, field, zero_velocity.still, t, int(k)) for k in boundaries]
    state = np.concatenate((levels[0], np.zeros(6)))
    P = _start(levels[0], variances[boundaries[0]], options)
    for step, (a, b) in enumerate(itertools.pairwise(boundaries.tolist())):
        rows = slice(a, b + 1)
        inputs = (t, gyro, accel, field, variances, noise)
        # A step's first sample belongs to the step before.
        kept = [array[a].copy() for array in arrays]
        run_filter(a, b, *inputs, state, P, forward, P_f)
        end = _end(forward[b], levels[step + 1], options, known_yaw=math.isfinite(variances[b, 2]))
        run_filter(b, a, *inputs, *end, backward, P_b)
        smoothed[rows], P_s[rows] = combine(forward[rows], P_f[rows], backward[rows], P_b[rows])
        state, P = smoothed[b], P_s[b]
        if step:
            for array, value in zip(arrays, kept, strict=True):
                array[a] = value
    parts = ((forward, P_f), (backward, P_b), (smoothed, P_s))
    estimates = [_estimate(t[whole], states[whole], P[whole]) for states, P in parts]
    return StepSmoothing(boundaries, zero_velocity.still[whole], *estimates)


def combine(
    forward: FloatArray, P_f: FloatArray, backward: FloatArray, P_b: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Weigh forward and backward states, eqs. (18)-(24).

    Their difference is taken for a measurement of the error of the forward states, the error of
    the backward states for its noise.

    Parameters
    ----------
    forward, backward : shape (n, 10)
        Quaternion, position and velocity; ``backward`` before the measurement of each sample.
    P_f, P_b : shape (n, 9, 9)
        Covariances of their errors: half rotation in sensor axes, position, velocity.

    Returns
    -------
    smoothed : shape (n, 10)
    P_s : shape (n, 9, 9)
    """
    d = multiply(conjugate(backward[:, :4]), forward[:, :4])
    d = np.where(d[:, :1] < 0.0, -d, d)
    zeta = np.concatenate((-d[:, 1:], backward[:, 4:] - forward[:, 4:]), axis=1)
    H_f = np.tile(np.eye(9), (len(d), 1, 1))
    H_f[:, :3, :3] = d[:, :1, np.newaxis] * np.eye(3) + skew(d[:, 1:])
    HP = H_f @ P_f
    gain = np.linalg.solve(HP @ np.swapaxes(H_f, 1, 2) + P_b, HP)  # K', as all is symmetric
    x = np.einsum("nij,ni->nj", gain, zeta)
    P_s = P_f - np.swapaxes(HP, 1, 2) @ gain
    turn = np.concatenate((np.ones((len(x), 1)), x[:, :3]), axis=1)
    q = normalize(multiply(forward[:, :4], turn))
    smoothed = np.concatenate((q, forward[:, 4:] + x[:, 3:]), axis=1)
    return smoothed, 0.5 * (P_s + np.swapaxes(P_s, 1, 2))


def find_stays(still: BoolArray, t: FloatArray) -> IntArray:
    """Return first and last sample of the stays of a foot that can bound steps, shape (k, 2).

    Intervals that flicker are joined, very short ones left out.
    """
    edges = np.flatnonzero(np.diff(np.concatenate(([False], still, [False]))))
    first, last = edges[::2], edges[1::2] - 1
    if not len(first):
        return np.empty((0, 2), dtype=np.int64)
    apart = t[first[1:]] - t[last[:-1]] > JOINED_S
    stays = np.column_stack((first[np.append(True, apart)], last[np.append(apart, True)]))
    return np.asarray(stays[t[stays[:, 1]] - t[stays[:, 0]] >= SHORTEST_S], dtype=np.int64)


def _boundaries(stays: IntArray, t: FloatArray) -> IntArray:
    """Return the samples in the middle of stays, and the outer ends of the first and the last."""
    middle = np.searchsorted(t, 0.5 * (t[stays[1:-1, 0]] + t[stays[1:-1, 1]]))
    return np.unique(np.concatenate((stays[:1, 0], middle, stays[-1:, 1])).astype(np.int64))


def _check(t: FloatArray, gyro: FloatArray, accel: FloatArray, still: BoolArray) -> None:
    if not (np.all(np.isfinite(gyro)) and np.all(np.isfinite(accel))):
        raise DataError(
            "readings of accelerometer or gyroscope are missing between the first and the last "
            "stay of the foot; cut the recording to a part that is whole."
        )
    dt = np.diff(t)
    if np.any(dt < 0.0):
        raise DataError("the time stamps run backwards; sort the samples by time.")
    longest = max(GAP_S, GAP_SAMPLES * float(np.median(dt)))
    gaps = np.flatnonzero((dt > longest) & ~(still[:-1] & still[1:]))
    if len(gaps):
        k = gaps[0]
        raise DataError(
            f"samples are missing for {dt[k]:.2f} s after {t[k]:.2f} s, in a swing of the foot, "
            "which nothing can bridge; cut the recording there."
        )


def _field(block: ImuBlock, options: TwoFilterOptions) -> FloatArray:
    """Return the magnetic field, NaN where it is not to be used."""
    if block.mag is None or not options.magnetometer:
        return np.full((len(block), 3), np.nan)
    return np.ascontiguousarray(block.mag, dtype=float)


def _variances(
    zero_velocity: ZeroVelocity, t: FloatArray, field: FloatArray, options: TwoFilterOptions
) -> FloatArray:
    """Return the variances of velocity, height and yaw of every sample, shape (n, 3)."""
    still = zero_velocity.still
    variances = np.full((len(still), 3), np.inf)
    dt = np.diff(t)
    with np.errstate(divide="ignore"):  # of two samples of one time, the second tells nothing
        looks = np.maximum(options.correlated_s / np.concatenate((dt[:1], dt)), 1.0)
    sigma = zero_velocity.sigma if options.velocity_sigma is None else options.velocity_sigma
    variances[still, 0] = (np.square(sigma) * looks)[still]
    if options.height_sigma is not None:
        variances[still, 1] = options.height_sigma**2 * looks[still]
    # Runs of still samples that have a field are the stays that weigh as one each.
    seen = still & np.all(np.isfinite(field), axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], seen, [False]))))
    for first, stop in zip(edges[::2], edges[1::2], strict=True):
        variances[first:stop, 2] = options.yaw_sigma**2 * (stop - first)
    return variances


def _standing(
    accel: FloatArray, field: FloatArray, still: BoolArray, t: FloatArray, k: int
) -> FloatArray:
    """Return the attitude that gravity, and the field if there is one, show around sample ``k``."""
    near = slice(*np.searchsorted(t, (t[k] - LEVEL_S, t[k] + LEVEL_S), side="left"))
    rows = np.arange(len(t))[near]
    rows = rows[still[rows]] if np.any(still[rows]) else np.array([k])
    seen = field[rows][np.all(np.isfinite(field[rows]), axis=1)]
    return triad(accel[rows].mean(axis=0), seen.mean(axis=0) if len(seen) else None)


def _start(q: FloatArray, variances: FloatArray, options: TwoFilterOptions) -> FloatArray:
    """Return the covariance at the start, where the foot stands at the origin."""
    velocity = math.sqrt(variances[0]) if math.isfinite(variances[0]) else UNKNOWN_MS
    yaw = math.sqrt(variances[2]) if math.isfinite(variances[2]) else KNOWN
    return _covariance(q, options.tilt_sigma, yaw, np.full(3, KNOWN), velocity)


def _end(
    forward: FloatArray, level: FloatArray, options: TwoFilterOptions, *, known_yaw: bool
) -> tuple[FloatArray, FloatArray]:
    """Return state and covariance with which the backward filter starts at the end of a step.

    Velocity and height are zero as far as a measurement that follows says so; what is unknown
    is taken from the forward filter and said to be uncertain, so that it is not counted twice.
    """
    q = level
    if not known_yaw:
        # The level attitude turned about the vertical to the forward filter's heading.
        between = multiply(forward[:4], conjugate(level))
        q = multiply(normalize(between * np.array((1.0, 0.0, 0.0, 1.0))), level)
    height = 0.0 if options.height_sigma is not None else float(forward[6])
    state = np.concatenate((q, forward[4:6], (height, 0.0, 0.0, 0.0)))
    unknown = np.full(3, UNKNOWN_M)
    return state, _covariance(q, options.tilt_sigma, UNKNOWN_YAW, unknown, UNKNOWN_MS)


def _covariance(
    q: FloatArray, tilt: float, yaw: float, position: FloatArray, velocity: float
) -> FloatArray:
    """Return the covariance (9, 9) of the error state from standard uncertainties."""
    R = to_matrix(q)
    P = np.zeros((9, 9))
    P[:3, :3] = 0.25 * (R.T * np.square((tilt, tilt, yaw))) @ R
    P[3:6, 3:6] = np.diag(position**2)
    P[6:, 6:] = velocity**2 * np.eye(3)
    return P


def _estimate(t: FloatArray, states: FloatArray, P: FloatArray) -> Estimate:
    """Return states and covariances (half rotation, position, velocity) in the package's order."""
    q, position, velocity = states[:, :4], states[:, 4:7], states[:, 7:]
    J = np.zeros_like(P)
    J[:, :3, :3] = 2.0 * to_matrix(q)
    J[:, 3:6, 6:] = J[:, 6:, 3:6] = np.eye(3)
    return Estimate(Trajectory(t, q, velocity, position), J @ P @ np.swapaxes(J, 1, 2))
