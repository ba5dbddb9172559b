"""What PX4 and ArduPilot have in common: reduced models, what they lose, and a parameter list.

Both store an offset per axis, a scale per axis for the accelerometer only, and a symmetric
matrix for the magnetometer. What a full calibration loses by that is worked out first, so that
nothing is lost silently.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from imu_rig.arrays import FloatArray
from imu_rig.calibration.accuracy import TURN_ANGLE, TURN_DURATION_S
from imu_rig.calibration.exports import reduced
from imu_rig.calibration.exports.loss import Loss
from imu_rig.calibration.exports.options import ExportOptions
from imu_rig.calibration.exports.reduced import Reduced
from imu_rig.calibration.exports.source import LINE_WIDTH, Source
from imu_rig.errors import InputError
from imu_rig.foreign_text import one_line, wrapped
from imu_rig.units import DEG

FRAME_TURNED = 0.05 * DEG
"""A frame that differs by more from the sensor's own is worth a word."""


@dataclass(frozen=True, eq=False)
class Stored:
    """A calibration in the form that an autopilot stores, and what was lost on the way.

    Attributes
    ----------
    models : mapping
        By sensor, the model as the autopilot applies it, in its axes and SI (field in uT).
    loss : Loss
        By the parameters' form.
    uncalibrated : Loss
        The same of readings that nobody calibrated, for comparison.
    frame_angle : float
        Angle [rad] by which the certificate's frame is turned from the sensor's own.
    """

    models: Mapping[str, Reduced]
    loss: Loss
    uncalibrated: Loss
    frame_angle: float


def stored(source: Source, options: ExportOptions, target: str) -> Stored:
    """Reduce a calibration to what an autopilot stores.

    Raises
    ------
    InputError
        Something would be lost and ``options`` do not allow it.
    """
    own, angle = source.in_sensor_frame()
    own = own.with_axes(options.axes)
    forms = {"accel": reduced.diagonal, "gyro": reduced.offset_only, "mag": reduced.symmetric}
    models = {name: forms[name](model) for name, model in own.sensors.items()}
    loss = _loss(own, models)
    if loss.lost and not options.nearest:
        raise InputError(
            f"{target} cannot hold {', '.join(loss.lost)}, and without them it would falsify "
            f"{loss.words}: add --nearest to export the best that {target} can hold, or export to "
            "c, numpy, matlab or csv, which hold all of it."
        )
    nothing = {name: reduced.untouched() for name in models}
    return Stored(models, loss, _loss(own, nothing), angle)


def _loss(source: Source, models: Mapping[str, Reduced]) -> Loss:
    def worst(sensor: str, size: float) -> float | None:
        exact = source.sensors.get(sensor)
        return None if exact is None else models[sensor].worst_error(exact, size)

    turn, field = worst("gyro", TURN_ANGLE / TURN_DURATION_S), worst("mag", source.field)
    return Loss(
        accel=worst("accel", source.gravity),
        turn=None if turn is None else turn * TURN_DURATION_S,
        field=None if field is None else field / source.field,
    )


def comments(
    source: Source, kept: Stored, options: ExportOptions, notes: Sequence[str]
) -> list[str]:
    """Comment lines that tell whose calibration a file holds, what it lacks, and ``notes``."""
    lines = []
    if kept.loss.lost:
        lines.append(f"Only the nearest approximation: it falsifies {kept.loss.words}.")
        lines.append(f"Without any calibration: {kept.uncalibrated.words}.")
        lines.append(f"Lost: {', '.join(kept.loss.lost)}.")
    if kept.frame_angle > FRAME_TURNED:
        lines.append(
            f"The turn of {kept.frame_angle / DEG:.2f} deg from the sensor's to the jig's frame is "
            "left out: level the vehicle as usual."
        )
    axes = one_line(options.axes_text)
    lines.append(f"The autopilot's axes x,y,z are {axes} of the calibrated recording.")
    told = [part for line in (*lines, *notes) for part in wrapped(line, LINE_WIDTH)]
    return [f"# {line}" for line in (*source.about, *told)]


def within(name: str, value: float, low: float, high: float, target: str) -> float:
    """Return a value that the autopilot accepts.

    Raises
    ------
    InputError
        Naming the parameter and its limits.
    """
    if not low <= value <= high:
        raise InputError(
            f"{target} accepts {name} from {low:g} to {high:g}, and this calibration needs "
            f"{value:.4g}: check the range and unit that the recording was scaled with."
        )
    return value


def off_diagonal(M: FloatArray) -> tuple[float, float, float]:
    """X, Y and Z of a symmetric matrix's other half: (0, 1), (0, 2) and (1, 2)."""
    return float(M[0, 1]), float(M[0, 2]), float(M[1, 2])


def number(value: float) -> str:
    """Write a float parameter: nine decimals, which a 32-bit float near 1 needs seven of."""
    return f"{value + 0.0:.9f}"
