"""Whether a reference has the wrong hand, or its z points down: told with figures, never turned.

Some motion capture exports are left-handed, and no error figure says so by itself: a straight walk
fits either way. A bend does not, and a foot rises and falls with every swing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.reference.planar import residual, root_mean_square

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
    """Fit a path to places (n, 3) [m] with all signs that could be meant."""
    given, other = residual(path, places), residual(path, places * TO_MIRRORED)
    below = residual(path, places * TO_Z_DOWN)
    return Handedness(
        root_mean_square(given[:, :2]),
        root_mean_square(other[:, :2]),
        root_mean_square(given[:, 2:]),
        root_mean_square(below[:, 2:]),
    )


def _much_better(other: float, given: float) -> bool:
    return other < MUCH * given and other < given - AT_LEAST_M
