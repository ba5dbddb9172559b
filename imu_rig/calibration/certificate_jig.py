"""Parts of a certificate that a jig session adds: the jig's errors, the sensor's nonlinearity."""

from __future__ import annotations

import numpy as np
from pydantic import Field, model_validator

from imu_rig.arrays import FloatArray
from imu_rig.calibration.certificate_parts import Part, Sigma, Sigmas, Vector
from imu_rig.calibration.jig_estimate import JigEstimate, Straightness

MOST_MOUNTINGS = 20
Pair = tuple[float, float]
SigmaPair = tuple[Sigma, Sigma]


class NonlinearityEntry(Part):
    """Share of 1 g by which each axis errs at 1 g, with standard uncertainties.

    ``deviation`` is the root mean square over all attitudes by which readings leave the line
    [m/s^2].
    """

    quadratic: Vector
    quadratic_standard_uncertainty: Sigmas
    cubic: Vector
    cubic_standard_uncertainty: Sigmas
    deviation: float = Field(ge=0)

    @staticmethod
    def of(straightness: Straightness | None) -> NonlinearityEntry | None:
        """Take over what was estimated, if anything was."""
        if straightness is None:
            return None
        return NonlinearityEntry(
            quadratic=_vector(straightness.quadratic.value),
            quadratic_standard_uncertainty=_vector(straightness.quadratic.sigma),
            cubic=_vector(straightness.cubic.value),
            cubic_standard_uncertainty=_vector(straightness.cubic.sigma),
            deviation=straightness.deviation,
        )


class JigEntry(Part):
    """Errors of the jig on which the session ran; angles in rad, pan, tilt and roll in turn.

    ``roll_axis`` is the direction of the roll axis in sensor axes, one per mounting; ``level`` the
    rotation about the sensor's y and x axes by which it is off level with all servos commanded to
    zero, as in `JigEstimate`: a positive first one points the sensor's x axis down.
    """

    servo_gain: Vector
    servo_gain_standard_uncertainty: Sigmas
    tilt_zero: float
    tilt_zero_standard_uncertainty: Sigma
    tilt_skew: float
    tilt_skew_standard_uncertainty: Sigma
    roll_skew: float
    roll_skew_standard_uncertainty: Sigma
    base: Pair
    base_standard_uncertainty: SigmaPair
    mounting: tuple[Vector, ...]
    mounting_standard_uncertainty: tuple[Sigmas, ...]
    roll_axis: tuple[Vector, ...]
    roll_axis_standard_uncertainty: tuple[Sigmas, ...]
    level: Pair
    level_standard_uncertainty: SigmaPair
    repeatability: Sigmas
    wobble: float = Field(ge=0)

    @model_validator(mode="after")
    def _as_many_everywhere(self) -> JigEntry:
        counts = {
            len(self.mounting),
            len(self.mounting_standard_uncertainty),
            len(self.roll_axis),
            len(self.roll_axis_standard_uncertainty),
        }
        if len(counts) != 1 or not 1 <= counts.pop() <= MOST_MOUNTINGS:
            raise ValueError("states some mountings without their figures")
        return self

    @staticmethod
    def of(jig: JigEstimate | None) -> JigEntry | None:
        """Take over what was estimated, if anything was."""
        if jig is None:
            return None
        return JigEntry(
            servo_gain=_vector(jig.servo_gain.value),
            servo_gain_standard_uncertainty=_vector(jig.servo_gain.sigma),
            tilt_zero=float(jig.tilt_zero.value[0]),
            tilt_zero_standard_uncertainty=float(jig.tilt_zero.sigma[0]),
            tilt_skew=float(jig.tilt_skew.value[0]),
            tilt_skew_standard_uncertainty=float(jig.tilt_skew.sigma[0]),
            roll_skew=float(jig.roll_skew.value[0]),
            roll_skew_standard_uncertainty=float(jig.roll_skew.sigma[0]),
            base=_pair(jig.base.value),
            base_standard_uncertainty=_pair(jig.base.sigma),
            mounting=_vectors(jig.mounting.value),
            mounting_standard_uncertainty=_vectors(jig.mounting.sigma),
            roll_axis=_vectors(jig.roll_axis.value),
            roll_axis_standard_uncertainty=_vectors(jig.roll_axis.sigma),
            level=_pair(jig.level.value),
            level_standard_uncertainty=_pair(jig.level.sigma),
            repeatability=_vector(jig.repeatability),
            wobble=jig.wobble,
        )


def _vector(values: FloatArray) -> Vector:
    x, y, z = np.asarray(values, dtype=float).tolist()
    return x, y, z


def _vectors(rows: FloatArray) -> tuple[Vector, ...]:
    return tuple(_vector(row) for row in rows)


def _pair(values: FloatArray) -> Pair:
    x, y = np.asarray(values, dtype=float).tolist()
    return x, y
