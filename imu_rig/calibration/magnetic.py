"""A magnetometer calibrated from a recording: which readings count, what the result is worth."""

from __future__ import annotations

from itertools import product

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray, IntArray
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.mag_result import Alignment, MagPoints, MagResult
from imu_rig.calibration.magnetometer import (
    FEWEST,
    FieldFit,
    FieldReadings,
    direction_uncertainty,
    fit_field,
)
from imu_rig.calibration.mean_noise import mean_variances, slow_terms
from imu_rig.calibration.model import AXES, Affine
from imu_rig.calibration.stills import Stills, sample_rate
from imu_rig.calibration.suspicion import at_limit
from imu_rig.errors import DataError, InputError
from imu_rig.units import DEG, STANDARD_GRAVITY

LEAST_NOISE_UT = 0.05
"""Below the noise of one sample of any sensor of the class."""
STRETCH_S = 2.0
"""Errors of a sensor that is turned about go on for so long: what lies further apart is new."""
MOST_STRETCHES = 60
MOST_SAMPLES = 3000
"""More samples of a hand-held recording tell nothing new."""
QUASI_STATIC = 0.1
"""Largest difference of the specific force from gravity, over gravity, at which it shows up."""
FIELD_RANGE_UT = (5.0, 500.0)
"""Magnitudes of a field that somebody may state."""
POSSIBLE_UT = (0.05, 1e5)
"""Largest readings that any magnetometer may show, whatever its unit of the field may be."""
USUAL_FIELD_UT = (15.0, 100.0)
"""Magnitudes that a magnetometer near no iron may read, scale errors included."""
GAIN_RANGE = (0.25, 4.0)
"""Gains beyond which the stated field or the unit of the readings is wrong."""
STRANGE_GAIN = 1.4
SATURATED_SHARE = 0.05
DISTURBED = 2.5
"""Scatter between still poses, in that which noise explains, that shows a disturbance."""
WILD_PERCENT = 1.0
LARGE_RESIDUAL = 0.03
"""The same of single samples, over the field."""
NO_FIELD = 0.15
"""Left-out error of the magnitude, over the field, at which no field can be told."""
DRIFTED, SURE = 0.003, 4.0
"""Change of the magnitude over the recording, over the field and in standard errors."""
WIDE_GAP = 75.0 * DEG
"""Angle between a direction and the nearest reading beyond which that side is unknown."""
LARGE_OFFSET = 0.02
"""Standard uncertainty of the offset, over the field, worth a warning."""
NO_OFFSET = 0.15
"""The same beyond which nothing is determined."""
LARGE_TURN, NO_TURN = 0.5 * DEG, 5.0 * DEG
"""Standard uncertainties of the alignment [rad] worth a warning, and worth nothing."""
MOST_POINTS = 300
HIDDEN_IRON = (
    "Iron and magnets that stand still while the sensor turns, such as a jig's servos, shift the "
    "result by more than any residual shows: 1 % of the field there turns readings by up to 0.6 "
    "degrees. Compare with a calibration by hand, away from the jig."
)


def varies(block: ImuBlock) -> bool:
    """Whether the block has a magnetometer that shows anything."""
    if block.mag is None or not len(block):
        return False
    # Values that are not numbers are somebody's readings too: calibrating refuses them.
    return bool(np.any(np.ptp(block.mag, axis=0) != 0))


def calibrate_from_stills(
    block: ImuBlock,
    stills: Stills,
    names: tuple[str, ...],
    accel: Affine,
    *,
    field_ut: float | None = None,
    attitudes: FloatArray | None = None,
    on_jig: bool = False,
) -> MagResult:
    """Calibrate from the means of still poses.

    Parameters
    ----------
    block : ImuBlock
        The recording.
    stills : Stills
        Its ``m`` still poses.
    names : tuple of str
        A name per pose.
    accel : Affine
        The solved accelerometer, whose axes become the magnetometer's.
    field_ut : float, optional
        Magnitude of the field [uT], where it is known.
    attitudes : shape (m, 3, 3), optional
        Attitudes body to navigation whose headings are known.
    on_jig : bool
        Whether motors turned the sensor.

    Raises
    ------
    DataError
        Data that cannot determine the calibration, with what to add.
    """
    mag = _readings(block, field_ut)
    limit = np.asarray(at_limit(mag).any(axis=1))
    rows = list(zip(stills.start, stills.stop, strict=True))
    share = np.array([float(limit[i:j].mean()) for i, j in rows])
    usable = np.asarray(share <= SATURATED_SHARE)
    warnings = _saturation(names, usable)
    count = int(usable.sum())
    if count < FEWEST:
        raise DataError(
            f"{count} still poses are too few for its gain, offset and axes; hold it still in "
            f"{FEWEST} poses or more ({2 * FEWEST} are advised), with every side up and two "
            "headings or more"
        )
    rows = [row for row, keep in zip(rows, usable, strict=True) if keep]
    rate = sample_rate(block.t)
    samples = np.array([float(j - i) for i, j in rows])
    variance = mean_variances([slow_terms(mag[i:j], rate) for i, j in rows], samples)
    up = accel.apply(stills.accel_mean[usable])
    readings = FieldReadings(
        raw=np.array([mag[i:j].mean(axis=0) for i, j in rows]),
        sem=np.sqrt(variance + LEAST_NOISE_UT**2 / samples[:, None]),
        up=up / np.linalg.norm(up, axis=1, keepdims=True),
        attitudes=None if attitudes is None else attitudes[usable],
        up_errors=_up_errors(stills.accel_mean[usable], accel),
    )
    fit = fit_field(readings, field_ut)
    names = tuple(name for name, keep in zip(names, usable, strict=True) if keep)
    warnings += [
        f"The magnetometer's reading in {names[i]} was set aside: it does not fit the others."
        for i in np.flatnonzero(~fit.used)
    ]
    worst = max(fit.noise[:2]) if _dip_counts(fit, up) else fit.noise[0]
    if worst > DISTURBED:
        warnings.append(
            f"The magnetic field differs between the poses {worst:.0f} times as much as noise "
            f"explains ({100 * _rms(fit.error[fit.used]):.2g} % of its magnitude): iron, magnets "
            "or currents that did not turn with the sensor disturb it, and the calibration is off "
            "by several times that; move the sensor 20 cm or more away from them."
        )
    t = ((stills.t0 + stills.t1) / 2.0)[usable]
    return _result(readings, fit, t, warnings, field_ut, on_jig=on_jig)


def calibrate_from_samples(
    block: ImuBlock, accel: Affine | None = None, *, field_ut: float | None = None
) -> MagResult:
    """Calibrate from all samples of a sensor that was turned about by hand.

    Parameters
    ----------
    block : ImuBlock
        The recording.
    accel : Affine, optional
        The accelerometer, if it was calibrated; raw readings tell up well enough otherwise.
    field_ut : float, optional
        Magnitude of the field [uT], where it is known.

    Raises
    ------
    DataError
        Data that cannot determine the calibration, with what to add.
    """
    mag = _readings(block, field_ut)
    keep = ~at_limit(mag).any(axis=1)
    warnings = []
    if not keep.all():
        warnings.append(
            f"The magnetometer is at its range limit in {int(np.sum(~keep))} samples, which were "
            "left out: a magnet is near, or its range is too small."
        )
    duration = float(block.t[-1] - block.t[0])
    stretches = min(MOST_STRETCHES, int(duration / STRETCH_S))
    if stretches < FEWEST:
        raise DataError(
            f"{duration:.0f} s are too short: turn it slowly for a minute or more, until every "
            "side has been up under several headings"
        )
    rows = np.flatnonzero(keep)[:: max(1, -(-len(block) // MOST_SAMPLES))]
    t = block.t[rows]
    force = (block.accel if accel is None else accel.apply(block.accel))[rows]
    size = np.linalg.norm(force, axis=1)
    up = force / np.maximum(size, 1e-9)[:, None]
    up[np.abs(size / STANDARD_GRAVITY - 1.0) > QUASI_STATIC] = np.nan
    cluster = np.minimum((t - block.t[0]) / duration * stretches, stretches - 1).astype(np.int64)
    steps = np.diff(mag, n=2, axis=0)
    noise = np.sqrt(np.mean(np.clip(steps**2, 0, 9 * np.median(steps**2, axis=0)), axis=0) / 6.0)
    readings = FieldReadings(
        raw=mag[rows],
        sem=np.tile(np.maximum(noise, LEAST_NOISE_UT), (len(rows), 1)),
        up=up if np.sum(np.isfinite(up[:, 0])) >= 0.2 * len(up) else None,
        cluster=np.unique(cluster, return_inverse=True)[1],
    )
    fit = fit_field(readings, field_ut)
    wild = 100.0 * float(np.mean(~fit.used))
    if wild > WILD_PERCENT:
        warnings.append(
            f"{wild:.0f} % of the magnetometer's samples lie far from all others and were left "
            "out: a bad connection, or magnets that came near for a moment."
        )
    if _rms(fit.left_out[fit.used]) > LARGE_RESIDUAL:
        warnings.append(
            f"The magnitude of the calibrated magnetic field varies by "
            f"{100 * _rms(fit.left_out[fit.used]):.1f} %: iron or currents near the place disturb "
            "it, or the sensor was moved about instead of turned on the spot."
        )
    return _result(readings, fit, t, warnings, field_ut, on_jig=False)


def _dip_counts(fit: FieldFit, force: FloatArray) -> bool:
    """Whether the dip scatters by more than the accelerometer's own errors explain.

    What makes its magnitude (m, 3) differ between poses turns its directions by about as much: a
    method that trusts the jig's angles leaves errors in it that no magnetic field makes.
    """
    size = np.linalg.norm(force, axis=1)
    dip = fit.dip_error[np.isfinite(fit.dip_error)]
    return len(dip) > 0 and _rms(dip) > DISTURBED * float(np.std(size) / np.mean(size))


def _up_errors(raw: FloatArray, accel: Affine) -> FloatArray | None:
    """One standard deviation (k, n, 3) of up along each way in which ``accel`` is uncertain."""
    variance, ways = np.linalg.eigh(accel.covariance)
    size = np.linalg.norm(accel.apply(raw), axis=1, keepdims=True)
    modes = [
        np.sqrt(v) * (raw @ way[:9].reshape(3, 3).T - way[9:]) / size
        for v, way in zip(variance, ways.T, strict=True)
        if v > 1e-12 * max(float(variance[-1]), 1e-300)
    ]
    return np.array(modes) if modes else None


def _readings(block: ImuBlock, field_ut: float | None) -> FloatArray:
    if block.mag is None:
        raise DataError("the recording has no magnetometer")
    if field_ut is not None and not FIELD_RANGE_UT[0] <= field_ut <= FIELD_RANGE_UT[1]:
        raise InputError(
            f"a magnetic field of {field_ut:g} uT is none of the Earth's, which has 22 to 67: "
            "state it in uT"
        )
    if not np.all(np.isfinite(block.mag)):
        raise DataError("its readings hold values that are not numbers")
    dead = [a for a, spread in zip(AXES, np.ptp(block.mag, axis=0), strict=True) if spread == 0]
    if dead:
        raise DataError(f"its axis {dead[0]} never changes: it is dead, or was not turned")
    largest = float(np.max(np.abs(block.mag)))
    if not POSSIBLE_UT[0] < largest < POSSIBLE_UT[1]:
        raise DataError(
            f"it reads up to {largest:.3g} uT, which no magnetometer does near the Earth: its unit "
            "is wrong"
        )
    return block.mag


def _saturation(names: tuple[str, ...], usable: BoolArray) -> list[str]:
    return [
        f"The magnetometer is at its range limit in {names[i]}, which was left out for it: a "
        "magnet is near, or its range is too small."
        for i in np.flatnonzero(~usable)
    ]


def _result(
    readings: FieldReadings,
    fit: FieldFit,
    t: FloatArray,
    warnings: list[str],
    field_ut: float | None,
    *,
    on_jig: bool,
) -> MagResult:
    off = _rms(fit.left_out[fit.used])
    if off > NO_FIELD:
        raise DataError(
            f"its readings do not fit one constant field (off by {100 * off:.0f} %): a magnet or "
            "currents near it, a wrong column, or a range that is too small"
        )
    affine, alignment, dip_u = fit.affine, _alignment(readings, fit), fit.dip_u
    warnings = [*warnings, *_unit_warnings(fit, field_ut)]
    calibrated = affine.apply(readings.raw)
    direction = calibrated / np.linalg.norm(calibrated, axis=1, keepdims=True)
    warnings += _coverage(fit, direction[fit.used])
    if alignment == "none":
        warnings.append(
            "The magnetometer's axes were not aligned with the accelerometer's: nothing shows "
            "their rotation well enough; turn the sensor to more headings, north, east, south "
            "and west, with different sides up."
        )
    elif fit.alignment_u is not None and fit.alignment_u > LARGE_TURN:
        warnings.append(
            f"The rotation between magnetometer and accelerometer is only known to "
            f"{fit.alignment_u / DEG:.1f} degrees (standard uncertainty): record poses under "
            "two headings or more, 90 degrees apart."
        )
    warnings += _drift(fit, t, readings.cluster)
    raw = np.linalg.norm(readings.raw, axis=1)
    before = raw / raw[fit.used].mean() - 1.0
    chosen = np.unique(np.linspace(0, len(t) - 1, min(len(t), MOST_POINTS)).astype(int))
    aligned = alignment != "none"
    if not aligned:
        affine = fit.symmetric
        calibrated = affine.apply(readings.raw)
        direction = calibrated / np.linalg.norm(calibrated, axis=1, keepdims=True)
    return MagResult(
        affine=affine,
        alignment=alignment,
        field_ut=fit.field_ut,
        field_known=field_ut is not None,
        dip_rad=fit.dip_rad if aligned else None,
        dip_u=dip_u if aligned else None,
        alignment_u=fit.alignment_u if aligned else None,
        direction_u=direction_uncertainty(affine, fit.field_ut) if aligned else None,
        from_stills=readings.cluster is None,
        count=int(fit.used.sum()),
        before_percent=100.0 * _rms(before[fit.used]),
        residual_percent=100.0 * _rms(fit.error[fit.used]),
        left_out_percent=100.0 * _rms(fit.left_out[fit.used]),
        points=MagPoints(
            t=t[chosen],
            direction=direction[chosen],
            before=before[chosen],
            after=fit.error[chosen],
            left_out=fit.left_out[chosen],
        ),
        warnings=tuple(warnings),
        notes=_notes(fit, known=field_ut is not None, on_jig=on_jig),
    )


def _alignment(readings: FieldReadings, fit: FieldFit) -> Alignment:
    if fit.alignment_u is None or fit.alignment_u > NO_TURN:
        return "none"
    return "dip" if readings.attitudes is None else "attitudes"


def _unit_warnings(fit: FieldFit, field_ut: float | None) -> list[str]:
    gains = np.linalg.svd(fit.affine.K, compute_uv=False)
    gain = float(np.prod(gains)) ** (1 / 3)
    raw = fit.field_ut / gain
    if field_ut is None:
        if USUAL_FIELD_UT[0] <= raw <= USUAL_FIELD_UT[1]:
            return []
        return [
            f"The magnetometer reads a field of {raw:.3g} uT, where the Earth's is 22 to 67: "
            "check its unit, and keep it away from iron."
        ]
    if not (GAIN_RANGE[0] < gains[2] and gains[0] < GAIN_RANGE[1]):
        raise DataError(
            f"the field is stated as {field_ut:g} uT, but it reads {raw:.3g}: its unit or the "
            "stated field is wrong"
        )
    if not 1.0 / STRANGE_GAIN < gain < STRANGE_GAIN:
        return [
            f"The magnetometer reads a field of {raw:.3g} uT where {field_ut:g} is stated: check "
            "its unit, and that the field was stated for this place."
        ]
    return []


def _coverage(fit: FieldFit, direction: FloatArray) -> list[str]:
    sides = [np.array(c, dtype=float) for c in product((1, 0, -1), repeat=3) if any(c)]
    away = [
        float(np.arccos(np.clip(np.max(direction @ s) / np.linalg.norm(s), -1, 1))) for s in sides
    ]
    offset = float(fit.affine.b_uncertainty.max()) / fit.field_ut
    missing = [
        "".join(("+" if v > 0 else "-") + a for v, a in zip(s, AXES, strict=True) if v)
        for s, angle in sorted(zip(sides, away, strict=True), key=lambda pair: -pair[1])
        if angle > (WIDE_GAP if offset < LARGE_OFFSET else WIDE_GAP / 2.0)
    ][:8]
    where = (
        f"; turn it until the field points along its {', '.join(missing)} too" if missing else ""
    )
    if offset > NO_OFFSET:
        raise DataError(f"the directions of the field do not determine its gain and offset{where}")
    if offset > LARGE_OFFSET:
        return [
            f"The magnetometer's offset is only known to {100 * offset:.0f} % of the field "
            f"(standard uncertainty){where}."
        ]
    if missing and max(away) > WIDE_GAP:
        return [f"The magnetometer was calibrated from one part of all directions{where}."]
    return []


def _drift(fit: FieldFit, t: FloatArray, cluster: IntArray | None) -> list[str]:
    """Warn of a magnitude that changes steadily with time, which is with place."""
    e, at = fit.error[fit.used], t[fit.used]
    if cluster is not None:
        names = cluster[fit.used]
        size = np.bincount(names)
        full = size > 0
        e = (np.bincount(names, e) / np.maximum(size, 1))[full]
        at = (np.bincount(names, at) / np.maximum(size, 1))[full]
    x = at - at.mean()
    slope = float(x @ e / (x @ x))
    rest = e - e.mean() - slope * x
    sigma = float(np.sqrt(rest @ rest / (len(e) - 2) / (x @ x)))
    change = slope * float(np.ptp(at))
    if abs(change) < DRIFTED or abs(slope) < SURE * sigma:
        return []
    return [
        f"The magnitude of the magnetic field changed by {100 * change:+.1f} % in the course of "
        "the recording: the place changed, the sensor warmed up, or something magnetic was moved."
    ]


def _notes(fit: FieldFit, *, known: bool, on_jig: bool) -> tuple[str, ...]:
    notes = []
    if not known:
        notes.append(
            f"The field's magnitude was not stated, so the magnetometer's mean gain is taken as 1, "
            f"which makes the field {fit.field_ut:.1f} uT; directions do not depend on it."
        )
    if on_jig:
        notes.append(HIDDEN_IRON)
    return tuple(notes)


def _rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2)))
