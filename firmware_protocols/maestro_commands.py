"""What one can tell a Pololu Maestro and what its errors mean, with the data bytes of each command.

Targets and positions are in quarters of a microsecond of pulse width. Source: Pololu Maestro User's
Guide, sections 4.e and 5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntFlag, auto

MAX_CHANNELS = 24
MAX_TARGET = 0x3FFF
MAX_SPEED = 10_000
"""Greatest speed limit in 0.25 us/10 ms; the board takes greater ones for this."""
MAX_ACCELERATION = 255
"""Greatest acceleration limit in 0.25 us/10 ms/80 ms; the board takes greater ones for this."""


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


def checked(what: str, value: int, greatest: int, least: int = 0) -> int:
    """Return the value, or raise ValueError where it is out of its range."""
    if not least <= value <= greatest:
        raise ValueError(f"{what} must be {least} to {greatest} for a Maestro, not {value}.")
    return value


def _channel(value: int) -> int:
    return checked("channel", value, MAX_CHANNELS - 1)


def _split14(what: str, value: int, greatest: int = MAX_TARGET) -> tuple[int, int]:
    """Return a 14-bit number as its low and its high 7 bits."""
    value = checked(what, value, greatest)
    return value & 0x7F, value >> 7


def _join14(low: int, high: int) -> int:
    return low | high << 7


def encode_data(command: Command) -> tuple[int, tuple[int, ...]]:
    """Return the compact command byte and the data bytes of any command but Mini SSC."""
    match command:
        case SetTarget(channel, target):
            return 0x84, (_channel(channel), *_split14("target", target))
        case SetMultipleTargets(first, targets):
            number = checked("the number of targets", len(targets), MAX_CHANNELS, 1)
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
            return 0xA7, (checked("sub", sub, 127),)
        case RestartScriptWithParameter(sub, parameter):
            return 0xA8, (checked("sub", sub, 127), *_split14("parameter", parameter))
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


def data_size(code: int, data: bytes | bytearray) -> int | None:
    """Return how many data bytes a command takes; None if the board cannot know it."""
    if code == 0x9F:
        if not data:
            return 2
        return 2 + 2 * data[0] if data[0] else None
    return _DECODERS[code][0] if code in _DECODERS else None


def decode_data(code: int, data: bytes) -> Command:
    """Return the command of a compact command byte and all its data bytes."""
    if code == 0x9F:
        pairs = zip(data[2::2], data[3::2], strict=True)
        return SetMultipleTargets(data[1], tuple(_join14(low, high) for low, high in pairs))
    return _DECODERS[code][1](data)


def last_channel(command: Command) -> int:
    """Return the highest channel that a command names; -1 for none."""
    match command:
        case SetMultipleTargets(first, targets):
            return first + len(targets) - 1
        case SetTarget() | SetSpeed() | SetAcceleration() | GetPosition():
            return command.channel
        case _:
            return -1
