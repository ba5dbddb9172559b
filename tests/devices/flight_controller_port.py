"""Simulated flight controllers at rest: on a pseudo-terminal, or in a time of their own."""

import threading
import time
from contextlib import ExitStack, contextmanager

import numpy as np

from imu_rig.units import STANDARD_GRAVITY
from simulators.encoders import MadeSamples
from simulators.flight_controller import FlightController
from simulators.inertial_sensor import Readings
from simulators.ports import port_maker

PUMP_S = 0.003


class AtRest:
    """A flight controller on a level table, up to a moment."""

    def __init__(self, model):
        self.controller = FlightController(model)
        self._made, self._made_s = 0, 0.0
        self._rng = np.random.default_rng(0)

    def until(self, now_s):
        """What it sends up to this moment."""
        period_s = 1.0 / self.controller.sample_hz
        number = int((now_s - self._made_s) / period_s)
        if not number:
            return b""
        t = self._made_s + period_s * np.arange(1, number + 1)
        up = np.array((0.0, 0.0, STANDARD_GRAVITY))
        readings = Readings(
            accel=up + self._rng.normal(0, 0.02, (number, 3)),
            gyro=self._rng.normal(0, 0.002, (number, 3)),
            mag=np.array((18.0, 0.0, -44.0)) + self._rng.normal(0, 0.3, (number, 3)),
            temperature=np.full(number, 31.0),
            saturated=np.zeros(number, bool),
            offsets=np.zeros((number, 6)),
        )
        samples = MadeSamples(
            t=t,
            device_s=t,
            counter=self._made + np.arange(number),
            readings=readings,
            pressure=np.full(number, 100_000.0),
            air_c=np.full(number, 25.0),
        )
        self._made += number
        self._made_s += number * period_s
        return b"".join(self.controller.encode(samples))


class Table:
    """Flight controllers on one line, in a time that passes when somebody listens.

    ``monotonic`` is that time, for modules under test.
    """

    def __init__(self, *models):
        self.devices = [AtRest(model) for model in models]
        self.controllers = [device.controller for device in self.devices]
        self.now_s = 0.0
        self.sent = []
        self._said = b""

    def monotonic(self):
        return self.now_s

    def write(self, data):
        self.sent.append(data)
        for controller in self.controllers:
            self._said += controller.receive(data, self.now_s)

    def hear(self, timeout_s):
        self.now_s += timeout_s
        heard, self._said = self._said, b""
        return heard + b"".join(device.until(self.now_s) for device in self.devices)

    def run(self, conversation, seconds):
        """Let a reader read, as the real one does, and return what it read."""
        heard = b""
        for _ in range(round(seconds)):
            for _ in range(10):
                heard += (piece := self.hear(0.1))
                conversation.heard(piece)
            conversation.keep(self.write)
        return heard


class _Served:
    def __init__(self, port, model):
        self._device = AtRest(model)
        self.controller = self._device.controller
        self._port = port
        self.url = port.url
        self._start_s = time.monotonic()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="flight controller")
        self._thread.start()

    def _run(self):
        while not self._stopping.wait(PUMP_S):
            now_s = time.monotonic() - self._start_s
            heard = self._port.read()
            said = self.controller.receive(heard, now_s) if heard else b""
            if said := said + self._device.until(now_s):
                self._port.write(said)

    def stop(self):
        self._stopping.set()
        self._thread.join()


@contextmanager
def served(model):
    """A flight controller in real time on a pseudo-terminal."""
    with ExitStack() as resources:
        port = port_maker("pty", resources)("pixhawk")
        device = _Served(port, model)
        resources.callback(device.stop)
        yield device
