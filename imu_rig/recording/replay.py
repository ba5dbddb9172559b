"""A trial as what went over its wires, piece by piece in the order of time, to be played again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

import numpy as np

from imu_rig.arrays import AnyArray, BoolArray, IntArray
from imu_rig.clock import NS_PER_S
from imu_rig.errors import InputError
from imu_rig.foreign_text import one_line
from imu_rig.recording.contents import Source
from imu_rig.recording.format import UNPLUGGED, Kind
from imu_rig.recording.reader import Trial
from imu_rig.recording.storage import read_exactly

What = Literal["in", "out", "unplug", "plug", "end"]

LONGEST_SILENCE_S = 600.0
"""A longer one, of a trial that went on the next day, is replayed as this long."""

REPLY_S = 1.0
"""What a device sends within this time of a request may be the answer to it."""

MOST_EXCHANGES = 1_000_000
"""So many requests of one source are learned; a jig session of an hour has some ten thousand."""

MOST_NAMED = 5
"""Names in one sentence."""

_LATEST_NS = 1 << 61  # sums and differences of times stay within 64 bits
_BLOCK_ROWS = 4096
_BLOCK_BYTES = 4 << 20  # read from the file at a time


class TimedChunk(NamedTuple):
    """Something that happened on a wire.

    Attributes
    ----------
    t_ns : int
        Trial time, long silences shortened.
    source : str
        Name of the source; empty at the end.
    what : str
        ``"in"`` and ``"out"``: bytes from and to the source. ``"unplug"`` and ``"plug"``: its port
        vanished and came back. ``"end"``: of the trial, after everything else.
    data : bytes
    """

    t_ns: int
    source: str
    what: What
    data: bytes


class Exchange(NamedTuple):
    """A request and what came back.

    Attributes
    ----------
    t_ns : int
        When it was asked, in trial time.
    request : bytes
    reply : tuple of (int, bytes)
        Pieces of the answer, each with its delay after the request [ns]; empty where none came.
    """

    t_ns: int
    request: bytes
    reply: tuple[tuple[int, bytes], ...]


class RecordedWires:
    """The wires of a trial, streamed from its file however large it is. Iterate as often as needed.

    A source that was sent bytes and has no packet layout answers requests: what it sent within
    ``REPLY_S`` of one is left out of the iteration and found in :meth:`exchanges`.

    Times that no recorder writes are put right: within a source time never goes back, and nothing
    is silent for longer than ``longest_silence_s``.

    Parameters
    ----------
    trial : Trial
    names : sequence of str
        Sources to play; all by default.
    longest_silence_s : float

    Attributes
    ----------
    sources : tuple of Source
    answering : tuple of str
        Names of those that answer requests.
    duration_ns : int
        Trial time of the end, long silences shortened.
    notes : list of str
        Sentences about what is not replayed as it stands in the file.

    Raises
    ------
    InputError
        If a source is not in the trial, or none of them sent or was sent anything.
    """

    def __init__(
        self,
        trial: Trial,
        names: Sequence[str] = (),
        *,
        longest_silence_s: float = LONGEST_SILENCE_S,
    ) -> None:
        self.notes: list[str] = []
        self._trial = trial
        self.sources = tuple(trial.source(name) for name in dict.fromkeys(names)) or tuple(
            trial.sources.values()
        )
        if not self.sources:
            raise InputError(f"{trial.path} holds no sources, so there is nothing to replay.")
        records = trial.records
        numbers = [source.id for source in self.sources]
        on_wire = (records.kind == Kind.BYTES_IN) | (records.kind == Kind.BYTES_OUT)
        rows = np.flatnonzero(on_wire & np.isin(records.source, numbers))
        if not len(rows):
            which = "Its" if not names else "The chosen"
            raise InputError(
                f"{trial.path} holds no bytes to replay. {which} sources sent nothing."
            )
        times = self._times(rows)
        order = np.argsort(times, kind="stable")
        self._rows, recorded = rows[order], times[order]
        self._recorded_ns = recorded
        self._t_ns = self._without_long_silences(recorded, longest_silence_s)
        self.duration_ns = self._end()
        self._names = {source.id: source.name for source in self.sources}
        is_reply = np.zeros(len(self._rows), bool)
        self._replies: dict[str, BoolArray] = {}
        for source in self.sources:
            if not isinstance(source.descriptor.get("layout"), dict):
                of_source = self._replies_of(source)
                if of_source is not None:
                    self._replies[source.name] = of_source
                    is_reply |= of_source
        self._played = ~is_reply
        self.answering = tuple(self._replies)
        self._plugs = self._unpluggings()

    def __iter__(self) -> Iterator[TimedChunk]:
        """Yield everything in order of time, replies to requests left out, and the end."""
        plugs = iter([*self._plugs, TimedChunk(self.duration_ns, "", "end", b"")])
        plug = next(plugs)
        for chunk in self._chunks(self._played):
            while plug.t_ns <= chunk.t_ns and plug.what != "end":
                yield plug
                plug = next(plugs)
            yield chunk
        yield plug
        yield from plugs

    def exchanges(self, name: str) -> Iterator[Exchange]:
        """Yield the requests that a source was sent, with its answers, in order of time."""
        number = self._trial.source(name).id
        records = self._trial.records
        asked = (records.kind[self._rows] == Kind.BYTES_OUT) & (
            records.source[self._rows] == number
        )
        chosen = asked | self._replies[name]
        pending: tuple[int, bytes] | None = None
        reply: list[tuple[int, bytes]] = []
        count = 0
        for chunk in self._chunks(chosen):
            if chunk.what == "in" and pending is not None:
                reply.append((chunk.t_ns - pending[0], chunk.data))
                continue
            if pending is not None:
                yield Exchange(*pending, tuple(reply))
                count += 1
                if count == MOST_EXCHANGES:
                    return
            pending, reply = (chunk.t_ns, chunk.data), []
        if pending is not None:
            yield Exchange(*pending, tuple(reply))

    def _times(self, rows: IntArray) -> IntArray:
        """Trial time of each row, put right within each source."""
        records = self._trial.records
        times = np.clip(records.time_ns[rows], 0, _LATEST_NS)
        moved: dict[str, int] = {}
        for source in self.sources:
            mine = np.flatnonzero(records.source[rows] == source.id)
            steady = _never_back(times[mine])
            count = int(np.count_nonzero(steady != records.time_ns[rows[mine]]))
            if count:
                moved[source.name] = count
            times[mine] = steady
        if moved:
            names = ", ".join(repr(one_line(name)) for name in list(moved)[:MOST_NAMED])
            more = f" and {len(moved) - MOST_NAMED} more" if len(moved) > MOST_NAMED else ""
            self.notes.append(
                f"{sum(moved.values())} pieces of {names}{more} have times that go back or are "
                "before the start; they are replayed in the order of the file."
            )
        return times

    def _without_long_silences(self, recorded: IntArray, longest_s: float) -> IntArray:
        self._longest_ns = int(longest_s * NS_PER_S)
        steps = np.diff(recorded, prepend=0)
        long = steps > self._longest_ns
        if long.any():
            self.notes.append(
                f"{_times_word(int(long.sum()))} nothing came for longer than {longest_s:g} s "
                f"({_hours(int(steps.max()))} at the longest); such a silence is replayed as "
                f"{longest_s:g} s."
            )
        shortened: IntArray = np.cumsum(np.minimum(steps, self._longest_ns))
        return shortened

    def _replayed_ns(self, recorded_ns: int) -> int:
        """When something between the pieces is replayed that was at this trial time."""
        place = int(np.searchsorted(self._recorded_ns, recorded_ns, side="right")) - 1
        since, at = (
            (int(self._recorded_ns[place]), int(self._t_ns[place])) if place >= 0 else (0, 0)
        )
        return at + min(max(0, recorded_ns - since), self._longest_ns)

    def _end(self) -> int:
        """When the trial's last record is replayed, if it can be right, or the last piece."""
        last = int(self._trial.records.time_ns[-1])
        return max(int(self._t_ns[-1]), self._replayed_ns(min(last, _LATEST_NS)))

    def _replies_of(self, source: Source) -> BoolArray | None:
        """Which pieces answer a request to the source; None if nobody asked it anything."""
        records = self._trial.records
        mine = np.flatnonzero(records.source[self._rows] == source.id)
        asked = records.kind[self._rows[mine]] == Kind.BYTES_OUT
        if not asked.any():
            return None
        t = self._t_ns[mine]
        latest: AnyArray = np.maximum.accumulate(np.where(asked, np.arange(len(mine)), -1))
        soon = t - t[np.maximum(latest, 0)] <= int(REPLY_S * NS_PER_S)
        is_reply = np.zeros(len(self._rows), bool)
        is_reply[mine] = ~asked & (latest >= 0) & soon
        if int(asked.sum()) > MOST_EXCHANGES:
            self.notes.append(
                f"{one_line(source.name)!r} answers as it did to the first {MOST_EXCHANGES} "
                "requests; what it was asked later is not learned."
            )
        return is_reply

    def _unpluggings(self) -> list[TimedChunk]:
        """When ports vanished and came back, in order of time."""
        stated: dict[str, list[tuple[int, int | None]]] = {}
        for gap in self._trial.gaps:
            if gap.source in self._names and gap.fields.get("reason") == UNPLUGGED:
                until = gap.fields.get("until_s")
                back = (
                    _ns(until)
                    if isinstance(until, int | float)
                    else self._next_bytes(gap.source, gap.t)
                )
                stated.setdefault(self._names[gap.source], []).append((_ns(gap.t), back))
        found = []
        for name, spans in stated.items():
            for begin, end in _common(spans):
                gone = self._replayed_ns(begin)
                found.append(TimedChunk(gone, name, "unplug", b""))
                if end is not None:
                    found.append(TimedChunk(max(gone, self._replayed_ns(end)), name, "plug", b""))
        return sorted(found, key=lambda chunk: chunk.t_ns)

    def _next_bytes(self, number: int, t: float) -> int | None:
        later = np.flatnonzero(
            (self._trial.records.source[self._rows] == number) & (self._recorded_ns > _ns(t))
        )
        return int(self._recorded_ns[later[0]]) if len(later) else None

    def _chunks(self, chosen: BoolArray) -> Iterator[TimedChunk]:
        """Read the chosen pieces from the file, a few thousand at a time."""
        records, path = self._trial.records, self._trial.path
        places = np.flatnonzero(chosen)
        with path.open("rb", buffering=0) as file:
            first = 0
            while first < len(places):
                block = places[first : first + _BLOCK_ROWS]
                rows = self._rows[block]
                fits = int(np.searchsorted(np.cumsum(records.length[rows]), _BLOCK_BYTES)) + 1
                block, rows = block[:fits], rows[:fits]
                first += len(block)
                start = records.offset[rows]
                length = records.length[rows]
                low, high = int(start.min()), int((start + length).max())
                window = b""
                if high - low <= 2 * _BLOCK_BYTES:
                    file.seek(low)
                    window = read_exactly(file, high - low, path)
                for t_ns, kind, number, at, size in zip(
                    self._t_ns[block].tolist(),
                    records.kind[rows].tolist(),
                    records.source[rows].tolist(),
                    start.tolist(),
                    length.tolist(),
                    strict=True,
                ):
                    if window:
                        data = window[at - low : at - low + size]
                    else:  # pieces that stand far apart, as in a file that somebody made up
                        file.seek(at)
                        data = read_exactly(file, size, path)
                    what: What = "in" if kind == Kind.BYTES_IN else "out"
                    yield TimedChunk(t_ns, self._names[number], what, data)


def _common(spans: list[tuple[int, int | None]]) -> list[tuple[int, int | None]]:
    """Return what overlapping spans have in common, in order; one without an end goes on.

    Each of several streams of a port states its own gap when the port vanishes.
    """
    found: list[tuple[int, int | None]] = []
    for begin, end in sorted(spans, key=lambda span: span[0]):
        last = found[-1] if found else None
        if last is None or (last[1] is not None and begin >= last[1]):
            found.append((begin, end))
        else:
            ends = [e for e in (last[1], end) if e is not None]
            found[-1] = (begin, min(ends, default=None))
    return found


def _never_back(times: IntArray) -> IntArray:
    """Make times ascend, by lifting what is too early or lowering what is too late.

    Whichever changes fewer of them: one stamp far in the future must not push all later ones
    there, nor one of zero pull all earlier ones down.
    """
    lifted: IntArray = np.maximum.accumulate(times)
    lowered: IntArray = np.minimum.accumulate(times[::-1])[::-1]
    return (
        lifted
        if np.count_nonzero(lifted != times) <= np.count_nonzero(lowered != times)
        else lowered
    )


def _ns(seconds: float) -> int:
    return int(min(max(0.0, seconds), _LATEST_NS / NS_PER_S) * NS_PER_S)


def _times_word(count: int) -> str:
    return "Once" if count == 1 else f"{count} times"


def _hours(span_ns: int) -> str:
    seconds = span_ns / NS_PER_S
    return f"{seconds / 3600:.3g} h" if seconds >= 3600 else f"{seconds:.3g} s"
