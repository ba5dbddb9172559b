"""A line to a simulated MTi without a port and without waiting: time passes when it is heard."""

import numpy as np

from firmware_protocols.xsens_frames import find_messages
from simulators.encoders import MadeSamples
from simulators.inertial_sensor import Readings

REST = {"accel": (0.0, 0.0, 9.81), "gyro": (0.01, 0.0, 0.0), "mag": (0.0, 24.5, -39.2)}


def made(t, counter, accel=None, gyro=None, mag=None):
    """Samples at times t, at rest unless it is said how they are moved."""
    n = len(t)

    def rows(name, given):
        return np.broadcast_to(REST[name] if given is None else given, (n, 3)).astype(float)

    readings = Readings(
        accel=rows("accel", accel),
        gyro=rows("gyro", gyro),
        mag=rows("mag", mag),
        temperature=np.full(n, 25.0),
        saturated=np.zeros(n, dtype=bool),
        offsets=np.zeros((n, 6)),
    )
    return MadeSamples(
        t=np.asarray(t, dtype=float),
        device_s=np.asarray(t, dtype=float),
        counter=np.asarray(counter),
        readings=readings,
        pressure=np.full(n, 101325.0),
        air_c=np.full(n, 20.0),
    )


class Line:
    """What lies between the driver and a unit.

    Parameters
    ----------
    unit : MtiUnit
        Not booted yet.
    on_s : float
        How long ago it was switched on.
    reaches : callable
        Tells of every message that the host sends, by its number and identifier, whether the unit
        hears it.
    garble : callable
        Changes what the unit says on its way.
    """

    def __init__(self, unit, *, on_s=0.0, reaches=None, garble=None):
        self.unit = unit
        self.now_s = 0.0
        self.written = []
        self._counter = 0
        self._reaches = reaches or (lambda number, mid: True)
        self._garble = garble or (lambda data: data)
        self._waiting = bytearray(unit.boot(0.0))
        self._run(on_s)
        if on_s:
            self._waiting.clear()

    def monotonic(self):
        """Stands in for the clock of the driver."""
        return self.now_s

    def write(self, data):
        number = len(self.written)
        self.written.append(bytes(data))
        (message,), _ = find_messages(data)
        if self._reaches(number, message.mid):
            self._waiting += self.unit.receive(data, self.now_s)

    def hear(self, seconds):
        self._run(seconds)
        heard = self._garble(bytes(self._waiting))
        self._waiting.clear()
        return heard

    def restart(self):
        """Switch the unit off and on."""
        self._waiting += self.unit.boot(self.now_s)

    def _run(self, seconds):
        hz = self.unit.sample_hz
        number = int(seconds * hz + 1e-9)
        t = self.now_s + np.arange(1, number + 1) / hz
        samples = made(t, self._counter + np.arange(number))
        self._counter += number
        self._waiting += b"".join(self.unit.encode(samples))
        self.now_s += seconds
