"""A small generator of calibration sessions with known truth, independent of the simulators."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig import rotation
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.model import Affine

DEG = np.pi / 180.0
MILLI_G = 9.80665e-3


@dataclass
class Truth:
    """A sensor as a data sheet would describe it, and its exact calibration."""

    accel: Affine
    gyro: Affine


@dataclass
class Recording:
    block: ImuBlock
    holds: np.ndarray  # (m, 2) begin and end of every rest [s]
    attitudes: np.ndarray  # (m, 4) body to navigation


def exact(K, b):
    return Affine(np.asarray(K, float), np.asarray(b, float), np.zeros((12, 12)))


def random_sensor(rng) -> Truth:
    """Scale 3 %, lean 2 %, bias 50 mg and 3 deg/s; accelerometer K upper triangular."""
    T = np.triu(0.02 * rng.standard_normal((3, 3)), 1) + np.diag(1 + 0.03 * rng.standard_normal(3))
    G = np.eye(3) + 0.02 * rng.standard_normal((3, 3))
    bias = 50 * MILLI_G * rng.standard_normal(3)
    drift = 3 * DEG * rng.standard_normal(3)
    return Truth(exact(T, T @ bias), exact(G, G @ drift))


def spread_attitudes(count, rng) -> np.ndarray:
    """Attitudes whose "up" covers the sphere evenly, each reached by a turn of 40 to 130 deg."""
    k = np.arange(count) + 0.5
    z, phi = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    up = np.stack((np.cos(phi) * np.sqrt(1 - z**2), np.sin(phi) * np.sqrt(1 - z**2), z), axis=1)
    up = up @ rotation.to_matrix(rotation.normalize(rng.standard_normal(4))).T
    attitudes = []
    for direction in up[rng.permutation(count)]:
        # A body-to-navigation rotation that takes ``direction`` to the vertical.
        axis = np.cross(direction, [0, 0, 1.0])
        angle = np.arctan2(np.linalg.norm(axis), direction[2])
        tilt = rotation.from_rotation_vector(angle * axis / max(np.linalg.norm(axis), 1e-12))
        heading = rotation.from_rotation_vector(np.array([0, 0, rng.uniform(-1, 1)]))
        attitudes.append(rotation.multiply(heading, tilt))
    return np.array(attitudes)


def jig_attitudes(angles_deg) -> np.ndarray:
    pan, tilt, roll = np.asarray(angles_deg, float).T * DEG
    turn = rotation.from_rotation_vector
    zero = np.zeros_like(pan)
    return rotation.multiply(
        rotation.multiply(
            turn(np.stack((zero, zero, pan), 1)), turn(np.stack((zero, tilt, zero), 1))
        ),
        turn(np.stack((roll, zero, zero), 1)),
    )


def record(
    attitudes,
    truth: Truth,
    rng,
    *,
    rate=100.0,
    hold_s=2.0,
    move_s=1.5,
    accel_noise=0.028,
    gyro_noise=0.05 * DEG,
    walk=0.0,
    jitter=0.0,
    gravity=9.80665,
    turns=None,
    earth=(0.0, 0.0, 0.0),
) -> Recording:
    """Rest ``hold_s`` in every attitude and turn between them about one body-fixed axis.

    ``accel_noise`` [m/s^2] and ``gyro_noise`` [rad/s] are standard deviations of one sample;
    ``earth`` [rad/s] is the Earth's rotation in navigation axes and
    ``walk`` [rad/s/sqrt(s)] is the gyroscope's; ``turns`` (m-1, 3) overrides the short way.
    """
    steps_hold, steps_move = round(hold_s * rate), round(move_s * rate)
    count = len(attitudes)
    total = count * steps_hold + (count - 1) * steps_move
    t = np.arange(total) / rate
    if jitter:
        t = t + rng.uniform(-0.5, 0.5, total) * jitter / rate
    q = np.empty((total, 4))
    w = np.zeros((total, 3))
    holds, row = [], 0
    for i in range(count):
        q[row : row + steps_hold] = attitudes[i]
        holds.append((t[row], t[row + steps_hold - 1]))
        row += steps_hold
        if i == count - 1:
            break
        theta = (
            rotation.to_rotation_vector(
                rotation.multiply(rotation.conjugate(attitudes[i]), attitudes[i + 1])
            )
            if turns is None
            else np.asarray(turns[i])
        )
        # A raised cosine from the last sample of the rest to the first of the next.
        begin, span = t[row - 1], (steps_move + 1) / rate
        phase = np.clip((t[row : row + steps_move] - begin) / span, 0, 1)
        done = phase - np.sin(2 * np.pi * phase) / (2 * np.pi)
        w[row : row + steps_move] = theta * ((1 - np.cos(2 * np.pi * phase)) / span)[:, None]
        q[row : row + steps_move] = rotation.multiply(
            attitudes[i], rotation.from_rotation_vector(done[:, None] * theta)
        )
        row += steps_move
    force = rotation.rotate(rotation.conjugate(q), np.array([0.0, 0.0, gravity]))
    drift = np.cumsum(rng.standard_normal((total, 3)) * walk / np.sqrt(rate), axis=0)
    drift -= drift.mean(axis=0)  # the true bias is the session's mean
    accel = truth.accel.undo(force) + accel_noise * rng.standard_normal((total, 3))
    w = w + rotation.rotate(rotation.conjugate(q), np.array(earth))
    gyro = truth.gyro.undo(w) + gyro_noise * rng.standard_normal((total, 3)) + drift
    return Recording(ImuBlock(t, accel, gyro, t), np.array(holds), np.asarray(attitudes))
