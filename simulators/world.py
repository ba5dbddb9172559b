"""The shared world: servo controller, servos, jig, sensor and firmware, advanced in small steps.

A deterministic state machine without threads, clocks or ports. Bytes from the host go in with
:meth:`World.receive`, bytes to the host come out with :meth:`World.take`. The same configuration,
bytes and times give the same world, bit for bit.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.rotation import from_rotation_vector, multiply, to_rotation_vector
from imu_rig.units import DEG
from simulators.config import RigConfig
from simulators.faults import (
    IMU_BROWNOUT_S,
    MAESTRO_BROWNOUT_S,
    FaultSet,
    check_device,
    check_fault,
)
from simulators.imu_firmware import Air, ImuFirmware
from simulators.inertial_sensor import InertialSensor
from simulators.jig import Jig
from simulators.maestro_board import MaestroBoard
from simulators.pose_errors import draw_pose_errors
from simulators.sampling import Sampler
from simulators.servo import NEW_STOP_AFTER_S, STEP_S, Follower, Servo

AXES = ("pan", "tilt", "roll")
STEPS_PER_TICK = 10
TICKS_PER_PULSE = 2
WOBBLE_BANDWIDTH_HZ = 4.0


@dataclass(frozen=True)
class WorldState:
    """The world at one moment, for tests and displays.

    Attributes
    ----------
    t_s : float
        World time.
    pulses_us : mapping of axis to pulse width, 0 for none
    angles_deg : mapping of axis to the true angle of the axis
    attitude : shape (3, 3)
        True rotation matrix, sensor to navigation axes.
    moving : bool
        Whether any axis moves.
    temperature_c : float
    faults : mapping of device to whether a fault is in effect
    """

    t_s: float
    pulses_us: Mapping[str, float]
    angles_deg: Mapping[str, float]
    attitude: FloatArray
    moving: bool
    temperature_c: float
    faults: Mapping[str, bool]


class World:
    """Everything but ports and clock.

    Parameters
    ----------
    config : RigConfig

    Raises
    ------
    LayoutError
        If the packet layout of the configuration cannot be used.
    ValueError
        If a servo is plugged into a channel that the board does not have.
    """

    def __init__(self, config: RigConfig) -> None:
        kind = config.kind
        encoder = kind.encoder(config.firmware, np.random.default_rng([config.seed, 3]))
        models = {axis: getattr(config.jig, axis) for axis in AXES}
        for axis, model in models.items():
            if model.channel >= config.maestro.channels:
                raise ValueError(
                    f"{axis}: channel {model.channel} is not on a Maestro with "
                    f"{config.maestro.channels} channels; take a lower one or a larger board."
                )
        seeds = np.random.SeedSequence([config.seed, 1]).spawn(8)
        rngs = [np.random.default_rng(seed) for seed in seeds]
        self.config = config
        self.jig = Jig(
            config.jig,
            gravity=config.gravity,
            earth_rate=config.earth_rate,
            field=config.field_ut,
        )
        self.servos = {
            axis: Servo(models[axis], rng) for axis, rng in zip(AXES, rngs[:3], strict=True)
        }
        self.imu = ImuFirmware(
            config.firmware,
            encoder,
            InertialSensor(config.sensor, kind.sensor_ranges, rngs[3]),
            Sampler(self.jig, 0.0),
            Air(config.pressure_pa, config.air_c),
            rng=rngs[4],
            garbage_rng=rngs[5],
        )
        self.maestro = MaestroBoard(config.maestro, config.maestro_mode, rngs[6])
        self._pose_rng = rngs[7]
        self._remount_rng = np.random.default_rng([config.seed, 2])
        self._wobble = [Follower(0.0, WOBBLE_BANDWIDTH_HZ) for _ in range(3)]
        self._joints: tuple[Servo | Follower, ...] = (*self.servos.values(), *self._wobble)
        self._steps = 0
        self._last_move_s = -math.inf
        self._event_numbers = itertools.count()
        self._events: list[tuple[int, int, Callable[[], None]]] = []
        for planned in config.faults:
            self._at(planned.at_s, self._planned(planned.device, planned.word, planned.duration_s))
        self._flush()

    @property
    def t_s(self) -> float:
        """World time [s]."""
        return self._steps * STEP_S

    def advance(self, t_s: float) -> None:
        """Run until a world time, or do nothing if it has passed."""
        end = int(t_s / STEP_S + 1e-6)
        while self._steps < end:
            next_event = self._events[0][0]
            self._run(min(end, max(next_event, self._steps)))
            while self._events[0][0] <= self._steps:
                heapq.heappop(self._events)[2]()

    def receive(self, device: str, data: bytes) -> None:
        """Take bytes that the host wrote to a device's port."""
        if device == "maestro":
            self.maestro.receive(data, self.t_s)
        else:
            self.imu.receive(data, self.t_s)

    def take(self, device: str) -> bytes:
        """Return the bytes of a device that have arrived at the host's port."""
        return (self.imu if device == "imu" else self.maestro).outbox.take(self.t_s)

    def plugged(self, device: str) -> bool:
        """Return whether a device's port is there."""
        return not self._faults(device).has("unplug")

    def fault(self, device: str, word: str, duration_s: float | None = None) -> None:
        """Put a fault into effect now.

        Raises
        ------
        ValueError
            For a fault that the device cannot have; the sentence lists those it can.
        """
        check_fault(device, word, duration_s)
        self.imu.catch_up(self.t_s)
        if word == "reset":
            (self.imu.boot(self.t_s) if device == "imu" else self.maestro.boot())
            return
        if word == "brownout":
            self._brownout(device, duration_s)
            return
        faults = self._faults(device)
        faults.start(word, self.t_s, duration_s)
        self._faults_changed(device)
        if duration_s is not None:
            self._at(self.t_s + duration_s, lambda: self._expire(device))

    def clear(self, device: str) -> None:
        """End every fault of a device."""
        check_device(device)
        self.imu.catch_up(self.t_s)
        self._faults(device).clear()
        self._faults_changed(device)

    def remount(self, turn: FloatArray) -> None:
        """Put the sensor on the plate in another way, at once.

        It sits as askew as before, in another direction; its first place is kept exactly.

        Parameters
        ----------
        turn : shape (3,)
            Nominal rotation vector of the sensor on the plate [rad].
        """
        self.imu.catch_up(self.t_s)
        askew = np.array(self.config.jig.mounting_deg) * DEG
        if np.any(turn):
            size = float(np.linalg.norm(askew)) / math.sqrt(3.0)
            askew = self._remount_rng.normal(0.0, size, 3)
        mounted = multiply(from_rotation_vector(np.asarray(turn)), from_rotation_vector(askew))
        x, y, z = (to_rotation_vector(mounted) / DEG).tolist()
        self.jig = Jig(
            self.config.jig.model_copy(update={"mounting_deg": (x, y, z)}),
            gravity=self.config.gravity,
            earth_rate=self.config.earth_rate,
            field=self.config.field_ut,
        )
        self.imu.sampler.remount(self.jig)

    def state(self) -> WorldState:
        """Return a picture of this moment."""
        pulses = self.maestro.pulses_us()
        angles = np.array([[joint.angle for joint in self._joints]])
        devices = ("imu", "maestro", *AXES)
        return WorldState(
            t_s=self.t_s,
            pulses_us={axis: pulses[s.model.channel] for axis, s in self.servos.items()},
            angles_deg={axis: s.angle / DEG for axis, s in self.servos.items()},
            attitude=self.jig.attitude(angles)[0],
            moving=not all(s.resting for s in self.servos.values()),
            temperature_c=float(self.imu.sensor.temperature(np.array(self.t_s))),
            faults={device: bool(self._faults(device)) for device in devices},
        )

    def _run(self, end: int) -> None:
        """Step the mechanics up to a step number."""
        steps = self._steps
        rows = self.imu.sampler.steps
        pan, tilt, roll = self.servos.values()
        while steps < end:
            if steps % STEPS_PER_TICK == 0:
                self._steps = steps
                self._tick(steps // STEPS_PER_TICK)
            until = min(end, steps - steps % STEPS_PER_TICK + STEPS_PER_TICK)
            if all(joint.resting for joint in self._joints):
                still = [x for joint in self._joints for x in (joint.angle, 0.0, 0.0)]
                rows.extend(still * (until - steps))
                steps = until
                continue
            wobbling = not all(joint.resting for joint in self._wobble)
            wobble: tuple[float, ...] = ()
            while steps < until:
                if wobbling or not wobble:
                    wobble = self._step_wobble()
                rows.extend((*pan.step(), *tilt.step(), *roll.step(), *wobble))
                steps += 1
        self._steps = steps

    def _step_wobble(self) -> tuple[float, ...]:
        x, y, z = self._wobble
        return (*x.step(), *y.step(), *z.step())

    def _tick(self, number: int) -> None:
        now_s = number * STEPS_PER_TICK * STEP_S
        self.maestro.tick(now_s)
        if number % TICKS_PER_PULSE:
            return
        channels = self.maestro.channels
        moved = [
            servo.hear(channels[servo.model.channel].position / 4.0, now_s)
            for servo in self.servos.values()
        ]
        if any(moved):
            if now_s - self._last_move_s > NEW_STOP_AFTER_S:
                self._new_pose(now_s)
            self._last_move_s = now_s

    def _new_pose(self, now_s: float) -> None:
        """Let the plate wobble to where it stands in this pose, and buzz as it does there."""
        self.imu.catch_up(now_s)
        errors = draw_pose_errors(self.config.jig, self._pose_rng)
        for follower, angle in zip(self._wobble, errors.wobble.tolist(), strict=True):
            follower.aim(angle)
        self.imu.vibration = errors.vibration

    def _at(self, t_s: float, action: Callable[[], None]) -> None:
        step = math.ceil(t_s / STEP_S - 1e-6)
        heapq.heappush(self._events, (step, next(self._event_numbers), action))

    def _flush(self) -> None:
        self.imu.flush(self.t_s)
        self._at(max(self.imu.flush_at_s, self.t_s + STEP_S), self._flush)

    def _planned(self, device: str, word: str, duration_s: float | None) -> Callable[[], None]:
        return lambda: self.fault(device, word, duration_s)

    def _brownout(self, device: str, duration_s: float | None) -> None:
        if device == "imu":
            self.imu.power_down()
            up_at_s = self.t_s + (duration_s or IMU_BROWNOUT_S)
            self._at(up_at_s, lambda: self.imu.boot(self.t_s))
        else:
            self.maestro.power_down()
            self._at(self.t_s + (duration_s or MAESTRO_BROWNOUT_S), self.maestro.boot)

    def _expire(self, device: str) -> None:
        self.imu.catch_up(self.t_s)
        self._faults(device).expire(self.t_s)
        self._faults_changed(device)

    def _faults(self, device: str) -> FaultSet:
        if device in self.servos:
            return self.servos[device].faults
        return self.imu.faults if device == "imu" else self.maestro.faults

    def _faults_changed(self, device: str) -> None:
        if device in self.servos:
            self.servos[device].aim()
            return
        controller = self.imu if device == "imu" else self.maestro
        controller.set_stuck(controller.faults.has("stuck"))
