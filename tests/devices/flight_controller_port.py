"""A simulated flight controller at rest on a pseudo-terminal, in real time."""

import threading
import time
from contextlib import ExitStack, contextmanager

import numpy as np

from imu_rig.units import STANDARD_GRAVITY
from simulators.encoders import MadeSamples
from simulators.flight_controller import FlightController, FlightControllerModel
from simulators.inertial_sensor import Readings
from simulators.ports import port_maker

PUMP_S = 0.003


class Served:
    """Flight controllers on one port, each with its own clock's seconds since the start."""

    def __init__(self, port, models):
        self.controllers = [FlightController(model) for model in models]
        self.port = port
        self.url = port.url
        self._made = [0] * len(models)
        self._start_s = time.monotonic()
        self._made_s = [0.0] * len(models)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="flight controller")

    def _run(self):
        rng = np.random.default_rng(0)
        while not self._stopping.wait(PUMP_S):
            heard = self.port.read()
            now_s = time.monotonic() - self._start_s
            for place, controller in enumerate(self.controllers):
                said = controller.receive(heard, now_s) if heard else b""
                period_s = 1.0 / controller.sample_hz
                number = int((now_s - self._made_s[place]) / period_s)
                if number:
                    said += b"".join(controller.encode(self._samples(place, number, period_s, rng)))
                    self._made[place] += number
                    self._made_s[place] += number * period_s
                if said:
                    self.port.write(said)

    def _samples(self, place, number, period_s, rng):
        t = self._made_s[place] + period_s * np.arange(1, number + 1)
        up = np.array((0.0, 0.0, STANDARD_GRAVITY))
        readings = Readings(
            accel=up + rng.normal(0, 0.02, (number, 3)),
            gyro=rng.normal(0, 0.002, (number, 3)),
            mag=np.array((18.0, 0.0, -44.0)) + rng.normal(0, 0.3, (number, 3)),
            temperature=np.full(number, 31.0),
            saturated=np.zeros(number, bool),
            offsets=np.zeros((number, 6)),
        )
        return MadeSamples(
            t=t,
            device_s=t,
            counter=self._made[place] + np.arange(number),
            readings=readings,
            pressure=np.full(number, 100_000.0),
            air_c=np.full(number, 25.0),
        )

    def start(self):
        self._thread.start()

    def stop(self):
        self._stopping.set()
        self._thread.join()


@contextmanager
def flight_controllers(*models: FlightControllerModel):
    with ExitStack() as resources:
        port = port_maker("pty", resources)("pixhawk")
        served = Served(port, models)
        served.start()
        resources.callback(served.stop)
        yield served
