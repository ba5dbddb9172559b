"""The configuration of a whole simulated rig, down to its seed."""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from firmware_protocols.known import load_protocol, protocol_from_dict
from firmware_protocols.layout import PacketLayout
from firmware_protocols.protocol import DeviceProtocol
from imu_rig.units import STANDARD_GRAVITY
from simulators.budget import Budget, draw_firmware, draw_jig, draw_sensor
from simulators.faults import PlannedFault
from simulators.imu_kinds import DEFAULT_KIND, IMU_KINDS, ImuKind, check_kind
from simulators.models import (
    ZERO,
    FirmwareModel,
    JigModel,
    MaestroMode,
    MaestroModel,
    Model,
    Positive,
    SensorModel,
    ServoModel,
    Vector3,
)

EARTH_RATE = 7.292115e-5
"""Rotation of the Earth [rad/s] (WGS-84)."""


def _usual(part: str) -> Any:
    """Return a default that is the usual part of the kind of IMU that was chosen."""

    def make(chosen: dict[str, Any]) -> Any:
        return getattr(IMU_KINDS[chosen.get("imu", DEFAULT_KIND)], part)

    return Field(default_factory=make)


class RigConfig(Model):
    """A jig, a sensor on it, a servo controller and the place where they stand.

    Attributes
    ----------
    seed : int
        Of everything random during a run: noise, drift, stops, bursts.
    gravity : float
        Local gravity [m/s^2].
    latitude_deg : float or None
        For the Earth's rotation, with x east and y north; None is an Earth at rest.
    field_ut : (float, float, float)
        Magnetic field in navigation axes [uT].
    pressure_pa, air_c : float
        Of the air, alike at all times [Pa, degC].
    imu : str
        Kind of IMU, a name of `simulators.imu_kinds.IMU_KINDS`; the defaults of sensor and
        firmware are those of the kind.
    jig, sensor, firmware, maestro : models
    maestro_mode : str
        "usb-dual-port", "usb-chained", or "uart-detect" as it comes from the factory.
    faults : tuple of PlannedFault
        Faults that come by themselves, at times since the start of the world.
    """

    seed: Annotated[int, Field(ge=0)] = 1
    gravity: Positive = STANDARD_GRAVITY
    latitude_deg: Annotated[float, Field(ge=-90.0, le=90.0)] | None = 45.0
    field_ut: Vector3 = (0.0, 22.0, -45.0)
    pressure_pa: Positive = 101_325.0
    air_c: float = 25.0
    imu: str = DEFAULT_KIND
    jig: JigModel = Field(default_factory=JigModel)
    sensor: SensorModel = _usual("sensor")
    firmware: FirmwareModel = _usual("firmware")
    maestro: MaestroModel = Field(default_factory=MaestroModel)
    maestro_mode: MaestroMode = "usb-dual-port"
    faults: tuple[PlannedFault, ...] = ()

    @model_validator(mode="before")
    @classmethod
    def _known_kind(cls, given: Any) -> Any:
        if isinstance(given, dict) and isinstance(imu := given.get("imu"), str):
            check_kind(imu)
        return given

    @property
    def kind(self) -> ImuKind:
        """The kind of IMU."""
        return IMU_KINDS[self.imu]

    @property
    def protocol(self) -> DeviceProtocol:
        """What the IMU speaks."""
        told = self.firmware.layout if self.kind.any_layout else self.kind.protocol
        return protocol_from_dict(told) if isinstance(told, dict) else load_protocol(told)

    @property
    def earth_rate(self) -> Vector3:
        """Rotation of the Earth in navigation axes [rad/s]."""
        if self.latitude_deg is None:
            return ZERO
        latitude = math.radians(self.latitude_deg)
        return 0.0, EARTH_RATE * math.cos(latitude), EARTH_RATE * math.sin(latitude)

    @classmethod
    def random(
        cls, seed: int, *, imu: str = DEFAULT_KIND, budget: Budget | None = None
    ) -> RigConfig:
        """Draw a rig from the error budgets; the same seed gives the same rig.

        Parameters
        ----------
        seed : int
        imu : str
            Kind of IMU.
        budget : Budget, optional
            In place of the kind's.

        Raises
        ------
        ValueError
            For a kind that there is not; the sentence lists them.
        """
        check_kind(imu)
        kind = IMU_KINDS[imu]
        budget = budget or kind.budget
        rng = np.random.default_rng([seed, 0])
        return cls(
            seed=seed,
            imu=imu,
            jig=draw_jig(rng, budget),
            sensor=draw_sensor(rng, budget, kind.sensor),
            firmware=draw_firmware(rng, budget, kind.firmware),
        )

    @classmethod
    def speaking(cls, protocol: DeviceProtocol, seed: int, stream: str | None = None) -> RigConfig:
        """Draw a rig with an IMU of the kind that speaks a protocol.

        Of a protocol with several inertial sensors, ``stream`` is the one on the jig.

        Packets of a fixed layout that no kind calls its own are sent by the one that sends any.

        Raises
        ------
        ValueError
            If no kind does; the sentence lists the kinds and what each speaks.
        """
        if len(protocol.inertial_streams) == 1:
            stream = None
        for name, kind in IMU_KINDS.items():
            if kind.protocol == protocol.name and stream in (None, kind.stream):
                return cls.random(seed, imu=name)
        if not (isinstance(protocol, PacketLayout) and protocol.inertial_streams):
            spoken = ", ".join(f"{kind.protocol} ({name})" for name, kind in IMU_KINDS.items())
            raise ValueError(
                f"no simulated IMU speaks {protocol.name}; take the protocol of one of them, "
                f"{spoken}, or a fixed packet layout with a field accel or gyro."
            )
        drawn = cls.random(seed)
        told = drawn.firmware.model_copy(update={"layout": protocol.to_dict()})
        return drawn.model_copy(update={"firmware": told})

    @classmethod
    def ideal(cls, seed: int = 1) -> RigConfig:
        """Return a rig without any error, noise or drift, on an Earth at rest.

        Servos still take their time, and readings are still whole counts.
        """
        usual = JigModel()

        def exact(servo: ServoModel) -> ServoModel:
            return ServoModel(
                channel=servo.channel,
                angle_deg=servo.angle_deg,
                pulse_us=servo.pulse_us,
                sine_deg=0.0,
                repeatability_deg=0.0,
                dead_band_us=0.0,
                backlash_deg=0.0,
                speed_dps=servo.speed_dps,
                acceleration_dps2=servo.acceleration_dps2,
                ring_hz=0.0,
            )

        return cls(
            seed=seed,
            latitude_deg=None,
            jig=JigModel(
                pan=exact(usual.pan),
                tilt=exact(usual.tilt),
                roll=exact(usual.roll),
                base_tilt_deg=(0.0, 0.0),
                tilt_skew_deg=0.0,
                roll_skew_deg=0.0,
                mounting_deg=ZERO,
                wobble_deg=0.0,
                lever_arm_m=ZERO,
                vibration_mg=0.0,
            ),
            sensor=SensorModel.exact(quantized=True),
            firmware=FirmwareModel(
                skew_ppm=0.0, clock_offset_s=0.0, burst_s=(0.0, 0.0), latency_s=0.0
            ),
        )
