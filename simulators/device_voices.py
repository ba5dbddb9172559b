"""What a served device sends by itself: one voice for each of the streams on its port.

A voice that repeats its loop is made ahead, cheaply. A device that can be spoken to, as an Xsens
MTi or a flight controller, is its own firmware's encoder: what it sends depends on what it hears.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np

from firmware_protocols.interleaved import InterleavedProtocol
from firmware_protocols.layout import PacketLayout
from firmware_protocols.protocol import DeviceProtocol
from imu_rig.arrays import FloatArray
from simulators.device_packets import (
    LOOP_S,
    DevicePackets,
    air_pressure,
    air_temperature,
    loop_motion,
)
from simulators.encoders import Encoder, MadeSamples
from simulators.imu_kinds import IMU_KINDS, ImuKind
from simulators.inertial_sensor import Readings

AHEAD_S = 0.5
"""So much of a loop is made at once, of at most ``MOST_AHEAD`` packets."""

MOST_AHEAD = 2000


class Voice(ABC):
    """Makes what a device sends with each of its samples, which are numbered from its start.

    Attributes
    ----------
    stream : str
        Of the protocol.
    rate_hz : float
        Samples per second of the device's clock; may change when it is told so.
    """

    stream: str
    rate_hz: float

    @abstractmethod
    def say(self, first: int, stop: int) -> list[bytes]:
        """Return what leaves with each of some samples, perhaps nothing."""

    def skip(self, first: int, stop: int) -> None:  # noqa: B027  (a loop forgets nothing)
        """Let samples pass that nobody hears."""

    def hear(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the host, so long after the start; return the answer."""
        del data, now_s
        return b""

    @abstractmethod
    def restart(self) -> bytes:
        """Start anew with sample 0; return what is sent at once."""


class LoopVoice(Voice):
    """Packets of a fixed layout, from a motion that repeats.

    Parameters
    ----------
    stream : str
    layout : PacketLayout
    rate_hz : float
    seed : int
    """

    def __init__(self, stream: str, layout: PacketLayout, rate_hz: float, seed: int) -> None:
        self.stream, self.rate_hz = stream, rate_hz
        self._packets = DevicePackets(layout, rate_hz, seed)
        self._length = layout.length
        self._ahead = memoryview(b"")
        self._ahead_from = 0  # number of the packet that it begins with

    def say(self, first: int, stop: int) -> list[bytes]:
        """Return one packet for each sample."""
        told: list[bytes] = []
        while first < stop:
            made_until = self._ahead_from + len(self._ahead) // self._length
            if not self._ahead_from <= first < made_until:
                number = min(MOST_AHEAD, max(1, round(AHEAD_S * self.rate_hz)))
                self._ahead = memoryview(self._packets.make(first, number))
                self._ahead_from, made_until = first, first + number
            last = min(stop, made_until)
            at = (first - self._ahead_from) * self._length
            told += [
                bytes(self._ahead[start : start + self._length])
                for start in range(at, at + (last - first) * self._length, self._length)
            ]
            first = last
        return told

    def restart(self) -> bytes:
        """Begin without a word, with counter and clock at zero."""
        self._ahead, self._ahead_from = memoryview(b""), 0
        self._packets.reset_clock()
        return b""


class EncoderVoice(Voice):
    """The firmware of a device that can be spoken to, on the same motion.

    Parameters
    ----------
    kind : ImuKind
    seed : int
    """

    stream = ""

    def __init__(self, kind: ImuKind, seed: int) -> None:
        self._encoder: Encoder = kind.encoder(kind.firmware, np.random.default_rng((seed, 2)))
        self._base_s, self._base = 0.0, 0.0  # time and number of the sample at which the rate began
        self._seed = seed
        self._encoder.boot(0.0)
        self.rate_hz = self._encoder.sample_hz
        self._make_loop()

    def _make_loop(self) -> None:
        """Make the readings of one loop at the present rate."""
        rng = np.random.default_rng(self._seed)
        number = max(1, round(LOOP_S * self.rate_hz))
        turn = 2 * math.pi * np.arange(number) / number
        motion = loop_motion(turn, LOOP_S, rng)
        self._readings = Readings(
            accel=motion["accel"],
            gyro=motion["gyro"],
            mag=motion["mag"],
            temperature=air_temperature(turn),
            saturated=np.zeros(number, bool),
            offsets=np.zeros((number, 6)),
        )
        self._pressure, self._air_c = air_pressure(turn), air_temperature(turn)

    def say(self, first: int, stop: int) -> list[bytes]:
        """Return what the firmware sends with each sample."""
        numbers = np.arange(first, stop, dtype=np.int64)
        places = numbers % len(self._pressure)
        since = numbers.astype(np.float64) + 1 - self._base
        made_s: FloatArray = self._base_s + since / self.rate_hz
        r = self._readings
        return self._encoder.encode(
            MadeSamples(
                t=made_s,
                device_s=made_s,
                counter=numbers,
                readings=Readings(
                    r.accel[places],
                    r.gyro[places],
                    r.mag[places],
                    r.temperature[places],
                    r.saturated[places],
                    r.offsets[places],
                ),
                pressure=self._pressure[places],
                air_c=self._air_c[places],
            )
        )

    def skip(self, first: int, stop: int) -> None:
        """Let the firmware go through them all the same."""
        self.say(first, stop)

    def hear(self, data: bytes, now_s: float) -> bytes:
        """Let the firmware answer, and take the rate that it has then."""
        answer = self._encoder.receive(data, now_s)
        if self._encoder.sample_hz != self.rate_hz:
            self._base += (now_s - self._base_s) * self.rate_hz
            self._base_s, self.rate_hz = now_s, self._encoder.sample_hz
            self._make_loop()
        return answer

    def restart(self) -> bytes:
        """Switch it off and on."""
        self._base_s = self._base = 0.0
        said = self._encoder.boot(1e-9)  # 0 would be the begin of the world
        self.rate_hz = self._encoder.sample_hz
        return said


def voices_of(protocol: DeviceProtocol, rate_hz: float | None, seed: int) -> list[Voice]:
    """Return what a device of a protocol sends by itself, the streams in their order.

    Parameters
    ----------
    protocol : DeviceProtocol
    rate_hz : float or None
        Packets per second in place of the layout's; for a single fixed layout only.
    seed : int

    Raises
    ------
    ValueError
        If nothing here speaks this protocol, or nobody says at which rate.
    """
    if isinstance(protocol, PacketLayout):
        return [_loop_voice("", protocol, rate_hz or protocol.rate_hz, seed)]
    if isinstance(protocol, InterleavedProtocol):
        return [
            _loop_voice(name, layout, layout.rate_hz, seed + at)
            for at, (name, layout) in enumerate(protocol.layouts)
        ]
    kind = _kind_of(protocol)
    if kind is None:
        raise ValueError(f"no simulated device speaks {protocol.name}.")
    return [EncoderVoice(kind, seed)]


def is_spoken(protocol: DeviceProtocol) -> bool:
    """Whether some simulated device speaks a protocol."""
    loops = isinstance(protocol, PacketLayout | InterleavedProtocol)
    return loops or _kind_of(protocol) is not None


def _kind_of(protocol: DeviceProtocol) -> ImuKind | None:
    return next((kind for kind in IMU_KINDS.values() if kind.protocol == protocol.name), None)


def _loop_voice(stream: str, layout: PacketLayout, rate_hz: float | None, seed: int) -> LoopVoice:
    if rate_hz is None:
        raise ValueError(f"layout {layout.name} states no rate; give one")
    return LoopVoice(stream, layout, rate_hz, seed)
