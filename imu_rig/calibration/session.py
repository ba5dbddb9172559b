"""What a solver is given and what it returns, the same for every method."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from imu_rig import rotation
from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.findings import Finding
from imu_rig.calibration.gravity import Gravity
from imu_rig.calibration.jig_estimate import JigEstimate, Straightness
from imu_rig.calibration.known import Known
from imu_rig.calibration.model import Affine
from imu_rig.calibration.stills import Stills
from imu_rig.errors import InputError
from imu_rig.units import DEG


@dataclass(frozen=True)
class CommandedTurn:
    """One driven part of a move, on the time of the block.

    Attributes
    ----------
    t0, t1 : float
        Begin and end [s]; the sensor rests at both.
    start_deg, stop_deg : tuple of float
        Commanded pan, tilt and roll before and after [deg].
    mounting_turn : tuple of float
        Nominal rotation vector of the sensor on the plate [rad].
    """

    t0: float
    t1: float
    start_deg: tuple[float, float, float]
    stop_deg: tuple[float, float, float]
    mounting_turn: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def rotation_vector(self) -> FloatArray | None:
        """Rotation vector (3,) in sensor axes [rad] of an ideal jig.

        None where not exactly one servo moved: that is no turn about one fixed axis.
        """
        change = (np.array(self.stop_deg) - np.array(self.start_deg)) * DEG
        moved = np.flatnonzero(np.abs(change) > 1e-9)
        if len(moved) != 1:
            return None
        _, tilt, roll = np.array(self.start_deg) * DEG
        tilted = rotation.about_y(tilt) @ rotation.about_x(roll)
        axes = (tilted[2], rotation.about_x(roll)[1], np.array([1.0, 0.0, 0.0]))
        axis = int(moved[0])
        mounted = rotation.to_matrix(rotation.from_rotation_vector(np.array(self.mounting_turn)))
        return np.asarray(mounted.T @ axes[axis] * change[axis])


@dataclass(frozen=True, eq=False)
class CommandedPoses:
    """Angles that a jig was told to take, one row per still window.

    Attributes
    ----------
    angles_deg : shape (m, 3)
        Pan, tilt and roll [deg]; turns beyond 180 deg count as they are.
    names : tuple of str
        A name per pose; ``"pose 1"`` and so on where empty.
    turns : tuple of CommandedTurn
        The parts that the moves were driven in; where empty, a move from one pose to the next
        counts as one turn.
    mounting : tuple of int
        Which mounting of the sensor on the plate, from 0; all 0 where empty.
    mounting_turns : tuple of rotation vectors
        Nominal rotation of the sensor on the plate in each mounting [rad]; none where empty.
    check : tuple of bool
        Poses kept out of the fit, to verify it; none where empty.
    """

    angles_deg: FloatArray
    names: tuple[str, ...] = ()
    turns: tuple[CommandedTurn, ...] = ()
    mounting: tuple[int, ...] = ()
    mounting_turns: tuple[tuple[float, float, float], ...] = ()
    check: tuple[bool, ...] = ()

    def __post_init__(self) -> None:
        angles = np.asarray(self.angles_deg, dtype=float)
        if angles.ndim != 2 or angles.shape[1] != 3 or not np.all(np.isfinite(angles)):
            raise InputError("commanded angles must be three numbers (pan, tilt, roll) per pose")
        if self.names and len(self.names) != len(angles):
            raise InputError(f"{len(self.names)} pose names stand for {len(angles)} poses")
        for per_pose in (self.mounting, self.check):
            if per_pose and len(per_pose) != len(angles):
                raise InputError("mounting and check need one entry per commanded pose")
        if self.mounting and not 0 <= min(self.mounting) <= max(self.mounting) < max(
            1, len(self.mounting_turns)
        ):
            raise InputError("mountings count from 0, and each needs its nominal rotation")
        if self.mounting_turns and not np.all(np.isfinite(self.mounting_turns)):
            raise InputError("the nominal rotations of the mountings must be finite numbers")
        object.__setattr__(self, "angles_deg", angles)

    def only(self, keep: BoolArray) -> CommandedPoses:
        """Return the poses that ``keep`` (m,) marks, with all turns."""

        def kept(values: tuple[Any, ...]) -> tuple[Any, ...]:
            return tuple(v for v, k in zip(values, keep, strict=True) if k) if values else ()

        return replace(
            self,
            angles_deg=self.angles_deg[keep],
            names=kept(self.names),
            mounting=kept(self.mounting),
            check=kept(self.check),
        )

    @property
    def mountings(self) -> IntArray:
        """Mounting of every pose, shape (m,)."""
        if not self.mounting:
            return np.zeros(len(self.angles_deg), dtype=np.int64)
        return np.array(self.mounting, dtype=np.int64)

    def mounting_matrices(self) -> FloatArray:
        """Nominal rotation of the sensor on the plate in each mounting, shape (k, 3, 3)."""
        vectors = np.array(self.mounting_turns or ((0.0, 0.0, 0.0),))
        return rotation.to_matrix(rotation.from_rotation_vector(vectors))

    def attitudes(self) -> FloatArray:
        """Attitudes body to navigation (m, 3, 3) of an ideal jig."""
        pan, tilt, roll = self.angles_deg.T * DEG
        A = rotation.about_z(pan) @ rotation.about_y(tilt) @ rotation.about_x(roll)
        return np.asarray(A @ self.mounting_matrices()[self.mountings])

    def gravity(self, magnitude: float) -> FloatArray:
        """Gravity reaction in sensor axes (m, 3) of an ideal jig [m/s^2]."""
        return np.asarray(self.attitudes()[:, 2, :] * magnitude)

    def driven(self, t0: FloatArray, t1: FloatArray, order: IntArray) -> tuple[CommandedTurn, ...]:
        """Return the driven turns, or else one from each pose to the next.

        Parameters
        ----------
        t0, t1 : shape (m,)
            Begin and end of the still of every pose [s].
        order : shape (m,)
            Place of each pose among all that were held: neighbours differ by one.
        """
        if self.turns:
            return self.turns
        angles = [tuple(row) for row in self.angles_deg.tolist()]
        mounted, turns = self.mountings, self.mounting_turns or ((0.0, 0.0, 0.0),)
        return tuple(
            CommandedTurn(
                float(t1[i]), float(t0[i + 1]), angles[i], angles[i + 1], turns[mounted[i]]
            )
            for i in range(len(angles) - 1)
            if order[i + 1] == order[i] + 1 and mounted[i] == mounted[i + 1]
        )


@dataclass(frozen=True, eq=False)
class Session:
    """A recording made ready for a solver.

    Attributes
    ----------
    block : ImuBlock
        The recording.
    stills : Stills
        Its ``m`` usable still poses, in time order.
    names : tuple of str
        A name per still.
    order : shape (m,)
        Place of each still among all poses, usable or not: neighbours differ by one.
    gravity : Gravity
        Local gravity.
    commanded : CommandedPoses or None
        Commanded angles of these stills.
    gyro_bad : shape (n, 3)
        Readings at the gyroscope's range limit, of a sensor that hung, or of moves that are kept
        out of the fit: those to and from check poses, and the sensor's being turned over.
    has_gyro : bool
        Whether the gyroscope shows anything at all.
    findings : tuple of Finding
        What was noticed while it was made ready; poses count all windows that were given.
    known : Known
        Facts that some methods need: named parts, known rates.
    """

    block: ImuBlock
    stills: Stills
    names: tuple[str, ...]
    order: IntArray
    gravity: Gravity
    commanded: CommandedPoses | None
    gyro_bad: BoolArray
    has_gyro: bool
    known: Known = field(default_factory=Known)
    findings: tuple[Finding, ...] = ()


@dataclass(frozen=True, eq=False)
class AccelOutcome:
    """A solved accelerometer over ``m`` poses; NaN where something is not known.

    Attributes
    ----------
    affine : Affine
        The model.
    sigma : shape (m,)
        Standard uncertainty of each mean along gravity [m/s^2].
    left_out, left_out_sigma : shape (m,)
        Magnitude error of a pose that the fit never saw, and its predicted sigma [m/s^2].
    vector_error : shape (m, 3) or None
        Error against the commanded gravity vector [m/s^2].
    """

    affine: Affine
    sigma: FloatArray
    left_out: FloatArray
    left_out_sigma: FloatArray
    vector_error: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class GyroOutcome:
    """A solved gyroscope over ``n`` moves; NaN where something is not known.

    Attributes
    ----------
    affine : Affine
        The model.
    first, last : shape (n,)
        Stills at the ends of each move.
    angle, before, after, held_out : shape (n,)
        Net angle turned, and errors of the gravity direction [rad].
    sigma : shape (n,)
        Standard uncertainty per axis of the direction [rad].
    vector_error : shape (n, 3) or None
        Error against the commanded rotation vector [rad].
    """

    affine: Affine
    first: IntArray
    last: IntArray
    angle: FloatArray
    before: FloatArray
    after: FloatArray
    held_out: FloatArray
    sigma: FloatArray
    vector_error: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a method found: one or two sensors, the frame of K, and sentences for the user.

    Methods that know more say so: the accelerometer's gain at zero input where ``accel`` is the
    best line over +-1 g, its nonlinearity, the jig's own errors, faults as values, and the
    attitudes (m, 3, 3) of all stills, body to navigation, NaN where a still was set aside.
    """

    frame: str
    accel: AccelOutcome
    gyro: GyroOutcome | None
    warnings: tuple[str, ...] = ()
    accel_at_zero: Affine | None = None
    straightness: Straightness | None = None
    jig: JigEstimate | None = None
    findings: tuple[Finding, ...] = ()
    attitudes: FloatArray | None = None
