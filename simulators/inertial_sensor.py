"""An inertial sensor's readings of a motion: gains, offsets, noise, drift, range, whole counts."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray
from imu_rig.units import DEG, MILLI_G, STANDARD_GRAVITY
from simulators.models import SensorModel, Vector3
from simulators.sampling import Means

HISTORY_S = 3600
"""Seconds of true offsets that are remembered."""
HISTORY_HZ = 10
"""Values remembered per second: over a hold of 2 s, an offset walks further between two values a
second apart than a calibration is uncertain by."""

WALK_TIME_S = 600.0
"""The time after which a walk has the standard deviation that its name gives."""

_NOISES = 15


@dataclass(frozen=True)
class SensorRange:
    """What the readings of one quantity can be.

    Attributes
    ----------
    count : float
        One count [SI, uT]; 0 for readings that are not rounded.
    least, greatest : float
        Ends of the range: in counts, or in the unit where readings are not rounded.
    axes : tuple of str
        Which of the part's own axes x, y and z of a reading are, with sign, as in a packet
        layout: ("+y", "+x", "-z") says x = own y, y = own x, z = - own z.
    cuts_off : bool
        Whether the device cuts off to whole counts in place of rounding; whoever reads them takes
        the middle of what each stands for, of 0 that of two counts' width.
    """

    count: float = 0.0
    least: float = -math.inf
    greatest: float = math.inf
    axes: tuple[str, str, str] = ("+x", "+y", "+z")
    cuts_off: bool = False

    @classmethod
    def of_bits(cls, count: float, bits: int) -> SensorRange:
        """Return the range of two's complement numbers of so many bits."""
        half = 2 ** (bits - 1)
        return cls(count, -half, half - 1)

    def reading(self, values: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return values (n, 3) as they are read, and which of them are at an end, (n, 3).

        Both on the axes of the values.
        """
        if self.count:
            values = values / self.count
        columns, signs = self._own_axes
        turned = columns != [0, 1, 2] or bool(np.any(signs < 0))
        if turned:
            own = np.empty_like(values)
            own[:, columns] = values * signs
            values = own
        if self.count and self.cuts_off:
            whole = np.trunc(values)
            values = whole + 0.5 * np.sign(whole)
        elif self.count:
            values = np.rint(values)
        read = np.clip(values, self.least, self.greatest)
        at_end = (read <= self.least) | (read >= self.greatest)
        if turned:
            read, at_end = read[:, columns] * signs, at_end[:, columns]
        return read * self.count if self.count else read, at_end

    @cached_property
    def _own_axes(self) -> tuple[list[int], FloatArray]:
        columns = ["xyz".index(axis[1]) for axis in self.axes]
        return columns, np.array([-1.0 if axis[0] == "-" else 1.0 for axis in self.axes])

    def unrounded(self) -> SensorRange:
        """Return the same range without counts."""
        if not self.count:
            return self
        return replace(
            self, count=0.0, least=self.least * self.count, greatest=self.greatest * self.count
        )


@dataclass(frozen=True)
class SensorRanges:
    """The parts of a sensor; None for one that it does not have, which then reads NaN."""

    accel: SensorRange
    gyro: SensorRange | None
    mag: SensorRange | None

    def unrounded(self) -> SensorRanges:
        """Return the same parts without counts."""
        return SensorRanges(
            self.accel.unrounded(),
            self.gyro and self.gyro.unrounded(),
            self.mag and self.mag.unrounded(),
        )


@dataclass(frozen=True)
class Readings:
    """What the sensor says, in nominal SI units on the accelerometer's axes.

    Attributes
    ----------
    accel : shape (n, 3)
        m/s^2.
    gyro : shape (n, 3)
        rad/s.
    mag : shape (n, 3)
        uT.
    temperature : shape (n,)
        degC.
    saturated : shape (n,)
        Whether an accelerometer or gyroscope axis is at the end of its range.
    offsets : shape (n, 6)
        True offsets of accelerometer [m/s^2] and gyroscope [rad/s], with walk and warm-up.
    """

    accel: FloatArray
    gyro: FloatArray
    mag: FloatArray
    temperature: FloatArray
    saturated: BoolArray
    offsets: FloatArray

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.temperature)


@dataclass(frozen=True)
class Vibration:
    """A buzz of the jig that the servos cause in some poses."""

    amplitude: FloatArray
    hz: float
    phase: float

    def mean(self, t: FloatArray, duration: FloatArray) -> FloatArray:
        """Return the mean specific force [m/s^2], shape (n, 3), over intervals that end at t."""
        middle = np.sin(2.0 * math.pi * self.hz * (t - 0.5 * duration) + self.phase)
        return (middle * np.sinc(self.hz * duration))[:, np.newaxis] * self.amplitude


class InertialSensor:
    """One sensor with its noise and drift.

    Parameters
    ----------
    model : SensorModel
    ranges : SensorRanges
    rng : numpy Generator
    """

    def __init__(self, model: SensorModel, ranges: SensorRanges, rng: np.random.Generator) -> None:
        self.model = model
        self.ranges = ranges
        self._rng = rng
        self._accel_sensitivity = np.linalg.inv(np.array(model.accel_gain))
        self._gyro_sensitivity = np.linalg.inv(np.array(model.gyro_gain))
        self._mag_sensitivity = np.linalg.inv(np.array(model.mag_gain))
        self._g_sensitivity = np.array(model.g_sensitivity) * (DEG / STANDARD_GRAVITY)
        self._offsets = np.array((*model.accel_offset, *model.gyro_offset))
        self._offsets_per_c = np.repeat(
            (model.accel_offset_mg_per_c * MILLI_G, model.gyro_offset_dps_per_c * DEG), 3
        )
        self._walks = np.zeros(6)
        self._history: deque[tuple[float, FloatArray]] = deque(maxlen=HISTORY_S * HISTORY_HZ)
        self._remembered_s = -1.0

    def offsets(self, start_s: float, stop_s: float) -> FloatArray:
        """Return the mean true offsets between two world times, shape (6,).

        Three of the accelerometer [m/s^2] and three of the gyroscope [rad/s], with walk and
        warm-up, from `HISTORY_HZ` values per second of the last hour; the nearest one where none
        is in between. At the very start, those of the model.
        """
        if not self._history:
            return self._offsets
        within = [offsets for t, offsets in self._history if start_s <= t <= stop_s]
        if not within:
            middle = 0.5 * (start_s + stop_s)
            within = [min(self._history, key=lambda entry: abs(entry[0] - middle))[1]]
        mean: FloatArray = np.mean(within, axis=0)
        return mean

    def temperature(self, t: FloatArray) -> FloatArray:
        """Return the temperature [degC] at world times."""
        model = self.model
        on_s = model.powered_s + t
        return model.ambient_c + model.warm_up_c * (1.0 - np.exp(-on_s / model.warm_up_tau_s))

    def read(self, means: Means, vibration: Vibration | None, *, factor: float = 1.0) -> Readings:
        """Return the readings of a motion.

        Parameters
        ----------
        means : Means
            Of the sample intervals; noise follows the length of each.
        vibration : Vibration or None
        factor : float
            Multiplies accelerometer and gyroscope: a sensor that is wrong.
        """
        model = self.model
        duration = means.duration[:, np.newaxis]
        noise = self._rng.standard_normal((len(means), _NOISES))
        walks = self._walk(noise[:, 9:], duration)
        temperature = self.temperature(means.t)
        cold = (temperature - (model.ambient_c + model.warm_up_c))[:, np.newaxis]

        force = means.force
        if vibration is not None:
            force = force + vibration.mean(means.t, means.duration)
        seen = bent(force, model.accel_quadratic, model.accel_cubic)
        gained = seen * (1.0 + cold * (model.accel_gain_percent_per_c / 100.0))
        offsets = walks + self._offsets + cold * self._offsets_per_c
        self._remember(means.t, offsets)
        accel = _turned(self._accel_sensitivity, gained + offsets[:, :3])
        # A one-sided density d gives the mean over a time T the variance d^2 / (2 T).
        band = 1.0 / np.sqrt(2.0 * duration)
        accel += noise[:, :3] * (model.accel_noise_ug * 1e-6 * STANDARD_GRAVITY) * band

        rate = means.rate + _turned(self._g_sensitivity, force)
        gyro = _turned(self._gyro_sensitivity, rate + offsets[:, 3:])
        gyro += noise[:, 3:6] * (model.gyro_noise_dps * DEG) * band

        mag = _turned(self._mag_sensitivity, means.field + np.array(model.mag_offset))
        mag += noise[:, 6:9] * model.mag_noise_ut

        ranges = self.ranges
        if not model.quantized:
            ranges = SensorRanges(
                SensorRange(), ranges.gyro and SensorRange(), ranges.mag and SensorRange()
            )
        accel, accel_ends = ranges.accel.reading(accel * factor)
        gyro, gyro_ends = _reading(ranges.gyro, gyro * factor)
        return Readings(
            accel=accel,
            gyro=gyro,
            mag=_reading(ranges.mag, mag)[0],
            temperature=temperature,
            saturated=np.any(accel_ends | gyro_ends, axis=1),
            offsets=offsets,
        )

    def _remember(self, t: FloatArray, offsets: FloatArray) -> None:
        tick = np.floor(HISTORY_HZ * t)
        for row in np.flatnonzero(np.diff(tick, prepend=np.floor(HISTORY_HZ * self._remembered_s))):
            self._history.append((float(t[row]), offsets[row].copy()))
        if len(t):
            self._remembered_s = float(t[-1])

    def _walk(self, noise: FloatArray, duration: FloatArray) -> FloatArray:
        """Return the walks at each sample, shape (n, 6), and go on from the last."""
        model = self.model
        after_walk_time = np.repeat((model.accel_walk_mg * MILLI_G, model.gyro_walk_dps * DEG), 3)
        steps = np.vstack((self._walks, noise * after_walk_time * np.sqrt(duration / WALK_TIME_S)))
        walks: FloatArray = np.cumsum(steps, axis=0)[1:]
        if len(walks):
            self._walks = walks[-1]
        return walks


def bent(force: FloatArray, quadratic: Vector3, cubic: Vector3) -> FloatArray:
    """Return what a nonlinear accelerometer makes of specific force (n, 3) [m/s^2]."""
    if not (any(quadratic) or any(cubic)):
        return force
    in_g = force / STANDARD_GRAVITY
    bend: FloatArray = np.array(quadratic) * in_g**2 + np.array(cubic) * in_g**3
    return force + STANDARD_GRAVITY * bend


def _reading(part: SensorRange | None, values: FloatArray) -> tuple[FloatArray, BoolArray]:
    if part is None:
        return np.full_like(values, np.nan), np.zeros(values.shape, dtype=np.bool_)
    return part.reading(values)


def _turned(matrix: FloatArray, vectors: FloatArray) -> FloatArray:
    turned: FloatArray = vectors @ matrix.T
    return turned
