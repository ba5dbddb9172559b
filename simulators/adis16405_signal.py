"""The ADIS16405's way from what its sensors feel to the numbers in its output registers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from firmware_protocols.adis16405 import (
    ACCEL_COUNT_G,
    AUX_COUNT_V,
    BURST,
    GYRO_COUNT_DPS,
    GYRO_RANGE_DPS,
    MAG_COUNT_G,
    SUPPLY_COUNT_V,
    TEMPERATURE_COUNT_C,
    TEMPERATURE_ZERO_C,
    Diag,
    averager,
)
from firmware_protocols.unconfirmed import ADIS16405_OUTPUT_DELAY_SAMPLES, ADIS16405_OVER_RANGE
from imu_rig.arrays import FloatArray, IntArray
from imu_rig.units import DEG, FIELD_UNITS, STANDARD_GRAVITY
from simulators.inertial_sensor import Readings

ACCEL_RANGE_G = 18.0
MAG_RANGE_G = 2.5
SUPPLY_LIMITS_V = (4.75, 5.25)

MOST_PAST = 2 * (1 << 6) - 2 + ADIS16405_OUTPUT_DELAY_SAMPLES
"""Samples that the longest averager looks back."""

_LEAST = np.array([-(1 << bits >> 1) if signed else 0 for _, bits, signed in BURST])
_GREATEST = np.array([(1 << bits >> signed) - 1 for _, bits, signed in BURST])


@dataclass(frozen=True)
class Alarm:
    """A limit on one word of the burst: its number, whether above it is wrong, and the flag."""

    word: int
    threshold: int
    above: bool
    flag: Diag


@dataclass(frozen=True)
class Settings:
    """What the control registers and the supply ask of the signal path.

    Attributes
    ----------
    gyro_range : int
        Range bits of SENS_AVG: 4, 2 or 1.
    m : int
        The averager has 2**m taps per stage.
    gyro_offsets_dps, accel_offsets, mag_offsets : three numbers
        Added, in deg/s, and in counts of accelerometer and magnetometer.
    mag_factors : three numbers
    supply_v, aux_v : float
    alarms : tuple of Alarm
    """

    gyro_range: int = 4
    m: int = 2
    gyro_offsets_dps: tuple[float, ...] = (0.0, 0.0, 0.0)
    accel_offsets: tuple[float, ...] = (0.0, 0.0, 0.0)
    mag_offsets: tuple[float, ...] = (0.0, 0.0, 0.0)
    mag_factors: tuple[float, ...] = (1.0, 1.0, 1.0)
    supply_v: float = 5.0
    aux_v: float = 0.0
    alarms: tuple[Alarm, ...] = ()


class SignalPath:
    """Averages samples and makes counts of them, remembering what the averager looks back on."""

    def __init__(self) -> None:
        self._past = np.empty((0, 9))

    def take(self, felt: FloatArray) -> None:
        """Let samples (n, 10), as of :func:`natural`, be past."""
        self._past = np.concatenate((self._past, felt[:, :9]))[-MOST_PAST:]

    def outputs(self, felt: FloatArray, settings: Settings) -> tuple[IntArray, IntArray]:
        """Return what the output registers hold after each sample; it does not become past.

        Parameters
        ----------
        felt : shape (n, 10)
            As of :func:`natural`.
        settings : Settings

        Returns
        -------
        counts : shape (n, 12)
            In the order of a burst.
        diag : shape (n,)
            Bits that each sample sets in DIAG_STAT.
        """
        smooth = self._averaged(felt[:, :9], settings.m)
        count_dps = GYRO_COUNT_DPS[settings.gyro_range]
        accel = smooth[:, 3:6] / ACCEL_COUNT_G + settings.accel_offsets
        mag = smooth[:, 6:] / MAG_COUNT_G * settings.mag_factors + settings.mag_offsets
        number = len(felt)
        exact = np.column_stack(
            (
                np.full(number, settings.supply_v / SUPPLY_COUNT_V),
                (smooth[:, :3] + settings.gyro_offsets_dps) / count_dps,
                accel,
                mag,
                (felt[:, 9] - TEMPERATURE_ZERO_C) / TEMPERATURE_COUNT_C,
                np.full(number, settings.aux_v / AUX_COUNT_V),
            )
        )
        counts = np.clip(np.rint(exact), _LEAST, _GREATEST).astype(np.int64)
        return counts, _diag(exact, counts, settings)

    def _averaged(self, felt: FloatArray, m: int) -> FloatArray:
        weights = averager(m)
        back = len(weights) - 1 + ADIS16405_OUTPUT_DELAY_SAMPLES
        if len(felt) == 0:
            return felt
        past = self._past[-back:]
        begin = past[0] if len(past) else felt[0]  # as if it had been so for ever
        filling = np.broadcast_to(begin, (back - len(past), 9))
        known = np.concatenate((filling, past, felt))
        number = len(felt)
        smooth = np.zeros((number, 9))
        for age, weight in enumerate(weights, ADIS16405_OUTPUT_DELAY_SAMPLES):
            smooth += weight * known[back - age : back - age + number]
        return smooth


def _diag(exact: FloatArray, counts: IntArray, settings: Settings) -> IntArray:
    most = (
        ADIS16405_OVER_RANGE["gyro"]
        * GYRO_RANGE_DPS[settings.gyro_range]
        / GYRO_COUNT_DPS[settings.gyro_range],
        ADIS16405_OVER_RANGE["accel"] * ACCEL_RANGE_G / ACCEL_COUNT_G,
        ADIS16405_OVER_RANGE["mag"] * MAG_RANGE_G / MAG_COUNT_G,
    )
    over = np.any(np.abs(exact[:, 1:10]) > np.repeat(most, 3), axis=1)
    diag = np.where(over, int(Diag.OVER_RANGE), 0)
    low_v, high_v = SUPPLY_LIMITS_V
    if settings.supply_v < low_v:
        diag |= int(Diag.SUPPLY_LOW)
    if settings.supply_v > high_v:
        diag |= int(Diag.SUPPLY_HIGH)
    for alarm in settings.alarms:
        number = counts[:, alarm.word]
        wrong = number > alarm.threshold if alarm.above else number < alarm.threshold
        diag |= np.where(wrong, int(alarm.flag), 0)
    return diag


def natural(readings: Readings) -> FloatArray:
    """Return readings in deg/s, g, gauss and degC, shape (n, 10)."""
    return np.column_stack(
        (
            readings.gyro / DEG,
            readings.accel / STANDARD_GRAVITY,
            readings.mag / FIELD_UNITS["G"],
            readings.temperature,
        )
    )
