"""What a session is expected to tell, before it runs.

Readings of a perfect sensor on a perfect jig, with the noise of the sensor's class, go through the
linearized joint model; its covariance is that of the session.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imu_rig import rotation
from imu_rig.arrays import FloatArray, IntArray
from imu_rig.calibration.accuracy import sphere_error, turn_error
from imu_rig.calibration.joint_data import JointData, earth_prior
from imu_rig.calibration.joint_fit import default_prior, predict
from imu_rig.calibration.joint_model import NONLINEARITY
from imu_rig.calibration.joint_result import gyro_model, jig_estimate, line_over_one_g
from imu_rig.calibration.model import AXES, Affine, PhysicalFigures, physical_figures
from imu_rig.calibration.moves import Moves
from imu_rig.calibration.session import CommandedTurn
from imu_rig.units import DEG, MILLI_G, STANDARD_GRAVITY

ACCEL_DENSITY = 0.4 * MILLI_G
"""White noise of an MPU-9150's accelerometer by its data sheet, one-sided [m/s^2/sqrt(Hz)]: the
mean over a time T has the variance ``density^2 / (2 T)``."""
GYRO_DENSITY = 0.005 * DEG
"""White noise of its gyroscope [rad/s/sqrt(Hz)]."""
ACCEL_FLICKER = 0.05 * MILLI_G
"""Wander of an accelerometer's bias that no averaging in one pose removes [m/s^2]."""
END_S = 0.05
"""Part of a hold's end that is not used."""
LEG_STEP = 8.0 * DEG
"""Longest turn taken as one small rotation."""
FREE = 1.0
"""Standard deviation of an attitude that nothing is known about [rad]."""


@dataclass(frozen=True, eq=False)
class Leg:
    """Part of a move: pan, tilt and roll (3,) [rad] run evenly from ``start`` to ``end``.

    Equal angles are a pause. ``duration`` in seconds. An overshoot counts with its time only.
    """

    start: FloatArray
    end: FloatArray
    duration: float


@dataclass(frozen=True, eq=False)
class Design:
    """A session of ``m`` poses on one jig, before it runs.

    Attributes
    ----------
    angles : shape (m, 3)
        Commanded pan, tilt and roll [rad].
    mounting : shape (m,)
        Index into ``mounting_turns``.
    mounting_turns : shape (k, 3)
        Nominal rotation vectors of the sensor on the plate, body to plate [rad].
    begin, end : shape (m,)
        Of the hold at each pose [s].
    legs : sequence of m sequences of Leg
        The way to each pose from the one before; empty where the sensor was turned over or
        something else came between.
    settle : float
        Begin of every hold that is not used [s].
    """

    angles: FloatArray
    mounting: IntArray
    mounting_turns: FloatArray
    begin: FloatArray
    end: FloatArray
    legs: Sequence[Sequence[Leg]]
    settle: float

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.begin)

    def directions(self) -> FloatArray:
        """Return unit vectors "up" in sensor axes, shape (m, 3)."""
        return self.directions_at(self.angles, self.mounting)

    def directions_at(self, angles: FloatArray, mounting: IntArray) -> FloatArray:
        """Return the same at other angles (s, 3) [rad], in mountings (s,)."""
        q = self._attitudes(angles, mounting)
        return rotation.rotate(rotation.conjugate(q), np.array([0.0, 0.0, 1.0]))

    def turns(self) -> tuple[FloatArray, FloatArray]:
        """Return rotation vectors (n, 3) [rad] and durations (n,) of turns about one axis."""
        vectors, durations = [], []
        for mounting, legs in zip(self.mounting, self.legs, strict=True):
            x, y, z = self.mounting_turns[mounting]
            for leg in legs:
                begin, end = (tuple((angles / DEG).tolist()) for angles in (leg.start, leg.end))
                turn = CommandedTurn(0.0, leg.duration, begin, end, (x, y, z)).rotation_vector()
                if turn is not None:
                    vectors.append(turn)
                    durations.append(leg.duration)
        return np.array(vectors).reshape(-1, 3), np.array(durations)

    def data(self) -> JointData:
        """Ideal readings with the noise of the class."""
        still = np.maximum(self.end - self.begin - self.settle - END_S, 0.05)
        force = STANDARD_GRAVITY * self.directions()
        moves = self._moves(force)
        earth_mean, earth_sigma = earth_prior(None)
        return JointData(
            angles=self.angles,
            mounting=self.mounting,
            mountings=rotation.to_matrix(self._mounted()),
            t=self.begin + self.settle + 0.5 * still,
            accel=force,
            force=force,
            accel_sigma=np.hypot(ACCEL_DENSITY / np.sqrt(2.0 * still), ACCEL_FLICKER),
            gyro=np.zeros((len(self), 3)),
            gyro_sigma=np.repeat((GYRO_DENSITY / np.sqrt(2.0 * still))[:, None], 3, axis=1),
            moves=moves,
            move_sigma=GYRO_DENSITY * np.sqrt(moves.duration / 2.0),
            gravity=STANDARD_GRAVITY,
            earth_mean=earth_mean,
            earth_sigma=earth_sigma,
        )

    def _mounted(self) -> FloatArray:
        return rotation.from_rotation_vector(self.mounting_turns)

    def _attitudes(self, angles: FloatArray, mounting: IntArray) -> FloatArray:
        """Quaternions (s, 4) of an ideal jig at angles (s, 3)."""
        turns = [
            rotation.from_rotation_vector(angles[:, i : i + 1] * np.eye(3)[axis])
            for i, axis in enumerate((2, 1, 0))
        ]
        arm = rotation.multiply(rotation.multiply(turns[0], turns[1]), turns[2])
        return rotation.multiply(arm, self._mounted()[mounting])

    def _moves(self, force: FloatArray) -> Moves:
        last = np.array([i for i, legs in enumerate(self.legs) if legs], dtype=np.int64)
        starts, ends, dt, length = [], [], [], []
        for pose in last:
            here = self.angles[pose]
            count = 0
            for leg in (*self.legs[pose], Leg(here, here, self.settle + END_S)):
                turn = np.abs(leg.end - leg.start).max()
                n = max(1, int(np.ceil(turn / LEG_STEP)))
                path = np.linspace(leg.start, leg.end, n + 1)
                starts.append(path[:-1])
                ends.append(path[1:])
                dt.append(np.full(n, leg.duration / n))
                count += n
            length.append(count)
        counts = np.array(length, dtype=np.int64)
        of = np.repeat(np.arange(len(last)), counts)
        mounted = self.mounting[last[of]]
        steps = np.concatenate(dt) if dt else np.empty(0)
        duration = np.bincount(of, steps, minlength=len(last)).astype(float)
        start, end = (np.concatenate(p) if p else np.empty((0, 3)) for p in (starts, ends))
        turned = rotation.multiply(
            rotation.conjugate(self._attitudes(start, mounted)), self._attitudes(end, mounted)
        )
        done = np.cumsum(steps)
        before = np.cumsum(duration) - duration
        return Moves(
            first=last - 1,
            last=last,
            rate=rotation.to_rotation_vector(turned) / steps[:, None],
            dt=steps,
            share=(done - 0.5 * steps - before[of]) / duration[of],
            length=counts,
            duration=duration,
            gravity_before=force[last - 1],
            gravity_after=force[last],
            gravity_sem=np.zeros(len(last)),
        )


@dataclass(frozen=True)
class FigureGroup:
    """Expected standard uncertainties of one kind of figure: root mean square and worst.

    ``unit`` is that of both numbers, ``worst_name`` the axis or lean that the worst one is of.
    """

    name: str
    unit: str
    rms: float
    worst: float
    worst_name: str


@dataclass(frozen=True, eq=False)
class ExpectedUncertainty:
    """Standard uncertainties that a session is expected to reach.

    Attributes
    ----------
    accel : PhysicalFigures
        Of the accelerometer.
    gyro : PhysicalFigures or None
        Of the gyroscope.
    level : float or None
        Lean of the sensor with all servos at zero, of one visit [rad]; None where the jig's angles
        take no part.
    reading : float
        Error of a calibrated accelerometer's reading at rest, rms over the sphere [m/s^2].
    turn : float or None
        Error of a turn of 90 deg, rms over all axes [rad].
    """

    accel: PhysicalFigures
    gyro: PhysicalFigures | None
    level: float | None
    reading: float
    turn: float | None

    def groups(self) -> tuple[FigureGroup, ...]:
        """Return the figures in the units people read, without those that a method keeps fixed."""
        a, g = self.accel, self.gyro
        found = [
            _group("accelerometer scale", "%", a.scale_percent_u, AXES),
            _group("accelerometer non-orthogonality", "mrad", 1e3 * a.cross_rad_u, a.cross_names),
            _group("accelerometer bias", "mg", a.bias_u / MILLI_G, AXES),
        ]
        if g is not None:
            found += [
                _group("gyroscope scale", "%", g.scale_percent_u, AXES),
                _group("gyroscope cross-axis", "mrad", 1e3 * g.cross_rad_u, g.cross_names),
                _group("gyroscope bias", "deg/s", g.bias_u / DEG, AXES),
            ]
        return tuple(group for group in found if group.worst > 0.0)


def expected_uncertainty(design: Design, *, angles_known: bool = True) -> ExpectedUncertainty:
    """Predict a session.

    Parameters
    ----------
    design : Design
        What will be done.
    angles_known : bool
        Whether the solver takes the jig's angles as hints; False predicts one that takes gravity
        and the gyroscope alone, and a sensor without nonlinearity.
    """
    data = design.data()
    prior = default_prior(data)
    if not angles_known:
        sigma = prior.sigma.copy()
        sigma[NONLINEARITY] = 0.0
        # A free rotation of every pose takes the angles out of the model.
        prior = replace(prior, sigma=sigma, wobble=np.full(len(data), FREE))
    fit = predict(data, prior)
    gyro = gyro_model(fit)
    accel = line_over_one_g(fit if angles_known else predict(replace(data, has_gyro=False), prior))
    return ExpectedUncertainty(
        accel=physical_figures(accel),
        gyro=physical_figures(gyro, accel),
        level=_rms(jig_estimate(fit).level.sigma) if angles_known else None,
        reading=sphere_error(accel).rms,
        turn=turn_error(gyro).rms,
    )


def expected_sensors(design: Design) -> tuple[Affine, Affine]:
    """Accelerometer and gyroscope of a nominal sensor with the covariance of the session."""
    fit = predict(design.data())
    return line_over_one_g(fit), gyro_model(fit)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _group(name: str, unit: str, sigma: FloatArray, names: Sequence[str]) -> FigureGroup:
    worst = int(np.argmax(sigma))
    return FigureGroup(name, unit, _rms(sigma), float(sigma[worst]), names[worst])
