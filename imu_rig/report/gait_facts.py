"""What a report of the gait in a set of trials is told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray
from imu_rig.gait.distance import WalkDistance
from imu_rig.gait.improvement import TrialComparison, compare_trials
from imu_rig.gait.strides import Strides, Summary, summary_of
from imu_rig.gait.trajectory import Trajectory
from imu_rig.report.stride_table import SHOWN_UNITS
from imu_rig.rotation import about_z

LEAD_M = 2.0
"""x points to where so many first metres went, as `imu_rig.gait.distance.WalkOptions` has it."""


@dataclass(frozen=True, eq=False)
class GaitTrial:
    """One foot in one recording.

    Attributes
    ----------
    name : str
        Of the recording, and of the sensor where there are several.
    strides : Strides
        By the default smoother.
    ours : shape (3,)
        From the begin to the end by it [m]; x along the walk, y to the left, z up.
    calibrated, uncalibrated : WalkDistance or None
        By zero-velocity double integration. None where it was not asked for, or impossible.
    notes : tuple of str
        About the trial and its strides.
    doubts : tuple of str
        About its double integration.
    """

    name: str
    strides: Strides
    ours: FloatArray
    calibrated: WalkDistance | None = None
    uncalibrated: WalkDistance | None = None
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class GaitReport:
    """A set of trials.

    Attributes
    ----------
    trials : tuple of GaitTrial
    known : shape (3,) or None
        How far every trial went along each axis [m], where that is known.
    facts : tuple of (str, str)
        How it was analysed.
    left_out : tuple of (str, str)
        Trials that could not be followed, and why.
    """

    trials: tuple[GaitTrial, ...]
    known: FloatArray | None = None
    facts: tuple[tuple[str, str], ...] = ()
    left_out: tuple[tuple[str, str], ...] = ()

    @property
    def remarks(self) -> list[str]:
        """What its reader should know of single trials, a sentence each."""
        several = len(self.trials) + len(self.left_out) > 1
        notes = [
            f"{trial.name}: {note}" if several else note
            for trial in self.trials
            for note in trial.notes
        ]
        return [f"{name} is left out: {why}" for name, why in self.left_out] + notes

    @property
    def doubted(self) -> str:
        """A sentence about the trials whose double integration is doubtful; empty without."""
        count = sum(bool(trial.doubts) for trial in self.trials)
        if not count:
            return ""
        return (
            f"Double integration is not to be trusted in {count} of {len(self.trials)} trials, as "
            "the velocity did not come back to zero or no stance was found."
        )

    @property
    def integrated(self) -> list[GaitTrial]:
        """Trials with a distance by double integration."""
        return [t for t in self.trials if t.calibrated is not None or t.uncalibrated is not None]

    @property
    def compared(self) -> list[GaitTrial]:
        """Trials with that distance with and without calibration."""
        return [t for t in self.trials if t.calibrated is not None and t.uncalibrated is not None]

    def comparison(self) -> TrialComparison | None:
        """Return Tables 1 to 3; None without trials or a known distance."""
        if self.known is None or not self.compared:
            return None
        before = [t.uncalibrated.distance for t in self.compared if t.uncalibrated is not None]
        after = [t.calibrated.distance for t in self.compared if t.calibrated is not None]
        return compare_trials(self.known, np.array(before), np.array(after))

    def pooled(self, name: str) -> tuple[str, Summary]:
        """Return the unit and the statistics of a column over the walking of all trials."""
        unit = "" if not self.trials else self.trials[0].strides.columns()[name].unit
        values = [getattr(t.strides, name)[t.strides.walking] for t in self.trials]
        shown, size = SHOWN_UNITS.get(unit, (unit, 1.0))
        return shown, summary_of(np.concatenate(values) / size if values else np.zeros(0))

    def column(self, name: str) -> FloatArray:
        """Return a column of all strides, trial by trial."""
        return np.concatenate([getattr(t.strides, name) for t in self.trials])

    @property
    def walking(self) -> BoolArray:
        """Which of all strides are of walking or running."""
        return np.concatenate([t.strides.walking for t in self.trials])


def along_the_walk(trajectory: Trajectory, lead_m: float = LEAD_M) -> FloatArray:
    """Return how far a trajectory went, (3,) [m], with x where its first metres went."""
    moved = trajectory.position - trajectory.position[0]
    gone = np.hypot(moved[:, 0], moved[:, 1])
    far = gone >= min(lead_m, 0.9 * float(gone.max()))
    x, y = moved[int(np.argmax(far)), :2]
    return np.asarray(about_z(-float(np.arctan2(y, x))) @ moved[-1])
