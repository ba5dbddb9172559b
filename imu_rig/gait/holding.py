"""How two ways of one person's feet must be bent so that the feet stay within a step's reach.

Damped Gauss-Newton over corrections of both headings at knots, the gains of both gyroscopes, the
first heading and place of the right foot and the ratio of the lengths that the sensors measure.
Each may change by about its standard uncertainty, and feet beyond their reach are punished.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray
from imu_rig.units import DEG

PASSING_S, PASSING_SHARE, PASSING_M = 3.0, 0.5, 1.0
"""Feet that walk pass each other in every stride: averaged over so long [s], they are nearer than
this share of their reach. Feet that come on by less than this in that time [m] stand, maybe a step
apart."""

SIDE_SIGMA_M = 0.2
"""Standard uncertainty of where the right foot stands beside the left one at the begin [m]."""

FIRST_TURN = 8.0 * DEG
"""Standard uncertainty of the angle between two ways as their first metres show it [rad]: feet half
a step aside of each other over three metres."""

FIRST = 0.01 * DEG
GAIN = 0.01
"""Standard uncertainty of a gyroscope's gain: who turns shows it."""

SOFT_M = 0.1
"""By which the limits may be exceeded [m], standard deviation for each second."""

ROUNDS, DAMPING, ENOUGH = 40, 1.0, 1e-3
"""Steps at most, how much they are held back at first, and what need not be gained any more."""

TURN, OFFSET, RATIO = -4, slice(-3, -1), -1
"""Unknowns behind those of both feet."""


@dataclass(frozen=True, eq=False)
class Way:
    """One foot's way at common moments, and how sure it is.

    Attributes
    ----------
    step : shape (n - 1, 2)
        From each moment to the next on the plan [m].
    knots : shape (n, k)
        Weight of the correction of heading at each knot, for each moment.
    facing : shape (n,)
        How far the foot has turned since the begin [rad].
    since : shape (n,)
        Time since the begin [s].
    drift : float
        Standard uncertainty of a drift of its heading that lasts [rad/s].
    wander : shape (k - 1,)
        Standard uncertainties of how its heading wanders from knot to knot besides [rad].
    length : float
        Standard uncertainty of its lengths [1].
    """

    step: FloatArray
    knots: FloatArray
    facing: FloatArray
    since: FloatArray
    drift: float
    wander: FloatArray
    length: float

    @property
    def angles(self) -> FloatArray:
        """Correction of heading per unknown of this foot, (n, k + 2): knots, gain and drift."""
        return np.column_stack((self.knots, self.facing, self.since))

    def bent(self, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return places (n, 2) with heading corrected, and their derivatives (n, 2, k + 2)."""
        half = 0.5 * (angle[1:] + angle[:-1])
        c, s = np.cos(half), np.sin(half)
        x, y = self.step.T
        turned = np.stack((c * x - s * y, s * x + c * y), axis=1)
        across = np.stack((-turned[:, 1], turned[:, 0]), axis=1)
        angles = self.angles
        weight = 0.5 * (angles[1:] + angles[:-1])
        return _summed(turned), _summed(across[:, :, None] * weight[:, None, :])

    def prior(self) -> FloatArray:
        """Rows whose squares say how unlikely the unknowns are, (k + 2, k + 2)."""
        k = self.knots.shape[1]
        rows = np.zeros((k + 2, k + 2))
        rows[0, 0] = 1.0 / FIRST  # right by definition
        rows[1:k, :k] = np.diff(np.eye(k), axis=0) / self.wander[:, np.newaxis]
        rows[k, k], rows[k + 1, k + 1] = 1.0 / GAIN, 1.0 / self.drift
        return rows


@dataclass(frozen=True, eq=False)
class Pair:
    """The ways of a left and a right foot, and what is asked of them.

    Attributes
    ----------
    left, right : Way
    step_s : float
        Between moments [s].
    reach : float
        Farthest that the feet can be apart [m].
    turn : float
        By which the right way seems to be turned against the left one [rad].
    side : shape (2,)
        From the left foot to the right one at the begin [m].
    """

    left: Way
    right: Way
    step_s: float
    reach: float
    turn: float
    side: FloatArray

    def begin(self) -> FloatArray:
        """Return the unknowns as they are if the feet do not contradict."""
        x = np.zeros(2 * self.left.angles.shape[1] + 4)
        x[TURN], x[OFFSET] = self.turn, self.side
        return x

    def parts(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the unknowns of the left and of the right foot: knots, gain and drift."""
        p = self.left.angles.shape[1]
        return x[:p], x[p : 2 * p]

    def scales(self, x: FloatArray) -> tuple[float, float]:
        """Return by what the lengths of left and right are multiplied: the surer one by less."""
        return 1.0 - self._left_share * float(x[RATIO]), 1.0 + (1.0 - self._left_share) * float(
            x[RATIO]
        )

    @property
    def _left_share(self) -> float:
        return self.left.length**2 / (self.left.length**2 + self.right.length**2)

    def between(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return from the left to the right foot at each moment (n, 2), and the derivatives."""
        ours, theirs = self.parts(x)
        p = len(ours)
        left, by_left = self.left.bent(self.left.angles @ ours)
        right, by_right = self.right.bent(self.right.angles @ theirs + x[TURN])
        a, b = self.scales(x)
        J = np.zeros((len(left), 2, len(x)))
        J[:, :, :p], J[:, :, p : 2 * p] = -a * by_left, b * by_right
        J[:, :, TURN] = b * np.stack((-right[:, 1], right[:, 0]), axis=1)
        J[:, :, OFFSET] = np.eye(2)
        J[:, :, RATIO] = self._left_share * left + (1.0 - self._left_share) * right
        return b * right - a * left + x[OFFSET], J

    def apart(self, x: FloatArray) -> float:
        """Return how far the feet are apart at most [m]."""
        return float(np.hypot(*self.between(x)[0].T).max())

    def unlikely(self, x: FloatArray) -> float:
        """Return how many standard uncertainties the largest correction is."""
        off = self._prior() @ (x - self.begin())
        return float(np.abs(off).max())

    def solved(self) -> FloatArray:
        """Return the likeliest unknowns."""
        x = self.begin()
        value, J = self._residual(x)
        prior = self._prior()
        stiff, held = prior.T @ prior, DAMPING
        for _ in range(ROUNDS):
            change = np.linalg.solve(J.T @ J + held * stiff, -(J.T @ value))
            tried, by = self._residual(x + change)
            gained = value @ value - tried @ tried
            if gained <= 0.0:
                held = 10.0 * held
                continue
            x, value, J, held = x + change, tried, by, 0.1 * held
            if gained < ENOUGH:
                break
        return x

    def _residual(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        where, by = self.between(x)
        weight = float(np.sqrt(self.step_s)) / SOFT_M
        prior = self._prior()
        parts = [_beyond(where, by, self.reach, weight), (prior @ (x - self.begin()), prior)]
        over = max(2, round(PASSING_S / self.step_s))
        if len(where) > over:
            walking = self._walking(over)
            mean, by_mean = _mean(where, over)[walking], _mean(by, over)[walking]
            parts.append(_beyond(mean, by_mean, PASSING_SHARE * self.reach, weight))
        return np.concatenate([r for r, _ in parts]), np.concatenate([J for _, J in parts])

    def _walking(self, over: int) -> BoolArray:
        """Whether both feet came on in ``over`` steps from each moment, (n - over,)."""
        come = []
        for way in (self.left, self.right):
            place = _summed(way.step)
            come.append(np.hypot(*(place[over:] - place[:-over]).T) > PASSING_M)
        return np.asarray(come[0] & come[1])

    def _prior(self) -> FloatArray:
        p = self.left.angles.shape[1]
        rows = np.zeros((2 * p + 4, 2 * p + 4))
        rows[:p, :p] = self.left.prior()
        rows[p : 2 * p, p : 2 * p] = self.right.prior()
        ratio = float(np.hypot(self.left.length, self.right.length))
        rows[-4:, -4:] = np.diag(1.0 / np.array([FIRST_TURN, SIDE_SIGMA_M, SIDE_SIGMA_M, ratio]))
        return rows


def _beyond(
    where: FloatArray, by: FloatArray, limit: float, weight: float
) -> tuple[FloatArray, FloatArray]:
    """Return by how much, and in which direction, a limit is exceeded, and the derivatives."""
    far = np.hypot(*where.T)
    out = far > limit
    left = 1.0 - limit / far[out]
    unit = where[out] / far[out, None]
    along = np.einsum("ij,ijk->ik", unit, by[out])
    change = left[:, None, None] * by[out] + (1.0 - left)[:, None, None] * (
        unit[:, :, None] * along[:, None, :]
    )
    excess = left[:, None] * where[out]
    return weight * excess.ravel(), weight * change.reshape(-1, by.shape[2])


def _mean(values: FloatArray, over: int) -> FloatArray:
    """Return means over ``over`` values from each on."""
    total = _summed(values)
    return np.asarray((total[over:-1] - total[: -over - 1]) / over)


def _summed(steps: FloatArray) -> FloatArray:
    return np.concatenate((np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)))
