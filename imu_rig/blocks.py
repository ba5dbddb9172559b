"""Blocks of samples: what drivers and trial files hand to everything else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from imu_rig.arrays import AnyArray, FloatArray, IntArray

INERTIAL_FIELDS = ("accel", "gyro")
"""Whatever has one of them is an inertial sensor."""


@dataclass(frozen=True)
class ImuBlock:
    """``n`` consecutive samples of one inertial sensor, nominally scaled, not calibrated.

    Attributes
    ----------
    t : shape (n,)
        Time of each sample on the host's monotonic clock [s]: the device clock mapped by a fit,
        strictly increasing. The time that algorithms use.
    accel : shape (n, 3)
        Specific force in sensor axes [m/s^2], +g on the axis that points up at rest.
    gyro : shape (n, 3)
        Angular rate in sensor axes [rad/s].
    host_s : shape (n,)
        Arrival of the bytes that completed the sample, host monotonic clock [s]. Bursty and late.
    device_s : shape (n,) or None
        Unwrapped device clock [s], as the device counted it; None where it sends none.
    counter : shape (n,) or None
        Unwrapped packet counter; a difference above 1 is a loss. None where there is none.
    mag : shape (n, 3) or None
        Magnetic field in the accelerometer's axes [uT].
    temperature : shape (n,) or None
        Sensor temperature [degC].
    """

    t: FloatArray
    accel: FloatArray
    gyro: FloatArray
    host_s: FloatArray
    device_s: FloatArray | None = None
    counter: IntArray | None = None
    mag: FloatArray | None = None
    temperature: FloatArray | None = None

    def __len__(self) -> int:
        """Return the number of samples."""
        return int(self.t.shape[0])

    def __repr__(self) -> str:
        """Return one line; the numbers are in the columns."""
        there = [f.name for f in fields(self) if getattr(self, f.name) is not None]
        return in_a_line("ImuBlock", self.t, there)

    def __getitem__(self, rows: slice | AnyArray) -> ImuBlock:
        """Return the samples that ``rows`` (a slice, mask or index array) selects."""
        columns: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}
        taken: dict[str, Any] = {k: None if c is None else c[rows] for k, c in columns.items()}
        return ImuBlock(**taken)

    @staticmethod
    def empty() -> ImuBlock:
        """Return a block without samples."""
        return ImuBlock(np.empty(0), np.empty((0, 3)), np.empty((0, 3)), np.empty(0))

    @staticmethod
    def concatenate(blocks: Sequence[ImuBlock]) -> ImuBlock:
        """Join blocks of one device in order; a column that one of them lacks is dropped."""
        full = [b for b in blocks if len(b)]
        if not full:
            return ImuBlock.empty()
        columns: dict[str, Any] = {}
        for f in fields(ImuBlock):
            parts = [getattr(b, f.name) for b in full]
            columns[f.name] = None if any(p is None for p in parts) else np.concatenate(parts)
        return ImuBlock(**columns)


@dataclass(frozen=True)
class Samples:
    """``n`` consecutive samples of any device that sends packets, in the units of its layout.

    Attributes
    ----------
    t : shape (n,)
        Time of each sample [s], strictly increasing, as of `ImuBlock`.
    host_s : shape (n,)
        Arrival of the bytes that completed the sample [s]. Bursty and late.
    device_s : shape (n,) or None
        Unwrapped device clock [s], as the device counted it; None where it sends none.
    counter : shape (n,) or None
        Unwrapped packet counter; a difference above 1 is a loss. None where there is none.
    values : dict
        Field name to its numbers, shape (n,) or (n, k). Pads, counter and clock are left out.
    units : dict
        Field name to its unit: "m/s2" for accel, "rad/s" for gyro, "uT" for mag, "degC" for
        temperature and "Pa" for pressure, else what the layout says; "" for counts and flags.
    """

    t: FloatArray
    host_s: FloatArray
    device_s: FloatArray | None = None
    counter: IntArray | None = None
    values: dict[str, FloatArray] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.t)

    def __repr__(self) -> str:
        """Return one line; the numbers are in the columns."""
        own = [n for n in ("t", "host_s", "device_s", "counter") if getattr(self, n) is not None]
        measured = [f"{n} [{self.units[n]}]" if self.units.get(n) else n for n in self.values]
        return in_a_line("Samples", self.t, [*own, *measured])

    @property
    def is_inertial(self) -> bool:
        """Whether an accelerometer or a gyroscope is among the values, in whatever unit."""
        return any(name in self.values for name in INERTIAL_FIELDS)

    def __getitem__(self, rows: slice | AnyArray) -> Samples:
        """Return the samples that ``rows`` (a slice, mask or index array) selects."""
        return Samples(
            self.t[rows],
            self.host_s[rows],
            None if self.device_s is None else self.device_s[rows],
            None if self.counter is None else self.counter[rows],
            {name: numbers[rows] for name, numbers in self.values.items()},
            dict(self.units),
        )


def in_a_line(name: str, t: FloatArray, what: Sequence[str], rows: str = "rows") -> str:
    """Tell a table with times in one line: how many rows, from when to when [s], and of what."""
    when = f", t {t[0]:.3f} to {t[-1]:.3f} s" if len(t) else ""
    return f"<{name}: {len(t)} {rows}{when}, {', '.join(what)}>"
