"""What kind of stride a foot took, by limits of the body and of buildings.

Statistics of gait are about walking and running; a foot does more than that between two footfalls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import AnyArray, BoolArray, FloatArray, IntArray
from imu_rig.units import DEG

WALK, RUN = "walk", "run"
GAIT = (WALK, RUN)
START, STOP = "start", "stop"
SHORT, SHIFT, TURN = "short", "shift", "turn"
UP, DOWN = "up", "down"
SIDEWAYS, BACKWARD = "sideways", "backward"
DOUBTFUL = "doubtful"

KINDS = {
    WALK: "a stride of walking",
    RUN: "less than half of the stride on the ground: both feet are in the air at times",
    START: "the first after standing, or of the recording",
    STOP: "the last before standing",
    UP: "up stairs or a step",
    DOWN: "down stairs or a step",
    TURN: "a turn on the spot",
    SIDEWAYS: "aside of where the foot points",
    BACKWARD: "backward",
    SHORT: "a shuffle, or closing up",
    SHIFT: "a standing foot that is set down anew",
    DOUBTFUL: "longer than anybody strides: a footfall was missed",
}
"""Every kind and what it is."""

SHIFT_M = 0.05
"""Half the width of a foot: a standing person who moves a foot by less goes nowhere."""
SHORT_M = 0.25
"""A foot's length: a stride that does not bring the heel past where the toes were."""
TURN_ANGLE, TURN_RADIUS_M = 30.0 * DEG, 0.4
"""Nobody walks along a bend tighter than a person is wide; who turns about less, turns on the
spot."""
STEP_M, STEEPEST = 0.07, 0.2
"""Less than half of the lowest stair, and a slope (11 deg) above that of any ramp, below that of
any stairs (20 deg and more): both must be exceeded. Onto stairs and off them a foot climbs one
stair in a longer stride than those between: beside a steep stride, the first is enough."""
CURB_M = 0.10
"""On level ground a single stride that rises by so much, more than twice what those beside it do,
is one up a step: ramps are longer than one stride."""
LONGEST_M = 5.5
"""The best sprinters' strides measure 5 m."""
LONGEST_SWING_S = 2.0
"""Nobody stands on the other leg for longer while walking; slow patients need 0.8 s."""
ASIDE, BACK = 50.0 * DEG, 130.0 * DEG
"""Travel seen from the foot: feet point outward by up to 25 deg, and turn by as much again."""
HALF = 0.5
"""Two legs that share the time cannot both leave the ground if each is on it for longer."""
SLOWEST_RUN_S = 1.0
"""Flight and landing set a pace: nobody runs with fewer than 120 steps a minute. Who slides the
feet along has little stance as well, and takes longer."""


@dataclass(frozen=True, eq=False)
class StrideFacts:
    """What the kind of a stride is judged by, shapes (m,).

    Attributes
    ----------
    length, height : [m]
    turn : [rad]
    swing_time, duration : [s]
        NaN where the foot never left the ground, or where it stood before.
    stance_share : [1]
        NaN where unknown.
    off_foot : [rad]
        Direction of travel against that of the foot, left positive.
    stood_before, stood_after : bool
        Whether the foot stood before and after, or nothing is known of before.
    """

    length: FloatArray
    height: FloatArray
    turn: FloatArray
    swing_time: FloatArray
    duration: FloatArray
    stance_share: FloatArray
    off_foot: FloatArray
    stood_before: BoolArray
    stood_after: BoolArray


def stride_kinds(facts: StrideFacts) -> AnyArray:
    """Return the kind of every stride, shape (m,) of str, one of `KINDS`."""
    length, rise = facts.length, np.abs(facts.height)
    turned, off = np.abs(facts.turn), np.abs(facts.off_foot)
    nowhere = (length < SHIFT_M) & (rise < STEP_M)
    stepped = _stepped(facts.height, length)
    with np.errstate(invalid="ignore"):  # unknown shares and times satisfy nothing
        cases = [
            ((length > LONGEST_M) | (facts.swing_time > LONGEST_SWING_S), DOUBTFUL),
            (nowhere & (turned < TURN_ANGLE), SHIFT),
            (stepped > 0, UP),
            (stepped < 0, DOWN),
            ((turned >= TURN_ANGLE) & (length < TURN_RADIUS_M * turned), TURN),
            (length < SHORT_M, SHORT),
            (off > BACK, BACKWARD),
            (off > ASIDE, SIDEWAYS),
            (facts.stood_before, START),
            (facts.stood_after, STOP),
            ((facts.stance_share < HALF) & (facts.duration < SLOWEST_RUN_S), RUN),
        ]
    return np.select([case for case, _ in cases], [kind for _, kind in cases], WALK)


def standing(on_ground: FloatArray, cycle: float) -> BoolArray:
    """Tell which stays of a foot on the ground [s], shape (k,), are those of a stand.

    Longer than a whole stride takes, usually ``cycle`` [s]: who walks is on each foot for 60 % of
    that, and in the slowest gait for 80 %.
    """
    return np.asarray(on_ground > cycle)


def _stepped(height: FloatArray, length: FloatArray) -> IntArray:
    """Return 1 for strides up a step or stairs, -1 for those down, else 0; up is as down."""
    sign = np.where(np.abs(height) >= STEP_M, np.sign(height), 0.0).astype(np.int64)
    steep = np.where(np.abs(height) > STEEPEST * length, sign, 0)
    beside = np.zeros((2, len(height)), dtype=np.int64)
    beside[0, 1:], beside[1, :-1] = steep[:-1], steep[1:]
    rise = np.concatenate(([0.0], np.abs(height), [0.0]))
    most = np.maximum(rise[:-2], rise[2:])
    alone = (np.abs(height) >= CURB_M) & (np.abs(height) > 2.0 * most)
    of_stairs = (steep != 0) | ((beside == sign) & (sign != 0)).any(axis=0) | alone
    return np.where(of_stairs, sign, 0)
