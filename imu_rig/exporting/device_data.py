"""What is exported: the samples of a trial, raw or calibrated, one device at a time."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from imu_rig.arrays import FloatArray, IntArray
from imu_rig.blocks import ImuBlock, Samples
from imu_rig.calibration.certificate import Certificate, apply_certificate
from imu_rig.clock import NS_PER_S, utc_of, utc_text
from imu_rig.errors import InputError
from imu_rig.exporting.names import file_names
from imu_rig.foreign_text import one_line
from imu_rig.recording.contents import Missing
from imu_rig.recording.reader import Trial

FIRST_FIELDS = ("accel", "gyro", "mag", "temperature")
"""Fields that stand before all others, in this order."""
INERTIAL = {"accel": "m/s2", "gyro": "rad/s", "mag": "uT"}
ABOUT = ("kind", "subject", "session", "trial", "note", "imu_rig")
"""What the configuration of a trial says of it, as far as it is text."""
UNKNOWN = "unknown"
STAND_IN_NS = 946_684_800 * NS_PER_S
"""2000-01-01, the start of a trial without one, where a format cannot do without a date."""


@dataclass(frozen=True, eq=False)
class Column:
    """One number of every sample of a device.

    Attributes
    ----------
    label : str
        What it is and in which unit: ``calibrated_accel_x_mps2``; no other column's label.
    name, unit : str
        "accel_x" and "m/s2"; the unit is empty for counts.
    calibrated : bool
    values : shape (n,)
    """

    label: str
    name: str
    unit: str
    calibrated: bool
    values: FloatArray


@dataclass(frozen=True, eq=False)
class DeviceData:
    """The samples of one device and what is known about them.

    Attributes
    ----------
    source, name, key : str
        Its name in the trial, the same in printable text, and a part of a file name or topic for
        it, unlike any other's.
    kind, layout : str
        Kind of source and name of the packet layout.
    rate_hz : float or None
        Nominal rate, where the layout states one.
    samples : Samples
    calibrated : tuple of str
        Fields that a certificate was applied to.
    missing : tuple of Missing
    start_utc_ns : int or None
        Wall clock at trial time 0 [ns since 1970 UTC]; None where nobody knows it.
    time_uncertainty_s : float
        Standard uncertainty of its times where it is worst [s]; infinite where there are none,
        not a number where they were imported and nobody knows it.
    time_problem : str or None
        Why its times cannot be right, as a sentence without its stop.
    """

    source: str
    name: str
    key: str
    kind: str
    layout: str
    rate_hz: float | None
    samples: Samples
    calibrated: tuple[str, ...]
    missing: tuple[Missing, ...]
    start_utc_ns: int | None
    time_uncertainty_s: float
    time_problem: str | None

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.samples)

    def __getitem__(self, rows: slice) -> DeviceData:
        """Return the samples that ``rows`` selects."""
        return replace(self, samples=self.samples[rows])

    @property
    def fields(self) -> list[str]:
        """Names of the measured fields, inertial ones first."""
        there = list(self.samples.values)
        first = [name for name in FIRST_FIELDS if name in there]
        return first + [name for name in there if name not in first]

    @property
    def columns(self) -> list[Column]:
        """Every measured number, as columns."""
        found: list[Column] = []
        used = {"t_s", "utc", "host_s", "device_s", "counter"}
        for field in self.fields:
            values, unit = self.samples.values[field], self.samples.units[field]
            numbers = values[None] if values.ndim == 1 else values.T
            for part, column in zip(parts(values), numbers, strict=True):
                name = f"{field}_{part}" if part else field
                words = ["calibrated"] if field in self.calibrated else []
                label = plain = "_".join(w for w in [*words, name, unit_word(unit)] if w)
                number = 1
                while label in used:
                    label, number = f"{plain}_{number + 1}", number + 1
                used.add(label)
                found.append(Column(label, name, unit, field in self.calibrated, column))
        return found

    @property
    def t_us(self) -> IntArray:
        """Trial time of each sample [us]."""
        return np.rint(self.samples.t * 1e6).astype(np.int64)

    @property
    def utc_us(self) -> IntArray | None:
        """Time of each sample [us since 1970 UTC], by the wall clock at the trial's start."""
        return None if self.start_utc_ns is None else self.t_us + round(self.start_utc_ns / 1000)

    @property
    def dated_start_ns(self) -> int:
        """Wall clock at trial time 0 or, where nobody knows it, `STAND_IN_NS`."""
        return dated(self.start_utc_ns)

    @property
    def dated_us(self) -> IntArray:
        """Time of each sample from there on [us]."""
        return self.t_us + round(self.dated_start_ns / 1000)

    @property
    def dated_ns(self) -> IntArray:
        """The same in nanoseconds, from the time as it is."""
        return np.rint(self.samples.t * 1e9).astype(np.int64) + self.dated_start_ns

    @property
    def start_utc(self) -> str:
        """Wall clock at trial time 0, ISO 8601, or "unknown"."""
        return iso_utc(self.start_utc_ns)

    @property
    def time_uncertainty(self) -> str:
        """Uncertainty of its times [s] as text, or "unknown"."""
        sigma_s = self.time_uncertainty_s
        return UNKNOWN if math.isnan(sigma_s) else f"{sigma_s:.3g}"

    @property
    def missing_samples(self) -> int:
        """Samples known to be missing."""
        return sum(m.samples or 0 for m in self.missing)


@dataclass(frozen=True)
class Summary:
    """What was exported of one device; as of `DeviceData`."""

    key: str
    samples: int
    calibrated: tuple[str, ...]
    measured: tuple[str, ...]
    gaps: int
    gap_s: float
    """How long they are together."""
    gaps_unknown: int
    """Gaps of which nothing tells how many samples are missing."""
    missing_samples: int
    time_uncertainty_s: float
    time_problem: str | None


@dataclass(frozen=True)
class Marked:
    """A moment that a person marked: trial time [s], wall clock [ns since 1970 UTC], words.

    The wall clock at the start is `STAND_IN_NS` where nobody knows it.
    """

    t: float
    dated_ns: int
    label: str


class TrialData:
    """The chosen devices of a trial, decoded one after the other.

    Attributes
    ----------
    trial : Trial
    names : tuple of str
        Devices, in the order of the trial.
    keys : dict
        A part of a file name or topic for each device of the trial.
    summaries : dict
        Of each device that was decoded so far and not left out.
    """

    def __init__(
        self,
        trial: Trial,
        names: Sequence[str] | None = None,
        certificates: Mapping[str, Certificate] | None = None,
    ) -> None:
        self.trial = trial
        self.names = tuple(trial.sensors if names is None else names)
        self.keys = file_names(trial.sensors, taken=("gaps", "markers"))
        self.summaries: dict[str, Summary] = {}
        self._certificates = dict(certificates or {})

    def __iter__(self) -> Iterator[DeviceData]:
        """Yield each device; only one is held at a time."""
        for name in self.names:
            yield self.device(name)

    def device(self, name: str) -> DeviceData:
        """Decode a device.

        Raises
        ------
        InputError
            If its layout cannot be used.
        """
        trial = self.trial
        samples = trial.samples(name)
        calibrated: tuple[str, ...] = ()
        if name in self._certificates:
            samples, calibrated = calibrate(samples, self._certificates[name])
        described = trial.source(name).descriptor.get("layout", {})
        device = DeviceData(
            source=name,
            name=one_line(name),
            key=self.keys[name],
            kind=one_line(trial.source(name).kind),
            layout=one_line(str(described.get("name", ""))),
            rate_hz=trial.layout(name).rate_hz,
            samples=samples,
            calibrated=calibrated,
            missing=tuple(trial.missing(name)),
            start_utc_ns=trial.start_utc_ns,
            time_uncertainty_s=trial.time_uncertainty_s(name),
            time_problem=trial.time_problem(name),
        )
        self.summaries[name] = Summary(
            device.key,
            len(device),
            calibrated,
            tuple(device.fields),
            len(device.missing),
            sum(m.stop_s - m.start_s for m in device.missing),
            sum(m.samples is None for m in device.missing),
            device.missing_samples,
            device.time_uncertainty_s,
            device.time_problem,
        )
        return device

    def leave_out(self, name: str) -> None:
        """Take a device that a format cannot hold out of what was exported."""
        del self.summaries[name]

    @property
    def chosen_keys(self) -> list[str]:
        """The keys of the chosen devices."""
        return [self.keys[name] for name in self.names]

    @cached_property
    def markers(self) -> list[Marked]:
        """The moments that a person marked, in printable text."""
        start_ns = dated(self.trial.start_utc_ns)
        return [
            Marked(mark.t, start_ns + round(mark.t * 1e9), one_line(mark.label))
            for mark in self.trial.markers
        ]

    @cached_property
    def about(self) -> dict[str, str]:
        """What is known about the trial, as text."""
        config: dict[str, Any] = self.trial.config
        said = {k: one_line(v) for k in ABOUT if isinstance(v := config.get(k), str)}
        return {
            **said,
            "file": one_line(self.trial.path.name),
            "start_utc": iso_utc(self.trial.start_utc_ns),
            "ended": one_line(self.trial.ended or "cut off"),
        }


def dated(start_utc_ns: int | None) -> int:
    """Return the start of a trial [ns since 1970 UTC], or what stands in for it."""
    return STAND_IN_NS if start_utc_ns is None else start_utc_ns


def iso_utc(utc_ns: int | None) -> str:
    """Write a wall clock time as ``2026-05-04T12:00:00.000000Z``, None as "unknown"."""
    return UNKNOWN if utc_ns is None else utc_text(utc_of(utc_ns))


def parts(values: FloatArray) -> list[str]:
    """Return names for the numbers of a field, which are one if it has shape (n,)."""
    if values.ndim == 1:
        return [""]
    count = values.shape[1]
    return list("xyz") if count == 3 else [str(number + 1) for number in range(count)]


def inertial_fields(samples: Samples) -> list[str]:
    """Return the fields that are specific force, angular rate or magnetic field in SI units."""
    return [
        name
        for name, unit in INERTIAL.items()
        if samples.units.get(name) == unit and samples.values[name].shape[1:] == (3,)
    ]


def temperature(samples: Samples) -> FloatArray | None:
    """Return the device's temperature [degC], if it sends one."""
    there = samples.units.get("temperature") == "degC" and samples.values["temperature"].ndim == 1
    return samples.values["temperature"] if there else None


def unit_word(unit: str) -> str:
    """Return a unit as a part of a name: "m/s2" as mps2, "%" as percent."""
    spelled = unit.replace("/", "p").replace("%", "percent").replace("°", "deg").replace("µ", "u")
    return re.sub(r"[^A-Za-z0-9]+", "", spelled)


def calibrate(samples: Samples, certificate: Certificate) -> tuple[Samples, tuple[str, ...]]:
    """Apply a certificate; return the samples and the fields it changed.

    Raises
    ------
    InputError
        If the samples are of no inertial sensor.
    """
    fields = inertial_fields(samples)
    if not (samples.is_inertial and fields):
        raise InputError("A certificate is of an inertial sensor, and this device is none.")
    known = {name: samples.values[name] for name in fields}
    nothing = np.full((len(samples), 3), np.nan)
    block = ImuBlock(
        t=samples.t,
        accel=known.get("accel", nothing),
        gyro=known.get("gyro", nothing),
        host_s=samples.host_s,
        mag=known.get("mag"),
        temperature=temperature(samples),
    )
    applied = apply_certificate(certificate, block)
    changed = tuple(name for name in fields if name in certificate.calibrated)
    new = {name: getattr(applied, name) for name in changed}
    return replace(samples, values=samples.values | new), changed
