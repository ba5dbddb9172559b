"""Write a trial file: sources, bytes, events and the times between them."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from secrets import token_bytes
from types import TracebackType
from typing import Any, Self

from imu_rig.clock import NS_PER_S, Clock
from imu_rig.errors import InputError, StorageError
from imu_rig.recording.contents import Source
from imu_rig.recording.format import (
    MAX_PAYLOAD,
    MAX_SOURCES,
    RESUMED,
    TRIAL,
    FileHeader,
    Kind,
    decode_json,
    encode_json,
)
from imu_rig.recording.latency import Latency
from imu_rig.recording.log import Entry, RecordingOptions, RecordLog
from imu_rig.recording.notes import (
    clock_pair,
    device_statistics,
    end,
    resumed,
    source_description,
    statistics,
    time_after,
)
from imu_rig.recording.reader import open_trial
from imu_rig.recording.storage import (
    create_for_append,
    open_for_append,
    require_space,
    sync_folder,
)

# Members of an enumeration are slow to compare and to hash.
_BYTES_IN = int(Kind.BYTES_IN)
_BYTES_OUT = int(Kind.BYTES_OUT)


class TrialWriter:
    """Records one trial; made by :meth:`create` or :meth:`append`.

    All methods may be called from any thread, and none but :meth:`flush` and :meth:`close` waits
    for the disk. When the queue is full or the disk has failed, what is handed in is counted in
    ``unwritten_records`` instead, and a gap is recorded once there is room again.

    As a context manager it closes at the end, with the reason ``"complete"``, ``"interrupted"``
    (Ctrl-C) or ``"failed: ..."``; a failure of the disk is then raised, unless the block itself
    raised.
    """

    def __init__(
        self,
        log: RecordLog,
        *,
        clock: Clock,
        origin_ns: int,
        options: RecordingOptions,
        config: bytes,
        sources: Mapping[str, Source],
    ) -> None:
        self._log = log
        self._clock = clock
        self._origin_ns = origin_ns
        self._options = options
        self._config = config
        self._sources = dict(sources)
        self._announced: set[str] = set()
        self._gaps: dict[int, _OpenGap] = {}
        self._lock = threading.Lock()
        self._closed = False
        self._reason = ""

    @classmethod
    def create(
        cls,
        path: Path | str,
        config: Mapping[str, Any],
        *,
        clock: Clock,
        on_error: Callable[[StorageError], None] | None = None,
        options: RecordingOptions | None = None,
    ) -> TrialWriter:
        """Start a new trial file.

        Parameters
        ----------
        path : path
            Its name, by custom ending in ``.imu-trial``; must not exist.
        config : mapping
            The configuration of the session, plain JSON values.
        clock : Clock
            The host clock whose stamps will be handed in.
        on_error : callable, optional
            Called once, from another thread, when the disk fails.
        options : RecordingOptions, optional
            Queue, reserve and periods.

        Raises
        ------
        InputError
            If the name is taken or cannot be used, or the configuration is not JSON.
        StorageError
            If the disk has too little space or fails.
        """
        path = Path(path)
        options = options or RecordingOptions()
        payload = encode_json(dict(config), "The configuration")
        require_space(path, options.needed_bytes, options.file_system)
        header = FileHeader(token_bytes(8), options.wall_ns())
        descriptor = create_for_append(path)
        origin_ns = clock.now_ns()
        log = RecordLog(
            descriptor,
            path,
            header.seed,
            offset=0,
            sequence=0,
            options=options,
            now_ns=lambda: clock.now_ns() - origin_ns,
            on_error=on_error,
        )
        writer = cls(
            log,
            clock=clock,
            origin_ns=origin_ns,
            options=options,
            config=payload,
            sources={},
        )
        # The configuration stands there twice, so that one flipped bit cannot take it.
        first = [(Kind.CONFIG, TRIAL, 0, payload)] * 2
        try:
            log.write_first(header.encode(), [*first, writer._clock_pair()])
            sync_folder(path.parent)
        except StorageError:
            log.abandon()
            path.unlink(missing_ok=True)
            raise
        log.start(writer._notes)
        return writer

    @classmethod
    def append(
        cls,
        path: Path | str,
        *,
        clock: Clock,
        on_error: Callable[[StorageError], None] | None = None,
        options: RecordingOptions | None = None,
    ) -> TrialWriter:
        """Continue a trial file that was interrupted.

        Bytes after the last sound record are cut off; there is none among them. Trial time goes
        on by what the wall clock says has passed since, and never backward.

        Parameters
        ----------
        path : path
            An existing trial file.
        clock, on_error, options
            As for :meth:`create`.

        Raises
        ------
        InputError
            If it is no trial file, holds no configuration, or is being written by another program.
        StorageError
            If the disk has too little space or fails.
        """
        path = Path(path)
        options = options or RecordingOptions()
        with ExitStack() as undo:
            descriptor = open_for_append(path)
            undo.callback(os.close, descriptor)
            trial = open_trial(path)
            if not trial.config:
                raise InputError(
                    f"{path} holds no configuration to continue with; start a new trial."
                )
            require_space(path, options.needed_bytes, options.file_system)
            now_ns = time_after(trial, options.wall_ns())
            origin_ns = clock.now_ns() - now_ns
            log = RecordLog(
                descriptor,
                path,
                trial.header.seed,
                offset=int(trial.records.end.max()),
                sequence=int(trial.records.sequence[-1]) + 1,
                options=options,
                now_ns=lambda: clock.now_ns() - origin_ns,
                on_error=on_error,
            )
            writer = cls(
                log,
                clock=clock,
                origin_ns=origin_ns,
                options=options,
                config=encode_json(trial.config, "The configuration"),
                sources=trial.sources,
            )
            if trial.damage.tail_bytes:
                log.cut_tail()
            log.write_first(b"", [resumed(trial, now_ns), writer._clock_pair()])
            undo.pop_all()
        log.start(writer._notes)
        return writer

    @property
    def path(self) -> Path:
        """The file."""
        return self._log.path

    @property
    def error(self) -> StorageError | None:
        """The first failure of the disk; nothing is recorded after it."""
        return self._log.error

    @property
    def written_records(self) -> int:
        """Records acknowledged: the system call that wrote each has returned.

        For whoever asks a file for what was promised, as the test that kills the recorder does.
        """
        return self._log.written

    @property
    def acknowledged_bytes(self) -> int:
        """Size of the file up to its last acknowledged record [bytes]."""
        return self._log.offset

    @property
    def synced_bytes(self) -> int:
        """Part of ``acknowledged_bytes`` that is known to survive a power cut [bytes]."""
        return self._log.synced_offset

    @property
    def queued_bytes(self) -> int:
        """Bytes handed in and waiting for the disk."""
        return self._log.queued_bytes

    @property
    def unwritten_records(self) -> int:
        """Records handed in that will never be written."""
        return self._log.unwritten

    def latency(self) -> Latency:
        """Return how long what arrived took from its host stamp to its acknowledgement."""
        return self._log.latency()

    def t_s(self, t_ns: int) -> float:
        """Return the trial time [s] of a stamp of the host clock [ns]."""
        return (t_ns - self._origin_ns) / NS_PER_S

    def add_source(self, name: str, kind: str, descriptor: Mapping[str, Any]) -> int:
        """Announce a device or port and return its number.

        In a continued trial a source of the same name and kind keeps its number. Its descriptor
        may tell of another port, but not of another packet layout, by which the bytes recorded
        before are read.

        Parameters
        ----------
        name : str
            Unique in the trial, not empty.
        kind : str
            What it is, for example ``"imu"`` or ``"maestro"``.
        descriptor : mapping
            What a reader of its bytes needs, plain JSON values; for a sensor its packet layout
            under ``"layout"``.

        Raises
        ------
        InputError
            If the name is taken by another source, there are 255 already, or the descriptor is
            not JSON.
        """
        payload = encode_json(dict(descriptor), f"The description of the source {name!r}")
        plain = decode_json(payload)
        with self._lock:
            known = self._sources.get(name)
            if known is not None and (
                name in self._announced or not _continues(known, kind, plain)
            ):
                raise InputError(
                    f"{self.path} has another source named {name!r} already; choose another name."
                )
            number = known.id if known else 1 + max(map(_number, self._sources.values()), default=0)
            if not name or number > MAX_SOURCES:
                raise InputError(
                    f"The source {name!r} cannot be added to {self.path}: a trial takes "
                    f"{MAX_SOURCES} sources, each with a name."
                )
            added = Source(number, name, kind, plain)
            entry = source_description(added, self._now_ns())
            self._announced.add(name)
            self._sources.setdefault(name, added)
            if known != added:
                for _ in range(2):  # like the configuration: without it the bytes mean nothing
                    self._put(*entry)
        return number

    def bytes_in(self, source: int, t_ns: int, data: bytes) -> None:
        """Record what a source sent.

        Parameters
        ----------
        source : int
            Its number.
        t_ns : int
            When it arrived, host clock [ns].
        data : bytes
            All of it.
        """
        self._wire(_BYTES_IN, source, t_ns, data)

    def bytes_out(self, source: int, t_ns: int, data: bytes) -> None:
        """Record what a source was sent; parameters as for :meth:`bytes_in`."""
        self._wire(_BYTES_OUT, source, t_ns, data)

    def event(self, name: str, /, **fields: Any) -> None:
        """Record something that happens now.

        Parameters
        ----------
        name : str
            What it is.
        **fields
            Particulars, plain JSON values (numpy numbers and arrays too).

        Raises
        ------
        InputError
            If a field is not JSON.
        """
        if name == RESUMED:
            raise InputError(f"The event name {name!r} is kept for continued trials; use another.")
        payload = encode_json({"name": name, "fields": fields}, f"The event {name!r}")
        with self._lock:
            self._put(Kind.EVENT, TRIAL, self._now_ns(), payload)

    def device_statistics(self, source: int, values: Mapping[str, Any]) -> None:
        """Record how a device is doing now.

        Parameters
        ----------
        source : int
            Its number.
        values : mapping
            Counts and states, plain JSON values.

        Raises
        ------
        InputError
            If a value is not JSON.
        """
        with self._lock:
            self._put(*device_statistics(source, values, self._now_ns()))

    def gap(self, source: int, t_ns: int, reason: str, **fields: Any) -> None:
        """Record that data of a source are missing from a moment on.

        Recorded again with the same source and time, a gap is told more of: the last counts.

        Parameters
        ----------
        source : int
            Its number.
        t_ns : int
            When the first is missing, host clock [ns].
        reason : str
            Why.
        **fields
            Particulars, plain JSON values.

        Raises
        ------
        InputError
            If a field is not JSON.
        """
        payload = encode_json({"reason": reason, **fields}, "The gap")
        with self._lock:
            self._put(Kind.GAP, source, t_ns - self._origin_ns, payload)

    def flush(self, timeout_s: float = 10.0) -> bool:
        """Wait until all that was handed in is written or given up.

        Returns
        -------
        bool
            False if that took longer than ``timeout_s``.
        """
        return self._log.flush(timeout_s)

    def close(self, reason: str = "complete") -> None:
        """Write what is queued and the end of the trial, and wait for the disk.

        Closing again does nothing. A failure of the disk is not raised but told by ``error``; the
        end then states ``"disk_full"`` or ``"storage_failed"`` instead of ``reason``, if there is
        room for it.

        Parameters
        ----------
        reason : str
            Why the recording ends.
        """
        with self._lock:
            if self._closed:
                return
            self._closed = True
            self._reason = reason
            self._tell_gaps()
        self._log.close(self._last)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is None:
            self.close()
            if self.error is not None:
                raise self.error
        elif isinstance(error, KeyboardInterrupt):
            self.close("interrupted")
        else:
            self.close(f"failed: {str(error) or type(error).__name__}")

    def _now_ns(self) -> int:
        return self._clock.now_ns() - self._origin_ns

    def _put(self, kind: int, source: int, time_ns: int, payload: bytes) -> None:
        if not self._closed:
            self._log.put((kind, source, time_ns, payload), reserve=True)

    def _wire(self, kind: int, source: int, t_ns: int, data: bytes) -> None:
        # The shortest way there is: this runs for every packet, most often with cold caches.
        if type(data) is not bytes:
            data = bytes(data)
        if type(t_ns) is not int:
            t_ns = int(t_ns)
        entry = (kind, source, t_ns - self._origin_ns, data)
        with self._lock:
            if self._gaps or not 0 < len(data) <= MAX_PAYLOAD or self._closed:
                self._put_pieces(entry)
            elif not self._log.put(entry):
                self._count_lost(entry)

    def _put_pieces(self, entry: Entry) -> None:
        """Record what is no ordinary case: too much for a record, nothing, after a loss, late."""
        kind, source, time_ns, data = entry
        if self._closed:
            return
        for start in range(0, len(data), MAX_PAYLOAD):
            piece = (kind, source, time_ns, data[start : start + MAX_PAYLOAD])
            if self._gaps and self._log.has_room(piece):
                self._tell_gaps()
            if not self._log.put(piece):
                self._count_lost(piece)

    def _count_lost(self, entry: Entry) -> None:
        _, source, time_ns, data = entry
        gap = self._gaps.setdefault(source, _OpenGap(time_ns))
        gap.records += 1
        gap.bytes += len(data)
        gap.last_ns = time_ns

    def _tell_gaps(self) -> None:
        """Record what found no room in the queue, now that there is some."""
        for source, gap in self._gaps.items():
            fields = {
                "reason": "queue full",
                "records": gap.records,
                "bytes": gap.bytes,
                "until_s": gap.last_ns / NS_PER_S,
            }
            self._log.put(
                (Kind.GAP, source, gap.first_ns, encode_json(fields, "The gap")), reserve=True
            )
        self._gaps.clear()

    def _clock_pair(self) -> Entry:
        return clock_pair(self._clock.now_ns(), self._options.wall_ns(), self._origin_ns)

    def _notes(self) -> list[Entry]:
        """Make the records due each second."""
        return [self._clock_pair(), statistics(self._log, self._options, self._now_ns())]

    def _last(self) -> list[Entry]:
        """Make the records that end the trial."""
        sources = self._sources.values()
        described = [(Kind.CONFIG, TRIAL, 0, self._config), *map(source_description, sources)]
        last = end(self._log, sources, self._reason, self._now_ns())
        return [*described, self._clock_pair(), last]


@dataclass
class _OpenGap:
    """What of one source found no room so far."""

    first_ns: int
    last_ns: int = 0
    records: int = 0
    bytes: int = 0


def _number(source: Source) -> int:
    return source.id


def _continues(known: Source, kind: str, descriptor: Mapping[str, Any]) -> bool:
    return known.kind == kind and known.descriptor.get("layout") == descriptor.get("layout")
