"""Whether a reference has the wrong hand, or its z points down: told with figures, never turned.

Some motion capture exports are left-handed, and no error figure says so by itself: a straight walk
fits either way. A bend does not, and a foot rises and falls with every swing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from imu_rig.arrays import FloatArray

TO_MIRRORED = np.array([1.0, -1.0, 1.0])
TO_Z_DOWN = np.array([1.0, -1.0, -1.0])
MUCH = 0.5
"""The other sign must leave less than this share of the error,"""
AT_LEAST_M = 0.02
"""and less by so much: below it the noise of either could decide."""


@dataclass(frozen=True)
class Handedness:
    """How a reference fits as it is, and with other signs.

    Attributes
    ----------
    as_given, mirrored : float
        Horizontal RMSE after the best turn and shift [m], as it is and with the sign of y turned.
    upright, upside_down : float
        Vertical RMSE after the best shift [m], as it is and with the sign of z turned.
    """

    as_given: float
    mirrored: float
    upright: float
    upside_down: float

    @property
    def suspect(self) -> bool:
        """Whether it fits much better mirrored on the plan."""
        return _much_better(self.mirrored, self.as_given)

    @property
    def z_suspect(self) -> bool:
        """Whether it fits much better with z turned."""
        return _much_better(self.upside_down, self.upright)

    @property
    def sentence(self) -> str | None:
        """What its user should know; None where the signs seem right."""
        plan = f"on the plan {self.mirrored:.3f} m instead of {self.as_given:.3f} m"
        height = f"in height {self.upside_down:.3f} m instead of {self.upright:.3f} m"
        if self.suspect and self.z_suspect:
            return (
                f"The reference fits much better with the signs of y and z turned ({plan}, "
                f"{height}): its z seems to point down; say so if it does."
            )
        if self.suspect:
            return (
                f"The reference fits much better mirrored ({plan}): it seems to be left-handed; "
                "say so if it is, its sign was not turned here."
            )
        if self.z_suspect:
            return (
                f"The reference fits much better with the sign of z turned ({height}): it seems to "
                "be left-handed with z down; say so if it is, its sign was not turned here."
            )
        return None

    def to_dict(self) -> dict[str, Any]:
        """Return the figures in SI units, for JSON."""
        return {
            "rmse_as_given_m": self.as_given,
            "rmse_mirrored_m": self.mirrored,
            "rmse_upright_m": self.upright,
            "rmse_upside_down_m": self.upside_down,
            "suspect": self.suspect,
            "z_suspect": self.z_suspect,
        }


def check_hands(path: FloatArray, places: FloatArray) -> Handedness:
    """Fit a path to places (n, 3) [m] with all signs that could be meant.

    With both centred and on the plan seen as complex numbers p and q, the best turn of p leaves
    ``|p|^2 + |q|^2 - 2 |sum conj(p) q|``; mirroring makes conj(q) of q.
    """
    a, b = path - path.mean(axis=0), places - places.mean(axis=0)
    p, q = a[:, 0] + 1j * a[:, 1], b[:, 0] + 1j * b[:, 1]
    sizes = np.sum(np.abs(p) ** 2) + np.sum(np.abs(q) ** 2)

    def left(turned: complex) -> float:
        return float(np.sqrt(max(sizes - 2.0 * abs(turned), 0.0) / len(p)))

    return Handedness(
        as_given=left(np.vdot(p, q)),
        mirrored=left(np.dot(p, q)),
        upright=float(np.sqrt(np.mean((a[:, 2] - b[:, 2]) ** 2))),
        upside_down=float(np.sqrt(np.mean((a[:, 2] + b[:, 2]) ** 2))),
    )


def _much_better(other: float, given: float) -> bool:
    return other < MUCH * given and other < given - AT_LEAST_M
