"""Trials with known samples, for every format to be read back against."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from firmware_protocols.layout import PacketLayout, load_layout
from firmware_protocols.packets import encode
from imu_rig.clock import NS_PER_S, SteppedClock
from imu_rig.recording import RecordingOptions, Trial, TrialWriter, open_trial

START_NS = 1_790_000_000_123_456_789
"""Wall clock when the trial begins; it is put on by an hour at once."""
LATE_S = 0.002
MARKERS = [(0.5, "turn 90 °, =1+1"), (1.25, "long: " + "Ä" * 90)]
SUBJECT = {"kind": "trial", "subject": "P07", "session": "morning", "note": 'two, "quoted"'}


@dataclass(frozen=True)
class Device:
    """``count`` packets of a device, without those numbered in ``lost``."""

    name: str
    layout: str = "mpu9150-28"
    count: int = 300
    lost: Sequence[int] = ()
    descriptor: Any = None

    @property
    def packet_layout(self) -> PacketLayout:
        return load_layout(self.layout)

    @property
    def kept(self) -> np.ndarray:
        return np.setdiff1d(np.arange(self.count), list(self.lost))

    def counts(self) -> dict[str, np.ndarray]:
        """Counts of every field over the whole range of its type, the same for every run."""
        layout, rows = self.packet_layout, self.kept
        rng = np.random.default_rng(sum(map(ord, self.name)))
        columns = {}
        for field in layout.fields:
            if field.type == "pad":
                continue
            shape = (len(rows), field.count) if field.count > 1 else (len(rows),)
            low, high = field.limits
            columns[field.name] = rng.integers(low, high, shape, endpoint=True)
        columns[layout.counter] = rows % 256
        period_us = round(1e6 / layout.rate_hz)
        columns[layout.clock] = (period_us * rows) % (1 << 32)
        return columns

    def truth(self) -> dict[str, np.ndarray]:
        """What the device measured, by its data sheet: SI units, temperature in degC."""
        counts = self.counts()
        if self.layout == "baro-16":
            pressure, celsius = counts["pressure"] / 100.0, counts["temperature"] / 100.0
            return {"pressure": pressure, "temperature": celsius, "battery": counts["battery"]}
        x, y, z = counts["mag"].T
        return {
            "accel": counts["accel"] / 4096.0 * 9.80665,
            "gyro": np.deg2rad(counts["gyro"] / 32.8),
            "mag": np.column_stack([y, x, -z]) * 0.3,
            "status": counts["status"],
        }

    @property
    def t(self) -> np.ndarray:
        """Trial time of the samples [s]: they arrive `LATE_S` after they were made, as ever."""
        return self.kept / self.packet_layout.rate_hz + LATE_S

    def packets(self) -> list[tuple[int, bytes]]:
        """Arrival [ns] and bytes of each packet."""
        layout, rows = self.packet_layout, self.kept
        data = encode(layout, self.counts()) if len(rows) else b""
        size = layout.length
        arrival = np.rint((rows / layout.rate_hz + LATE_S) * NS_PER_S).astype(int).tolist()
        return [(t, data[size * i : size * (i + 1)]) for i, t in enumerate(arrival)]


LEFT = Device("left shoe", lost=range(100, 160))
RIGHT = Device("../왼발 \x1b[31m", count=250)
BARO = Device("barometer", layout="baro-16", count=120)
EMPTY = Device("Left_Shoe", count=0)
DEVICES = (LEFT, RIGHT, BARO, EMPTY)


def write_trial(path: Path, devices: Sequence[Device] = DEVICES, *, marked: bool = True) -> Trial:
    """Record the devices; the wall clock jumps by an hour after its first look."""
    clock, looks = SteppedClock(), []

    def wall_ns() -> int:
        looks.append(None)  # the header, the first clock pair, then an hour later
        return START_NS + clock.now_ns() + (3600 * NS_PER_S if len(looks) > 2 else 0)

    options = RecordingOptions(note_s=3600.0, sync_s=3600.0, wall_ns=wall_ns, reserve_bytes=0)
    with TrialWriter.create(path, SUBJECT, clock=clock, options=options) as trial:
        due: list[tuple[int, int, Any]] = []
        for device in devices:
            number = trial.add_source(
                device.name,
                "imu" if device.packet_layout.has("accel") else "sensor",
                {"layout": device.packet_layout.to_dict(), **(device.descriptor or {})},
            )
            due += [(t, number, data) for t, data in device.packets()]
        due += [(round(t * NS_PER_S), 0, label) for t, label in MARKERS] if marked else []
        for t_ns, number, what in sorted(due, key=lambda item: item[0]):
            clock.advance((t_ns - clock.now_ns()) / NS_PER_S)
            if number:
                trial.bytes_in(number, t_ns, what)
            else:
                trial.event("marker", label=what)
        trial.flush()
    return open_trial(path)


def float_trial(path: Path, layout: dict[str, Any], accel: np.ndarray, load: np.ndarray) -> Trial:
    """Record a device that sends floating-point numbers."""
    number = np.arange(len(accel))
    columns = {"seq": number, "time": 10_000 * number, "accel": accel, "load": load}
    packet_layout = PacketLayout.from_dict(layout)
    data, clock = encode(packet_layout, columns), SteppedClock()
    options = RecordingOptions(note_s=3600.0, sync_s=3600.0, reserve_bytes=0)
    with TrialWriter.create(path, SUBJECT, clock=clock, options=options) as trial:
        source = trial.add_source("floats", "imu", {"layout": layout})
        for start in range(0, len(data), packet_layout.length):
            clock.advance(0.01)
            trial.bytes_in(source, clock.now_ns(), data[start : start + packet_layout.length])
        trial.flush()
    return open_trial(path)
