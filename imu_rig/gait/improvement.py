"""What calibrating changes in measured distances: Tables 1 to 3 of the gait distance paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.errors import InputError

AXES = ("x", "y", "z")


@dataclass(frozen=True, eq=False)
class AxisTable:
    """One axis of ``n`` trials, with and without calibration: a table of the paper.

    Attributes
    ----------
    axis : str
        "x", "y" or "z".
    reference, uncalibrated, calibrated : shape (n,)
        Distances [m].
    """

    axis: str
    reference: FloatArray
    uncalibrated: FloatArray
    calibrated: FloatArray

    @property
    def uncalibrated_error(self) -> FloatArray:
        """Size of the error before calibration, (n,) [m]."""
        return np.abs(self.uncalibrated - self.reference)

    @property
    def calibrated_error(self) -> FloatArray:
        """Size of the error after calibration, (n,) [m]."""
        return np.abs(self.calibrated - self.reference)

    @property
    def improvement(self) -> FloatArray:
        """By how much calibrating made the error of each trial smaller, (n,) [%].

        As the paper has it, of the error without calibration. Negative where it made it larger,
        which a trial that happened to be right without can make as large as it likes; NaN where
        there was no error.
        """
        before = self.uncalibrated_error
        safe = np.where(before > 0.0, before, np.nan)
        return np.asarray(100.0 * (before - self.calibrated_error) / safe)

    @property
    def mean(self) -> float:
        """Mean improvement, as the paper states it [%], of the trials that had an error."""
        return float(np.mean(self._known)) if len(self._known) else float("nan")

    @property
    def sd(self) -> float:
        """Sample standard deviation of the improvement [%]; NaN of a single trial."""
        return float(np.std(self._known, ddof=1)) if len(self._known) > 1 else float("nan")

    @property
    def median(self) -> float:
        """Median improvement [%], which single trials do not move."""
        return float(np.median(self._known)) if len(self._known) else float("nan")

    @property
    def _known(self) -> FloatArray:
        return self.improvement[np.isfinite(self.improvement)]

    @property
    def pooled(self) -> float:
        """By how much the mean error of all trials is smaller [%]."""
        before = float(np.mean(self.uncalibrated_error))
        if before == 0.0:
            return float("nan")
        return 100.0 * (before - float(np.mean(self.calibrated_error))) / before


@dataclass(frozen=True, eq=False)
class TrialComparison:
    """Trials of known distance, with and without calibration.

    Attributes
    ----------
    axes : tuple of AxisTable
        x along the walk, y to the left, z up.
    """

    axes: tuple[AxisTable, AxisTable, AxisTable]

    def __len__(self) -> int:
        """Return the number of trials."""
        return len(self.axes[0].reference)


def compare_trials(
    reference: Sequence[Sequence[float]] | FloatArray,
    uncalibrated: Sequence[Sequence[float]] | FloatArray,
    calibrated: Sequence[Sequence[float]] | FloatArray,
) -> TrialComparison:
    """Set the distances of the same trials beside each other.

    Parameters
    ----------
    reference : shape (n, 3) or (3,)
        What is true of each trial, or of all [m].
    uncalibrated, calibrated : shape (n, 3)
        `imu_rig.gait.distance.WalkDistance.distance` of each [m].

    Raises
    ------
    InputError
        No trials, or not the same number of each, or values that are not finite.
    """
    before, after = (np.array(rows, dtype=float, ndmin=2) for rows in (uncalibrated, calibrated))
    known = np.array(reference, dtype=float, ndmin=2)
    if before.shape != after.shape or before.shape[1:] != (3,) or not len(before):
        raise InputError(
            f"distances of shapes {before.shape} and {after.shape} cannot be compared: give three "
            "of each trial, without and with calibration"
        )
    if known.shape not in ((1, 3), before.shape):
        raise InputError(
            f"there are {len(known)} known distances for {len(before)} trials; give three of each "
            "trial, or three for all"
        )
    known = np.broadcast_to(known, before.shape)
    if not all(np.isfinite(rows).all() for rows in (known, before, after)):
        raise InputError("a distance is not a finite number; leave that trial out")
    x, y, z = (
        AxisTable(name, known[:, axis], before[:, axis], after[:, axis])
        for axis, name in enumerate(AXES)
    )
    return TrialComparison((x, y, z))
