"""What the simulators' tests share: decoding, a world to talk to, and rigs without noise."""

from collections.abc import Callable

import numpy as np
import pytest

from firmware_protocols.decoder import StreamDecoder
from firmware_protocols.layout import load_layout
from firmware_protocols.maestro import Command, encode
from firmware_protocols.packets import values
from imu_rig.units import DEG, STANDARD_GRAVITY
from simulators.config import RigConfig
from simulators.models import FirmwareModel
from simulators.world import World


class Conversation:
    """A world with a host that sends commands and decodes what the sensor says."""

    def __init__(self, config: RigConfig) -> None:
        self.world = World(config)
        self.layout = load_layout(config.firmware.layout)
        self.decoder = StreamDecoder(self.layout)

    def send(self, *commands: Command) -> bytes:
        """Send commands; return what has been answered by now."""
        for command in commands:
            self.world.receive("maestro", encode(command))
        return self.world.take("maestro")

    def run(self, seconds: float) -> np.ndarray:
        """Let time pass; return the packets of this time."""
        self.world.advance(self.world.t_s + seconds)
        return self.decoder.feed(self.world.take("imu")).rows

    def accel(self, rows: np.ndarray) -> np.ndarray:
        """Specific force [m/s^2]."""
        return values(self.layout, rows, "accel") * STANDARD_GRAVITY

    def gyro(self, rows: np.ndarray) -> np.ndarray:
        """Angular rate [rad/s]."""
        return values(self.layout, rows, "gyro") * DEG

    def mag(self, rows: np.ndarray) -> np.ndarray:
        """Magnetic field [uT]."""
        return values(self.layout, rows, "mag")


@pytest.fixture
def talk() -> Callable[[RigConfig], Conversation]:
    """Start a conversation with the world of a configuration."""
    return Conversation


@pytest.fixture
def exact_layout(tmp_path) -> str:
    """Path of a layout whose numbers are not rounded: to test the physics behind the counts."""
    path = tmp_path / "exact.toml"
    path.write_text(
        """
name = "exact"
title = "Readings in full precision"
byte_order = "big"
header = "C0 DE"
counter = "seq"
clock = "time"
clock_tick_s = 1e-6
rate_hz = 100.0
[[fields]]
name = "seq"
type = "u16"
[[fields]]
name = "time"
type = "u32"
[[fields]]
name = "accel"
type = "f64"
count = 3
unit = "g"
[[fields]]
name = "gyro"
type = "f64"
count = 3
unit = "deg/s"
[[fields]]
name = "mag"
type = "f64"
count = 3
unit = "uT"
[[fields]]
name = "temperature"
type = "f32"
unit = "degC"
[checksum]
kind = "crc32"
"""
    )
    return str(path)


@pytest.fixture
def exact(exact_layout: str) -> RigConfig:
    """An ideal rig whose readings are not rounded either."""
    ideal = RigConfig.ideal()
    return ideal.model_copy(
        update={
            "sensor": ideal.sensor.model_copy(update={"quantized": False}),
            "firmware": FirmwareModel(
                layout=exact_layout,
                skew_ppm=0.0,
                clock_offset_s=0.0,
                burst_s=(0.1, 0.1),
                latency_s=0.0,
            ),
        }
    )
