"""A device of some kind on a bench: moved as a test likes, heard through its own bytes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from imu_rig.devices.conversation import conversation_for
from imu_rig.devices.imu import inertial_stream
from imu_rig.imu_scaling import si_factors, si_values
from simulators.config import RigConfig
from simulators.encoders import MadeSamples
from simulators.inertial_sensor import InertialSensor
from simulators.sampling import Means

CHUNK_S = 5.0


def steady(config: RigConfig) -> RigConfig:
    """Return a rig whose sensor has its noise and its errors, but neither walk nor warm-up."""
    still = {"accel_walk_mg": 0.0, "gyro_walk_dps": 0.0, "warm_up_c": 0.0}
    return config.model_copy(update={"sensor": config.sensor.model_copy(update=still)})


class Bench:
    """Holds a device and moves it at will, without a jig, a port or a clock.

    Parameters
    ----------
    config : RigConfig
    """

    def __init__(self, config: RigConfig) -> None:
        self.protocol = config.protocol
        self._stream = inertial_stream(self.protocol, config.kind.stream)
        self.layout = self.protocol.streams[self._stream]
        self.encoder = config.kind.encoder(config.firmware, np.random.default_rng(1))
        self._sensor = InertialSensor(
            config.sensor, config.kind.sensor_ranges, np.random.default_rng(config.seed)
        )
        self._decoder = self.protocol.quick_decoder()  # of what it sends later on
        self._factors = si_factors(self.layout)
        self._config = config
        self._time_s, self._counter = 0.0, 0
        self._still = np.array((0.0, 0.0, config.gravity)), np.zeros(3), np.array(config.field_ut)
        self._answers = bytearray(self.encoder.boot(0.0))
        conversation = conversation_for(self.protocol)
        if conversation is not None:
            conversation.begin(self._write, self._hear)
        self._decoder.feed(bytes(self._answers))

    def readings(
        self,
        seconds: float,
        force: np.ndarray | None = None,
        rate: np.ndarray | None = None,
    ) -> Mapping[str, np.ndarray]:
        """Return what the device sends in SI units while it is held or turned so."""
        steady_force, steady_rate, field = self._still
        force = steady_force if force is None else force
        rate = steady_rate if rate is None else rate
        parts = []
        while seconds > 1e-9:
            data = self._made(min(seconds, CHUNK_S), force, rate, field)
            rows = self._decoder.feed(data).get(self._stream)
            if rows is not None and len(rows):
                parts.append(si_values(self.layout, rows.rows, self._factors))
            seconds -= CHUNK_S
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def _made(
        self, seconds: float, force: np.ndarray, rate: np.ndarray, field: np.ndarray
    ) -> bytes:
        hz = self.encoder.sample_hz
        number = round(seconds * hz)
        t = self._time_s + np.arange(1, number + 1) / hz
        means = Means(
            t=t,
            duration=np.full(number, 1.0 / hz),
            force=np.broadcast_to(force, (number, 3)),
            rate=np.broadcast_to(rate, (number, 3)),
            field=np.broadcast_to(field, (number, 3)),
        )
        samples = MadeSamples(
            t=t,
            device_s=t + self._config.firmware.clock_offset_s,
            counter=self._counter + np.arange(number),
            readings=self._sensor.read(means, None),
            pressure=np.full(number, self._config.pressure_pa),
            air_c=np.full(number, self._config.air_c),
        )
        self._time_s, self._counter = float(t[-1]), self._counter + number
        return b"".join(self.encoder.encode(samples))

    def _write(self, data: bytes) -> None:
        self._answers += self.encoder.receive(data, self._time_s)

    def _hear(self, timeout_s: float) -> bytes:
        self._answers += self._made(min(timeout_s, 0.05), *self._still)
        heard = bytes(self._answers)
        self._answers.clear()
        return heard
