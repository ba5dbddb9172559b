"""A foot's strides while it walks: the forward filter, and each stride smoothed soon after it.

Everything is decided at fixed moments of the sensor's time, from what had come by then, so that
the result does not depend on the size of the blocks that samples come in.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError
from imu_rig.gait.adaptive import detect_stance
from imu_rig.gait.filter_inputs import foot_inputs, foot_model
from imu_rig.gait.fitness import check_recording
from imu_rig.gait.footfalls import (
    LEAST_SHARE,
    LEAST_STRIDE_S,
    UNMOVED_M,
    UNTURNED,
    find_footfalls,
)
from imu_rig.gait.grade import SensorGrade
from imu_rig.gait.level import FREE_M, level_strides
from imu_rig.gait.live_checks import EarlyCheck, after_hidden, require_usable, stride_sigma
from imu_rig.gait.live_strides import LiveState, LiveStride
from imu_rig.gait.options import FootOptions
from imu_rig.gait.start import first_attitude
from imu_rig.gait.stills import find_stills, rough_gyro_bias
from imu_rig.gait.stride_kinds import LONGEST_M
from imu_rig.gait.trajectory import Footfalls
from imu_rig.gait.unseen import Unseen, unseen_motion
from imu_rig.gait.zero_velocity import ZeroVelocity
from imu_rig.kernels.foot_filter import smooth_foot_states
from imu_rig.kernels.foot_types import FootInputs, FootModel, FootState, FootStates
from imu_rig.rotation import conjugate, multiply, to_matrix

__all__ = ["LiveFoot", "LiveState", "LiveStride"]

LOOK_EVERY_S = 0.05
"""So often strides are looked for [s]: a short part of their delay."""

START_S = 2.0
"""Of standing at the begin is waited for before anything is said [s]: tilt and gyroscope bias are
read from it."""

LEFT_S = 0.3
"""A stance is over when the foot has been away for so long [s]: what comes sooner belongs to it, as
a heel that strikes and rests for a moment before the sole lies flat."""

STANDS_S = 0.6
"""A stance that lasts as long ends its stride, although it goes on [s]: a slow stride is told
before the next swing."""

REMEMBERED, FEWEST = 9, 3
"""Of the latest strides the usual duration is taken, when there are at least so many."""

MOVES_ON_S = 2.0
"""While the foot goes on standing, the next stride is taken to begin this near to the present."""

CONTEXT_S = 1.1
"""Of the past is kept for the detector, which looks back so far [s]."""

LOST_S = 6.0
"""After a swing as long as this the stride is given up [s]: integration has drifted by a stride."""


@dataclass(frozen=True, eq=False)
class _Look:
    """What is known of the samples kept, at one moment."""

    t: FloatArray
    inputs: FootInputs
    zero_velocity: ZeroVelocity
    unseen: Unseen


class LiveFoot:
    """Strides and state of a foot from samples as they come; see the module.

    Memory stays bounded: a few seconds of samples are kept.

    Parameters
    ----------
    options : FootOptions
    grade : SensorGrade or None
        What is known of the sensor; None: nothing.

    Attributes
    ----------
    strides : int
        That were told.
    lost : int
        That were not, as samples were missing in them, or nobody strides so far.
    """

    def __init__(
        self,
        options: FootOptions = FootOptions(),  # noqa: B008  (frozen)
        *,
        grade: SensorGrade | None = None,
    ) -> None:
        self.options = options
        self.grade = SensorGrade() if grade is None else grade
        self.strides = 0
        self.lost = 0
        self._check = EarlyCheck(self.options, self.grade)
        self._refused: DataError | None = None
        self._kept = ImuBlock.empty()
        self._floor_sigma = np.empty(0)
        self._floor_step = np.empty(0)
        self._next_look = -np.inf
        self._bias = np.zeros(3)
        self._begun = False
        self._model: FootModel | None = None
        self._state: FootState | None = None
        self._first = np.empty(0)
        self._done = 0  # samples of those kept that are in the state
        self._anchor: int | None = None  # quietest sample of the latest stance
        self._durations: deque[float] = deque(maxlen=REMEMBERED)

    def update(self, block: ImuBlock) -> list[LiveStride]:
        """Take samples and return the strides that they complete.

        Parameters
        ----------
        block : ImuBlock
            Of any length, its times not before those that came already.

        Raises
        ------
        DataError
            If a reading is no number or none of a sensor, or time goes back; the block is not
            taken. After some strides, if they cannot be those of a foot with these units and axes:
            nothing is taken any more.
        """
        if self._refused is not None:
            raise self._refused
        if not len(block):
            return []
        require_usable(block, self._kept.t[-1:] if len(self._kept) else block.t[:1])
        told = []
        before = len(self._kept)
        self._keep(block)
        row = before
        while row < len(self._kept):
            if self._kept.t[row] >= self._next_look:
                self._next_look = self._kept.t[row] + LOOK_EVERY_S
                row -= self._begin_anew(row + 1)
                stride = self._look(row + 1)
                if stride is not None:
                    told.append(stride)
                    self._look_back(stride.told_s)
                row -= self._forget(row + 1)
            row += 1
        return told

    @property
    def state(self) -> LiveState | None:
        """The latest state; None as long as the begin is waited for."""
        if self._model is None:
            return None
        look = self._seen(len(self._kept))
        latest = self._run(look, self._done, len(look.t), forward_only=True)
        return LiveState(
            float(look.t[-1]),
            latest.quaternion[-1],
            latest.velocity[-1],
            latest.position[-1],
            bool(look.zero_velocity.still[-1]),
        )

    def _keep(self, block: ImuBlock) -> None:
        plain = ImuBlock(
            np.asarray(block.t, dtype=float),
            np.ascontiguousarray(block.accel, dtype=float),
            np.ascontiguousarray(block.gyro, dtype=float),
            np.asarray(block.t, dtype=float),
        )
        self._kept = ImuBlock.concatenate([self._kept, plain])
        self._check.keep(plain)
        self._floor_sigma = np.append(self._floor_sigma, np.full(len(block), np.inf))
        self._floor_step = np.append(self._floor_step, np.zeros(len(block)))

    def _look_back(self, until: float) -> None:
        try:
            self._check.after(self.strides, until)
        except DataError as error:
            self._refused = error
            raise

    def _look(self, n: int) -> LiveStride | None:
        """Return the stride that is complete with the first ``n`` samples kept, if one is."""
        if self._model is None and not self._begin(n):
            return None
        look = self._seen(n)
        falls = find_footfalls(look.zero_velocity, look.t)
        now = look.t[-1]
        statistic = look.zero_velocity.statistic
        for k, quietest in enumerate(falls.quietest):
            first, last = int(falls.first[k]), int(falls.last[k])
            if now - look.t[last] < LEFT_S and now - look.t[first] < STANDS_S:
                break
            if self._anchor is None:
                self._anchor = int(quietest)
            elif first <= self._anchor <= last:
                self._stand_on(look, last)
            elif first > self._anchor and self._strides_apart(look.t, self._anchor, quietest):
                later = falls.quietest[k + 1 : k + 2]
                if (
                    len(later)
                    and not self._strides_apart(look.t, quietest, later[0])
                    and statistic[later[0]] < statistic[quietest]
                ):
                    continue  # a stride ends in the quieter one
                self._remember(look.t, falls, k)
                return self._stride(look, int(quietest))
        since = self._done if self._anchor is None else self._anchor
        if now - look.t[since] > LOST_S:
            self._advance(look, int(np.searchsorted(look.t, now - CONTEXT_S)))
            self._anchor = None
        return None

    def _strides_apart(self, t: FloatArray, begin: int, end: int) -> bool:
        """Tell whether a whole stride fits between two moments of rest."""
        known = len(self._durations) >= FEWEST
        usual = float(np.median(self._durations)) if known else 0.0
        return bool(t[end] - t[begin] >= max(LEAST_STRIDE_S, LEAST_SHARE * usual))

    def _remember(self, t: FloatArray, falls: Footfalls, k: int) -> None:
        """Note how long strides take, by the stance just before, whichever was the anchor.

        Else one stance that was passed over would make strides seem twice as long from then on.
        """
        if k > 0:
            left = max(t[falls.quietest[k - 1]], t[falls.last[k - 1]] - STANDS_S)
            self._durations.append(float(t[falls.quietest[k]] - left))

    def _begin_anew(self, n: int) -> int:
        """Leave out what was before a gap that hides a swing; return how many samples.

        Tilt and velocity after it are read from what follows, as at the begin; the bias is kept.
        """
        rows = after_hidden(self._kept[self._done : n])
        if not len(rows):
            return 0
        row = self._done + int(rows[-1])
        self.lost += self._anchor is not None
        if self._state is not None:
            self._bias = self._bias + self._state.gyro_bias
        self._model, self._state, self._anchor = None, None, None
        self._drop(row)
        self._done = 0
        return row

    def _begin(self, n: int) -> bool:
        """Read tilt and bias from the begin; False as long as it is too short."""
        t, accel = self._kept.t[:n], self._kept.accel[:n]
        if t[-1] - t[0] < START_S:
            return False
        if not accel.any():
            raise DataError("the accelerometer reads nothing but zeros; check its connection")
        if not self._begun:
            check_recording(self._kept[:n], gravity=self.options.gravity)
        gyro = self._kept.gyro[:n]
        if not self._begun:
            self._bias = rough_gyro_bias(find_stills(t, accel, gyro))
            self._begun = True
        gyro = gyro - self._bias
        stance = detect_stance(t, accel, gyro, self.options.stance, self.options.gravity)
        self._first, quietest = first_attitude(t, accel, gyro, stance.statistic)
        up = accel[quietest] / np.linalg.norm(accel[quietest])
        self._model = foot_model(self.options, self.grade, up)
        self._floor_step[0] = FREE_M
        return True

    def _seen(self, n: int) -> _Look:
        t, accel = self._kept.t[:n], self._kept.accel[:n]
        bias = self._bias if self._state is None else self._bias + self._state.gyro_bias
        rate = self._kept.gyro[:n]
        stance = detect_stance(t, accel, rate - bias, self.options.stance, self.options.gravity)
        unseen = unseen_motion(self._kept[:n])
        inputs = foot_inputs(t, accel, rate - self._bias, stance, self._first, self.options, unseen)
        inputs = inputs._replace(floor_sigma=self._floor_sigma[:n], floor_step=self._floor_step[:n])
        return _Look(t, inputs, stance, unseen)

    def _run(self, look: _Look, first: int, end: int, *, forward_only: bool = False) -> FootStates:
        """Filter the samples from ``first`` to before ``end``, going on from the state."""
        assert self._model is not None
        return smooth_foot_states(
            _rows(look.inputs, slice(first, end)),
            self._model,
            estimate_gyro_bias=True,
            forward_only=forward_only,
            start=self._state,
        )

    def _stride(self, look: _Look, quietest: int) -> LiveStride | None:
        """Smooth the stride from the anchor to there, and make that the anchor.

        None if it leads nowhere: a stance that was torn by a shift of weight.
        """
        begin = self._anchor
        assert begin is not None
        if self.options.level != "never":
            free = self._run(look, self._done, len(look.t))
            places = free.position[[begin - self._done, quietest - self._done]]
            level = self.options.level == "always" or level_strides(places, self.options)[0]
            self._floor_sigma[quietest] = self.options.flat_m
            self._floor_step[quietest] = self.options.floor_walk_m if level else FREE_M
            look = self._seen(len(look.t))
        smoothed = self._run(look, self._done, len(look.t))
        done = self._done
        a, b = begin - done, quietest - done
        way = smoothed.position[b] - smoothed.position[a]
        turned = to_matrix(multiply(smoothed.quaternion[b], conjugate(smoothed.quaternion[a])))
        turn = float(np.arctan2(turned[1, 0] - turned[0, 1], turned[0, 0] + turned[1, 1]))
        self._advance(look, begin)
        self._anchor = quietest
        if np.linalg.norm(way) < UNMOVED_M and abs(turn) < UNTURNED:
            return None
        length = float(np.hypot(way[0], way[1]))
        if length > LONGEST_M:
            self.lost += 1
            return None
        self.strides += 1
        return LiveStride(
            begin_s=float(look.t[begin]),
            end_s=float(look.t[quietest]),
            told_s=float(look.t[-1]),
            length=length,
            height=float(way[2]),
            turn=turn,
            length_sigma=self._sigma(look, smoothed, a, b, done),
        )

    def _sigma(self, look: _Look, smoothed: FootStates, a: int, b: int, done: int) -> float:
        rows = slice(done, len(look.t))
        assert self._model is not None
        return stride_sigma(
            look.t[rows],
            smoothed,
            _rows(look.inputs, rows),
            self._model,
            (a, b),
            self._bias + smoothed.gyro_bias[-1],
            self.grade,
            look.unseen[rows],
        )

    def _stand_on(self, look: _Look, last: int) -> None:
        """Let the next stride begin later while the foot goes on standing."""
        assert self._anchor is not None
        if look.t[last] - look.t[self._anchor] <= MOVES_ON_S:
            return
        recent = int(np.searchsorted(look.t, look.t[last] - 0.5 * MOVES_ON_S))
        self._advance(look, self._anchor)
        some = look.zero_velocity.statistic[recent : last + 1]
        self._anchor = recent + int(np.argmin(some))

    def _advance(self, look: _Look, end: int) -> None:
        """Take samples up to ``end`` into the state."""
        if end > self._done:
            self._state = self._run(look, self._done, end, forward_only=True).end
            self._done = end

    def _forget(self, n: int) -> int:
        """Drop what neither detector nor filter need; return how many samples."""
        if self._model is None:
            return 0
        t = self._kept.t
        begin = min(self._done, n - 1)
        drop = int(np.searchsorted(t, t[begin] - CONTEXT_S))
        if drop == 0:
            return 0
        self._drop(drop)
        self._done -= drop
        if self._anchor is not None:
            self._anchor -= drop
        return drop

    def _drop(self, rows: int) -> None:
        self._kept = self._kept[rows:]
        self._floor_sigma = self._floor_sigma[rows:]
        self._floor_step = self._floor_step[rows:]


def _rows(inputs: FootInputs, rows: slice) -> FootInputs:
    """Return some samples of the inputs."""
    columns = {
        name: getattr(inputs, name)[rows]
        for name in FootInputs._fields
        if name not in ("q0", "v0") and getattr(inputs, name) is not None
    }
    return inputs._replace(**columns)
