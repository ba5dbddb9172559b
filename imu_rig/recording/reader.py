"""Read a trial file: whatever is sound in it, and in words what is not."""

from __future__ import annotations

import contextlib
import hashlib
import math
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime, timedelta
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from firmware_protocols.fields import LayoutError
from firmware_protocols.known import protocol_from_dict
from firmware_protocols.protocol import DeviceProtocol
from firmware_protocols.rows import RowLayout
from imu_rig.arrays import ByteArray, IntArray
from imu_rig.blocks import ImuBlock, Samples
from imu_rig.clock import NS_PER_S, utc_of
from imu_rig.errors import DataError, InputError
from imu_rig.foreign_text import one_line
from imu_rig.imu_scaling import is_inertial
from imu_rig.imu_stream import imu_block, packet_samples
from imu_rig.packet_stream import AssembledPackets, StreamStats, assemble_packets
from imu_rig.recording.contents import ClockPairs, Event, Gap, Marker, Missing, Source, Wire
from imu_rig.recording.file_header import read_file_header
from imu_rig.recording.format import (
    CERTIFICATES,
    CLOCK_PAIR,
    IMPORTED_FROM,
    MARKER,
    RESUMED,
    STREAMS,
    TRIAL,
    FileHeader,
    Kind,
    decode_json,
    encode_json,
)
from imu_rig.recording.missing import Losses, missing_samples
from imu_rig.recording.scan import Damage, Records, anywhere, scan_records
from imu_rig.recording.storage import read_exactly, require_file

if TYPE_CHECKING:
    from imu_rig.calibration.certificate import Certificate

Direction = Literal["in", "out"]

_WIRE_KIND = {"in": Kind.BYTES_IN, "out": Kind.BYTES_OUT}
_SPAN_BYTES = 4 << 20  # read from the file at a time
LATEST_UTC_NS = 1 << 62  # in 2116; a wall clock before 1970 or after this one was never set


def open_trial(path: Path | str) -> Trial:
    """Open a trial file of any age and state, also one that is still being written.

    Raises
    ------
    InputError
        If it is missing, empty, zero-filled, foreign or of a newer version. Damage is no error,
        also of the header: see ``Trial.damage``.
    """
    path = Path(path)
    require_file(path)
    try:
        with path.open("rb") as file:
            return Trial(path, read_file_header(file, path))
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}).") from error


class Trial:
    """A trial file, read when asked and held in memory only as far as asked.

    The first access to anything but ``header`` reads the whole file once, checks every record
    and keeps 26 bytes about each. What a recorder adds after that is seen by opening it again.

    Attributes
    ----------
    path : Path
        The file.
    header : FileHeader
        Its header.
    """

    def __init__(self, path: Path, header: FileHeader) -> None:
        self.path = path
        self.header = header
        self._decoded: tuple[str, dict[str, AssembledPackets]] | None = None
        self._protocols: dict[str, DeviceProtocol] = {}

    @property
    def records(self) -> Records:
        """Every sound record, in the order it was written."""
        return self._scan[0]

    @property
    def damage(self) -> Damage:
        """What is missing or unreadable."""
        return self._scan[1]

    @property
    def duration_s(self) -> float:
        """Trial time of the last record [s]."""
        return float(self.records.time_ns.max()) / NS_PER_S if len(self.records) else 0.0

    @property
    def created_wall_ns(self) -> int:
        """Wall clock when the file was made [ns since 1970 UTC]."""
        return self.header.created_wall_ns

    @cached_property
    def config(self) -> dict[str, Any]:
        """The configuration of the session; empty if every copy of it is lost."""
        found = self._objects(Kind.CONFIG)
        return found[0][1] if found else {}

    @cached_property
    def sources(self) -> dict[str, Source]:
        """The sources by name.

        One whose descriptor is lost goes by its number, and so does one that was recorded under
        the name that a stream of another has: see ``renamed``.
        """
        by_id: dict[int, Source] = {}
        names: set[str] = set()
        for row, value in self._objects(Kind.SOURCE):
            number = int(self.records.source[row])
            match value:
                case {"name": str(name), "kind": str(kind), "descriptor": dict(descriptor)}:
                    if number not in by_id and name not in names:
                        by_id[number] = Source(number, name, kind, descriptor)
                        names.add(name)
        wires = np.isin(self.records.kind, list(_WIRE_KIND.values()))
        for number in np.unique(self.records.source[wires]).tolist():
            if number not in by_id:
                by_id[number] = Source(number, f"source-{number}", "unknown", {})
        for number in self._like_streams(by_id):
            by_id[number] = replace(by_id[number], name=f"source-{number}")
        return {source.name: source for _, source in sorted(by_id.items())}

    @cached_property
    def renamed(self) -> dict[str, str]:
        """The recorded name of each source that goes by its number, as it was a stream's name."""
        recorded = {
            int(self.records.source[row]): value.get("name")
            for row, value in reversed(self._objects(Kind.SOURCE))
        }
        return {
            name: was
            for name, source in self.sources.items()
            if isinstance(was := recorded.get(source.id), str) and was != name
        }

    @cached_property
    def events(self) -> list[Event]:
        """All events, in the order they were written."""
        return [
            Event(self._t(row), name, fields)
            for row, value in self._objects(Kind.EVENT)
            if isinstance(name := value.get("name"), str)
            and isinstance(fields := value.get("fields", {}), dict)
        ]

    @property
    def markers(self) -> list[Marker]:
        """The moments that a person marked."""
        marks = [event for event in self.events if event.name == MARKER]
        return [Marker(event.t, str(event.fields.get("label", ""))) for event in marks]

    @property
    def gaps(self) -> list[Gap]:
        """Data that the recorder knew were missing, each gap once and as last stated."""
        return self._losses.gaps

    @property
    def statistics(self) -> list[tuple[float, dict[str, Any]]]:
        """How the recorder was doing, as trial time [s] and counts."""
        return self._statistics(TRIAL)

    def device_statistics(self, name: str) -> list[tuple[float, dict[str, Any]]]:
        """How a device was doing, as trial time [s] and counts since the start.

        Of a source with several streams, all together, or those of one under "NAME/STREAM".

        Raises
        ------
        InputError
            If the trial has no such source.
        """
        source = self.source(name)
        told = self._statistics(source.id)
        if name == source.name:
            return told
        stream = name.removeprefix(f"{source.name}/")
        return [
            (t, values)
            for t, of_port in told
            if isinstance(streams := of_port.get(STREAMS), dict)
            and isinstance(values := streams.get(stream), dict)
        ]

    @property
    def start_utc_ns(self) -> int | None:
        """Wall clock at trial time 0, by the first clock pair [ns since 1970 UTC].

        None where nobody knows it: the trial was imported from a file that does not tell its
        date, or its clock pairs are lost or impossible. A wall clock that was set during the
        trial changes nothing here; see ``clock_pairs``.
        """
        match self.config.get("origin"):
            case {"start_known": False}:  # the clock pairs are of the import
                return None
        pairs = self.clock_pairs
        if not len(pairs.t):
            return None
        start = int(pairs.wall_ns[0]) - round(float(pairs.t[0]) * NS_PER_S)
        return start if 0 <= start < LATEST_UTC_NS else None

    def utc(self, t: float = 0.0) -> datetime | None:
        """Return the UTC of a trial time [s], by the wall clock at the start; None as there."""
        start = self.start_utc_ns
        return None if start is None else utc_of(start) + timedelta(seconds=t)

    @cached_property
    def clock_pairs(self) -> ClockPairs:
        """Trial time next to the host's clocks."""
        records = self.records
        is_pair = (records.kind == Kind.CLOCK_PAIR) & (records.length == CLOCK_PAIR.size)
        rows = np.flatnonzero(is_pair)
        pairs = [CLOCK_PAIR.unpack(payload) for _, payload in self._payloads(rows)]
        host_wall = np.array(pairs, np.int64).reshape(-1, 2)
        return ClockPairs(records.time_ns[rows] / NS_PER_S, host_wall[:, 0], host_wall[:, 1])

    @cached_property
    def ended(self) -> str | None:
        """Why the recording ended: ``"complete"``, another word, or None if it was cut off."""
        resumed = self._resumed_rows.max(initial=-1)
        ends = [value.get("reason") for row, value in self._objects(Kind.END) if row > resumed]
        return str(ends[-1]) if ends else None

    @cached_property
    def sha256(self) -> str:
        """Hexadecimal SHA-256 of the file."""
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    @property
    def sensors(self) -> list[str]:
        """Names of the sensors: "NAME", or "NAME/STREAM" of a source with several streams."""
        return [
            sensor
            for name, source in self.sources.items()
            if isinstance(source.descriptor.get("layout"), dict)
            for sensor in self._sensors_of(name)
        ]

    @cached_property
    def imus(self) -> list[str]:
        """Names of the inertial sensors among them."""
        return [name for name in self.sensors if self._is_inertial(name)]

    def source(self, name: str) -> Source:
        """Return a source by its name, or by that of a sensor of it.

        Raises
        ------
        InputError
            If the trial has no such source.
        """
        if name in self.sources:
            return self.sources[name]
        source, _, stream = name.rpartition("/")
        if source in self.sources and stream in self._protocol(source).streams:
            return self.sources[source]
        known = ", ".join(one_line(source) for source in self.sources) or "none"
        raise InputError(f"{self.path} has no source {name!r}; it has {known}.")

    def wire(self, name: str, direction: Direction = "in") -> Wire:
        """Return all that a source sent (``"in"``) or was sent (``"out"``).

        Raises
        ------
        InputError
            If the trial has no such source.
        """
        rows, stops, data = self._bytes(name, direction)
        t = self.records.time_ns[rows] / NS_PER_S
        return Wire(data.tobytes(), t, stops, self._losses.breaks(rows, self.source(name).id))

    def imu(self, name: str, *, calibrated: bool = False) -> ImuBlock:
        """Return the samples of an inertial sensor; times are trial time.

        Parameters
        ----------
        name : str
            Its source.
        calibrated : bool
            Whether to apply the certificate that the trial holds. What it does not calibrate
            stays as it is, and so do times and gaps.

        Raises
        ------
        InputError
            If the trial has no such source, one without a readable packet layout or without
            accelerometer and gyroscope, or no certificate to calibrate by.
        """
        if not calibrated:
            layout, packets = self._packets(name)
            return imu_block(layout, packets.block)
        from imu_rig.calibration.certificate import apply_certificate

        return apply_certificate(self.certificate(name), self.imu(name))

    def certificate(self, name: str) -> Certificate:
        """Return the certificate of a sensor that was recorded with the trial.

        Raises
        ------
        InputError
            If the trial has no such source, or no certificate of it that can be used.
        """
        # Most trials are read without, and its checks take as long to import as all the rest.
        from imu_rig.calibration.certificate import parse_certificate

        kept = self.kept_certificate(name)
        if kept is None:
            raise InputError(
                f"{self.path} holds no certificate of {name!r}: read it uncalibrated, or apply "
                "one of another file."
            )
        text = encode_json(kept, "The certificate")
        return parse_certificate(text, f"{self.path}, the certificate of {name!r}")

    def kept_certificate(self, name: str) -> Any:
        """Return what was recorded as the certificate of a sensor, unchecked; None without.

        One without the name of a stream is that of the only inertial stream of its port.

        Raises
        ------
        InputError
            If the trial has no such sensor.
        """
        source, stream = self._place(name)
        descriptor = self.source(source).descriptor
        of_streams = descriptor.get(CERTIFICATES)
        if isinstance(of_streams, dict) and stream in of_streams:
            return of_streams[stream]
        alone = self._protocol(source).inertial_streams in ((stream,), ())
        return descriptor.get("certificate") if alone else None

    def imu_in_time(self, name: str) -> ImuBlock:
        """Return the samples of a sensor to measure with, as :meth:`imu`.

        Raises
        ------
        DataError
            If their times cannot be right, besides what :meth:`imu` raises.
        """
        block, problem = self.imu(name), self.time_problem(name)
        if problem is not None:
            raise DataError(f"{self.path}: {problem}")
        return block

    def samples(self, name: str) -> Samples:
        """Return all that a sensor of any kind sent; times are trial time.

        Raises
        ------
        InputError
            If the trial has no such source, or one without a readable packet layout.
        """
        layout, packets = self._packets(name)
        return packet_samples(layout, packets.block)

    def missing(self, name: str) -> list[Missing]:
        """Return what is missing from the samples of a sensor, in order of time.

        Nothing is ever filled in: between two rows of :meth:`samples` lies either one period of
        the device or an entry of this list.

        Raises
        ------
        InputError
            As :meth:`samples`.
        """
        _, packets = self._packets(name)
        source, stream = self._place(name)
        causes = self._losses.causes(self.source(source).id, stream, self.duration_s)
        return missing_samples(packets, causes, self.duration_s)

    def time_uncertainty_s(self, name: str) -> float:
        """Return the standard uncertainty of a sensor's times where it is worst [s].

        Each device's clock is mapped to the recording computer's by its own fit, so that samples
        of several devices can be compared by their ``t`` as they are. The uncertainty of the time
        between samples of two devices is the root of the sum of the squares of both uncertainties
        (`imu_rig.timing.alignment_sigma_s`), and the difference between the constant parts of
        their delays, which no fit can see, comes on top: nothing for two devices on links of the
        same kind, up to a few milliseconds between a cable and a radio.

        Returns
        -------
        float
            Infinite where nothing came, or where the times cannot be right. Not a number where
            nobody knows it: the samples were imported with the times that their file gave them.

        Raises
        ------
        InputError
            As :meth:`samples`.
        """
        sigma_s = self._packets(name)[1].sigma_s
        return math.nan if self.imported(name) else sigma_s

    def imported(self, name: str) -> bool:
        """Whether a source's samples and their times were read from another program's file.

        Raises
        ------
        InputError
            If the trial has no such source.
        """
        return IMPORTED_FROM in self.source(name).descriptor

    def time_problem(self, name: str) -> str | None:
        """Return why a sensor's times cannot be right, as a sentence without its stop.

        None where they can. Raises as :meth:`samples`.
        """
        return self._packets(name)[1].time_problem

    def stream_statistics(self, name: str) -> StreamStats:
        """Return what has become of a sensor's bytes; raises as :meth:`samples`."""
        return self._packets(name)[1].stats

    @staticmethod
    def _like_streams(sources: dict[int, Source]) -> list[int]:
        """Numbers of the sources whose name is that of a stream of another source."""
        by_name = {source.name: source for source in sources.values()}
        found = []
        for number, source in sources.items():
            name, _, stream = source.name.rpartition("/")
            layout = by_name[name].descriptor.get("layout") if name in by_name else None
            if isinstance(layout, dict):
                with contextlib.suppress(LayoutError):
                    if stream in protocol_from_dict(layout).streams:
                        found.append(number)
        return found

    def _sensors_of(self, source: str) -> list[str]:
        try:
            streams = self._protocol(source).streams
        except InputError:  # its samples will say what is wrong with its layout
            return [source]
        return [f"{source}/{stream}" if stream else source for stream in streams]

    def _is_inertial(self, name: str) -> bool:
        try:
            return is_inertial(self.layout(name))
        except InputError:  # its samples will say what is wrong with its layout
            return self.source(name).kind == "imu"

    def _place(self, name: str) -> tuple[str, str]:
        """Return the source and the stream of a sensor.

        A source with several streams may be named without its stream where one is inertial, or
        where it says which is meant, as a session's does.

        Raises
        ------
        InputError
            If there is no such sensor.
        """
        source = self.source(name).name
        if name != source:
            return source, name.removeprefix(f"{source}/")
        protocol = self._protocol(source)
        if len(protocol.streams) == 1:
            return source, next(iter(protocol.streams))
        if len(protocol.inertial_streams) == 1:
            return source, protocol.inertial_streams[0]
        meant = self.source(source).descriptor.get("stream")
        if isinstance(meant, str) and meant in protocol.inertial_streams:
            return source, meant
        sensors = ", ".join(repr(sensor) for sensor in self._sensors_of(source))
        raise InputError(f"The source {name!r} of {self.path} has several sensors: {sensors}.")

    def _packets(self, name: str) -> tuple[RowLayout, AssembledPackets]:
        """Decode a source; the last one asked for is kept, for its samples are asked in turns."""
        source, stream = self._place(name)
        protocol = self._protocol(source)
        if self._decoded is None or self._decoded[0] != source:
            rows, stops, data = self._bytes(source, "in")
            # A clock stamp out of order would be a recorder's mistake and must not spoil the rest.
            arrival_s = np.maximum.accumulate(self.records.time_ns[rows] / NS_PER_S)
            breaks = self._losses.breaks(rows, self.source(source).id)
            packets = assemble_packets(protocol, data.data, stops, arrival_s, breaks)
            self._decoded = source, packets
        return protocol.streams[stream], self._decoded[1][stream]

    def _bytes(self, name: str, direction: Direction) -> tuple[IntArray, IntArray, ByteArray]:
        """Return the rows of a source's records, where each stops in its bytes, and the bytes."""
        number = self.source(name).id
        records = self.records
        rows = np.flatnonzero((records.kind == _WIRE_KIND[direction]) & (records.source == number))
        lengths = records.length[rows].astype(np.int64)
        stops = np.cumsum(lengths)
        places = stops - lengths
        data = np.empty(int(stops[-1]) if len(stops) else 0, np.uint8)
        for chosen, piece, starts in self._pieces(rows):
            _place(piece, starts, lengths[chosen], data, places[chosen])
        return rows, stops, data

    def layout(self, name: str) -> RowLayout:
        """Return what each packet of a sensor says.

        Raises
        ------
        InputError
            As :meth:`samples`.
        """
        source, stream = self._place(name)
        return self._protocol(source).streams[stream]

    def _protocol(self, source: str) -> DeviceProtocol:
        if source not in self._protocols:
            layout = self.source(source).descriptor.get("layout")
            if not isinstance(layout, dict):
                raise InputError(
                    f"The source {source!r} of {self.path} is no sensor: it has no layout."
                )
            try:
                self._protocols[source] = protocol_from_dict(layout)
            except LayoutError as error:
                raise InputError(f"The source {source!r} of {self.path}: {error}") from error
        return self._protocols[source]

    @cached_property
    def _losses(self) -> Losses:
        gaps = [
            (row, Gap(self._t(row), int(self.records.source[row]), value))
            for row, value in self._objects(Kind.GAP)
        ]
        return Losses.of(self.records, gaps, self._resumed_rows)

    def _statistics(self, number: int) -> list[tuple[float, dict[str, Any]]]:
        return [
            (self._t(row), value)
            for row, value in self._objects(Kind.STATISTICS)
            if self.records.source[row] == number
        ]

    @cached_property
    def _resumed_rows(self) -> IntArray:
        rows = [row for row, v in self._objects(Kind.EVENT) if v.get("name") == RESUMED]
        return np.array(rows, np.int64)

    @cached_property
    def _scan(self) -> tuple[Records, Damage]:
        with self.path.open("rb", buffering=0) as file:
            return scan_records(file, self.header)

    def _t(self, row: int) -> float:
        return int(self.records.time_ns[row]) / NS_PER_S

    def _objects(self, kind: Kind) -> list[tuple[int, dict[str, Any]]]:
        """Return the JSON objects of one kind with their rows; what is no object is left out."""
        found = []
        for row, payload in self._payloads(np.flatnonzero(self.records.kind == kind)):
            try:
                value = decode_json(payload)
            except ValueError:  # a checksum vouches for the bytes, not for who wrote them
                continue
            if isinstance(value, dict):
                found.append((row, value))
        return found

    def _payloads(self, rows: IntArray) -> Iterator[tuple[int, bytes]]:
        """Yield the payloads of ``rows`` with their row numbers."""
        lengths = self.records.length[rows].astype(np.int64)
        for chosen, piece, starts in self._pieces(rows):
            stops = starts + lengths[chosen]
            places = zip(rows[chosen].tolist(), starts.tolist(), stops.tolist(), strict=True)
            for row, start, stop in places:
                yield row, piece[start:stop]

    def _pieces(self, rows: IntArray) -> Iterator[tuple[slice, bytes, IntArray]]:
        """Read the file in few large pieces: which rows, piece, and where payloads begin in it."""
        start = self.records.offset[rows]
        stop = start + self.records.length[rows]
        with self.path.open("rb", buffering=0) as file:
            for first, last in _spans(start, stop):
                base = int(start[first])
                file.seek(base)
                piece = read_exactly(file, int(stop[last - 1]) - base, self.path)
                yield slice(first, last), piece, start[first:last] - base


def _place(
    piece: bytes, starts: IntArray, lengths: IntArray, data: ByteArray, places: IntArray
) -> None:
    """Copy the ``lengths`` bytes from each of ``starts`` of a piece to ``places`` of the data."""
    source = np.frombuffer(piece, np.uint8)
    for length in np.flatnonzero(np.bincount(lengths)).tolist():
        if length == 0:
            continue
        same = np.flatnonzero(lengths == length)
        anywhere(data, length)[places[same]] = anywhere(source, length)[starts[same]]


def _spans(start: IntArray, end: IntArray) -> Iterator[tuple[int, int]]:
    """Split runs of records into pieces of the file that are ascending and not too long."""
    first = 0
    descents = (np.flatnonzero(np.diff(start) < 0) + 1).tolist()
    for run_stop in [*descents, len(start)]:
        while first < run_stop:
            limit = start[first] + _SPAN_BYTES
            stop = first + int(np.searchsorted(end[first:run_stop], limit, side="right"))
            stop = max(stop, first + 1)
            yield first, stop
            first = stop
