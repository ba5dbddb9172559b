"""Faults that a device tells of in its packets, in words."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from firmware_protocols.fields import Field
from firmware_protocols.packets import counts, flag
from firmware_protocols.rows import RowLayout
from imu_rig.arrays import BoolArray, StructArray
from imu_rig.blocks import INERTIAL_FIELDS

PROM_FAULT = "barometer PROM does not check (CRC-4)"
CONVERSION_FAULT = "barometer gave no reading (read before its conversion was over)"
CONVERTER_FAULT = "{} at the end of its converter (saturated, or a wire is off)"
SCALE_FAULT = "{} is a setting that the layout does not know: no {}"


def faults_of(layout: RowLayout, rows: StructArray) -> dict[str, int]:
    """Return the faults that rows tell of, and the last row of each.

    Parameters
    ----------
    layout : RowLayout
        Names the bits of its fields that are faults. A barometer whose PROM is damaged or that
        gives no reading is one too, and so are a converter at its end and an unknown range.
    rows : shape (n,), structured
        Of ``layout.dtype``.
    """
    found: dict[str, int] = {}
    for name, where in _all_faults(layout, rows):
        told = np.flatnonzero(where)
        if len(told):
            found[name] = max(int(told[-1]), found.get(name, 0))
    return found


def _all_faults(layout: RowLayout, rows: StructArray) -> Iterator[tuple[str, BoolArray]]:
    for field in layout.fields:
        for name, bit in field.faults:
            yield name, flag(layout, rows, field.name, bit)
        if field.name in INERTIAL_FIELDS and field.type[0] == "u":
            # An analogue sensor ends before its converter does; a digital one tells by a flag.
            at_end: BoolArray = np.isin(counts(layout, rows, field.name), field.limits)
            if at_end.ndim > 1:
                at_end = np.logical_or.reduce(at_end, axis=1)
            yield CONVERTER_FAULT.format(field.name), at_end
        if field.scale_by is not None:
            yield (
                SCALE_FAULT.format(field.scale_by, field.name),
                _unknown_scale(layout, rows, field),
            )
    if layout.barometer is not None:
        from firmware_protocols.ms5803 import is_reading, prom_is_sound  # which few devices need

        barometer = layout.barometer
        yield PROM_FAULT, ~prom_is_sound(counts(layout, rows, barometer.prom))
        for name in (barometer.d1, barometer.d2):
            yield CONVERSION_FAULT, ~is_reading(counts(layout, rows, name))


def _unknown_scale(layout: RowLayout, rows: StructArray, field: Field) -> BoolArray:
    """Return where a range is set that has no scale, unless that setting's own bits say why."""
    assert field.scale_by is not None
    selected = counts(layout, rows, field.scale_by)
    unknown: BoolArray = ~np.isin(selected, [selection for selection, _ in field.scales])
    for _, bit in layout.field(field.scale_by).faults:
        unknown &= ~flag(layout, rows, field.scale_by, bit)
    return unknown
