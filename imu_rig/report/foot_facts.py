"""What a report of a walk is told: the track of each foot and how it came about."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.gait.mounting import foot_matrices
from imu_rig.gait.strides import Strides, foot_pitch
from imu_rig.gait.trajectory import FootTrack
from imu_rig.gait.two_filter import StepSmoothing
from imu_rig.reference.alignment import Alignment
from imu_rig.report.foot_figures import SeenPath

STEEP = 1.3
"""A foot that points up or down more steeply [rad] has no heading to speak of."""


@dataclass(frozen=True, eq=False)
class Measured:
    """What a comparison with another instrument found.

    Attributes
    ----------
    rows : tuple of (str, str)
        Name and value, with unit, of each figure.
    card : (str, str, str, str)
        The most telling one: label, value, unit, explanation.
    note : str
        How the two were laid on each other.
    seen : SeenPath or None
        The other's way on the axes of the track.
    stride_lengths : shape (m,) or None
        Of every stride by the other [m]; NaN where it has none.
    figures : dict
        Name to value of the same, for programs.
    alignment : Alignment or None
        With a path.
    doubts : tuple of str
        What speaks against the track, or against the two being of one walk; a sentence each.
    """

    rows: tuple[tuple[str, str], ...]
    card: tuple[str, str, str, str]
    note: str
    seen: SeenPath | None = None
    stride_lengths: FloatArray | None = None
    figures: dict[str, Any] | None = None
    alignment: Alignment | None = None
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class FootAnalysis:
    """One foot in one recording.

    Attributes
    ----------
    name : str
        Of the sensor.
    block : ImuBlock
        What was analysed, calibrated where that was possible.
    track : FootTrack
    strides : Strides
    reference, footprints : Measured or None
        Comparisons with positions by optics, and with footprints on the ground.
    notes : tuple of str
        What its reader should know, a sentence each.
    steps : StepSmoothing or None
        What the published two filters say, on the axes of the track, where they were asked.
    motion_unit : str
        Of what the detector compares; empty where it is a number of its own.
    """

    name: str
    block: ImuBlock
    track: FootTrack
    strides: Strides
    reference: Measured | None = None
    footprints: Measured | None = None
    notes: tuple[str, ...] = ()
    steps: StepSmoothing | None = None
    motion_unit: str = "m/s"

    @cached_property
    def angles(self) -> FloatArray:
        """Roll, pitch and heading of the foot, shape (n, 3) [rad]; no heading where it is steep."""
        R = foot_matrices(self.track.trajectory.quaternion, self.strides.axes)
        pitch = foot_pitch(R)
        heading = np.arctan2(R[:, 1, 0], R[:, 0, 0])
        steep = np.abs(pitch) > STEEP
        heading[~steep] = np.unwrap(heading[~steep])  # a whole turn is no jump
        heading[steep] = np.nan
        return np.column_stack((np.arcsin(np.clip(R[:, 2, 1], -1.0, 1.0)), pitch, heading))

    @property
    def heading_at_footfalls(self) -> FloatArray:
        """Heading of the standing foot, shape (k,) [rad]."""
        R = foot_matrices(
            self.track.trajectory.quaternion[self.track.footfalls.quietest], self.strides.axes
        )
        return np.arctan2(R[:, 1, 0], R[:, 0, 0])

    @property
    def heading_sigma(self) -> float:
        """Standard uncertainty of the heading at the end against that at the start [rad]."""
        covariance = self.track.covariance
        return float("nan") if covariance is None else float(covariance.heading_sigma[-1])

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        span = float(self.block.t[-1] - self.block.t[0])
        return (len(self.block) - 1) / span if span > 0.0 else float("nan")

    @property
    def duration_s(self) -> float:
        """Of the recording [s]."""
        return float(self.block.t[-1] - self.block.t[0])


@dataclass(frozen=True, eq=False)
class FootReport:
    """One recording.

    Attributes
    ----------
    recording : str
        Name of its file.
    sha256 : str
    feet : tuple of FootAnalysis
    shared : bool
        Whether both feet are in one frame, so that they can be drawn together.
    facts : tuple of (str, str)
        How it was analysed: method, calibration, gravity ...
    left_out : tuple of (str, str)
        Feet that could not be followed, and why.
    """

    recording: str
    sha256: str
    feet: tuple[FootAnalysis, ...]
    shared: bool = False
    facts: tuple[tuple[str, str], ...] = ()
    left_out: tuple[tuple[str, str], ...] = ()
