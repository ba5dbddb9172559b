"""A simulated rig on real ports: the world, a clock to drive it, faults, and its truth."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Self

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.clock import NS_PER_S, Clock, ScaledClock, SteppedClock
from simulators.config import RigConfig
from simulators.models import JigModel, Matrix3, Vector3
from simulators.ports import SimulatedPort, Transport, port_maker, wait_readable
from simulators.world import World, WorldState

__all__ = ["AffineTruth", "RigConfig", "RigTruth", "SimulatedRig"]

DEVICES = ("imu", "maestro")

PUMP_PERIOD_S = 0.004
"""Longest time on the rig's clock between two looks at the ports."""

SHORTEST_WAIT_S = 0.001
"""Shortest wait of the machine's time; a faster clock gets larger steps instead."""

SLICE_S = 0.05
"""Longest step of the world between two looks at the ports, when it lags behind its clock."""

LEAD_S = 0.1
"""So far a clock that is faster than life may run ahead of the world; then it waits for it."""


@dataclass(frozen=True)
class AffineTruth:
    """The calibration that is true: the physical quantity is ``K @ raw - b``.

    Attributes
    ----------
    K : shape (3, 3)
    b : shape (3,)
        In the output unit, at the start and for the warm sensor.
    """

    K: FloatArray
    b: FloatArray

    def apply(self, raw: FloatArray) -> FloatArray:
        """Return the calibrated values of raw ones, shape (n, 3)."""
        calibrated: FloatArray = raw @ self.K.T - self.b
        return calibrated


@dataclass(frozen=True)
class RigTruth:
    """What a calibration of the rig should find.

    Attributes
    ----------
    accel, gyro, mag : AffineTruth
        In m/s^2, rad/s and uT, on the sensor's axes.
    jig : JigModel
    gravity : float
        m/s^2.
    earth_rate, field : shape (3,)
        Rotation of the Earth [rad/s] and magnetic field [uT] in navigation axes.
    """

    accel: AffineTruth
    gyro: AffineTruth
    mag: AffineTruth
    jig: JigModel
    gravity: float
    earth_rate: FloatArray
    field: FloatArray

    @classmethod
    def of(cls, config: RigConfig) -> RigTruth:
        """Return the truth of a configuration."""
        sensor = config.sensor
        return cls(
            accel=_affine(sensor.accel_gain, sensor.accel_offset),
            gyro=_affine(sensor.gyro_gain, sensor.gyro_offset),
            mag=_affine(sensor.mag_gain, sensor.mag_offset),
            jig=config.jig,
            gravity=config.gravity,
            earth_rate=_constant(config.earth_rate),
            field=_constant(config.field_ut),
        )


class SimulatedRig:
    """A jig, a sensor and a servo controller that any program can open.

    On a running clock a thread keeps the world in step with it. A :class:`SteppedClock` has no
    thread: :meth:`step` moves clock and world together.

    Parameters
    ----------
    config : RigConfig
    clock : Clock
        World time follows it from the start on.
    transport : str
        "pty" for pseudo-terminals, "tcp" for sockets.

    Raises
    ------
    LayoutError, ValueError
        If the configuration cannot be used.
    """

    def __init__(self, config: RigConfig, *, clock: Clock, transport: Transport = "pty") -> None:
        self.config = config
        self.truth = RigTruth.of(config)
        self.world = World(config)
        self._clock = clock
        self._transport = transport
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._ports: dict[str, SimulatedPort] = {}
        self._resources = ExitStack()
        self._origin_ns = 0

    def __enter__(self) -> Self:
        """Start."""
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Stop."""
        self.stop()

    @property
    def imu_url(self) -> str:
        """What a program opens for the sensor; the same over unplugging and replugging."""
        return self.ports()["imu"]

    @property
    def maestro_url(self) -> str:
        """What a program opens for the servo controller's command port."""
        return self.ports()["maestro"]

    def ports(self) -> dict[str, str]:
        """Return the address of every device's port, from the start on."""
        if not self._ports:
            raise RuntimeError("the simulated rig has no ports before its start.")
        return {device: port.url for device, port in self._ports.items()}

    def start(self) -> None:
        """Open the ports and let time run. Does nothing the second time.

        Raises
        ------
        RuntimeError
            After :meth:`stop`.
        PortError
            If a port cannot be made.
        """
        if self._stopping.is_set():
            raise RuntimeError("the simulated rig was stopped; make a new one.")
        if self._ports:
            return
        with ExitStack() as resources:
            make = port_maker(self._transport, resources)
            ports = {device: make(device) for device in DEVICES}
            self._resources = resources.pop_all()
        self._ports = ports
        self._origin_ns = self._clock.now_ns() - round(self.world.t_s * NS_PER_S)
        if not isinstance(self._clock, SteppedClock):
            self._thread = threading.Thread(target=self._pump, name="simulated-rig", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Close and remove everything, and end the thread. Does nothing the second time."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        with self._lock:
            self._resources.close()

    def step(self, seconds: float) -> None:
        """Move a stepped clock and the world forward, serving the ports before and after.

        Raises
        ------
        RuntimeError
            If the clock runs by itself.
        """
        if not isinstance(self._clock, SteppedClock):
            raise RuntimeError("the rig's clock runs by itself; only a SteppedClock is stepped.")
        self._clock.advance(seconds)
        with self._lock:
            self._serve(self._now_s())

    def fault(self, device: str, word: str, *, duration_s: float | None = None) -> None:
        """Put a fault into effect now, until it is cleared or for a time.

        Parameters
        ----------
        device : str
            "imu", "maestro", or a servo: "pan", "tilt", "roll".
        word : str
            A fault of :data:`simulators.faults.SUPPORTED`.
        duration_s : float, optional
            World seconds it lasts; for a brownout, how long the device is silent.

        Raises
        ------
        ValueError
            For a fault that the device cannot have; the sentence lists those it can.
        """
        with self._lock:
            self.world.fault(device, word, duration_s)
            self._match_plugs()

    def clear(self, device: str) -> None:
        """End every fault of a device."""
        with self._lock:
            self.world.clear(device)
            self._match_plugs()

    def remount(self, turn: tuple[float, float, float]) -> None:
        """Put the sensor on the plate in another way; see `World.remount`."""
        with self._lock:
            self.world.remount(np.array(turn))

    def state(self) -> WorldState:
        """Return a picture of the world now."""
        with self._lock:
            return self.world.state()

    @property
    def lag_s(self) -> float:
        """How far the world is behind its clock [s]; grows when the machine is too slow."""
        with self._lock:
            return max(0.0, self._now_s() - self.world.t_s)

    @property
    def dropped(self) -> dict[str, int]:
        """Bytes of each device that were lost because its client did not read."""
        with self._lock:
            return {device: port.dropped for device, port in self._ports.items()}

    def truth_between(self, start_ns: int, stop_ns: int) -> RigTruth:
        """Return the truth with the mean offsets between two times on the rig's clock.

        Offsets walk, the gyroscope's by far more than a calibration is uncertain: this is what to
        compare a session's offsets with.
        """
        with self._lock:
            offsets = self.world.imu.sensor.offsets(
                (start_ns - self._origin_ns) / NS_PER_S, (stop_ns - self._origin_ns) / NS_PER_S
            )
        return replace(
            self.truth,
            accel=AffineTruth(self.truth.accel.K, _constant(offsets[:3])),
            gyro=AffineTruth(self.truth.gyro.K, _constant(offsets[3:])),
        )

    def _now_s(self) -> float:
        return (self._clock.now_ns() - self._origin_ns) / NS_PER_S

    def _serve(self, until_s: float) -> None:
        """Take what clients wrote, advance the world, and send what devices say."""
        for device, port in self._ports.items():
            self.world.receive(device, port.read())
        self.world.advance(until_s)
        self._match_plugs()
        for device, port in self._ports.items():
            port.write(self.world.take(device))

    def _match_plugs(self) -> None:
        for device, port in self._ports.items():
            plugged = self.world.plugged(device) and not self._stopping.is_set()
            if plugged != port.plugged:
                (port.plug if plugged else port.unplug)()

    def _pump(self) -> None:
        try:
            while not self._stopping.is_set():
                with self._lock:
                    behind_s = self._now_s() - self.world.t_s
                    self._serve(self.world.t_s + min(behind_s, SLICE_S))
                    self._hold_clock(self.world.t_s + LEAD_S)
                    descriptors = [d for port in self._ports.values() for d in port.descriptors()]
                if behind_s <= SLICE_S:
                    self._wait(descriptors)
                else:
                    self._stopping.wait(SHORTEST_WAIT_S)  # clients must get their turn
        finally:  # clients must see that nobody serves them any more
            self._hold_clock(None)
            with self._lock:
                for port in self._ports.values():
                    port.unplug()

    def _hold_clock(self, at_s: float | None) -> None:
        """Let a clock that can wait go no further than a world time."""
        if isinstance(self._clock, ScaledClock):
            self._clock.hold(self, None if at_s is None else self._origin_ns + at_s * NS_PER_S)

    def _wait(self, descriptors: list[int]) -> None:
        """Wait until a client writes or the next look is due.

        Only a hint: a descriptor may be closed meanwhile, and all ports are served afterwards.
        """
        seconds = max(PUMP_PERIOD_S / self._clock.speed, SHORTEST_WAIT_S)
        if not descriptors:
            self._stopping.wait(seconds)
            return
        wait_readable(descriptors, seconds)


def _affine(gain: Matrix3, offset: Vector3) -> AffineTruth:
    return AffineTruth(_constant(gain), _constant(offset))


def _constant(values: Matrix3 | Vector3 | FloatArray) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array
