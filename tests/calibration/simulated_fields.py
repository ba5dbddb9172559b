"""Still poses of a magnetometer with known truth, on a jig and by hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig import rotation
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.stills import Stills, summarize

DEG = np.pi / 180.0
G = 9.80665
FIELD = 48.0
RATE = 100.0


def pose_list(rolls: int) -> np.ndarray:
    """Pan, tilt and roll [deg]: three tilts at each of ``rolls`` rolls, pan 0 and 90 in turn."""
    poses = []
    for k, roll in enumerate(np.linspace(-180, 180, rolls, endpoint=False)):
        tilts = (0, 60, -60) if k % 4 == 0 else (0, 90, -90) if k % 4 == 2 else (0, -45, 45)
        poses += [(90 * (k % 2), tilt, roll) for tilt in tilts]
    return np.array(poses, dtype=float)


def jig_matrices(angles_deg) -> np.ndarray:
    pan, tilt, roll = np.asarray(angles_deg, float).T * DEG
    return rotation.about_z(pan) @ rotation.about_y(tilt) @ rotation.about_x(roll)


def field(dip_deg, azimuth_deg=40.0) -> np.ndarray:
    """Field in navigation axes, below the horizontal for a positive dip [uT]."""
    dip, azimuth = dip_deg * DEG, azimuth_deg * DEG
    level = np.cos(dip) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    return FIELD * (level + np.array([0.0, 0.0, -np.sin(dip)]))


@dataclass
class Compass:
    """A magnetometer: soft iron 10 %, hard iron half of the field."""

    K: np.ndarray
    b: np.ndarray

    @staticmethod
    def random(rng) -> Compass:
        offset = rng.standard_normal(3)
        K = np.eye(3) + 0.1 * rng.uniform(-1, 1, (3, 3))
        return Compass(K, 0.5 * FIELD * offset / np.linalg.norm(offset))

    def read(self, h) -> np.ndarray:
        return (h + self.b) @ np.linalg.inv(self.K).T


def session(
    matrices,
    compass,
    rng,
    *,
    dip_deg=60.0,
    azimuth_deg=40.0,
    noise=0.012,
    hold_s=2.0,
    iron=None,
) -> tuple[ImuBlock, Stills]:
    """Rest in every attitude; only the rests are in the block.

    ``noise`` of one sample is over the field; ``iron`` (m, 3) is a field added in navigation
    axes [uT].
    """
    count = round(hold_s * RATE)
    nav = (
        field(dip_deg, azimuth_deg) + (0.0 if iron is None else iron) + np.zeros((len(matrices), 3))
    )
    h = np.einsum("nji,nj->ni", matrices, nav)
    shape = (len(matrices) * count, 3)
    mag = np.repeat(compass.read(h), count, axis=0) + noise * FIELD * rng.standard_normal(shape)
    accel = np.repeat(matrices[:, 2, :] * G, count, axis=0) + 0.03 * rng.standard_normal(shape)
    t = np.arange(len(mag)) / RATE
    block = ImuBlock(t, accel, 0.001 * rng.standard_normal(shape), t, mag=mag)
    begin = np.arange(len(matrices)) * count / RATE
    return block, summarize(block, np.stack((begin + 0.005, begin + hold_s - 0.015), axis=1))
