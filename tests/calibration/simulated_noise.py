"""Noise of known coefficients, independent of the simulators."""

from __future__ import annotations

import numpy as np

from imu_rig.blocks import ImuBlock
from simulators.models import SensorModel
from simulators.mpu9150 import Mpu9150
from simulators.sampling import Means

GRAVITY = 9.80665


def noise(count, period, rng, *, white=0.0, flicker=0.0, walk=0.0, axes=None):
    """Samples of the sum of three kinds of noise, shape (count,) or (count, axes)."""
    shape = (count,) if axes is None else (count, axes)
    x = white / np.sqrt(period) * rng.standard_normal(shape)
    if flicker:
        # White noise filtered to a two-sided density of flicker^2 / (2 pi f).
        size = 1 << int(np.ceil(np.log2(2 * count)))
        f = np.fft.rfftfreq(size, period)
        f[0] = f[1]
        gain = np.sqrt(flicker**2 / (2 * np.pi * f) / period)
        drawn = np.fft.rfft(rng.standard_normal((size, *shape[1:])), axis=0)
        x = x + np.fft.irfft((drawn.T * gain).T, size, axis=0)[:count]
    return x + np.cumsum(walk * np.sqrt(period) * rng.standard_normal(shape), axis=0)


def still_block(count=30000, period=0.01, seed=0, *, accel=0.004, gyro=1e-4, walk=0.0) -> ImuBlock:
    """A sensor that lies still, white noise of given densities and the gyroscope's walk."""
    rng = np.random.default_rng(seed)
    t = 100.0 + period * np.arange(count)
    a = noise(count, period, rng, white=accel, axes=3) + np.array((0.1, -0.2, GRAVITY))
    g = noise(count, period, rng, white=gyro, walk=walk, axes=3) + np.array((0.01, -0.02, 0.005))
    return ImuBlock(t=t, accel=a, gyro=g, host_s=t)


def still_mpu9150(count, period, seed, **model) -> ImuBlock:
    """The simulated MPU-9150, level and at rest."""
    rng = np.random.default_rng(seed)
    t = period * np.arange(1, count + 1)

    def rows(*v):
        return np.tile(np.array(v, dtype=float), (count, 1))

    means = Means(
        t, np.full(count, period), rows(0, 0, GRAVITY), rows(0, 0, 0), rows(20.0, 0, -40.0)
    )
    r = Mpu9150(SensorModel(**model), rng).read(means, None)
    return ImuBlock(t=t, accel=r.accel, gyro=r.gyro, host_s=t, mag=r.mag, temperature=r.temperature)
