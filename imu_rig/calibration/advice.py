"""Which poses to add: the directions that would tell most about what is still uncertain."""

from __future__ import annotations

from itertools import product

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.calibration.magnitude import UPPER
from imu_rig.units import MILLI_G, STANDARD_GRAVITY

SHEET_SIGMA = np.array([0.03] * 6 + [0.08 * STANDARD_GRAVITY] * 3)
"""What a data sheet promises without any measurement: scale and lean 3 %, bias 80 mg."""
POSE_SIGMA = 0.3 * MILLI_G
GOAL = np.array([2e-4] * 6 + [0.2 * MILLI_G] * 3)
"""Standard uncertainty worth aiming at: scale 0.02 %, lean 0.2 mrad, bias 0.2 mg."""
MOST = 8


def poses_to_add(directions: FloatArray) -> tuple[str, ...]:
    """Choose faces, edges and corners to put on top, most telling first.

    Parameters
    ----------
    directions : shape (m, 3)
        Unit vectors "up" of the poses there are, sensor axes.

    Returns
    -------
    tuple of str
        At most `MOST` names such as ``"+x-y"``: the edge between +x and -y on top.
    """
    candidates = [np.array(c, dtype=float) for c in product((1, 0, -1), repeat=3) if any(c)]
    units = np.array([c / np.linalg.norm(c) for c in candidates])
    return tuple(_name(candidates[i]) for i in choose(units, directions))


def choose(candidates: FloatArray, directions: FloatArray) -> list[int]:
    """Choose among candidates (c, 3) at most `MOST` to add to the poses' directions (m, 3).

    Returns their indices, most telling first; none where the poses are enough.
    """
    rows = _rows(candidates)
    N = _information(directions)
    chosen: list[int] = []
    while len(chosen) < MOST and len(rows):
        C = np.linalg.inv(N)
        if np.all(np.sqrt(np.diag(C)) < 2.0 * GOAL):
            break
        reach = rows @ C
        gain = np.sum((reach / GOAL) ** 2, axis=1) / (1.0 + np.sum(reach * rows, axis=1))
        best = int(np.argmax(gain))
        N = N + np.outer(rows[best], rows[best])
        chosen.append(best)
    return chosen


def magnitude_sigma(directions: FloatArray) -> FloatArray:
    """Uncertainties (9,) of gain (upper triangle) and offset [m/s^2] by gravity's magnitude.

    From poses of directions (m, 3) and from what a data sheet promises without them.
    """
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(_information(directions)))))


def _information(directions: FloatArray) -> FloatArray:
    rows = _rows(directions)
    return np.asarray(np.diag(1.0 / SHEET_SIGMA**2) + rows.T @ rows)


def _rows(up: FloatArray) -> FloatArray:
    """Weighted derivatives (m, 9) of the magnitude for a nominal sensor."""
    gains = up[:, UPPER[0]] * up[:, UPPER[1]] * STANDARD_GRAVITY
    return np.concatenate((gains, -up), axis=1) / POSE_SIGMA


def _name(direction: FloatArray) -> str:
    signs = {1: "+", -1: "-"}
    return "".join(signs[int(s)] + axis for s, axis in zip(direction, "xyz", strict=True) if s)
