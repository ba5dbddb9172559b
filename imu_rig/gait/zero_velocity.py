"""What a zero-velocity detector says of each sample."""

from __future__ import annotations

from dataclasses import dataclass

from imu_rig.arrays import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class ZeroVelocity:
    """When a foot stands, and how surely.

    Attributes
    ----------
    still : shape (n,)
        Whether the sample lies in a zero-velocity interval.
    sigma : shape (n,)
        Standard uncertainty of "the velocity is zero" [m/s]; infinite where the foot swings.
    statistic : shape (n,)
        What the detector compares, in its own unit.
    threshold : shape (n,)
        What it is compared with; the foot is taken to stand below it.
    """

    still: BoolArray
    sigma: FloatArray
    statistic: FloatArray
    threshold: FloatArray

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.still)
