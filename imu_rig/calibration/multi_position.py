"""Calibration without known angles: gravity's magnitude in still poses, its direction over moves.

Works on a recording made by hand (Tedaldi and others 2014) as on a jig's.
"""

from __future__ import annotations

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.calibration.advice import poses_to_add
from imu_rig.calibration.direction import (
    DirectionFit,
    angles_turned,
    errors_before,
    fit_directions,
)
from imu_rig.calibration.earth import earth_covariance
from imu_rig.calibration.faces import faces_of
from imu_rig.calibration.gyro_bias import BiasTrack, track_bias
from imu_rig.calibration.magnitude import UNKNOWNS, MagnitudeFit, fit_magnitude
from imu_rig.calibration.model import AXES, Affine, PhysicalFigures, physical_figures
from imu_rig.calibration.moves import Moves, moves_between
from imu_rig.calibration.session import AccelOutcome, GyroOutcome, Outcome, Session
from imu_rig.calibration.suspicion import describe_axes, match_gyro
from imu_rig.errors import DataError
from imu_rig.units import DEG, MILLI_G

COMFORTABLE_POSES = 16
"""Fewer poses leave the fit fragile: one of them decides too much."""
LARGE_ACCEL = (0.1, 1e-3, 1.0 * MILLI_G)
"""Standard uncertainties worth a warning: scale [%], angle between axes [rad], bias [m/s^2]."""
LARGE_GYRO = (0.5, 5e-3, 0.02 * DEG)
"""The same of a gyroscope, bias in rad/s."""
NO_ACCEL = (10.0, 0.1, 1.0)
"""Standard uncertainties beyond which a data sheet says more: the parameter is not determined."""
NO_GAIN, NO_LEAN = 0.05, 0.1
"""The same of a gyroscope's gains, on and off the diagonal."""
ON_FACE = 10.0 * DEG
"""A still this near to an axis was meant to stand on that face."""
HOPELESS = 5.0 * DEG
"""Median gravity-direction error after calibration that makes the gyroscope's gain worthless."""
LARGE_EXCESS = 0.3 * DEG
LARGE_NOISE_SCALE = 2.5
LARGE_WALK = 0.2 * DEG
ABSURD_SCALE = 60.0
"""What no wrong sensor but only wrong data can be off by [%]."""
STRANGE_SCALE = 15.0
"""No sensor of this kind is further off its nominal scale [%]: a unit or a rate is wrong."""


def multi_position(session: Session) -> Outcome:
    """Solve a session with `fit_magnitude` and `fit_directions`.

    Raises
    ------
    DataError
        Too few poses or too poor a spread for the accelerometer, or a gyroscope whose unit, rate
        or axes contradict gravity. A gyroscope that was not turned enough is left out instead,
        and a warning says which turns to add.
    """
    fit, warnings = solve_accelerometer(session)
    gyro: GyroOutcome | None = None
    if session.has_gyro:
        gyro, more = _solve_gyro(session, fit)
        warnings += more
    else:
        warnings.append("No gyroscope shows anything, so only the accelerometer was calibrated.")
    accel = AccelOutcome(fit.affine, fit.sigma, fit.left_out, fit.left_out_sigma)
    return Outcome("sensor", accel, gyro, tuple(warnings))


def static(session: Session) -> Outcome:
    """Solve the accelerometer alone, from still poses; a gyroscope only tells what is still.

    Raises
    ------
    DataError
        Too few poses or too poor a spread.
    """
    fit, warnings = solve_accelerometer(session)
    accel = AccelOutcome(fit.affine, fit.sigma, fit.left_out, fit.left_out_sigma)
    return Outcome("sensor", accel, None, tuple(warnings))


def solve_accelerometer(session: Session) -> tuple[MagnitudeFit, list[str]]:
    """Fit the accelerometer to the magnitude of gravity, with sentences for the user.

    Raises
    ------
    DataError
        Too few poses or too poor a spread, with what to add, or the method that needs less.
    """
    stills = session.stills
    directions = _unit(stills.accel_mean)
    if len(stills) < UNKNOWNS:
        raise DataError(
            f"{len(stills)} still poses cannot determine the nine parameters of an accelerometer "
            f"(scale, non-orthogonality and bias of three axes); record {COMFORTABLE_POSES} or "
            f"more; {poses_needed(directions)}{_or_faces(stills.accel_mean)}"
        )
    fit = fit_magnitude(stills.accel_mean, stills.accel_cov, session.gravity.value)
    figures = physical_figures(fit.affine)
    free = beyond(figures, NO_ACCEL)
    if free:
        raise DataError(
            f"the {len(stills)} still poses do not determine {listed(free)} of the accelerometer; "
            f"{poses_needed(directions)}{_or_faces(stills.accel_mean)}"
        )
    return fit, _accel_warnings(session, fit, figures, directions)


def _or_faces(means: FloatArray) -> str:
    """Name the method for six faces where all are there; trusting them is the user's choice."""
    axis, sign, near = faces_of(means, ON_FACE)
    if len({(a, s) for a, s, on in zip(axis, sign, near, strict=True) if on}) < 6:
        return ""
    return (
        ". All six faces are there: if the sensor sits in a square block that stood on a level "
        "table and was turned once about each axis, --method ferraris uses that, with less certain "
        "non-orthogonality and gain"
    )


def _solve_gyro(session: Session, accel: MagnitudeFit) -> tuple[GyroOutcome | None, list[str]]:
    stills = session.stills
    track = track_bias((stills.t0 + stills.t1) / 2, stills.gyro_mean, stills.gyro_sem)
    moves = moves_between(session.block, stills, track.at_stills, session.gyro_bad)
    refuse_wrong_gyro(moves.with_gravity(accel.affine.apply), track.at_stills)
    turns = (
        "turn it by 90 to 180 degrees between still poses about each of its axes while that "
        "axis is level"
    )
    try:
        fit = fit_directions(moves, stills, accel.affine, track, np.eye(3))
    except DataError as error:
        return None, [f"The gyroscope was not calibrated: {error}; {turns}."]
    if float(np.median(fit.error)) > HOPELESS:
        raise DataError(
            f"gyroscope and gravity disagree by {np.median(fit.error) / DEG:.0f} degrees in a "
            "typical move whatever the gain: check the gyroscope's unit, its axes and the sample "
            "rate"
        )
    unseen = unseen_turns(fit.affine)
    if unseen:
        return None, [unseen]
    affine = fit.affine.with_bias_covariance(
        earth_covariance(moves, len(stills), fit.affine.K, track.at_stills)
    )
    figures = physical_figures(affine, accel.affine)
    outcome = GyroOutcome(
        affine=affine,
        first=moves.first,
        last=moves.last,
        angle=angles_turned(moves, fit.affine.K, track.at_stills),
        before=errors_before(moves, stills, track),
        after=fit.error,
        held_out=fit.held_out,
        sigma=fit.sigma,
    )
    return outcome, _gyro_warnings(session, moves, track, fit, figures)


def unseen_turns(gyro: Affine) -> str:
    """Say about which axes the moves never turned a gyroscope; empty if about all.

    Raises
    ------
    DataError
        A gain that mirrors: one of the axes has the wrong sign.
    """
    # Column j of K is what a turn about raw axis j does.
    unknown = gyro.K_uncertainty / np.where(np.eye(3) > 0, NO_GAIN, NO_LEAN)
    free = [axis for j, axis in enumerate(AXES) if unknown[:, j].max() > 1.0]
    if free:
        return (
            f"The gyroscope was not calibrated because the moves do not show how it responds to "
            f"turns about {listed(free)}: turn it by 90 to 180 degrees between still poses about "
            f"{listed(free)} while that axis is level."
        )
    wrong = [axis for j, axis in enumerate(AXES) if gyro.K[j, j] < 0]
    if wrong:
        raise DataError(
            f"the gyroscope turns the wrong way about {listed(wrong)}: correct the sign of that "
            "column"
        )
    return ""


def refuse_wrong_gyro(moves: Moves, bias: FloatArray) -> None:
    """Refuse a gyroscope whose unit, rate or axes contradict the gravity directions.

    Raises
    ------
    DataError
        Saying what the data look like instead.
    """
    match = match_gyro(moves, bias)
    if not match.conclusive:
        return
    off = f"gyroscope and gravity disagree by {match.error / DEG:.0f} degrees in a typical move"
    if match.factor in (1.0 / DEG, DEG):
        units = "deg/s, not rad/s" if match.factor == DEG else "rad/s, not deg/s"
        raise DataError(f"{off}, and agree if the rates are in {units}: state the right unit")
    if match.factor != 1.0:
        times = f"{match.factor:g}" if match.factor >= 1 else f"1/{1 / match.factor:g}"
        raise DataError(
            f"{off}, and agree if every turn was {times} times as large: the sample rate or the "
            "gyroscope's range setting is wrong by that factor, so correct it"
        )
    if not np.array_equal(match.axes, np.eye(3)):
        raise DataError(
            f"{off}, and agree if the gyroscope's x, y, z are the accelerometer's "
            f"{describe_axes(match.axes)}: correct the order and signs of its columns"
        )


def _accel_warnings(
    session: Session, fit: MagnitudeFit, figures: PhysicalFigures, directions: FloatArray
) -> list[str]:
    warnings = []
    count = int(fit.used.sum())
    large = beyond(figures, LARGE_ACCEL)
    if count < COMFORTABLE_POSES:
        warnings.append(
            f"{count} poses for nine accelerometer parameters leave the fit fragile "
            f"({count - UNKNOWNS} to spare, {COMFORTABLE_POSES - UNKNOWNS} advised): standard "
            f"uncertainties reach {largest(figures, 'accel')}; {poses_needed(directions)}."
        )
    elif large:
        warnings.append(
            f"The poses determine {listed(large)} of the accelerometer poorly: standard "
            f"uncertainties reach {largest(figures, 'accel')}; {poses_needed(directions)}."
        )
    for i in np.flatnonzero(~fit.used):
        times = abs(fit.left_out[i] / fit.left_out_sigma[i])
        warnings.append(
            f"The pose {session.names[i].removeprefix('pose ')} was set aside: its gravity is off "
            f"by {fit.left_out[i] / MILLI_G:.2f} mg, {times:.0f} times what noise and parameters "
            "explain."
        )
    if fit.noise_scale > LARGE_NOISE_SCALE:
        warnings.append(
            f"The poses disagree with each other {fit.noise_scale:.1f} times as much as the noise "
            "within them explains: a sensor that warms up, is not linear, or was not at rest."
        )
    warnings += strange_scale(figures, "accelerometer", "its unit")
    return warnings


def _gyro_warnings(
    session: Session, moves: Moves, track: BiasTrack, fit: DirectionFit, figures: PhysicalFigures
) -> list[str]:
    warnings = []
    large = beyond(figures, LARGE_GYRO)
    if large:
        warnings.append(
            f"{int(fit.used.sum())} usable moves determine {listed(large)} of the gyroscope "
            f"poorly: standard uncertainties reach {largest(figures, 'gyro')}; add turns of 90 to "
            "180 degrees about each axis while it is level."
        )
    for i in np.flatnonzero(~fit.used):
        warnings.append(
            f"The move from {session.names[moves.first[i]]} to {session.names[moves.last[i]]} was "
            f"set aside: gravity ends {fit.error[i] / DEG:.2f} degrees from where it should."
        )
    if fit.excess > LARGE_EXCESS:
        warnings.append(
            f"The moves scatter by {fit.excess / DEG:.2f} degrees beyond noise: turns too fast "
            "for the gyroscope, or a sensor that slipped in its mount."
        )
    span = float(np.ptp(track.at_stills, axis=0).max())
    if span > LARGE_WALK:
        warnings.append(
            f"The gyroscope's bias walked by {span / DEG:.2f} deg/s during the session; the "
            "certificate states its mean, so let the sensor warm up first."
        )
    warnings += strange_scale(figures, "gyroscope", "its unit, range setting or the sample rate")
    return warnings


def strange_scale(figures: PhysicalFigures, sensor: str, suspects: str) -> list[str]:
    """Warn of an axis that is further off its nominal scale than sensors are.

    Raises
    ------
    DataError
        So far off that no sensor reads like that.
    """
    worst = int(np.argmax(np.abs(figures.scale_percent)))
    if abs(figures.scale_percent[worst]) < STRANGE_SCALE:
        return []
    if abs(figures.scale_percent[worst]) > ABSURD_SCALE:
        raise DataError(
            f"axis {AXES[worst]} of the {sensor} would be {figures.scale_percent[worst]:+.3g} % "
            f"off its nominal scale, which no sensor is: check {suspects}, and that every axis "
            "has a column of its own"
        )
    return [
        f"Axis {AXES[worst]} of the {sensor} is {figures.scale_percent[worst]:+.0f} % off its "
        f"nominal scale, more than such a sensor should be: check {suspects}."
    ]


def poses_needed(directions: FloatArray) -> str:
    """Say which poses to add to those with ``directions`` (m, 3) up."""
    missing = poses_to_add(directions)
    if not missing:
        # The directions would do; what the poses disagree by is not for want of them.
        return "add poses in other attitudes in between, each held quite still for some seconds"
    return f"add poses with these sides, edges or corners up: {', '.join(missing)}"


def _named(figures: PhysicalFigures) -> list[tuple[str, int, float]]:
    """Name, kind (scale, angle, bias) and standard uncertainty of every figure."""
    return [
        *((f"scale {a}", 0, float(u)) for a, u in zip(AXES, figures.scale_percent_u, strict=True)),
        *(
            (f"{figures.angles} {n}", 1, float(u))
            for n, u in zip(figures.cross_names, figures.cross_rad_u, strict=True)
        ),
        *((f"bias {a}", 2, float(u)) for a, u in zip(AXES, figures.bias_u, strict=True)),
    ]


def beyond(figures: PhysicalFigures, bounds: tuple[float, float, float]) -> list[str]:
    """Name the figures that are more uncertain than scale [%], angle [rad] and bias bounds."""
    return [name for name, kind, u in _named(figures) if u > bounds[kind]]


def largest(figures: PhysicalFigures, sensor: str) -> str:
    """State the largest uncertainty of each kind."""
    scale, angle, bias = (max(u for _, k, u in _named(figures) if k == kind) for kind in (0, 1, 2))
    bias_text = f"{bias / MILLI_G:.2g} mg" if sensor == "accel" else f"{bias / DEG:.2g} deg/s"
    angles = f"{angle * 1e3:.2g} mrad in {figures.angles}"
    return f"{scale:.2g} % in scale, {angles} and {bias_text} in bias"


def listed(words: list[str]) -> str:
    """Join words as a sentence does."""
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))
