"""What differs from pose to pose on a real jig: a small rotation of the plate, and a buzz."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.units import DEG, MILLI_G
from simulators.inertial_sensor import Vibration
from simulators.models import JigModel


@dataclass(frozen=True)
class PoseErrors:
    """The errors of one pose.

    Attributes
    ----------
    wobble : shape (3,)
        Rotations of the plate about x, y and z [rad].
    vibration : Vibration or None
        What the servos do while they hold, in some poses.
    """

    wobble: FloatArray
    vibration: Vibration | None


def draw_pose_errors(model: JigModel, rng: np.random.Generator) -> PoseErrors:
    """Draw the errors of the next pose."""
    wobble = rng.normal(0.0, model.wobble_deg * DEG, 3)
    direction = rng.normal(size=3)
    amplitude = model.vibration_mg * MILLI_G * direction / np.linalg.norm(direction)
    buzzes = bool(rng.uniform() < model.vibration_share)
    hz, phase = float(rng.uniform(*model.vibration_hz)), float(rng.uniform(0.0, 2 * math.pi))
    return PoseErrors(wobble, Vibration(amplitude, hz, phase) if buzzes else None)
