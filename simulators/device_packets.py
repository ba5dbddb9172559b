"""Packets of any layout without a simulated world: a plausible motion that repeats.

Made in blocks from a loop of a few seconds whose counts are settled once, so that many fast devices
cost little. Counter, clock and supply go on from packet to packet and are those of a real device.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_protocols.layout import Field, PacketLayout
from firmware_protocols.ms5803 import counts_for
from firmware_protocols.packets import encode, quantize
from imu_rig.arrays import FloatArray
from imu_rig.units import ACCELERATION_UNITS, FIELD_UNITS, RATE_UNITS, STANDARD_GRAVITY
from simulators.mma7260 import NOMINAL_SUPPLY_V
from simulators.ms5803_chip import typical_prom

LOOP_S = 8.0
"""The motion repeats after this; every frequency in it is a whole number of turns per loop."""

SWINGS = ((0.35, 4, 0.10, 9), (0.45, 8, 0.05, 17), (0.60, 5, 0.08, 13))
"""Roll, pitch and yaw: two swings each, as amplitude [rad] and turns per loop."""

PUSHES = ((1.5, 8), (0.8, 16), (2.5, 16))
"""Acceleration over the ground in x, y, z: amplitude [m/s^2] and turns per loop."""

FIELD_UT = (18.0, 0.0, -44.0)
NOISE = {"accel": 0.02, "gyro": 0.002, "mag": 0.3}  # m/s^2, rad/s, uT, standard deviations
CELL_NAMES = ("battery", "voltage")
FULL_V, FALL_V_PER_H = 4.15, 0.06  # of a lithium cell
FALL_PERCENT_PER_H = 8.0

RAIL_NAME = "supply"
"""What a board calls what feeds its sensor: it is regulated and does not fall."""

RAIL_V = 5.0  # as an ADIS16405 has it
RAILS_V = {"waist-unit.accel": NOMINAL_SUPPLY_V}  # of layouts, where it is another

PRESSURE_UNITS = {"Pa": 1.0, "hPa": 100.0, "mbar": 100.0, "kPa": 1000.0, "bar": 1e5}

Columns = dict[str, np.ndarray[Any, Any]]


class DevicePackets:
    """Makes the packets of one device, any stretch of them, with numbers counted from its start.

    Parameters
    ----------
    layout : PacketLayout
    rate_hz : float
    seed : int
        Of the phases, the noise and what the clock shows at the start.
    """

    def __init__(self, layout: PacketLayout, rate_hz: float, seed: int) -> None:
        self._layout, self._rate_hz = layout, rate_hz
        rng = np.random.default_rng(seed)
        self._loop = _loop(layout, max(1, round(LOOP_S * rate_hz)), rng)
        self._clock_s = float(rng.uniform(0.0, 3600.0))

    def reset_clock(self) -> None:
        """Let the clock begin at zero with the packet of number zero, as after power-up."""
        self._clock_s = 0.0

    def make(self, first: int, number: int) -> bytes:
        """Return packets ``first`` to ``first + number - 1`` on the wire."""
        layout = self._layout
        numbers = first + np.arange(number, dtype=np.int64)
        made_s = (numbers + 1) / self._rate_hz
        columns: Columns = {}
        for field in layout.fields:
            if field.name == layout.counter:
                columns[field.name] = numbers % (field.limits[1] + 1)
            elif field.name == layout.clock:
                ticks = np.floor((self._clock_s + made_s) / layout.clock_tick_s + 0.5)
                columns[field.name] = ticks.astype(np.int64) % (field.limits[1] + 1)
            elif field.name in CELL_NAMES and field.count == 1:
                columns[field.name] = quantize(layout, field.name, _cell(field, made_s))
            elif field.name == RAIL_NAME and field.count == 1:
                rail = np.full(number, RAILS_V.get(layout.name, RAIL_V))
                columns[field.name] = quantize(layout, field.name, _in_unit(field, rail))
            elif field.type != "pad":
                loop = self._loop[field.name]
                columns[field.name] = loop[numbers % len(loop)]
        return encode(layout, columns)


def _loop(layout: PacketLayout, number: int, rng: np.random.Generator) -> Columns:
    """Return the counts of every measured field over one loop."""
    turn = 2 * math.pi * np.arange(number) / number
    motion = loop_motion(turn, LOOP_S, rng)
    loop = _barometer(layout, turn)
    # a range setting stays on the one that the readings are counted in
    settings = {f.scale_by: f.scales[0][0] for f in layout.fields if f.scale_by is not None}
    for field in layout.fields:
        if field.type == "pad" or field.name in loop:
            continue
        if field.name in settings:
            loop[field.name] = np.full(number, settings[field.name], dtype=np.int64)
            continue
        shape = (number, field.count) if field.count > 1 else (number,)
        values = _values(field, motion, turn)
        if values is None or values.shape != shape:
            loop[field.name] = np.zeros(shape, dtype=np.int64)
        else:
            loop[field.name] = quantize(layout, field.name, values)
    return loop


def _barometer(layout: PacketLayout, turn: FloatArray) -> Columns:
    """Return what a barometer of the MS5803 family counts, where the layout has one."""
    raw = layout.barometer
    if raw is None:
        return {}
    prom = typical_prom(raw.variant)
    d1, d2 = counts_for(raw.variant, prom, air_pressure(turn), air_temperature(turn))
    return {raw.prom: np.tile(prom, (len(turn), 1)), raw.d1: d1, raw.d2: d2}


def air_pressure(turn: FloatArray) -> FloatArray:
    """Return the pressure of the air over one loop [Pa]."""
    return 101_325.0 + 12.0 * np.sin(turn)


def air_temperature(turn: FloatArray) -> FloatArray:
    """Return the temperature of the sensor over one loop [degC]."""
    return 31.0 + 0.2 * np.sin(turn)


def loop_motion(turn: FloatArray, loop_s: float, rng: np.random.Generator) -> dict[str, FloatArray]:
    """Return specific force, rate and field on the sensor's axes, in SI units and uT, with noise.

    The rates are the derivatives of the attitude that turns gravity and field.
    """
    angles, speeds = np.zeros((3, len(turn))), np.zeros((3, len(turn)))
    for axis, (wide, slow, narrow, quick) in enumerate(SWINGS):
        for amplitude, turns in ((wide, slow), (narrow, quick)):
            phase = turns * turn + rng.uniform(0, 2 * math.pi)
            angles[axis] += amplitude * np.sin(phase)
            speeds[axis] += amplitude * np.cos(phase) * turns * 2 * math.pi / loop_s
    push = np.stack(
        [a * np.sin(turns * turn + rng.uniform(0, 2 * math.pi)) for a, turns in PUSHES], axis=1
    )
    roll, pitch, _ = angles
    rate = np.stack(
        (
            speeds[0] - speeds[2] * np.sin(pitch),
            speeds[1] * np.cos(roll) + speeds[2] * np.cos(pitch) * np.sin(roll),
            -speeds[1] * np.sin(roll) + speeds[2] * np.cos(pitch) * np.cos(roll),
        ),
        axis=1,
    )
    exact = {
        "accel": _on_sensor(angles, push + np.array([0.0, 0.0, STANDARD_GRAVITY])),
        "gyro": rate,
        "mag": _on_sensor(angles, np.broadcast_to(FIELD_UT, (len(turn), 3))),
    }
    return {name: v + rng.normal(0, NOISE[name], v.shape) for name, v in exact.items()}


def _on_sensor(angles: FloatArray, vectors: FloatArray) -> FloatArray:
    """Turn vectors from the ground's axes to the sensor's by yaw, pitch and roll."""
    x, y, z = vectors.T
    (roll, pitch, yaw) = angles
    x, y = np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x
    x, z = np.cos(pitch) * x - np.sin(pitch) * z, np.cos(pitch) * z + np.sin(pitch) * x
    y, z = np.cos(roll) * y + np.sin(roll) * z, np.cos(roll) * z - np.sin(roll) * y
    return np.stack((x, y, z), axis=1)


def _values(field: Field, motion: dict[str, FloatArray], turn: FloatArray) -> FloatArray | None:
    """Return a field's values in its unit; None for a field of which nothing is known."""
    match field.name:
        case "accel":
            return motion["accel"] / ACCELERATION_UNITS.get(field.unit, 1.0)
        case "gyro":
            return motion["gyro"] / RATE_UNITS.get(field.unit, 1.0)
        case "mag":
            return motion["mag"] / FIELD_UNITS.get(field.unit, 1.0)
        case "temperature":
            return air_temperature(turn)
        case "pressure":
            return air_pressure(turn) / PRESSURE_UNITS.get(field.unit, 1.0)
        case _:
            return None


def _cell(field: Field, since_s: FloatArray) -> FloatArray:
    hours = since_s / 3600.0
    if field.unit == "%":
        return np.maximum(0.0, 98.0 - FALL_PERCENT_PER_H * hours)
    return _in_unit(field, np.maximum(3.3, FULL_V - FALL_V_PER_H * hours))


def _in_unit(field: Field, volts: FloatArray) -> FloatArray:
    return volts * {"mV": 1000.0}.get(field.unit, 1.0)
