"""What a device speaks: the streams of rows that its bytes hold, and how they are decoded."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from firmware_protocols.rows import RowLayout

INERTIAL_FIELDS = ("accel", "gyro")
"""A stream with one of these fields is that of an inertial sensor."""


@dataclass(frozen=True)
class Packets:
    """Packets of one stream in the order of the bytes.

    Attributes
    ----------
    rows : shape (n,), structured
        Of the dtype of the stream's layout; see :mod:`firmware_protocols.packets` for counts and
        values.
    end : shape (n,), int64
        Bytes received up to and including each packet.
    """

    rows: npt.NDArray[np.void]
    end: npt.NDArray[np.int64]

    def __len__(self) -> int:
        """Return the number of packets."""
        return len(self.rows)

    @staticmethod
    def concatenate(parts: list[Packets]) -> Packets:
        """Join packets of one stream in order, of which there must be a part."""
        if len(parts) == 1:
            return parts[0]
        return Packets(
            # without the dtype numpy would turn big-endian fields to the machine's order
            np.concatenate([part.rows for part in parts], dtype=parts[0].rows.dtype),
            np.concatenate([part.end for part in parts]),
        )


@dataclass(frozen=True)
class DecodeStats:
    """What the bytes have held so far; sums with ``+``.

    Attributes
    ----------
    good : int
        Packets decoded.
    corrupt : int
        Headers that turned out not to begin a good packet.
    skipped_bytes : int
        Bytes that belong to no packet.
    lost, duplicates, reordered : int
        By the layout's counter, see :mod:`firmware_protocols.counting`; 0 without one.
    """

    good: int = 0
    corrupt: int = 0
    skipped_bytes: int = 0
    lost: int = 0
    duplicates: int = 0
    reordered: int = 0

    def __add__(self, other: DecodeStats) -> DecodeStats:
        return DecodeStats(
            *(getattr(self, f.name) + getattr(other, f.name) for f in fields(DecodeStats))
        )


class Decoder(Protocol):
    """Decoder of the bytes of one port; how they are cut into chunks never matters."""

    @property
    def pending(self) -> int:
        """Bytes received but not decided yet."""

    @property
    def stats(self) -> DecodeStats:
        """What everything decided so far has held, all streams together."""

    def feed(self, data: bytes | bytearray | memoryview) -> Mapping[str, Packets]:
        """Return the packets of every stream that these next bytes complete.

        A stream of which there is none may be left out.
        """

    def cut(self) -> None:
        """Let no packet lie on both sides of here: something may be missing before what comes."""


@runtime_checkable
class NoticesFaults(Protocol):
    """A decoder that notices faults which no single packet tells of."""

    def take_faults(self) -> dict[str, int]:
        """Return the faults noticed since the last call, in words.

        With each, how many bytes had been received up to where it was noticed last. There may be
        a few different ones in all, however long the stream is.
        """


class DeviceProtocol(ABC):
    """What a device speaks.

    Attributes
    ----------
    name, title : str
        Short name for options and files, and one line for people.
    """

    name: str
    title: str

    @property
    @abstractmethod
    def streams(self) -> Mapping[str, RowLayout]:
        """Layout of the rows of each stream by its name, the most important first.

        A single stream is called "".
        """

    @property
    @abstractmethod
    def longest(self) -> int:
        """Bytes of the longest packet."""

    @property
    @abstractmethod
    def proves_packets(self) -> bool:
        """Whether every packet has a checksum that proves it whole."""

    @property
    @abstractmethod
    def bytes_per_s(self) -> float | None:
        """Nominal bytes per second; None where nobody knows."""

    @property
    def packets_per_s(self) -> float | None:
        """Nominal packets per second, all streams together; None where nobody knows."""
        rates = [layout.rate_hz for layout in self.streams.values()]
        return None if None in rates else sum(rate for rate in rates if rate is not None)

    @abstractmethod
    def decoder(self) -> Decoder:
        """Return a new decoder of what a port delivers."""

    def quick_decoder(self) -> Decoder:
        """Return a new decoder for a short stretch, of which it is asked only what it is.

        Where a decoder first waits until it is certain whose packets count, this one does not.
        """
        return self.decoder()

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Return the protocol as plain data; see `firmware_protocols.known.protocol_from_dict`."""

    @abstractmethod
    def to_toml(self) -> str:
        """Return the protocol as the text of a file that `known.load_protocol` reads back."""

    @property
    def inertial_streams(self) -> tuple[str, ...]:
        """Names of the streams with an accelerometer or a gyroscope."""
        return tuple(
            name
            for name, layout in self.streams.items()
            if any(layout.has(field) for field in INERTIAL_FIELDS)
        )
