"""Counts of a device's rows to SI units, for the fields that are measurements."""

from __future__ import annotations

import numpy as np

from firmware_protocols.packets import counts, flag, values
from firmware_protocols.rows import RowLayout
from imu_rig.arrays import FloatArray, StructArray
from imu_rig.blocks import INERTIAL_FIELDS
from imu_rig.errors import InputError
from imu_rig.units import (
    ACCELERATION_UNITS,
    FIELD_UNITS,
    PRESSURE_UNITS,
    RATE_UNITS,
    TEMPERATURE_UNITS,
)

_UNITS = {
    "accel": ACCELERATION_UNITS,
    "gyro": RATE_UNITS,
    "mag": FIELD_UNITS,
    "temperature": TEMPERATURE_UNITS,
}
_SI_UNITS = {
    "accel": "m/s2",
    "gyro": "rad/s",
    "mag": "uT",
    "temperature": "degC",
    "pressure": "Pa",
}

_KNOWN_UNITS = {**_UNITS, "pressure": PRESSURE_UNITS}


def is_inertial(layout: RowLayout) -> bool:
    """Whether packets hold an accelerometer or a gyroscope: their fields are called so."""
    return any(layout.has(name) for name in INERTIAL_FIELDS)


def si_factors(layout: RowLayout) -> dict[str, float]:
    """Return SI units per unit of the layout, by the name of the field.

    Raises
    ------
    InputError
        If the layout holds neither accelerometer nor gyroscope, or a field of unknown unit.
    """
    if not is_inertial(layout):
        raise InputError(
            f"Packet layout {layout.name} has neither a field accel nor a field gyro: name the "
            "fields that hold the accelerometer and the gyroscope so."
        )
    factors = {}
    for name, units in _UNITS.items():
        if not layout.has(name):
            continue
        field = layout.field(name)
        if field.unit not in units:
            raise InputError(
                f"Packet layout {layout.name}: field {name} has the unit {field.unit!r}, which is "
                f"not known for it; use one of {', '.join(units)}."
            )
        if field.count != (1 if name == "temperature" else 3):
            raise InputError(
                f"Packet layout {layout.name}: field {name} holds {field.count} numbers; "
                f"it must hold {'one' if name == 'temperature' else 'three'}."
            )
        factors[name] = units[field.unit]
    return factors


def si_values(
    layout: RowLayout, rows: StructArray, factors: dict[str, float]
) -> dict[str, FloatArray]:
    """Return the measurements of packets in SI units; an absent accel or gyro reads NaN.

    Parameters
    ----------
    layout : RowLayout
    rows : shape (n,), structured
        Packets, of ``layout.dtype``.
    factors : dict
        As `si_factors` gives them.

    Returns
    -------
    dict
        "accel" [m/s^2] and "gyro" [rad/s], shape (n, 3); "mag" [uT], shape (n, 3), and
        "temperature" [degC], shape (n,), where the layout has them.
    """
    columns = {name: values(layout, rows, name) for name in factors}
    with np.errstate(over="ignore"):  # infinite then, as of `values`
        for name, factor in factors.items():
            columns[name] *= factor
    for name in INERTIAL_FIELDS:
        if name not in columns:
            columns[name] = np.full((len(rows), 3), np.nan)
    return columns


def field_values(
    layout: RowLayout, rows: StructArray
) -> tuple[dict[str, FloatArray], dict[str, str]]:
    """Return every field of packets but pads, counter and clock, and the unit of each.

    Inertial measurements and pressure come in SI units, as of `si_values`; a field of any other
    name, or in a unit that is not known for it, in the layout's own. Flags are 0 or 1. The raw
    readings of a barometer are joined by its pressure [Pa] and temperature [degC], which are NaN
    where its PROM is damaged.
    """
    columns, units = {}, {}
    for field in layout.fields:
        if field.type == "pad" or field.name in (layout.counter, layout.clock):
            continue
        numbers, unit = values(layout, rows, field.name), field.unit
        factor = _KNOWN_UNITS.get(field.name, {}).get(unit)
        if factor is not None:
            with np.errstate(over="ignore"):
                numbers *= factor
            unit = _SI_UNITS[field.name]
        columns[field.name], units[field.name] = numbers, unit
        for name, bit in field.flags:
            columns[name] = flag(layout, rows, field.name, bit).astype(np.float64)
            units[name] = ""
    if layout.barometer is not None:
        columns["pressure"], columns["temperature"] = _barometer_values(layout, rows)
        units |= {"pressure": "Pa", "temperature": "degC"}
    return columns, units


def _barometer_values(layout: RowLayout, rows: StructArray) -> tuple[FloatArray, FloatArray]:
    from firmware_protocols.ms5803 import compensate  # which few devices need

    raw = layout.barometer
    assert raw is not None
    prom, d1, d2 = (counts(layout, rows, name) for name in (raw.prom, raw.d1, raw.d2))
    return compensate(raw.variant, prom, d1, d2)


def watched_fields(layout: RowLayout) -> tuple[str, ...]:
    """Return the fields whose counts change all the time while a sensor measures."""
    return tuple(name for name in INERTIAL_FIELDS if layout.has(name))
