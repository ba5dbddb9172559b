"""A queue, a thread that writes its records one by one, and a thread that waits for the disk.

Whoever hands in a record never waits for the disk. A record counts as acknowledged once the
system call that wrote it has returned: from then on a killed program cannot lose it, and after the
next sync, at most ``sync_s`` later, a power cut cannot either.
"""

import contextlib
import errno
import os
import threading
import time
from collections import defaultdict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from imu_rig.errors import StorageError
from imu_rig.recording.format import MAX_SEQUENCE, RECORD_OVERHEAD, Kind, encode_records
from imu_rig.recording.latency import Latency, LatencyCounts
from imu_rig.recording.storage import DISK_FULL, FileSystem, OsFileSystem
from imu_rig.recording.watch_file import SavedCopy, find_accident

Entry = tuple[int, int, int, bytes]  # kind, source, trial time [ns], payload
Item = Entry | threading.Event | None  # a record, a mark to set when passed, or the end

_BYTES_IN = int(Kind.BYTES_IN)  # members of an enumeration are slow to compare and to hash
_JOINED_WRITE_BYTES = 1 << 16
_RESERVE_BYTES = 1 << 20  # room in the queue that is kept for events and the like
_END_BYTES = 1 << 16  # room on the disk that is kept for the end of the trial


@dataclass(frozen=True)
class RecordingOptions:
    """How much a recording may hold back, what it asks of the disk, and what it stands on.

    Attributes
    ----------
    queue_bytes : int
        Records waiting for a slow disk [bytes in the file; about four times as much memory]. The
        default holds 12 minutes of one 28-byte sensor at 100 Hz, or 45 s of four at 400 Hz.
    reserve_bytes : int
        Free space without which no recording starts [bytes].
    planned_bytes : int
        Expected size of the recording [bytes]; twice that is asked for on top of the reserve.
    join_s : float
        How long records wait for others after a write, so that they share the next one [s].
    sync_s : float
        Time between waits for the disk, so the most a power cut can take [s].
    note_s : float
        Time between clock pairs and statistics [s].
    close_s : float
        How long closing waits for a disk that does not answer [s].
    wall_ns : callable
        The wall clock [ns since 1970 UTC].
    file_system : FileSystem
        What writes.
    """

    queue_bytes: int = 4 << 20
    reserve_bytes: int = 100_000_000
    planned_bytes: int = 0
    join_s: float = 0.005
    sync_s: float = 1.0
    note_s: float = 1.0
    close_s: float = 10.0
    wall_ns: Callable[[], int] = time.time_ns
    file_system: FileSystem = field(default_factory=OsFileSystem)

    @property
    def needed_bytes(self) -> int:
        """Free space asked for before the start [bytes]."""
        return self.reserve_bytes + 2 * self.planned_bytes


@dataclass(slots=True)
class Count:
    """Records of one kind and source, and the bytes of their payloads."""

    records: int = 0
    bytes: int = 0


class RecordLog:
    """Appends records to an open trial file from a thread of its own.

    ``put`` must be called by one thread at a time; everything else from any.

    Attributes
    ----------
    sequence : int
        Number of the next record.
    offset : int
        Size of the file up to its last acknowledged record [bytes].
    written : int
        Records acknowledged through this object.
    synced_offset : int
        Part of ``offset`` that is known to be on the disk [bytes].
    counts : dict
        ``(kind, source)`` to the count of acknowledged records.
    """

    def __init__(
        self,
        descriptor: int,
        path: Path,
        seed: int,
        *,
        offset: int,
        sequence: int,
        options: RecordingOptions,
        now_ns: Callable[[], int],
        on_error: Callable[[StorageError], None] | None = None,
    ) -> None:
        self.sequence = sequence
        self.offset = offset
        self.written = 0
        self.synced_offset = 0
        self.counts: defaultdict[tuple[int, int], Count] = defaultdict(Count)
        self.path = path
        self._descriptor = descriptor
        self._seed = seed
        self._file_system = options.file_system
        self._options = options
        self._now_ns = now_ns
        self._on_error = on_error
        self._room = options.queue_bytes
        self._enough = min(_JOINED_WRITE_BYTES, options.queue_bytes // 2)  # to be written at once
        self._waiting: deque[Item] = deque()
        self._idle = False  # the writing thread waits for the first record
        self._hurried = False  # somebody waits for what is queued, or there is enough of it
        self._bell = threading.Lock()  # rung by releasing it, by whichever thread
        self._bell.acquire()
        self._refused = 0  # counted by whoever calls put
        self._given_up = 0  # counted by the writing thread
        self._put_bytes = 0
        self._taken_bytes = 0
        self._peak_bytes = 0
        self._slowest_write_ns = 0
        self._latency = LatencyCounts()
        self._error: StorageError | None = None
        self._end_reason: str | None = None
        self._sync_failed = False
        self._torn_bytes = 0  # of a failed write, where the file could not be cut back either
        self._error_lock = threading.Lock()
        self._saved: SavedCopy | None = None  # of a file that was deleted
        self._look_lock = threading.Lock()
        self._give_back_room: Callable[[], None] = lambda: None
        self._periodic: Callable[[], list[Entry]] = list
        self._last: Callable[[], list[Entry]] = list
        self._due = 0.0
        self._stop_sync = threading.Event()
        name = path.name
        self._writer = threading.Thread(target=self._run, name=f"write {name}", daemon=True)
        self._syncer = threading.Thread(target=self._keep_syncing, name=f"sync {name}", daemon=True)

    @property
    def error(self) -> StorageError | None:
        """The first failure of the disk; nothing is written after it."""
        return self._error

    @property
    def end_reason(self) -> str | None:
        """``disk_full`` or ``storage_failed`` after an error."""
        return self._end_reason

    @property
    def unwritten(self) -> int:
        """Records handed in that will never be written: the queue was full or the disk failed."""
        return self._refused + self._given_up

    @property
    def queued_bytes(self) -> int:
        """Bytes handed in and not yet acknowledged or given up."""
        return self._put_bytes - self._taken_bytes

    def latency(self) -> Latency:
        """Return how long the bytes of all sources took from their arrival to the file."""
        return self._latency.summary()

    def take_peaks(self) -> tuple[int, float, Latency]:
        """Return highest fill [bytes], slowest write [s] and latency since the last call.

        For the writing thread only.
        """
        peaks = (
            max(self._peak_bytes, self.queued_bytes),
            self._slowest_write_ns / 1e9,
            self._latency.take_latest(),
        )
        self._peak_bytes = self._slowest_write_ns = 0
        return peaks

    def write_first(self, start: bytes, entries: list[Entry]) -> None:
        """Write ``start`` and ``entries`` and wait for the disk, before the threads start.

        Raises
        ------
        StorageError
            If the disk refuses.
        """
        self._write(entries, start)
        if self._error is None:
            self._sync()
        if self._error is not None:
            raise self._error

    def start(self, periodic: Callable[[], list[Entry]]) -> None:
        """Start the threads; ``periodic`` makes the records for each ``note_s``."""
        self._periodic = periodic
        with contextlib.suppress(OSError):
            self._give_back_room = self._file_system.hold_room(self.path.parent, _END_BYTES)
        self._due = time.monotonic() + self._options.note_s
        self._writer.start()
        self._syncer.start()

    def put(self, entry: Entry, *, reserve: bool = False) -> bool:
        """Hand in a record without waiting; False if it was not taken.

        Parameters
        ----------
        entry : tuple
            The record.
        reserve : bool
            Whether it may use the room kept for what matters more than one packet.
        """
        size = RECORD_OVERHEAD + len(entry[3])
        queued = self._put_bytes - self._taken_bytes + size
        if queued >= self._enough and not self._admits(queued, reserve):
            self._refused += 1
            return False
        self._put_bytes += size
        self._waiting.append(entry)
        # The writing thread says that it is idle before it looks for records a last time.
        if self._idle or (queued >= self._enough and not self._hurried):
            self._hurry()
        return True

    def _admits(self, queued: int, reserve: bool) -> bool:
        room = self._room + _RESERVE_BYTES if reserve else self._room
        return queued <= room and self._error is None

    def has_room(self, entry: Entry) -> bool:
        """Whether ``put`` would find room in the queue."""
        return self.queued_bytes + RECORD_OVERHEAD + len(entry[3]) <= self._room

    def flush(self, timeout_s: float) -> bool:
        """Wait until all that was handed in before is written or given up; False if it is not."""
        passed = threading.Event()
        self._waiting.append(passed)
        self._hurry()
        return passed.wait(timeout_s) if self._writer.is_alive() else passed.is_set()

    def close(self, last: Callable[[], list[Entry]]) -> None:
        """Write what is queued and then the ``last`` records, wait for the disk and close."""
        if self._writer.is_alive():
            self._last = last
            self._waiting.append(None)
            self._hurry()
            self._writer.join(self._options.close_s)
        if self._writer.is_alive():
            self._fail(
                f"{self.path}: the disk has not answered for {self._options.close_s:.0f} s, so "
                "the end of the recording is missing; check the disk.",
                "storage_failed",
            )

    def cut_tail(self) -> None:
        """Cut off what stands after the last sound record.

        Raises
        ------
        StorageError
            If the disk refuses.
        """
        try:
            self._file_system.ftruncate(self._descriptor, self.offset)
        except OSError as error:
            self._fail_on(error)
        if self._error is not None:
            raise self._error

    def abandon(self) -> None:
        """Close a file whose threads were never started."""
        os.close(self._descriptor)

    def _run(self) -> None:
        finished = False
        try:
            while self._turn():
                pass
            finished = True
        finally:
            if not finished:
                self._fail(
                    f"{self.path}: the thread that writes it stopped unexpectedly; "
                    "what was acknowledged is kept.",
                    "storage_failed",
                )
            self._finish()

    def _turn(self) -> bool:
        """Write what is waiting; return whether to go on."""
        items = self._take()
        self._peak_bytes = max(self._peak_bytes, self.queued_bytes)
        batch: list[Entry] = []
        size = 0
        for item in items:
            if isinstance(item, tuple):
                batch.append(item)
                size += RECORD_OVERHEAD + len(item[3])
                if size < _JOINED_WRITE_BYTES:
                    continue
            self._write(batch)
            self._taken_bytes += size
            batch, size = [], 0
            if item is None:
                return False
            if isinstance(item, threading.Event):
                item.set()
        if time.monotonic() >= self._due:
            batch += self._periodic()
            self._due = time.monotonic() + self._options.note_s
        self._write(batch)
        self._taken_bytes += size
        return True

    def _take(self) -> list[Item]:
        """Wait for something to write, but not beyond the next notes, and take all there is.

        Waking up costs more than writing a record does. So after a write a few records may come
        together, unless somebody waits for them.
        """
        if not self._hurried:
            self._bell.acquire(timeout=self._options.join_s)
        self._idle = True
        if not self._waiting:
            self._bell.acquire(timeout=max(0.0, self._due - time.monotonic()))
        self._idle = self._hurried = False
        take = self._waiting.popleft
        return [take() for _ in range(len(self._waiting))]

    def _hurry(self) -> None:
        self._idle = False
        self._hurried = True
        with contextlib.suppress(RuntimeError):  # rung already
            self._bell.release()

    def _write(self, entries: list[Entry], start: bytes = b"") -> None:
        """Append records with one system call; all of them count, or none."""
        if self._error is None and self.sequence + len(entries) > MAX_SEQUENCE:
            self._fail(
                f"{self.path} holds as many records as a trial file can; start another one.",
                "storage_failed",
            )
        if self._error is not None:
            self._given_up += len(entries)
        elif (problem := self._commit(entries, start)) is not None:
            self._given_up += len(entries)
            self._fail_on(problem)

    def _commit(self, entries: list[Entry], start: bytes = b"") -> OSError | None:
        if not entries:
            return None
        problem = self._append(start + encode_records(self._seed, self.sequence, entries))
        if problem is not None:
            if self._torn_bytes:  # some of these may stand there whole, so their numbers are taken
                self.sequence += len(entries)
        else:
            self.sequence += len(entries)
            self.written += len(entries)
            for kind, source, _, payload in entries:
                count = self.counts[kind, source]
                count.records += 1
                count.bytes += len(payload)
            now_ns = self._now_ns()
            self._latency.add([now_ns - entry[2] for entry in entries if entry[0] == _BYTES_IN])
        return problem

    def _append(self, block: bytes) -> OSError | None:
        """Write a block; on failure cut the file back to where it was and say why."""
        before = time.monotonic_ns()
        problem = None
        try:
            count = self._file_system.write(self._descriptor, block)
            if count != len(block):  # writing the rest tells why it was not taken
                count += self._file_system.write(self._descriptor, block[count:])
            if count != len(block):
                problem = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            problem = error
        self._slowest_write_ns = max(self._slowest_write_ns, time.monotonic_ns() - before)
        if problem is None:
            self.offset += self._torn_bytes + len(block)
            self._torn_bytes = 0
            return None
        try:
            self._file_system.ftruncate(self._descriptor, self.offset)
            self._torn_bytes = 0
        except OSError:
            self._torn_bytes = os.fstat(self._descriptor).st_size - self.offset
        return problem

    def _fail_on(self, problem: OSError, kept: str = "which are kept") -> None:
        subject, advice = f"The disk of {self.path} fails", "check the disk"
        if problem.errno in DISK_FULL:
            subject, advice = f"The disk of {self.path} is full", "free some space"
        if problem.errno == errno.EFBIG:
            subject = (
                f"{self.path} has reached the largest size that its disk or its user's limit allows"
            )
            advice = "start another trial, raise the limit or record to another disk"
        self._fail(
            f"{subject} ({problem.strerror}); the recording stopped after {self.sequence} "
            f"records, {kept}; {advice} before you go on.",
            "disk_full" if problem.errno in (*DISK_FULL, errno.EFBIG) else "storage_failed",
        )

    def _fail(self, sentence: str, end_reason: str) -> None:
        with self._error_lock:
            if self._error is not None:
                return
            self._end_reason = end_reason
            self._enough = 0  # so that what is handed in from now on is looked at twice
            error = self._error = StorageError(sentence)
        if self._on_error is not None:
            self._on_error(error)

    def _look_at_file(self) -> None:
        """See that the file is still there and whole; save what it holds where it is not."""
        with self._look_lock:
            if self._error is not None:
                return
            accident = find_accident(self._descriptor, self.path, self.offset)
            if accident is None or accident.kind == "moved":
                return
            stopped = f"the recording stopped after {self.sequence} records"
            if accident.kind == "shortened":
                kept = "of which those cut off are lost"
            else:
                try:
                    self._saved = SavedCopy(self._descriptor, self.path)
                    kept = f"which are kept in {self._saved.path}"
                except StorageError as error:
                    kept = f"which are lost: {error}"
            self._fail(
                f"{accident.sentence}; {stopped}, {kept}; leave the file alone until its recording "
                "has ended.",
                "storage_failed",
            )

    def _say_where_it_is(self) -> None:
        """Say after its end that a recording is whole, but not where it was to be."""
        if self._error is not None:
            return
        accident = find_accident(self._descriptor, self.path, 0)
        if accident is not None:
            self._fail(f"{accident.sentence}; the recording is whole there.", "storage_failed")

    def _finish(self) -> None:
        self._give_back_room()
        self._look_at_file()
        self.offset = min(self.offset, os.fstat(self._descriptor).st_size)  # it was shortened
        # After a failure too: cutting the file back often leaves room for something small.
        problem = self._commit(self._last())
        if problem is not None:
            self._fail_on(problem)
            self._commit(self._last()[-1:])  # the end itself, without what describes
        self._stop_sync.set()
        self._syncer.join()
        self._sync()
        self._say_where_it_is()
        if self._saved is not None:
            self._saved.close()
        os.close(self._descriptor)

    def _keep_syncing(self) -> None:
        while not self._stop_sync.wait(self._options.sync_s):
            self._look_at_file()
            self._sync()

    def _sync(self) -> None:
        offset = self.offset
        if offset == self.synced_offset:
            return
        try:
            self._file_system.fdatasync(self._descriptor)
        except OSError as error:
            # A system says once that it dropped what it could not keep, and then that all is well.
            self._sync_failed = True
            self._fail_on(error, f"of which the first {self.synced_offset} bytes are safe")
        else:
            if not self._sync_failed:
                self.synced_offset = offset
