"""The classic detectors of zero velocity, each with one threshold for everybody.

SHOE, ARE, moving variance (MV) and magnitude (MAG) are those of Skog, Handel, Nilsson and
Rantakokko, "Zero-velocity detection - an algorithm evaluation", IEEE Trans. Biomed. Eng. 57, 2010;
the foot paper's asks for a small angular rate and a specific force that hardly varies. Windows are
in seconds on the measured time stamps, centred on the sample, and shorter at the ends of a
recording.

The default thresholds come from simulated walks of 0.5 to 1.8 m/s with sensors of a smart phone's
grade, before calibration (``tests/benchmarks/distance_study.py detectors``): the geometric middle
between the least one that finds every stance and the largest that lets in no swing, rounded. What
one threshold cannot do is to serve slow gait and running; that is what `imu_rig.gait.adaptive` is
for.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.errors import InputError
from imu_rig.gait.detector_stream import Passed, WindowDetector
from imu_rig.gait.fixed_threshold import FixedThreshold
from imu_rig.kernels.windows import largest_norm, mean_square, mean_square_excess, scatter
from imu_rig.units import DEG, STANDARD_GRAVITY

Detector = WindowDetector


@dataclass(frozen=True)
class Shoe(WindowDetector):
    """Stance hypothesis optimal estimation (SHOE), Skog et al. 2010.

    ``mean(|f - g fbar / |fbar||^2 / sigma_f^2 + |w|^2 / sigma_w^2)`` over the window, without unit.

    Attributes
    ----------
    sigma_accel, sigma_gyro : float
        Noise of the sensors [m/s^2, rad/s]; the weights of both parts.
    gravity : float
        [m/s^2]
    """

    name: ClassVar[str] = "shoe"
    threshold: float = 1.2e4
    sigma_accel: float = 0.05
    sigma_gyro: float = 0.1 * DEG
    gravity: float = STANDARD_GRAVITY

    def statistic(self, passed: Passed, first: IntArray, last: IntArray) -> FloatArray:
        """Return the statistic of each window."""
        force = scatter(passed.accel, self.gravity, first, last)
        rate = mean_square(passed.gyro, first, last)
        return force / self.sigma_accel**2 + rate / self.sigma_gyro**2


@dataclass(frozen=True)
class AngularRateEnergy(WindowDetector):
    """Angular rate energy (ARE), Skog et al. 2010: ``mean(|w|^2) / sigma_w^2``, without unit.

    Attributes
    ----------
    sigma_gyro : float
        Noise of the gyroscope [rad/s].
    """

    name: ClassVar[str] = "are"
    threshold: float = 1.2e4
    sigma_gyro: float = 0.1 * DEG

    def statistic(self, passed: Passed, first: IntArray, last: IntArray) -> FloatArray:
        """Return the statistic of each window."""
        return mean_square(passed.gyro, first, last) / self.sigma_gyro**2


@dataclass(frozen=True)
class MovingVariance(WindowDetector):
    """Acceleration moving variance (MV), Skog et al. 2010.

    ``mean(|f - fbar|^2) / sigma_f^2`` over the window, without unit.

    Attributes
    ----------
    sigma_accel : float
        Noise of the accelerometer [m/s^2].
    """

    name: ClassVar[str] = "variance"
    threshold: float = 130.0
    sigma_accel: float = 0.05

    def statistic(self, passed: Passed, first: IntArray, last: IntArray) -> FloatArray:
        """Return the statistic of each window."""
        return scatter(passed.accel, 0.0, first, last) / self.sigma_accel**2


@dataclass(frozen=True)
class Magnitude(WindowDetector):
    """Acceleration magnitude (MAG), Skog et al. 2010: ``mean((|f| - g)^2) / sigma_f^2``, no unit.

    Attributes
    ----------
    sigma_accel : float
        Noise of the accelerometer [m/s^2].
    gravity : float
        [m/s^2]
    """

    name: ClassVar[str] = "magnitude"
    threshold: float = 140.0
    sigma_accel: float = 0.05
    gravity: float = STANDARD_GRAVITY

    def statistic(self, passed: Passed, first: IntArray, last: IntArray) -> FloatArray:
        """Return the statistic of each window."""
        return mean_square_excess(passed.accel, self.gravity, first, last) / self.sigma_accel**2


@dataclass(frozen=True)
class SmallMotion(WindowDetector):
    """The foot paper's: the angular rate is small and the specific force hardly varies.

    The larger of ``max |w| / most_rate`` and the specific force's standard deviation, taken over
    its three axes together, over ``most_scatter``; without unit, compared with 1.

    Attributes
    ----------
    most_rate : float
        [rad/s]
    most_scatter : float
        [m/s^2]
    """

    name: ClassVar[str] = "paper"
    threshold: float = 1.0
    most_rate: float = 40.0 * DEG
    most_scatter: float = 0.6

    def statistic(self, passed: Passed, first: IntArray, last: IntArray) -> FloatArray:
        """Return the statistic of each window."""
        rate = largest_norm(passed.gyro, first, last) / self.most_rate
        force = np.sqrt(scatter(passed.accel, 0.0, first, last)) / self.most_scatter
        return np.asarray(np.maximum(rate, force))


DETECTORS: dict[str, type[WindowDetector]] = {
    kind.name: kind
    for kind in (SmallMotion, Shoe, AngularRateEnergy, MovingVariance, Magnitude, FixedThreshold)
}
"""The classic detectors by name."""


def detector_named(detector: str | Detector, **settings: Any) -> Detector:
    """Return a detector by its name, with other settings than the usual ones if any are given.

    A detector is returned as it is, so that functions may take either.

    Raises
    ------
    InputError
        There is no such detector or setting, or a setting is no positive number.
    """
    if not isinstance(detector, str):
        return detector
    kind = DETECTORS.get(detector)
    if kind is None:
        known = ", ".join(DETECTORS)
        raise InputError(f"there is no detector of zero velocity {detector!r}; take one of {known}")
    known_settings = [field.name for field in fields(kind)]
    for setting in settings:
        if setting not in known_settings:
            raise InputError(
                f"the detector {detector} has no setting {setting!r}; it has "
                f"{', '.join(known_settings)}"
            )
    return kind(**settings)
