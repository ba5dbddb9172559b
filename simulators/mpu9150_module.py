"""The jig's own sensor module: an MPU-9150 whose firmware sends any fixed packet by Bluetooth."""

from __future__ import annotations

import numpy as np

from firmware_protocols.layout import PacketLayout, load_layout
from simulators.encoders import Encoder, LayoutEncoder
from simulators.imu_kinds import ImuKind
from simulators.models import FirmwareModel
from simulators.mpu9150 import MPU9150_RANGES


def _firmware(model: FirmwareModel, rng: np.random.Generator) -> Encoder:
    del rng
    layout = model.layout
    read = PacketLayout.from_dict(layout) if isinstance(layout, dict) else load_layout(layout)
    return LayoutEncoder(read, model.rate_hz)


MPU9150_MODULE = ImuKind(
    name="mpu9150",
    title="MPU-9150 module over Bluetooth: +-8 g, +-1000 deg/s",
    protocol="mpu9150-28",
    output_hz=100.0,
    ranges=MPU9150_RANGES,
    encoder=_firmware,
    any_layout=True,
)
