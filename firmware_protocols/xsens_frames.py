"""Frames of the Xsens MTi: FA FF MID LEN DATA CS, and what the messages are called.

``FA`` is the preamble and ``FF`` the bus identifier of a unit on its own. A length byte of FF means
that two more bytes follow with the length of the data, big-endian. The checksum makes the sum of
all bytes after the preamble 0, modulo 256. FA and FF also occur inside the data.

The answer to a message is the message whose identifier is one higher. A message that sets something
asks for it when it is sent without data.

Sources: Xsens MTi and MTx User Manual and Technical Documentation (MT0100P), section 4; Xsens MTi
User Manual (MT0605P); ethz-asl/ethzasl_xsens_driver.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

import numpy as np

from firmware_protocols.checksums import checksum_rows
from firmware_protocols.variable_framing import Bytes, Flags, Positions, find_frames

PREAMBLE = 0xFA
BUS_ID = 0xFF
EXTENDED = 0xFF
"""Value of the length byte that says that two more length bytes follow."""

MAX_DATA = 2048
"""Bytes of data that any message may announce; a header that says more is none."""

LONGEST_SHORT = 5 + EXTENDED - 1
"""Bytes of the longest frame that has but one length byte, as all that units usually send."""


class Mid(IntEnum):
    """Message identifiers; the answer to each is the next number unless it is named itself."""

    REQ_DID = 0x00
    DEVICE_ID = 0x01
    SET_PERIOD = 0x04
    REQ_CONFIGURATION = 0x0C
    CONFIGURATION = 0x0D
    GO_TO_MEASUREMENT = 0x10
    REQ_FIRMWARE = 0x12
    SET_BAUD_RATE = 0x18
    REQ_PRODUCT_CODE = 0x1C
    GO_TO_CONFIG = 0x30
    MT_DATA = 0x32
    REQ_DATA = 0x34
    MT_DATA2 = 0x36
    WAKE_UP = 0x3E
    WAKE_UP_ACK = 0x3F
    RESET = 0x40
    ERROR = 0x42
    SET_OUTPUT_CONFIGURATION = 0xC0
    SET_OUTPUT_MODE = 0xD0
    SET_OUTPUT_SETTINGS = 0xD2
    SET_OUTPUT_SKIP_FACTOR = 0xD4


ERRORS = {
    0x03: "the period is not one that the unit can run at",
    0x04: "the unit does not know the message, or not in the state that it is in",
    0x1E: "its timer overflowed: it cannot keep up with the rate",
    0x20: "it cannot run at that baud rate",
    0x21: "a parameter of the message is not one that it accepts",
    0x28: "the device itself failed; its firmware may need an update",
}
"""What the byte of an Error message means."""


def error_words(data: bytes) -> str:
    """Say what an Error message says: "error 33: a parameter ..."."""
    if not data:
        return "an error without a number"
    return f"error {data[0]}: {ERRORS.get(data[0], 'which its manual does not name')}"


def answer_to(mid: int) -> int:
    """Return the identifier of the answer to a message."""
    return (mid + 1) & 0xFF


@dataclass(frozen=True)
class Message:
    """One message: what it is and what it carries."""

    mid: int
    data: bytes = b""


def encode_message(mid: int, data: bytes = b"") -> bytes:
    """Return the frame of a message.

    Raises
    ------
    ValueError
        For more than :data:`MAX_DATA` bytes of data.
    """
    if len(data) > MAX_DATA:
        raise ValueError(f"a message carries up to {MAX_DATA} bytes, not {len(data)}.")
    if len(data) < EXTENDED:
        size = bytes([len(data)])
    else:
        size = bytes([EXTENDED, *len(data).to_bytes(2, "big")])
    summed = bytes([BUS_ID, mid]) + size + data
    return bytes([PREAMBLE]) + summed + bytes([-sum(summed) & 0xFF])


def message_of(frame: bytes) -> Message:
    """Return the message of a good frame."""
    return Message(frame[2], frame[6 if frame[3] == EXTENDED else 4 : -1])


def find_messages(data: bytes, form: XsensFormat | None = None) -> tuple[list[Message], int]:
    """Return the messages in a stretch of bytes, and how many bytes of it are decided.

    Without a format they may be of any length.
    """
    found = find_frames(form or XSENS_FORMAT, data)
    ends = (found.starts + found.lengths).tolist()
    frames = [data[start:end] for start, end in zip(found.starts.tolist(), ends, strict=True)]
    return [message_of(frame) for frame in frames], found.decided


@dataclass(frozen=True)
class XsensFormat:
    """What the frames look like, for :mod:`firmware_protocols.variable_framing`.

    Attributes
    ----------
    longest : int
        Bytes of the longest frame to expect; a header that announces more is none.
    """

    longest: int = 7 + MAX_DATA
    head: ClassVar[int] = 6
    header: ClassVar[re.Pattern[bytes]] = re.compile(rb"\xfa(?:\xff|\Z)")

    def length(self, data: bytes, at: int) -> int | None:
        """Return the bytes of the frame at ``at``; 0 for one that is too long, None if unknown."""
        if len(data) < at + 4:
            return None
        if data[at + 3] != EXTENDED:
            length = 5 + data[at + 3]
        elif len(data) < at + 6:
            return None
        else:
            length = 7 + (data[at + 4] << 8 | data[at + 5])
        return length if length <= self.longest else 0

    def is_good(self, frame: bytes) -> bool:
        """Return whether the checksum holds."""
        return sum(frame) & 0xFF == PREAMBLE

    def candidates(self, data: Bytes) -> Positions:
        """Return where FA FF stands with at least ``head`` bytes from there on."""
        count = max(0, len(data) - self.head + 1)
        found: Positions
        found = np.flatnonzero((data[:count] == PREAMBLE) & (data[1 : count + 1] == BUS_ID))
        return found

    def lengths(self, data: Bytes, at: Positions) -> Positions:
        """Return the bytes of each frame, 0 for those that are too long."""
        short = data[at + 3].astype(np.int64)
        long = data[at + 4].astype(np.int64) << 8 | data[at + 5]
        lengths = np.where(short == EXTENDED, 7 + long, 5 + short)
        return np.where(lengths <= self.longest, lengths, 0)

    def good(self, rows: Bytes) -> Flags:
        """Return whether each checksum holds; ``rows`` of shape (n, length)."""
        holds: Flags = checksum_rows("sum8", rows) == PREAMBLE
        return holds


XSENS_FORMAT = XsensFormat()
