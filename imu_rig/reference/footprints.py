"""Strides beside measured footprints, or beside strides that another instrument measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.errors import DataError
from imu_rig.gait.stride_kinds import SHIFT
from imu_rig.gait.strides import Strides


@dataclass(frozen=True, eq=False)
class Footprints:
    """Where one foot came down, in order, measured by hand or otherwise.

    Attributes
    ----------
    position : shape (k, 2) or (k, 3)
        The same point of each footprint [m]; the first is where the foot stood at the begin.
    """

    position: FloatArray

    def __len__(self) -> int:
        """Return the number of footprints."""
        return len(self.position)

    @property
    def stride_lengths(self) -> FloatArray:
        """Horizontal distances from each to the next, shape (k - 1,) [m]."""
        return np.asarray(np.linalg.norm(np.diff(self.position[:, :2], axis=0), axis=1))


@dataclass(frozen=True, eq=False)
class StrideComparison:
    """Stride lengths beside the true ones.

    Attributes
    ----------
    length, true_length : shape (m,)
        Of the strides that were paired [m].
    count, true_count : int
        Strides that were found, and that there are.
    distance, true_distance : float
        Sums of the lengths of all of them [m]; where only some strides have a truth, of those.
    """

    length: FloatArray
    true_length: FloatArray
    count: int
    true_count: int
    distance: float
    true_distance: float

    @property
    def errors(self) -> FloatArray:
        """Estimate less truth of each pair, shape (m,) [m]."""
        return self.length - self.true_length

    @property
    def mae(self) -> float:
        """Mean absolute error of length [m]; NaN without pairs."""
        return float(np.mean(np.abs(self.errors))) if len(self.errors) else float("nan")

    @property
    def bias(self) -> float:
        """Mean error of length [m]; NaN without pairs."""
        return float(np.mean(self.errors)) if len(self.errors) else float("nan")

    @property
    def sd(self) -> float:
        """Sample standard deviation of the errors [m]; NaN for fewer than two pairs."""
        return float(np.std(self.errors, ddof=1)) if len(self.errors) > 1 else float("nan")

    @property
    def distance_percent(self) -> float:
        """Error of the distance [%]; NaN where the true one is none."""
        if not self.true_distance:
            return float("nan")
        return 100.0 * (self.distance / self.true_distance - 1.0)

    def to_dict(self) -> dict[str, Any]:
        """Return all figures in SI units, for JSON; None for what is unknown."""
        figures = {"mae_m": self.mae, "bias_m": self.bias, "sd_m": self.sd}
        return {
            "strides": self.count,
            "true_strides": self.true_count,
            "paired": len(self.errors),
            **{name: None if np.isnan(v) else v for name, v in figures.items()},
            "distance_m": self.distance,
            "true_distance_m": self.true_distance,
            "distance_percent": None if not self.true_distance else self.distance_percent,
        }

    def lines(self) -> list[str]:
        """Return the figures as text."""
        told = [
            f"strides     {self.count} found, {self.true_count} true, {len(self.errors)} compared",
            f"distance    {self.distance:.2f} m, true {self.true_distance:.2f} m: "
            f"{self.distance_percent:+.2f} %",
        ]
        if len(self.errors):
            told.append(
                f"length      {1000 * self.mae:.1f} mm mean absolute error, bias "
                f"{1000 * self.bias:+.1f} mm, sd {1000 * self.sd:.1f} mm"
            )
        return told


def compare_footprints(strides: Strides, footprints: Footprints) -> StrideComparison:
    """Compare all strides of a foot with its footprints, the first with the first.

    A foot that is set down anew while its owner stands makes a stride of a few centimetres and no
    new footprint; it is left out. Where the numbers differ after that, the lengths are not paired:
    one missed stride would shift all that follow, and errors of pairs that do not belong together
    say nothing.

    Raises
    ------
    DataError
        Fewer than two footprints, or all at one place.
    """
    true = footprints.stride_lengths
    if not len(true):
        raise DataError("a comparison needs two footprints or more")
    if not true.any():
        raise DataError(
            f"all {len(footprints)} footprints are at one place; give where the foot came down, in "
            "metres"
        )
    taken = strides.length[strides.kind != SHIFT]
    paired = len(taken) == len(true)
    return StrideComparison(
        length=taken if paired else taken[:0],
        true_length=true if paired else true[:0],
        count=len(taken),
        true_count=len(true),
        distance=float(taken.sum()),
        true_distance=float(true.sum()),
    )
