"""How a detector goes over a recording: whole, or in pieces with the same result."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.blocks import ImuBlock
from imu_rig.errors import InputError
from imu_rig.gait.zero_velocity import ZeroVelocity
from imu_rig.kernels.windows import window_edges


@dataclass(frozen=True, eq=False)
class Passed:
    """Samples as a detector sees them.

    Attributes
    ----------
    t : shape (n,)
        Times [s], never decreasing.
    accel, gyro : shape (n, 3)
        Specific force [m/s^2] and angular rate [rad/s].
    """

    t: FloatArray
    accel: FloatArray
    gyro: FloatArray

    def after(self, number: int) -> Passed:
        """Return all but the first ``number`` samples, as copies that hold on to nothing else."""
        return Passed(self.t[number:].copy(), self.accel[number:].copy(), self.gyro[number:].copy())

    @staticmethod
    def joined(parts: Sequence[Passed]) -> Passed:
        """Return one after the other."""
        return Passed(
            np.concatenate([part.t for part in parts]),
            np.concatenate([part.accel for part in parts]),
            np.concatenate([part.gyro for part in parts]),
        )

    @staticmethod
    def none() -> Passed:
        """Return no samples."""
        return Passed(np.empty(0), np.empty((0, 3)), np.empty((0, 3)))


class Preparation:
    """Makes of a recording what a detector looks at: here the readings as they are.

    Samples may be kept back, but all come out in the end, and in order.
    """

    def update(self, block: ImuBlock) -> Passed:
        """Take samples and return those that are ready."""
        return Passed(*(np.ascontiguousarray(c) for c in (block.t, block.accel, block.gyro)))

    def finish(self) -> Passed:
        """Return the rest."""
        return Passed.none()


@dataclass(frozen=True)
class WindowDetector(ABC):
    """A detector that compares a statistic of a window around each sample with a threshold.

    Attributes
    ----------
    threshold : float
        The foot is taken to stand where the statistic is below; in the statistic's unit.
    window : float
        Length of the window [s]. A flat foot rests for 0.3 s in a walk and for 0.07 s in a run; a
        window is to be a good deal shorter, and long enough for three samples.
    sigma : float
        Standard uncertainty of "the velocity is zero" where the foot stands [m/s]: an instep 0.1 m
        above the ground, over which the foot begins to roll at 20 deg/s.

    Raises
    ------
    InputError
        A setting is no positive number.
    """

    name: ClassVar[str]
    threshold: float
    window: float = 0.1
    sigma: float = 0.035

    def __post_init__(self) -> None:
        """Refuse settings that no detector can work with."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not (isinstance(value, int | float) and math.isfinite(value) and value > 0.0):
                raise InputError(
                    f"the detector {self.name}: {field.name} is {value!r}; it must be a positive "
                    "number"
                )

    @abstractmethod
    def statistic(self, passed: Passed, first: IntArray, last: IntArray) -> FloatArray:
        """Return the statistic of each window, (m,); NaN or infinite where it says nothing."""

    def preparation(self) -> Preparation:
        """Return what makes of a recording what this detector looks at."""
        return Preparation()

    def stream(self) -> DetectorStream:
        """Begin a recording that comes in pieces."""
        return DetectorStream(self)

    def detect(self, block: ImuBlock) -> ZeroVelocity:
        """Return when a foot stands in a whole recording."""
        stream = self.stream()
        parts = stream.update(block), stream.finish()
        return joined(parts)

    def judged(self, statistic: FloatArray) -> ZeroVelocity:
        """Compare a statistic (m,) with the threshold."""
        still = statistic < self.threshold
        return ZeroVelocity(
            still,
            np.where(still, self.sigma, np.inf),
            statistic,
            np.full(len(statistic), self.threshold),
        )


class DetectorStream:
    """A detector on a recording that comes in pieces of any size.

    The verdicts are exactly those on the whole recording; each comes as soon as the sample's window
    is over. No more than two windows of samples are kept.

    Parameters
    ----------
    detector : WindowDetector
    """

    def __init__(self, detector: WindowDetector) -> None:
        self._detector = detector
        self._preparation = detector.preparation()
        self._kept = Passed.none()
        self._judged = 0  # of the samples kept

    def update(self, block: ImuBlock) -> ZeroVelocity:
        """Take the next samples; return the verdicts on those samples, in order, that are due."""
        self._take(self._preparation.update(block))
        return self._judge(all_of_them=False)

    def finish(self) -> ZeroVelocity:
        """Return the verdicts on the last samples; the recording is over."""
        self._take(self._preparation.finish())
        return self._judge(all_of_them=True)

    def _take(self, samples: Passed) -> None:
        if len(samples.t):
            self._kept = Passed.joined((self._kept, samples)) if len(self._kept.t) else samples

    def _judge(self, *, all_of_them: bool) -> ZeroVelocity:
        kept, begin, end = self._kept, self._judged, len(self._kept.t)
        half = 0.5 * self._detector.window
        first, last, complete = window_edges(kept.t, half, begin, end)
        due = end - begin if all_of_them else complete
        verdicts = self._detector.judged(
            self._detector.statistic(kept, first[:due], last[:due]) if due else np.empty(0)
        )
        spent = int(first[due]) if due < end - begin else end
        self._kept = kept.after(spent)
        self._judged = begin + due - spent
        return verdicts


def joined(parts: Sequence[ZeroVelocity]) -> ZeroVelocity:
    """Return verdicts on consecutive pieces as those on the whole."""
    return ZeroVelocity(
        np.concatenate([part.still for part in parts]),
        np.concatenate([part.sigma for part in parts]),
        np.concatenate([part.statistic for part in parts]),
        np.concatenate([part.threshold for part in parts]),
    )
