"""Units that nobody stated, or that are stated and wrong: what rest and gravity say about them.

A guess is never used silently; it becomes the sentence that asks the user to state it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.moves import moves_between
from imu_rig.calibration.stills import find_stills
from imu_rig.calibration.suspicion import AGREES, match_gyro
from imu_rig.errors import DataError, InputError
from imu_rig.importing.unit_text import Kind, known_units, parse_unit
from imu_rig.units import DEG, STANDARD_GRAVITY

ACCEL_UNITS = (
    "m/s2",
    "g",
    "mg",
    "16384 LSB/g",
    "8192 LSB/g",
    "4096 LSB/g",
    "2048 LSB/g",
    "256 LSB/g",
)
GYRO_UNITS = (
    "rad/s",
    "deg/s",
    "mdps",
    "131 LSB/(deg/s)",
    "65.5 LSB/(deg/s)",
    "32.8 LSB/(deg/s)",
    "16.4 LSB/(deg/s)",
)
EARTH_FIELD_UT = (15.0, 150.0)
"""The field near a sensor, its own magnets included."""
REST_AGREES = 1.25
"""How far, as a factor, an uncalibrated accelerometer may be from gravity at rest."""
REST_CONTRADICTS = 1.6
CLEARER = 2.0
"""How much better than the next a guess of the gyroscope's unit must explain gravity."""
RATE_FACTORS = (0.5, 2.0, 0.25, 4.0, 0.1, 10.0)
JUDGED_ROWS = 300_000
QUIET_SHARE = 0.1


def rest_magnitude(t: FloatArray, accel: FloatArray) -> float:
    """Magnitude (in the unit of ``accel``) that the quietest windows of half a second read."""
    width = max(4, min(len(t) // 2, round(0.5 / float(np.median(np.diff(t))))))
    width = min(width, len(t))
    count = len(t) // width
    windows = accel[: count * width].reshape(count, width, 3)
    scatter = windows.var(axis=1).sum(axis=1)
    quiet = scatter <= np.quantile(scatter, QUIET_SHARE)
    return float(np.median(np.linalg.norm(windows.mean(axis=1)[quiet], axis=1)))


def guess_units(
    source: str,
    t: FloatArray,
    raw: Mapping[Kind, FloatArray | None],
    units: Mapping[Kind, str | None],
) -> str:
    """Return the sentence that asks for the units that are missing.

    Parameters
    ----------
    source : str
        Name of the file.
    t : shape (n,)
        Time [s].
    raw : mapping
        Readings (n, 3) of ``accel``, ``gyro`` and ``mag`` as they stand in the table.
    units : mapping
        Their stated units; None where missing.
    """
    accel, gyro, mag = (
        None if (x := raw.get(kind)) is None else x[:JUDGED_ROWS] for kind in _KINDS
    )
    t = t[:JUDGED_ROWS]
    reasons, options = [], []
    accel_unit = units.get("accel")
    if accel is not None and accel_unit is None:
        rest = rest_magnitude(t, accel)
        accel_unit = _accel_unit(rest)
        like = f"probably in {accel_unit}" if accel_unit else "in no usual unit"
        reasons.append(f"at rest the accelerometer reads {rest:.5g}, so it is {like}")
        options.append(f"--accel-unit {_quoted(accel_unit or '<unit>')}")
    if gyro is not None and "gyro" in units and units["gyro"] is None:
        gyro_unit = None
        if accel is not None and accel_unit is not None:
            factor = parse_unit(accel_unit, "accel")
            gyro_unit = _gyro_unit(t, accel * factor, gyro)
        reasons.append(
            f"the gyroscope agrees with gravity if it is in {gyro_unit}"
            if gyro_unit
            else "too few turns between rests tell the gyroscope's unit "
            f"(one of {known_units('gyro')})"
        )
        options.append(f"--gyro-unit {_quoted(gyro_unit or '<unit>')}")
    if mag is not None and "mag" in units and units["mag"] is None:
        size = float(np.median(np.linalg.norm(mag, axis=1)))
        mag_unit = _mag_unit(size)
        like = f"probably in {mag_unit}" if mag_unit else "in no usual unit"
        reasons.append(f"the magnetometer reads {size:.5g}, so it is {like}")
        options.append(f"--mag-unit {_quoted(mag_unit or '<unit>')}")
    return f"{source} does not state its units; {', and '.join(reasons)}: add {' '.join(options)}"


def refuse_contradiction(source: str, block: ImuBlock, units: Mapping[Kind, str | None]) -> None:
    """Refuse stated units that the readings contradict.

    Raises
    ------
    InputError
        Saying what the readings look like and the option that states it.
    """
    part = block[:JUDGED_ROWS]
    rest = rest_magnitude(part.t, part.accel)
    stated = units.get("accel")
    if stated is not None and abs(math.log(rest / STANDARD_GRAVITY)) > math.log(REST_CONTRADICTS):
        raw = rest / parse_unit(stated, "accel")
        better = _accel_unit(raw)
        remedy = (
            f"which looks like {better}: use --accel-unit {_quoted(better)}"
            if better
            else ("which fits no usual unit: check the unit and the columns")
        )
        raise InputError(
            f"{source}: the accelerometer is stated in {stated}, but at rest it reads {raw:.5g}, "
            f"{remedy}"
        )
    if units.get("gyro") is not None:
        _refuse_gyro(source, part, str(units["gyro"]))


_KINDS: tuple[Kind, Kind, Kind] = ("accel", "gyro", "mag")


def _refuse_gyro(source: str, block: ImuBlock, stated: str) -> None:
    try:
        stills = find_stills(block)
    except DataError:
        return
    if len(stills) < 4:
        return
    moves = moves_between(block, stills, stills.gyro_mean)
    here = parse_unit(stated, "gyro")
    units = {parse_unit(unit, "gyro") / here: unit for unit in GYRO_UNITS}
    others = {f: unit for f, unit in units.items() if abs(f - 1.0) > 0.05}
    # Range settings differ by factors of two, and so do wrong sample rates.
    others = {f: unit for f, unit in others.items() if "LSB" not in unit or "LSB" in stated}
    match = match_gyro(moves, stills.gyro_mean, (*others, *RATE_FACTORS))
    if not match.conclusive or match.factor == 1.0:
        return
    rate = 1.0 / float(np.median(np.diff(block.t)))
    unit = next((u for f, u in others.items() if abs(f / match.factor - 1.0) < 0.05), None)
    remedies = [] if unit is None else [f"the unit were {unit} (--gyro-unit {_quoted(unit)})"]
    if any(abs(f / match.factor - 1.0) < 0.05 for f in RATE_FACTORS):
        remedies.append(f"the sample rate were {rate / match.factor:.4g} Hz (--rate)")
    raise InputError(
        f"{source}: with rates in {stated} sampled at {rate:.4g} Hz, the gyroscope's turns "
        f"disagree with gravity by {match.error / DEG:.0f} degrees and would agree if "
        f"{' or '.join(remedies)}"
    )


def _accel_unit(rest: float) -> str | None:
    if not rest > 0:
        return None
    off = {
        unit: abs(math.log(rest * parse_unit(unit, "accel") / STANDARD_GRAVITY))
        for unit in ACCEL_UNITS
    }
    best = min(off, key=lambda unit: off[unit])
    return best if off[best] < math.log(REST_AGREES) else None


def _mag_unit(size: float) -> str | None:
    for unit in ("uT", "gauss", "mG", "nT"):
        if EARTH_FIELD_UT[0] <= size * parse_unit(unit, "mag") < EARTH_FIELD_UT[1]:
            return unit
    return None


def _gyro_unit(t: FloatArray, accel: FloatArray, gyro: FloatArray) -> str | None:
    """Return the unit in which the turns between rests agree with gravity, if one stands out."""
    # Stillness is judged in rad/s: bring the quiet windows to the noise of a usual sensor.
    width = max(4, round(0.5 / float(np.median(np.diff(t)))))
    count = len(t) // width
    if count < 4:
        return None
    windows = gyro[: count * width].reshape(count, width, 3)
    noise = float(np.sqrt(np.quantile(windows.var(axis=1).sum(axis=1), 0.05)))
    normal = 0.1 * DEG / noise if noise > 0 else 1.0
    block = ImuBlock(t, accel, gyro * normal, t)
    try:
        stills = find_stills(block)
    except DataError:
        return None
    if len(stills) < 4:
        return None
    moves = moves_between(block, stills, stills.gyro_mean)
    errors = {}
    for unit in GYRO_UNITS:
        factor = parse_unit(unit, "gyro") / normal
        match = match_gyro(moves.scaled(factor), stills.gyro_mean * factor, ())
        if not match.conclusive:
            return None
        errors[unit] = match.error
    best, second = sorted(errors, key=lambda unit: errors[unit])[:2]
    clear = errors[best] < AGREES and errors[best] * CLEARER < errors[second]
    return best if clear else None


def _quoted(unit: str) -> str:
    return f"'{unit}'" if set(unit) & set(" ()") else unit
