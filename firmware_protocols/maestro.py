"""Pololu Maestro servo controllers: commands, replies and errors, for both ends of the wire.

A command travels in the compact form ``cmd data...``, in the Pololu form
``AA device cmd-80 data...`` or, for 8-bit targets, as Mini SSC ``FF servo value``. Data bytes have
7 bits. Source: Pololu Maestro User's Guide, sections 4.e and 5.
"""

from __future__ import annotations

from firmware_protocols.maestro_commands import (
    MAX_ACCELERATION,
    MAX_CHANNELS,
    MAX_SPEED,
    MAX_TARGET,
    Command,
    GetErrors,
    GetMovingState,
    GetPosition,
    GetScriptStatus,
    GoHome,
    MaestroErrors,
    MiniSscTarget,
    RestartScript,
    RestartScriptWithParameter,
    SetAcceleration,
    SetMultipleTargets,
    SetPwm,
    SetSpeed,
    SetTarget,
    StopScript,
    checked,
    data_size,
    decode_data,
    encode_data,
    last_channel,
)

__all__ = [
    "DEFAULT_DEVICE",
    "MAX_ACCELERATION",
    "MAX_CHANNELS",
    "MAX_SPEED",
    "MAX_TARGET",
    "Command",
    "CommandParser",
    "GetErrors",
    "GetMovingState",
    "GetPosition",
    "GetScriptStatus",
    "GoHome",
    "MaestroErrors",
    "MiniSscTarget",
    "RestartScript",
    "RestartScriptWithParameter",
    "SetAcceleration",
    "SetMultipleTargets",
    "SetPwm",
    "SetSpeed",
    "SetTarget",
    "StopScript",
    "crc7",
    "decode_reply_u16",
    "encode",
    "encode_reply_u16",
    "reply_length",
]

DEFAULT_DEVICE = 12
POLOLU_START = 0xAA
MINI_SSC_START = 0xFF


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
        servo = checked("servo", command.servo, 254)
        return bytes((MINI_SSC_START, servo, checked("value", command.value, 254)))
    code, data = encode_data(command)
    if device is None:
        packet = bytes((code, *data))
    else:
        packet = bytes((POLOLU_START, checked("device", device, 127), code & 0x7F, *data))
    return packet + bytes((crc7(packet),)) if crc else packet


def reply_length(command: Command) -> int:
    """Return how many bytes the board answers to a command: 0, 1 or 2."""
    if isinstance(command, GetPosition | GetErrors):
        return 2
    return 1 if isinstance(command, GetMovingState | GetScriptStatus) else 0


def encode_reply_u16(value: int) -> bytes:
    """Return a two-byte reply: little-endian, all 8 bits of each byte in use."""
    return checked("reply", value, 0xFFFF).to_bytes(2, "little")


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
        size = data_size(packet[at] | 0x80, packet[at + 1 :])
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
        command = decode_data(packet[at] | 0x80, packet[at + 1 :])
        if last_channel(command) >= self._channels:
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
