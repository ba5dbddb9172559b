"""What the joint fit sees of a session: one mean per pose, one integrable move between poses.

A recording is summarized into it, and a protocol that was never run can be written as it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.calibration.earth import EARTH_RATE
from imu_rig.calibration.model import Affine
from imu_rig.calibration.moves import Moves
from imu_rig.calibration.session import CommandedPoses, Session
from imu_rig.units import DEG

BIAS_WALK = 0.1 * DEG / np.sqrt(600.0)
"""Random walk of a gyroscope's bias to start from [rad/s per sqrt(s)]: 0.1 deg/s in 10 minutes."""


@dataclass(frozen=True, eq=False)
class JointData:
    """Summaries of ``m`` poses and ``n`` moves of one session on one jig.

    Attributes
    ----------
    angles : shape (m, 3)
        Commanded pan, tilt and roll [rad].
    mounting : shape (m,)
        Mounting of the sensor on the plate, an index into ``mountings``.
    mountings : shape (k, 3, 3)
        Nominal rotation of the sensor on the plate in each mounting, body to plate.
    t : shape (m,)
        Middle of each still [s].
    accel : shape (m, 3)
        Mean raw specific force [m/s^2].
    force : shape (m, 3)
        The same calibrated well enough to say how a gyroscope feels it [m/s^2].
    accel_sigma : shape (m,)
        Standard error of the mean along gravity [m/s^2].
    gyro, gyro_sigma : shape (m, 3)
        Mean raw rate and its standard error [rad/s].
    moves : Moves
        Gyroscope samples between neighbouring poses; ``moves.first`` and ``last`` are poses.
    move_sigma : shape (n,)
        Standard uncertainty per axis of the rotation of each move, from white noise [rad].
    gravity : float
        Local gravity [m/s^2].
    earth_mean, earth_sigma : shape (3,)
        Rotation of the Earth in navigation axes, as far as the latitude tells it [rad/s].
    has_gyro : bool
        Whether the gyroscope takes part.
    """

    angles: FloatArray
    mounting: IntArray
    mountings: FloatArray
    t: FloatArray
    accel: FloatArray
    force: FloatArray
    accel_sigma: FloatArray
    gyro: FloatArray
    gyro_sigma: FloatArray
    moves: Moves
    move_sigma: FloatArray
    gravity: float
    earth_mean: FloatArray
    earth_sigma: FloatArray
    has_gyro: bool = True

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.t)

    def only(self, keep: BoolArray) -> JointData:
        """Return the poses that ``keep`` (m,) marks and the moves between two of them."""
        place = np.cumsum(keep) - 1
        moved = keep[self.moves.first] & keep[self.moves.last]
        moves = self.moves.only(moved)
        moves = replace(moves, first=place[moves.first], last=place[moves.last])
        poses = ("angles", "mounting", "t", "accel", "force", "accel_sigma", "gyro", "gyro_sigma")
        return replace(
            self,
            moves=moves,
            move_sigma=self.move_sigma[moved],
            **{name: getattr(self, name)[keep] for name in poses},
        )


def earth_prior(latitude_deg: float | None) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation (3,) of the Earth's rotation in navigation axes [rad/s].

    The heading of the jig is never known; without a latitude the axis may point anywhere.
    """
    if latitude_deg is None:
        return np.zeros(3), np.full(3, EARTH_RATE / np.sqrt(3.0))
    latitude = latitude_deg * DEG
    level = EARTH_RATE * abs(np.cos(latitude)) / np.sqrt(2.0)
    # A jig's base is level within some degrees, which is what the vertical part is uncertain by.
    mean = np.array([0.0, 0.0, EARTH_RATE * np.sin(latitude)])
    return mean, np.array([level, level, 0.05 * EARTH_RATE])


def white_rate(gyro_sigma: FloatArray, duration: FloatArray) -> float:
    """Density of a gyroscope's white noise [rad/s/sqrt(Hz)] from stills (m, 3) and lengths (m,).

    The quietest stills show the sensor's own noise, the others a table that trembles.
    """
    variance = np.mean(gyro_sigma**2 * duration[:, None], axis=1)
    return float(np.sqrt(np.quantile(variance, 0.25)))


def joint_data(
    session: Session, commanded: CommandedPoses, moves: Moves, accel: Affine
) -> JointData:
    """Summarize a session.

    Parameters
    ----------
    session : Session
        Recording, stills and gravity.
    commanded : CommandedPoses
        One row per still.
    moves : Moves
        Moves between neighbouring stills; those across a change of mounting are left out.
    accel : Affine
        Accelerometer from gravity's magnitude alone.
    """
    stills = session.stills
    mounting = commanded.mountings
    moves = moves.only(mounting[moves.first] == mounting[moves.last])
    duration = stills.t1 - stills.t0
    up = stills.accel_mean / np.linalg.norm(stills.accel_mean, axis=1, keepdims=True)
    mean, sigma = earth_prior(session.gravity.latitude_deg)
    return JointData(
        angles=commanded.angles_deg * DEG,
        mounting=mounting,
        mountings=commanded.mounting_matrices(),
        t=0.5 * (stills.t0 + stills.t1),
        accel=stills.accel_mean,
        force=accel.apply(stills.accel_mean),
        accel_sigma=np.sqrt(np.einsum("mi,mij,mj->m", up, stills.accel_cov, up)),
        gyro=stills.gyro_mean,
        gyro_sigma=stills.gyro_sem,
        moves=moves,
        move_sigma=white_rate(stills.gyro_sem, duration) * np.sqrt(moves.duration),
        gravity=session.gravity.value,
        earth_mean=mean,
        earth_sigma=sigma,
        has_gyro=session.has_gyro,
    )
