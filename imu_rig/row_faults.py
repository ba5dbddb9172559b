"""Faults that a device tells of in its packets, in words."""

from __future__ import annotations

import numpy as np

from firmware_protocols.packets import counts, flag
from firmware_protocols.rows import RowLayout
from imu_rig.arrays import StructArray

PROM_FAULT = "barometer PROM does not check (CRC-4)"


def faults_of(layout: RowLayout, rows: StructArray) -> dict[str, int]:
    """Return the faults that rows tell of, and the last row of each.

    Parameters
    ----------
    layout : RowLayout
        Names the bits of its fields that are faults. A barometer whose PROM is damaged is one too:
        its pressure cannot be computed.
    rows : shape (n,), structured
        Of ``layout.dtype``.
    """
    found: dict[str, int] = {}
    for field in layout.fields:
        for name, bit in field.faults:
            where = np.flatnonzero(flag(layout, rows, field.name, bit))
            if len(where):
                found[name] = max(int(where[-1]), found.get(name, 0))
    if layout.barometer is not None:
        from firmware_protocols.ms5803 import prom_is_sound  # which few devices need

        prom = counts(layout, rows, layout.barometer.prom)
        where = np.flatnonzero(~prom_is_sound(prom))
        if len(where):
            found[PROM_FAULT] = int(where[-1])
    return found
