"""Recorded devices on real ports: what a trial holds, byte for byte and at its time.

It takes what happened on the wires as an iterable, and knows nothing of the file it came from; see
`imu_rig.recording.replay.RecordedWires`, and `imu_rig.testing.replayed` for both together.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

from imu_rig.clock import NS_PER_S, Clock, SteppedClock, SystemClock
from simulators.ports import SimulatedPort, Transport, port_maker, wait_readable
from simulators.recorded_answers import RecordedAnswers, Reply
from simulators.replay_ports import SETTLE_S, SOCKET_SETTLE_S, ServedSource

TimedChunk = tuple[int, str, Literal["in", "out", "unplug", "plug", "end"], bytes]
"""Time [ns], source, what happened and bytes; see `imu_rig.recording.replay.TimedChunk`."""

FAST = math.inf
"""A speed: as fast as the clients read."""

# Constants of time, by the machine's clock.
IDLE_S = 0.01  # longest time between two looks at the ports
BUSY_S = 0.002  # between two attempts to send to a client that is behind
FINE_S = 0.0015  # waits below this are slept, above it a client's word ends them
RETURN_S = 2.0  # of replay time, for which a port that is plugged in again waits for its client

FOLLOW_S = 0.5  # of both clocks, for which the data wait for a command that was due
GRACE_NS = 30_000_000  # of replay time: what was sent so soon after a command shows nothing of it
LINGER_S = 5.0  # of the clock: for a program that asks and is behind to finish what it does

WAITING_BYTES = 256 * 1024
"""What one client may be behind, besides the system's own buffers, before the replay waits."""

MOST_AT_ONCE = 2000
MOST_LATE = 20_000
SHORTEST_LOOP_NS = 1_000_000


@dataclass(frozen=True)
class ReplayStatus:
    """How a replay does.

    Attributes
    ----------
    state : str
        ``"waiting"``: for clients, before the start. ``"playing"``. ``"held"``: for a client that
        is behind or has left. ``"ending"``: until the clients have read everything. ``"ended"``.
    t_s : float
        Trial time reached [s].
    loops : int
        How often it began anew.
    sent : dict of str to int
        Bytes by source that a client's side took.
    lost : dict of str to int
        Bytes by source that had no client, as those of a radio that is not connected.
    without_client : tuple of str
        Sources whose port nobody has open.
    """

    state: Literal["waiting", "playing", "held", "ending", "ended"]
    t_s: float
    loops: int
    sent: dict[str, int]
    lost: dict[str, int]
    without_client: tuple[str, ...]


@dataclass(frozen=True, repr=False)
class Waited:
    """Whether a replay has ended, and if not, why: a failing ``assert`` shows it."""

    ended: bool
    why: str

    def __bool__(self) -> bool:
        """Whether it has ended."""
        return self.ended

    def __repr__(self) -> str:
        """In words."""
        return "<ended>" if self.ended else f"<not ended: {self.why}>"


class Replay:
    """Recorded sources, each on a port that any program can open.

    On a running clock a thread plays them. A :class:`SteppedClock` has no thread: :meth:`step` and
    :meth:`step_to_next` move clock and replay together. No byte is dropped because a client is
    slow: the replay, all sources of it, waits until there is room again.

    Parameters
    ----------
    sources : sequence of str
        Names; each gets a port.
    chunks : iterable of TimedChunk
        What happened, in order of time, an ``"end"`` last. Iterated anew for each loop.
    clock : Clock, optional
        The machine's by default.
    speed : float
        Seconds of the recording per second on the clock, or :data:`FAST`.
    transport : str
        "pty" for pseudo-terminals, "tcp" for sockets on this machine.
    answers : mapping of str to iterable, optional
        Exchanges of the sources that answer requests; see `simulators.recorded_answers`.
    wait : bool
        Begin when every port has a client, and at :data:`FAST` wait for one that left. Otherwise
        bytes without a client are lost, as they are in life.
    loop : bool
        Begin anew at the end.
    unplug_in_gaps : bool
        Let a port vanish where the recording says that it was unplugged.
    folder : Path, optional
        For the names of pseudo-terminals; otherwise a temporary one.
    """

    def __init__(
        self,
        sources: Sequence[str],
        chunks: Iterable[TimedChunk],
        *,
        clock: Clock | None = None,
        speed: float = 1.0,
        transport: Transport = "pty",
        answers: Mapping[str, Iterable[tuple[int, bytes, Reply]]] | None = None,
        wait: bool = True,
        loop: bool = False,
        unplug_in_gaps: bool = False,
        folder: Path | None = None,
    ) -> None:
        if not speed > 0:
            raise ValueError(f"a replay's speed must be above 0, not {speed}")
        self._names = tuple(sources)
        self._chunks = chunks
        self._clock = clock or SystemClock()
        self._speed, self._transport = speed, transport
        self._answers = answers or {}
        self._wait_for_clients, self._loop, self._unplug = wait, loop, unplug_in_gaps
        self._folder = folder
        self._served: dict[str, ServedSource] = {}
        self._lock = threading.RLock()
        self._stopping = threading.Event()
        self._finished = threading.Event()
        self._thread: threading.Thread | None = None
        self._resources = ExitStack()
        self._script: Iterator[TimedChunk] = iter(())
        self._next: TimedChunk | None = None
        self._origin_ns: int | None = None
        self._held_ns: int | None = None
        self._held_since_s = 0.0
        self._base_ns = self._played_ns = 0
        self._ended_ns: int | None = None
        self._loops = 0
        self._ending = False
        self._late_ns: deque[float] = deque(maxlen=MOST_LATE)
        self._error: Exception | None = None

    def __enter__(self) -> Self:
        """Start."""
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Stop."""
        self.stop()

    # --- what a test or a command does with it -------------------------------------------------

    def start(self) -> None:
        """Open the ports. Does nothing the second time.

        Raises
        ------
        PortError
            If a port cannot be made.
        """
        if self._served or self._stopping.is_set():
            return
        with ExitStack() as resources:
            make = port_maker(self._transport, resources, self._folder)
            served = {name: self._serving(name, make(name)) for name in self._names}
            self._resources = resources.pop_all()
        self._served = served
        self._script = iter(self._chunks)
        if not isinstance(self._clock, SteppedClock):
            self._thread = threading.Thread(target=self._pump, name="replay", daemon=True)
            self._thread.start()

    def _serving(self, name: str, port: SimulatedPort) -> ServedSource:
        answers = self._answers.get(name)
        return ServedSource(
            name,
            port,
            settle_s=SETTLE_S if self._transport == "pty" else SOCKET_SETTLE_S,
            answers=None if answers is None else RecordedAnswers(answers),
        )

    def stop(self) -> None:
        """Take the ports away and end the thread. Does nothing the second time."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        with self._lock:
            self._resources.close()
            self._script = iter(())  # lets go of the recording's file

    def ports(self) -> dict[str, str]:
        """Return the address of every source's port, from the start on."""
        if not self._served:
            raise RuntimeError("the replay has no ports before its start.")
        return {name: served.port.url for name, served in self._served.items()}

    def url(self, name: str) -> str:
        """Return the address of one source's port."""
        return self.ports()[name]

    def received(self, name: str) -> bytes:
        """Return what clients wrote to a source, the last mebibyte of it."""
        with self._lock:
            return bytes(self._served[name].received)

    def unknown_bytes(self, name: str) -> int:
        """Return how many bytes that clients wrote were part of no recorded request."""
        with self._lock:
            answers = self._served[name].answers
            return 0 if answers is None else answers.unknown_bytes

    def lateness_s(self) -> list[float]:
        """Return how late the last chunks were sent, by the replay's clock [s]."""
        with self._lock:
            return [late / NS_PER_S for late in self._late_ns]

    @property
    def status(self) -> ReplayStatus:
        """How it does now."""
        with self._lock:
            served = self._served.values()
            return ReplayStatus(
                self._state(),
                (self._played_ns if self._ending else self._position_ns()) / NS_PER_S,
                self._loops,
                {s.name: s.sent for s in served},
                {s.name: s.lost for s in served},
                tuple(s.name for s in served if s.since_s is None),
            )

    def wait_for_clients(self, timeout_s: float) -> bool:
        """Wait until every port has a client that can read, and return whether that is so."""
        deadline = time.monotonic() + timeout_s
        while True:
            with self._lock:
                if self._thread is None:
                    self._listen()
                if all(served.ready for served in self._served.values()):
                    return True
            if time.monotonic() > deadline:
                return False
            time.sleep(BUSY_S)

    def wait(self, timeout_s: float | None = None) -> Waited:
        """Wait for the end: everything read by the clients and the ports gone.

        Returns
        -------
        Waited
            True if it was reached; otherwise it says in words what the replay waits for.

        Raises
        ------
        Exception
            What the recording raised while it was read.
        """
        ended = self._finished.wait(timeout_s)
        if self._error is not None:
            raise self._error
        return Waited(ended, "" if ended else self._hindrance())

    def _hindrance(self) -> str:
        """Say why it has not ended yet."""
        status = self.status
        absent = f"nobody has open the port of {', '.join(status.without_client)}"
        if status.state == "waiting":
            return absent if status.without_client else "it begins in a moment"
        if status.state == "held":
            return absent if status.without_client else "a program reads too slowly"
        if status.state == "ending":
            return "everything is sent and not read to the end"
        return f"it is at {status.t_s:.1f} s of the recording"

    def step(self, seconds: float) -> None:
        """Move a stepped clock forward and send what is due; 0 only serves the ports.

        What a client has no room for is sent in the next step.

        Raises
        ------
        RuntimeError
            If the clock runs by itself, or a port has no client yet.
        """
        clock = self._stepped_clock()
        with self._lock:
            self._begin_stepping()
            self._serve_all_due()
            clock.advance(seconds)
            self._serve_all_due()

    def step_to_next(self) -> float | None:
        """Move a stepped clock to the next moment at which something is due, and send it.

        Returns
        -------
        float or None
            Seconds on the clock until then; None after the last.
        """
        self._stepped_clock()
        with self._lock:
            self._begin_stepping()
            if self._peek() is None:
                self.step(0)
                return None
            seconds = max(0.0, (self._due_ns() - self._replay_ns()) / NS_PER_S / self._speed)
            self.step(math.ceil(seconds * NS_PER_S) / NS_PER_S)
            return seconds

    # --- one look at everything ----------------------------------------------------------------

    def _serve_all_due(self) -> None:
        while not self._finished.is_set() and self._serve() == 0:
            pass
        self._finish_if_done()

    def _serve(self) -> float:
        """Serve all ports once and return how long nothing needs to be done [s of the clock]."""
        self._listen()
        served = self._served.values()
        if self._origin_ns is None and (not self._wait_for_clients or all(s.ready for s in served)):
            self._origin_ns = self._clock.now_ns()
        due_s = IDLE_S if self._origin_ns is None else self._play()
        for each in served:
            due_s = min(due_s, self._send_replies(each))
            each.flush()
            if each.queue:
                due_s = min(due_s, BUSY_S)
        return due_s

    def _listen(self) -> None:
        """Take what clients wrote, and see who has come and who has gone."""
        now_s = time.monotonic()
        keep = self._keeps_for_absent
        for each in self._served.values():
            data = each.port.read()
            each.look(now_s, keep=keep or self._returning(each))
            if data:
                each.hear(data)
            if each.answers is not None:
                for reply in each.answers.answer(data, self._position_ns(), now_s):
                    # a clock that stands still would keep the reply until the next step
                    stepped = isinstance(self._clock, SteppedClock)
                    each.reply(reply, self._clock.now_ns(), FAST if stepped else self._speed)

    def _play(self) -> float:
        """Send what is due; return the time until more is [s of the clock]."""
        for _ in range(MOST_AT_ONCE):
            chunk = self._peek()
            if chunk is None:
                return IDLE_S
            wait_ns = self._due_ns() - self._replay_ns()
            if wait_ns > 0:
                return min(IDLE_S, wait_ns / NS_PER_S / self._speed)
            if not self._room_for(chunk) or self._awaits_command():
                if self._held_ns is None:
                    self._held_ns = self._clock.now_ns()
                return BUSY_S
            if self._held_ns is not None and self._origin_ns is not None:
                self._origin_ns += self._clock.now_ns() - self._held_ns
                self._held_ns = None
            self._perform(chunk)
        return 0.0

    def _awaits_command(self) -> bool:
        """Whether a program that commands a device, as the recorded one did, is behind it.

        What sensors sent after a command makes no sense to a program before it has given it.
        """
        if self._speed == FAST or isinstance(self._clock, SteppedClock):
            return False
        for each in self._served.values():
            expected = None if each.answers is None else each.answers.expected_ns
            if expected is None or self._due_ns() - self._base_ns <= expected + GRACE_NS:
                continue
            if self._held_ns is None:
                self._held_since_s = time.monotonic()
                return True
            held_s = (self._clock.now_ns() - self._held_ns) / NS_PER_S
            if min(held_s, time.monotonic() - self._held_since_s) < FOLLOW_S:
                return True
            if each.answers is not None:
                each.answers.give_up()
        return False

    def _room_for(self, chunk: TimedChunk) -> bool:
        _, name, what, _ = chunk
        each = self._served.get(name)
        if each is None or what in ("plug", "end"):
            return True
        absent = each.since_s is None
        if what == "unplug":  # what came before it was received, so it must be now
            return (
                not self._unplug or (absent and not each.queue) or (not each.queue and each.quiet())
            )
        if absent and self._keeps_for_absent and each.port.plugged:
            return False
        return len(each.queue) < WAITING_BYTES

    def _perform(self, chunk: TimedChunk) -> None:
        t_ns, name, what, data = chunk
        self._next = None
        due_ns = self._base_ns + t_ns
        each = self._served.get(name)
        if what == "end":
            self._end(t_ns)
        elif each is None:
            return
        elif what == "in":
            if self._speed != FAST:
                self._late_ns.append((self._replay_ns() - due_ns) / self._speed)
            if not each.port.plugged:
                self._plug(each)
            if each.since_s is not None or self._returning(each) or self._keeps_for_absent:
                each.queue += data
                each.flush()
            else:
                each.lost += len(data)
        elif what == "unplug" and self._unplug:
            each.port.unplug()
            each.look(time.monotonic(), keep=False)
        elif what == "plug" and self._unplug and not each.port.plugged:
            self._plug(each)
        self._played_ns = max(self._played_ns, t_ns)

    def _plug(self, each: ServedSource) -> None:
        each.port.plug()
        each.returning_ns = self._base_ns + self._played_ns

    def _end(self, t_ns: int) -> None:
        if not self._loop:
            self._ending = True
            return
        self._loops += 1
        self._base_ns += max(t_ns, SHORTEST_LOOP_NS)
        self._played_ns = 0
        self._script = iter(self._chunks)

    def _send_replies(self, each: ServedSource) -> float:
        """Queue the replies that are due; return the time until the next is [s of the clock]."""
        now = self._clock.now_ns()
        while each.replies and each.replies[0][0] <= now:
            each.queue += each.replies.popleft()[1]
        return (each.replies[0][0] - now) / NS_PER_S if each.replies else IDLE_S

    def _finish_if_done(self) -> None:
        """After the last chunk: take each port away as soon as its client has read everything."""
        if not self._ending or self._finished.is_set() or self._lingers():
            return
        served = self._served.values()
        for each in served:
            if each.queue or each.replies or not each.port.plugged or not each.at_end():
                continue
            if not each.told_end:
                each.port.end_of_data()
                each.told_end = True
            if each.at_end():
                each.port.unplug()
                each.since_s = None
        if not any(each.port.plugged for each in served):
            self._finished.set()

    def _lingers(self) -> bool:
        """Whether a program that has asked a device may still be asking."""
        if self._ended_ns is None:
            self._ended_ns = self._clock.now_ns()
        asking = self._speed != FAST and any(
            s.answers is not None and s.since_s is not None and s.received
            for s in self._served.values()
        )
        return asking and self._clock.now_ns() - self._ended_ns < LINGER_S * NS_PER_S

    # --- time ----------------------------------------------------------------------------------

    def _replay_ns(self) -> float:
        """Time since the start in the recording's time, over all loops; infinite at FAST."""
        if self._origin_ns is None:
            return 0
        if self._speed == FAST:
            return math.inf
        now = self._clock.now_ns() if self._held_ns is None else self._held_ns
        return (now - self._origin_ns) * self._speed

    def _position_ns(self) -> int:
        """Trial time that has been reached."""
        if self._speed == FAST or self._origin_ns is None:
            return self._played_ns
        return int(self._replay_ns()) - self._base_ns

    def _peek(self) -> TimedChunk | None:
        if self._next is None and not self._ending:
            sent = (chunk for chunk in self._script if chunk[2] != "out")
            self._next = next(sent, None)
            if self._next is None:
                self._ending = True
        return self._next

    def _due_ns(self) -> int:
        return self._base_ns + (self._next[0] if self._next else 0)

    def _returning(self, each: ServedSource) -> bool:
        """Whether a port was plugged in again so recently that its client may not know it."""
        if each.returning_ns is None:
            return False
        limit_ns = RETURN_S * NS_PER_S
        recent = self._speed == FAST or self._replay_ns() - each.returning_ns < limit_ns
        if each.ready or not recent:
            each.returning_ns = None
        return each.returning_ns is not None

    @property
    def _keeps_for_absent(self) -> bool:
        return self._speed == FAST and self._wait_for_clients

    def _state(self) -> Literal["waiting", "playing", "held", "ending", "ended"]:
        if self._finished.is_set():
            return "ended"
        if self._origin_ns is None:
            return "waiting"
        if self._ending:
            return "ending"
        return "playing" if self._held_ns is None else "held"

    # --- the thread and its ports --------------------------------------------------------------

    def _pump(self) -> None:
        try:
            while not (self._stopping.is_set() or self._finished.is_set()):
                with self._lock:
                    seconds = self._serve()
                    self._finish_if_done()
                    descriptors = [d for s in self._served.values() for d in s.port.descriptors()]
                if seconds > 0:
                    self._pause(descriptors, seconds)
        except Exception as error:  # whatever the recording raises, `wait` raises it again
            self._error = error
        finally:  # clients must see that nobody serves them any more
            with self._lock:
                for served in self._served.values():
                    served.port.unplug()
            self._finished.set()

    def _pause(self, descriptors: list[int], seconds: float) -> None:
        """Wait until something is due or a client writes; never late by more than a scheduler is.

        Waiting on descriptors is rounded up to milliseconds, so the rest of a wait is slept.
        """
        seconds /= self._clock.speed
        if seconds <= FINE_S:
            time.sleep(seconds)
            return
        if not descriptors:
            self._stopping.wait(seconds - FINE_S / 2)
            return
        wait_readable(descriptors, (seconds - FINE_S / 2) // 0.001 * 0.001)

    def _stepped_clock(self) -> SteppedClock:
        if not isinstance(self._clock, SteppedClock):
            raise RuntimeError("the replay's clock runs by itself; only a SteppedClock is stepped.")
        return self._clock

    def _begin_stepping(self) -> None:
        """See to it that the clients which are there can read, and that none is missing."""
        if self._finished.is_set():
            return
        deadline = time.monotonic() + 2 * SETTLE_S
        self._listen()
        while any(s.since_s is not None and not s.ready for s in self._served.values()):
            if time.monotonic() > deadline:
                break
            time.sleep(BUSY_S)
            self._listen()
        if self._origin_ns is None and self._wait_for_clients:
            missing = [s.name for s in self._served.values() if not s.ready]
            if missing:
                raise RuntimeError(f"nobody has opened the port of {', '.join(missing)} yet.")
        if self._origin_ns is None:
            self._origin_ns = self._clock.now_ns()
