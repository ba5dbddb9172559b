"""What an Xsens MTi speaks: one stream of rows out of MTData2 or legacy MTData messages.

MTData2 messages say what they hold, so a row is filled with what is there: what a message lacks is
NaN, what the description does not ask for is skipped. Legacy messages hold what the unit was told
to send, so all of another size are of another configuration and are left out.

A description is a TOML file with ``kind = "xsens-mti"`` and ``format = "mtdata2"`` with ``outputs``
(identifiers as hexadecimal texts), or ``format = "legacy"`` with ``output_mode`` and
``output_settings``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from firmware_protocols.counting import SequenceCounter
from firmware_protocols.descriptions import every, take
from firmware_protocols.fields import LayoutError, quote
from firmware_protocols.layout import toml_lines
from firmware_protocols.packets import counts
from firmware_protocols.protocol import DecodeStats, DeviceProtocol, Packets
from firmware_protocols.rows import RowLayout, check_names
from firmware_protocols.variable_framing import FramedBytes, FrameDecoder
from firmware_protocols.xsens_data import (
    ALARMING_ERRORS,
    ITEMS,
    STATUS_WORD,
    FloatArray,
    Part,
    fields_of,
    find_items,
    item_of,
    legacy_parts,
    read_item,
    read_part,
    size_of,
)
from firmware_protocols.xsens_frames import (
    EXTENDED,
    LONGEST_SHORT,
    Message,
    Mid,
    XsensFormat,
)

KIND = "xsens-mti"
MTDATA2, LEGACY = "mtdata2", "legacy"
MAX_OUTPUTS = 32
MAX_RATE_HZ = 2000.0

TICK_S = 1e-4
"""One count of the sample time: packets recorded from an MTi-300 are 25 apart at 400 Hz."""

PERIOD_HZ = 115_200.0
"""Ticks per second in which a legacy unit is told the time between two samples."""

PERIODS = range(225, 11_521)
"""Ticks between two samples that a legacy unit has: 512 to 10 samples per second."""

ERROR_BYTES = 6
"""Of the frame of an Error message."""

MANY_SHAPES = 8
"""From so many arrangements of items of one length on, messages are sorted one by one."""

MOST_KEPT = 1000
"""Arrangements that are remembered."""

Bytes = npt.NDArray[np.uint8]
Indices = npt.NDArray[np.int64]
Shape = tuple[tuple[int, int, int], ...]
"""Identifier, offset of the data and size of each item."""
Wanted = tuple[tuple[str, int, int, int], ...]
"""Field, identifier, offset and size of the items that are read."""

_ALARMS = np.zeros(256, dtype=np.uint8)
for _error, _bit in ALARMING_ERRORS.items():
    _ALARMS[_error] = 1 << _bit

_IDENTIFIER = re.compile(r"(?:0x)?[0-9A-Fa-f]{4}")


@dataclass(frozen=True)
class XsensProtocol(DeviceProtocol):
    """What an MTi is told to send, and sends then.

    Attributes
    ----------
    name, title : str
    format : str
        "mtdata2" or "legacy".
    rate_hz : float
        Samples per second.
    outputs : tuple of int
        Identifiers of the items of MTData2, with the format of their numbers, in order.
    output_mode, output_settings : int
        Of the legacy format.
    """

    name: str
    title: str = ""
    format: str = MTDATA2
    rate_hz: float = 100.0
    outputs: tuple[int, ...] = ()
    output_mode: int = 0
    output_settings: int = 0

    def __post_init__(self) -> None:
        check_names(self.name, self.title)
        if not (math.isfinite(self.rate_hz) and 1.0 <= self.rate_hz <= MAX_RATE_HZ):
            raise LayoutError(f"rate_hz must be 1 to {MAX_RATE_HZ:g}.")
        if self.format == MTDATA2:
            self._check_outputs()
        elif self.format == LEGACY:
            legacy_parts(self.output_mode, self.output_settings)
            self._check_period()
        else:
            raise LayoutError(f'format {quote(self.format)} must be "{MTDATA2}" or "{LEGACY}".')

    def _check_period(self) -> None:
        period = PERIOD_HZ / self.rate_hz
        if abs(period - round(period)) > 1e-6 * period or round(period) not in PERIODS:
            raise LayoutError(
                f"rate_hz must be {PERIOD_HZ:g} divided by a whole number from {PERIODS[0]} to "
                f"{PERIODS[-1]}, such as 100 or 512, for the legacy format."
            )

    def _check_outputs(self) -> None:
        if not 1 <= len(self.outputs) <= MAX_OUTPUTS:
            raise LayoutError(f"outputs must list 1 to {MAX_OUTPUTS} identifiers.")
        if self.rate_hz != int(self.rate_hz):
            raise LayoutError("rate_hz must be a whole number for MTData2.")
        seen: dict[str, int] = {}
        for identifier in self.outputs:
            item = item_of(identifier)
            if item is None:
                raise LayoutError(
                    f"outputs: {identifier:04X} is not known; take of "
                    f"{', '.join(f'{known:04X}' for known in ITEMS)}, with the format of the "
                    "numbers in the last digit."
                )
            if item.field in seen:
                raise LayoutError(
                    f"outputs: {seen[item.field]:04X} and {identifier:04X} say the same; take one."
                )
            seen[item.field] = identifier

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """What a legacy message holds; nothing for MTData2."""
        if self.format == MTDATA2:
            return ()
        return legacy_parts(self.output_mode, self.output_settings)

    @cached_property
    def data_bytes(self) -> int:
        """Bytes of data of a message that holds everything."""
        if self.format == MTDATA2:
            return sum(3 + size_of(identifier) for identifier in self.outputs)
        return self.parts[-1].offset + self.parts[-1].size

    @cached_property
    def layout(self) -> RowLayout:
        """The fields of a row."""
        if self.format == MTDATA2:
            names = [ITEMS[identifier & 0xFFF0].field for identifier in self.outputs]
        else:
            names = [part.field for part in self.parts]
        names.append("alarms")
        return RowLayout(
            name=self.name,
            title=self.title,
            byte_order="little",
            fields=fields_of(names, status_word=STATUS_WORD in self.outputs),
            counter="counter" if "counter" in names else None,
            clock="time" if "time" in names else None,
            clock_tick_s=TICK_S,
            rate_hz=self.rate_hz,
        )

    @cached_property
    def streams(self) -> Mapping[str, RowLayout]:
        """One stream, without a name."""
        return {"": self.layout}

    @property
    def longest(self) -> int:
        """Bytes of a frame that holds everything."""
        return self.data_bytes + (5 if self.data_bytes < EXTENDED else 7)

    @cached_property
    def form(self) -> XsensFormat:
        """What the frames look like that may come.

        Answers, and what a unit sends that does not hear, fit into one length byte. A header that
        announces more than that and the layout need is damage, and nothing waits for its end.
        """
        return XsensFormat(max(self.longest, LONGEST_SHORT))

    @property
    def proves_packets(self) -> bool:
        """Every frame has a checksum."""
        return True

    @property
    def bytes_per_s(self) -> float:
        """What it sends where every message holds everything."""
        return self.longest * self.rate_hz

    def decoder(self) -> XsensDecoder:
        """Return a new decoder of what a port delivers."""
        return XsensDecoder(self)

    def to_dict(self) -> dict[str, Any]:
        """Return the protocol as plain data; see :func:`from_dict`."""
        values: dict[str, Any] = {
            "kind": KIND,
            "name": self.name,
            "title": self.title,
            "format": self.format,
            "rate_hz": self.rate_hz,
        }
        if self.format == MTDATA2:
            values["outputs"] = [f"{identifier:04X}" for identifier in self.outputs]
        else:
            values["output_mode"] = self.output_mode
            values["output_settings"] = self.output_settings
        return values

    def to_toml(self) -> str:
        """Return the protocol as the text of a file that can be read back."""
        return "\n".join(toml_lines(self.to_dict())) + "\n"


_KINDS = {
    "kind": str,
    "name": str,
    "title": str,
    "format": str,
    "rate_hz": float,
    "outputs": list,
    "output_mode": int,
    "output_settings": int,
}
"""What a description may hold, and of which kind."""


def from_dict(data: Mapping[str, Any]) -> XsensProtocol:
    """Build the protocol from plain data, checking every key and type.

    Raises
    ------
    LayoutError
        For anything that is not a usable description.
    """
    take("the layout", data, "name", str)
    values = every("the layout", data, _KINDS)
    values.pop("kind", None)
    if "outputs" in values:
        values["outputs"] = tuple(_identifier(entry) for entry in values["outputs"][:256])
    unfit = {"outputs"} if values.get("format") == LEGACY else {"output_mode", "output_settings"}
    for key in unfit & values.keys():
        form = quote(values.get("format", MTDATA2))
        raise LayoutError(f"{key} does not go with the format {form}.")
    return XsensProtocol(**values)


def _identifier(entry: Any) -> int:
    if not isinstance(entry, str) or not _IDENTIFIER.fullmatch(entry):
        raise LayoutError(f'outputs: {quote(entry)} is no identifier; write one as "4020".')
    return int(entry, 16)


class XsensDecoder(FrameDecoder):
    """Decoder of an MTi's bytes.

    Parameters
    ----------
    protocol : XsensProtocol
    """

    def __init__(self, protocol: XsensProtocol) -> None:
        super().__init__(protocol.form)
        self._protocol = protocol
        self._layout = protocol.layout
        self._blank = _blank(self._layout)
        self._rows = 0
        self._malformed = 0
        self._alarms = 0  # that the next row tells of
        self._sequence = SequenceCounter(1 << 16)
        self._wanted: dict[Shape, Wanted] = {}

    @property
    def stats(self) -> DecodeStats:
        """Statistics of everything decided so far.

        ``good`` counts rows. Answers and messages of another configuration are none, and are not
        skipped bytes either: their frames are sound.
        """
        framed = super().stats
        order = self._sequence
        return DecodeStats(
            good=self._rows,
            corrupt=framed.corrupt + self._malformed,
            skipped_bytes=framed.skipped_bytes,
            lost=order.lost,
            duplicates=order.duplicates,
            reordered=order.reordered,
        )

    def _read(self, frames: FramedBytes) -> dict[str, Packets]:
        rows = np.full(len(frames), self._blank)
        is_row = np.zeros(len(frames), dtype=bool)
        alarms = np.zeros(len(frames), dtype=np.uint8)
        wanted = Mid.MT_DATA2 if self._protocol.format == MTDATA2 else Mid.MT_DATA
        for index, frame in frames.by_length():
            for is_long in (False, True):
                chosen = (frame[:, 2] == wanted) & ((frame[:, 3] == EXTENDED) == is_long)
                if bool(chosen.any()):
                    data = frame[chosen, 6 if is_long else 4 : -1]
                    if wanted == Mid.MT_DATA2:
                        self._read_items(data, index[chosen], rows, is_row)
                    else:
                        self._read_parts(data, index[chosen], rows, is_row)
            if frame.shape[1] == ERROR_BYTES:
                is_error = frame[:, 2] == Mid.ERROR
                alarms[index[is_error]] = _ALARMS[frame[is_error, 4]]
        found = rows[is_row]
        self._rows += len(found)
        if self._layout.counter is not None and len(found):
            numbers = counts(self._layout, found, self._layout.counter)
            self._sequence.add(numbers, found.view(np.uint8).reshape(len(found), -1))
        self._tell(alarms, is_row, found)
        return {"": Packets(found, frames.end[is_row])}

    def _tell(
        self, alarms: Bytes, is_row: npt.NDArray[np.bool_], found: npt.NDArray[np.void]
    ) -> None:
        """Let each row tell of the errors that were reported since the row before."""
        if not self._alarms and not bool(alarms.any()):
            return
        following = np.cumsum(is_row)  # of an error: the number of the next row
        told = np.zeros(len(found) + 1, dtype=np.uint8)
        told[0] = self._alarms
        np.bitwise_or.at(told, following, alarms)
        found["alarms"] |= told[:-1]
        self._alarms = int(told[-1])

    def _read_parts(
        self, data: Bytes, index: Indices, rows: npt.NDArray[np.void], is_row: npt.NDArray[np.bool_]
    ) -> None:
        """Read legacy messages of one length into their rows, if it is that of the protocol."""
        protocol = self._protocol
        if data.shape[1] != protocol.data_bytes:
            return
        for part in protocol.parts:
            raw = data[:, part.offset : part.offset + part.size]
            _fill(rows, part.field, index, read_part(part, raw, protocol.output_settings))
        is_row[index] = True

    def _read_items(
        self, data: Bytes, index: Indices, rows: npt.NDArray[np.void], is_row: npt.NDArray[np.bool_]
    ) -> None:
        """Read MTData2 messages of one length into their rows."""
        for shape, which in _shapes(data):
            if shape is None:
                self._malformed += len(which)
                continue
            wanted = self._wanted.get(shape)
            if wanted is None:
                wanted = self._want(shape)
            if not wanted:
                continue
            some = data if len(which) == len(data) else data[which]
            to = index if len(which) == len(data) else index[which]
            for field, identifier, at, size in wanted:
                _fill(rows, field, to, read_item(identifier, some[:, at : at + size]))
            is_row[to] = True

    def _want(self, shape: Shape) -> Wanted:
        """Return which items of an arrangement go into which fields; none if it is no row."""
        layout = self._layout
        found = []
        for identifier, at, size in shape:
            item = item_of(identifier)
            if item is not None and size == size_of(identifier) and layout.has(item.field):
                found.append((item.field, identifier, at, size))
        fields = {entry[0] for entry in found}
        if not {layout.counter, layout.clock} - {None} <= fields:
            found = []  # nothing tells where it belongs
        if len(self._wanted) >= MOST_KEPT:
            self._wanted.clear()
        self._wanted[shape] = tuple(found)
        return tuple(found)


def _blank(layout: RowLayout) -> npt.NDArray[np.void]:
    """Return a row in which every measurement is absent, shape ()."""
    row = np.zeros((), dtype=layout.dtype)
    for field in layout.fields:
        if not field.is_integer:
            row[field.name] = np.nan
    return row


def _fill(rows: npt.NDArray[np.void], field: str, index: Indices, said: FloatArray) -> None:
    rows[field][index] = said
    if field == "status":
        rows["alarms"][index] = ~rows[field][index] & 1


def _shapes(data: Bytes) -> list[tuple[Shape | None, Indices]]:
    """Return the arrangements of items in messages of one length, and which have each.

    None stands for messages whose items do not end where they end.
    """
    found: list[tuple[Shape | None, Indices]] = []
    left = np.arange(len(data), dtype=np.int64)
    while len(left) and len(found) < MANY_SHAPES:
        shape = find_items(data[left[0]].tobytes())
        if shape is None:
            same = np.zeros(len(left), dtype=bool)
            same[0] = True
        else:
            heads = np.array([at - back for _, at, _ in shape for back in (3, 2, 1)], dtype=int)
            same = (data[left[:, np.newaxis], heads] == data[left[0], heads]).all(axis=1)
        found.append((None if shape is None else tuple(shape), left[same]))
        left = left[~same]
    others: dict[Shape | None, list[int]] = {}
    for place in left.tolist():
        shape = find_items(data[place].tobytes())
        others.setdefault(None if shape is None else tuple(shape), []).append(place)
    found += [(shape, np.array(places, dtype=np.int64)) for shape, places in others.items()]
    return found


def describe(messages: list[Message]) -> str:
    """Say in a few words what measurements messages hold; nothing where they hold none."""
    last = next((m for m in reversed(messages) if m.mid in (Mid.MT_DATA, Mid.MT_DATA2)), None)
    if last is None:
        return ""
    if last.mid == Mid.MT_DATA:
        return f"legacy MTData with {len(last.data)} bytes"
    items = find_items(last.data) or []
    shown = " ".join(f"{identifier:04X}" for identifier, _, _ in items[:16])
    return f"MTData2 with {shown}" if shown else "MTData2 without any data"
