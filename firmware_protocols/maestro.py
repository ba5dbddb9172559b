"""Pololu Maestro servo controllers: commands, replies and errors, for both ends of the wire.

A command travels in the compact form ``cmd data...``, in the Pololu form
``AA device cmd-80 data...`` or, for 8-bit targets, as Mini SSC ``FF servo value``. Data bytes have
7 bits. Targets and positions are in quarters of a microsecond of pulse width. Source: Pololu
Maestro User's Guide, sections 4.e and 5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntFlag, auto

DEFAULT_DEVICE = 12
MAX_CHANNELS = 24
MAX_TARGET = 0x3FFF
MAX_SPEED = 10_000
"""Greatest speed limit in 0.25 us/10 ms; the board takes greater ones for this."""
MAX_ACCELERATION = 255
"""Greatest acceleration limit in 0.25 us/10 ms/80 ms; the board takes greater ones for this."""

POLOLU_START = 0xAA
MINI_SSC_START = 0xFF


@dataclass(frozen=True)
class SetTarget:
    """Move a channel to a pulse width [quarter-us]; 0 stops its pulses."""

    channel: int
    target: int


@dataclass(frozen=True)
class SetMultipleTargets:
    """Move neighbouring channels, from ``first`` on, at the same moment. Not on a Micro Maestro."""

    first: int
    targets: tuple[int, ...]


@dataclass(frozen=True)
class SetSpeed:
    """Limit a channel's speed, in units of 0.25 us/10 ms (25 us/s); 0 is no limit."""

    channel: int
    speed: int


@dataclass(frozen=True)
class SetAcceleration:
    """Limit a channel's acceleration, in units of 0.25 us/10 ms/80 ms (312.5 us/s^2); 0 is none."""

    channel: int
    acceleration: int


@dataclass(frozen=True)
class SetPwm:
    """Set the PWM output's time on and period, both in 1/48 us. Not on a Micro Maestro."""

    on_time: int
    period: int


@dataclass(frozen=True)
class GetPosition:
    """Ask for the pulse width now sent to a channel [quarter-us]; two bytes answer."""

    channel: int


@dataclass(frozen=True)
class GetMovingState:
    """Ask whether a channel with a speed or acceleration limit still moves; one byte answers."""


@dataclass(frozen=True)
class GetErrors:
    """Ask for the error register, which the reading clears; two bytes answer."""


@dataclass(frozen=True)
class GoHome:
    """Send every channel to its home position, by default off."""


@dataclass(frozen=True)
class StopScript:
    """Stop the script on the board."""


@dataclass(frozen=True)
class RestartScript:
    """Run the script from a subroutine."""

    sub: int


@dataclass(frozen=True)
class RestartScriptWithParameter:
    """Run the script from a subroutine, with one number on its stack."""

    sub: int
    parameter: int


@dataclass(frozen=True)
class GetScriptStatus:
    """Ask whether the script is stopped (1) or runs (0); one byte answers."""


@dataclass(frozen=True)
class MiniSscTarget:
    """Move a servo by an 8-bit value, 0 to 254, within its 8-bit range around its neutral."""

    servo: int
    value: int

    def target(self, neutral: int = 6000, reach: int = 1905) -> int:
        """Return the pulse width [quarter-us] for a channel's 8-bit neutral and range."""
        return neutral + (self.value - 127) * reach // 127


Command = (
    SetTarget
    | SetMultipleTargets
    | SetSpeed
    | SetAcceleration
    | SetPwm
    | GetPosition
    | GetMovingState
    | GetErrors
    | GoHome
    | StopScript
    | RestartScript
    | RestartScriptWithParameter
    | GetScriptStatus
    | MiniSscTarget
)


class MaestroErrors(IntFlag):
    """The error register. Bits stay until it is read; any of them sends all channels home."""

    SERIAL_SIGNAL = auto()
    SERIAL_OVERRUN = auto()
    SERIAL_BUFFER_FULL = auto()
    SERIAL_CRC = auto()
    SERIAL_PROTOCOL = auto()
    SERIAL_TIMEOUT = auto()
    SCRIPT_STACK = auto()
    SCRIPT_CALL_STACK = auto()
    SCRIPT_PROGRAM_COUNTER = auto()

    def describe(self) -> str:
        """Return what the set bits mean, for people; "no error" for none."""
        known = [text for flag, text in _ERROR_TEXTS.items() if flag in self]
        unknown = int(self) & ~sum(int(flag) for flag in MaestroErrors)
        if unknown:
            known.append(f"unknown error bits 0x{unknown:04X}")
        return ", ".join(known) or "no error"


_ERROR_TEXTS = {
    MaestroErrors.SERIAL_SIGNAL: "serial signal error (a stop bit was not where it should be)",
    MaestroErrors.SERIAL_OVERRUN: "serial overrun error (bytes came faster than they were read)",
    MaestroErrors.SERIAL_BUFFER_FULL: "serial receive buffer full (bytes were lost)",
    MaestroErrors.SERIAL_CRC: "CRC error (a command came with a wrong CRC byte)",
    MaestroErrors.SERIAL_PROTOCOL: "protocol error (a command was unknown or incomplete)",
    MaestroErrors.SERIAL_TIMEOUT: "timeout (no command came within the time set on the board)",
    MaestroErrors.SCRIPT_STACK: "script stack error",
    MaestroErrors.SCRIPT_CALL_STACK: "script call stack error",
    MaestroErrors.SCRIPT_PROGRAM_COUNTER: "script program counter error",
}


def crc7(data: bytes) -> int:
    """Return the 7-bit CRC (x^7 + x^3 + 1, least significant bit first) of a command's bytes."""
    register = 0
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = (register ^ 0x91 if register & 1 else register) >> 1
    return register


def encode(command: Command, *, device: int | None = None, crc: bool = False) -> bytes:
    """Return the bytes of a command.

    Parameters
    ----------
    command : Command
    device : int, optional
        Device number, 0 to 127: the Pololu form. Without it, the compact form.
    crc : bool
        Whether the board expects a CRC byte after each command.

    Raises
    ------
    ValueError
        For a number that does not fit its place, and for Mini SSC with a device number.
    """
    if isinstance(command, MiniSscTarget):
        if device is not None:
            raise ValueError("A Mini SSC command has no device number; leave the device out.")
        servo = _checked("servo", command.servo, 254)
        return bytes((MINI_SSC_START, servo, _checked("value", command.value, 254)))
    code, data = _encode_data(command)
    if device is None:
        packet = bytes((code, *data))
    else:
        packet = bytes((POLOLU_START, _checked("device", device, 127), code & 0x7F, *data))
    return packet + bytes((crc7(packet),)) if crc else packet


def reply_length(command: Command) -> int:
    """Return how many bytes the board answers to a command: 0, 1 or 2."""
    if isinstance(command, GetPosition | GetErrors):
        return 2
    return 1 if isinstance(command, GetMovingState | GetScriptStatus) else 0


def encode_reply_u16(value: int) -> bytes:
    """Return a two-byte reply: little-endian, all 8 bits of each byte in use."""
    return _checked("reply", value, 0xFFFF).to_bytes(2, "little")


def decode_reply_u16(reply: bytes) -> int:
    """Return the number in a two-byte reply."""
    if len(reply) != 2:
        raise ValueError(f"A two-byte reply of the Maestro has {len(reply)} bytes.")
    return int.from_bytes(reply, "little")


class CommandParser:
    """What a Maestro makes of the bytes it receives; the other end of :func:`encode`.

    A byte from 80 up begins a command, and is a protocol error where a data byte was due. Unknown
    commands, data bytes without a command and channels that the board does not have are protocol
    errors too; after an error data bytes are passed over until the next command. Commands in the
    Pololu form for other devices and Mini SSC commands for other servos are passed over silently.
    An AA as the very first byte may stand alone: it tells a board in "detect baud" mode the rate.

    Parameters
    ----------
    device : int
        The board's device number.
    crc : bool
        Whether every command but Mini SSC must end with a CRC byte.
    mini_ssc_offset : int
        Mini SSC number of the board's channel 0; parsed Mini SSC commands name the channel.
    channels : int
        How many channels the board has.
    """

    def __init__(
        self,
        device: int = DEFAULT_DEVICE,
        crc: bool = False,
        mini_ssc_offset: int = 0,
        *,
        channels: int = MAX_CHANNELS,
    ) -> None:
        self._device = device
        self._crc = crc
        self._mini_ssc_offset = mini_ssc_offset
        self._channels = channels
        self._packet = bytearray()
        self._passing_over = False
        self._untouched = True
        self._only_baud_byte = False

    def feed(self, data: bytes) -> list[Command | MaestroErrors]:
        """Return the commands that these bytes complete and the errors they raise, in order."""
        events: list[Command | MaestroErrors] = []
        for byte in data:
            self._take(byte, events)
            self._untouched = False
        return events

    def _take(self, byte: int, events: list[Command | MaestroErrors]) -> None:
        packet = self._packet
        if packet[:1] == bytes((MINI_SSC_START,)) and byte != MINI_SSC_START:
            packet.append(byte)
            if len(packet) == 3:
                self._finish_mini_ssc(events)
            return
        if byte >= 0x80:
            if packet and not self._only_baud_byte:
                events.append(MaestroErrors.SERIAL_PROTOCOL)
            self._only_baud_byte = self._untouched and byte == POLOLU_START
            self._passing_over = False
            packet[:] = bytes((byte,))
        elif packet:
            self._only_baud_byte = False
            packet.append(byte)
        elif self._passing_over:
            return
        else:
            self._fail(events, MaestroErrors.SERIAL_PROTOCOL)
            return
        self._examine(events)

    def _examine(self, events: list[Command | MaestroErrors]) -> None:
        """Complete, refuse or go on with the packet so far."""
        packet = self._packet
        if packet[0] == MINI_SSC_START:
            return
        at = 0
        if packet[0] == POLOLU_START:
            if len(packet) >= 2 and packet[1] != self._device:
                packet.clear()
                self._passing_over = True
                return
            at = 2
            if len(packet) < 3:
                return
        size = _data_size(packet[at] | 0x80, packet[at + 1 :])
        if size is None:
            self._fail(events, MaestroErrors.SERIAL_PROTOCOL)
        elif len(packet) == at + 1 + size + self._crc:
            self._finish(at, events)

    def _finish(self, at: int, events: list[Command | MaestroErrors]) -> None:
        packet = bytes(self._packet)
        self._packet.clear()
        if self._crc:
            if crc7(packet[:-1]) != packet[-1]:
                self._fail(events, MaestroErrors.SERIAL_CRC)
                return
            packet = packet[:-1]
        command = _decode_data(packet[at] | 0x80, packet[at + 1 :])
        if _last_channel(command) >= self._channels:
            self._fail(events, MaestroErrors.SERIAL_PROTOCOL)
        else:
            events.append(command)

    def _finish_mini_ssc(self, events: list[Command | MaestroErrors]) -> None:
        channel = self._packet[1] - self._mini_ssc_offset
        if 0 <= channel < self._channels:
            events.append(MiniSscTarget(channel, self._packet[2]))
        self._packet.clear()

    def _fail(self, events: list[Command | MaestroErrors], error: MaestroErrors) -> None:
        events.append(error)
        self._packet.clear()
        self._passing_over = True


def _checked(what: str, value: int, greatest: int, least: int = 0) -> int:
    if not least <= value <= greatest:
        raise ValueError(f"{what} must be {least} to {greatest} for a Maestro, not {value}.")
    return value


def _channel(value: int) -> int:
    return _checked("channel", value, MAX_CHANNELS - 1)


def _split14(what: str, value: int, greatest: int = MAX_TARGET) -> tuple[int, int]:
    """Return a 14-bit number as its low and its high 7 bits."""
    value = _checked(what, value, greatest)
    return value & 0x7F, value >> 7


def _join14(low: int, high: int) -> int:
    return low | high << 7


def _encode_data(command: Command) -> tuple[int, tuple[int, ...]]:
    """Return the compact command byte and the data bytes of any command but Mini SSC."""
    match command:
        case SetTarget(channel, target):
            return 0x84, (_channel(channel), *_split14("target", target))
        case SetMultipleTargets(first, targets):
            number = _checked("the number of targets", len(targets), MAX_CHANNELS, 1)
            _channel(_channel(first) + number - 1)
            data = [part for target in targets for part in _split14("target", target)]
            return 0x9F, (number, first, *data)
        case SetSpeed(channel, speed):
            return 0x87, (_channel(channel), *_split14("speed", speed, MAX_SPEED))
        case SetAcceleration(channel, acceleration):
            limit = _split14("acceleration", acceleration, MAX_ACCELERATION)
            return 0x89, (_channel(channel), *limit)
        case SetPwm(on_time, period):
            return 0x8A, (*_split14("on_time", on_time), *_split14("period", period))
        case GetPosition(channel):
            return 0x90, (_channel(channel),)
        case RestartScript(sub):
            return 0xA7, (_checked("sub", sub, 127),)
        case RestartScriptWithParameter(sub, parameter):
            return 0xA8, (_checked("sub", sub, 127), *_split14("parameter", parameter))
        case _:
            return _CODES[type(command)], ()


_CODES: dict[type[Command], int] = {
    GetMovingState: 0x93,
    GetErrors: 0xA1,
    GoHome: 0xA2,
    StopScript: 0xA4,
    GetScriptStatus: 0xAE,
}

_DECODERS: dict[int, tuple[int, Callable[[bytes], Command]]] = {
    0x84: (3, lambda d: SetTarget(d[0], _join14(d[1], d[2]))),
    0x87: (3, lambda d: SetSpeed(d[0], min(_join14(d[1], d[2]), MAX_SPEED))),
    0x89: (3, lambda d: SetAcceleration(d[0], min(_join14(d[1], d[2]), MAX_ACCELERATION))),
    0x8A: (4, lambda d: SetPwm(_join14(d[0], d[1]), _join14(d[2], d[3]))),
    0x90: (1, lambda d: GetPosition(d[0])),
    0x93: (0, lambda _: GetMovingState()),
    0xA1: (0, lambda _: GetErrors()),
    0xA2: (0, lambda _: GoHome()),
    0xA4: (0, lambda _: StopScript()),
    0xA7: (1, lambda d: RestartScript(d[0])),
    0xA8: (3, lambda d: RestartScriptWithParameter(d[0], _join14(d[1], d[2]))),
    0xAE: (0, lambda _: GetScriptStatus()),
}
"""Number of data bytes and meaning of every command byte, but Set Multiple Targets."""


def _data_size(code: int, data: bytes | bytearray) -> int | None:
    """Return how many data bytes a command takes; None if the board cannot know it."""
    if code == 0x9F:
        if not data:
            return 2
        return 2 + 2 * data[0] if data[0] else None
    return _DECODERS[code][0] if code in _DECODERS else None


def _decode_data(code: int, data: bytes) -> Command:
    if code == 0x9F:
        pairs = zip(data[2::2], data[3::2], strict=True)
        return SetMultipleTargets(data[1], tuple(_join14(low, high) for low, high in pairs))
    return _DECODERS[code][1](data)


def _last_channel(command: Command) -> int:
    """Return the highest channel that a command names; -1 for none."""
    match command:
        case SetMultipleTargets(first, targets):
            return first + len(targets) - 1
        case SetTarget() | SetSpeed() | SetAcceleration() | GetPosition():
            return command.channel
        case _:
            return -1
