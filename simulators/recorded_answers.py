"""A device that answers as it did in a recording: the same request gets the same reply."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable

Reply = tuple[tuple[int, bytes], ...]
"""Pieces of an answer, each with its delay after the request [ns]."""

PATIENCE_S = 0.05
"""How long the rest of a request may take that has begun."""

LEAD_NS = 150_000_000
"""A device is as far with a command as it was this much later when recorded.

A program that looks a little later than the recorded one did finds its sensor's data gone on to the
next move. One that is told of an arrival a little early waits for the data.
"""

AHEAD_NS = 10_000_000_000
"""A program is not further ahead of the recording than this, in replay time."""

MOST_WAITING = 65_536
"""Bytes that wait for the rest of a request at most."""


class RecordedAnswers:
    """Finds requests in what a client writes, and what was answered to each.

    Requests are told from one another as they were written when recorded: the longest known one
    that the client's bytes begin with counts. Bytes that begin no known request are passed over.

    A request that never got a reply is a command, and what a device answers depends on its last
    command and on how long ago that was. So a reply is looked for behind the same command of the
    recording, that nearest in replay time, and there at the same distance. A client that has sent
    no command gets the reply nearest in replay time.

    Parameters
    ----------
    exchanges : iterable of (int, bytes, Reply)
        When each request was made [ns], the request, and its reply; in order of time.

    Attributes
    ----------
    unknown_bytes : int
        Written by the client and not part of any recorded request.
    """

    def __init__(self, exchanges: Iterable[tuple[int, bytes, Reply]]) -> None:
        self.unknown_bytes = 0
        recorded = [exchange for exchange in exchanges if exchange[1]]
        answered = {request for _, request, reply in recorded if _said(reply)}
        self._commands: dict[bytes, list[int]] = {}
        self._times: list[int] = []  # of all commands
        self._answers: dict[bytes, _Answers] = {request: _Answers() for request in answered}
        for t_ns, request, reply in recorded:
            if request in answered:
                self._answers[request].add(t_ns, reply, len(self._times))
            else:
                self._commands.setdefault(request, []).append(t_ns)
                self._times.append(t_ns)
        known = {*answered, *self._commands}
        self._sorted = sorted(known)
        self._lengths = sorted({len(request) for request in known}, reverse=True)
        self._waiting = bytearray()
        self._since_s = 0.0
        self._last: tuple[int, int] | None = None  # the client's last command, recorded and here
        self._given_up = False

    def answer(self, data: bytes, t_ns: int, now_s: float) -> list[Reply]:
        """Take in what a client wrote, perhaps nothing, and return the replies that are due.

        Parameters
        ----------
        data : bytes
        t_ns : int
            Replay time.
        now_s : float
            By the machine's clock.
        """
        if data:
            self._since_s = now_s
            self._waiting += data
        replies = []
        while self._waiting:
            request = self._first_request()
            if request:
                replies.append(self._reply(request, t_ns))
                del self._waiting[: len(request)]
            elif self._may_go_on() and now_s - self._since_s < PATIENCE_S:
                break
            else:
                del self._waiting[0]
                self.unknown_bytes += 1
        return replies

    @property
    def expected_ns(self) -> int | None:
        """When the command was recorded that the client, going by its last one, sends next.

        None where it has sent none, or none is left, or it was waited for in vain.
        """
        if self._last is None or self._given_up:
            return None
        place = bisect_right(self._times, self._last[0])
        return self._times[place] if place < len(self._times) else None

    def give_up(self) -> None:
        """Expect no command until the client sends another of the recorded ones."""
        self._given_up = True

    def forget(self) -> None:
        """Begin anew with the next client."""
        self._waiting.clear()
        self._last = None

    def _reply(self, request: bytes, t_ns: int) -> Reply:
        if request in self._commands:
            self._last = self._recorded(self._commands[request], t_ns), t_ns
            self._given_up = False
            return ()
        answers = self._answers[request]
        if self._last is None:
            return answers.nearest(t_ns)
        recorded_ns, here_ns = self._last
        same_ns = recorded_ns + t_ns - here_ns + LEAD_NS
        place = bisect_right(self._times, recorded_ns)
        until = self._times[place] if place < len(self._times) else None
        for stop in (until, None):  # it may have been asked only after several commands in a row
            reply = answers.between(recorded_ns, stop, same_ns)
            if reply is not None:
                return reply
        return answers.nearest(t_ns)

    def _recorded(self, times: list[int], t_ns: int) -> int:
        """Return when a command was recorded that the client sends now.

        The nearest after the one found last: a command may be sent twice in a row.
        """
        first = 0 if self._last is None else bisect_right(times, self._last[0])
        if first < len(times):
            ahead = times[_nearest(times, t_ns, first, len(times))]
            if ahead - t_ns < AHEAD_NS:
                return ahead
        return times[_nearest(times, t_ns, 0, len(times))]

    def _first_request(self) -> bytes | None:
        for length in self._lengths:
            if length <= len(self._waiting):
                request = bytes(self._waiting[:length])
                if request in self._answers or request in self._commands:
                    return request
        return None

    def _may_go_on(self) -> bool:
        """Return whether what waits is the beginning of a known request."""
        begun = bytes(self._waiting)
        place = bisect_left(self._sorted, begun)
        return (
            len(begun) < MOST_WAITING
            and place < len(self._sorted)
            and self._sorted[place].startswith(begun)
        )


class _Answers:
    """The replies to one request; of a run of equal ones only the first and the last."""

    def __init__(self) -> None:
        self._times: list[int] = []
        self._replies: list[Reply] = []
        self._run = 0
        self._command = -1

    def __len__(self) -> int:
        return len(self._times)

    def add(self, t_ns: int, reply: Reply, command: int) -> None:
        """Keep a reply; ``command`` is the number of the last command before it."""
        same = command == self._command and _said(self._replies[-1]) == _said(reply)
        self._command = command
        self._run = self._run + 1 if same else 1
        if self._run > 2:
            self._times[-1] = t_ns
            return
        self._times.append(t_ns)
        self._replies.append(self._replies[-1] if same else reply)

    def nearest(self, t_ns: int) -> Reply:
        return self._replies[_nearest(self._times, t_ns, 0, len(self._times))]

    def between(self, start_ns: int, until_ns: int | None, t_ns: int) -> Reply | None:
        """Return the reply nearest to ``t_ns`` of those in a stretch of time, if there are any."""
        first = bisect_left(self._times, start_ns)
        stop = len(self._times) if until_ns is None else bisect_left(self._times, until_ns)
        return self._replies[_nearest(self._times, t_ns, first, stop)] if first < stop else None


def _nearest(times: list[int], t_ns: int, first: int, stop: int) -> int:
    """Return the place of the time nearest to ``t_ns`` from ``first`` up to before ``stop``."""
    place = bisect_left(times, t_ns, first, stop)
    if place == stop or (place > first and t_ns - times[place - 1] <= times[place] - t_ns):
        place -= 1
    return place


def _said(reply: Reply) -> bytes:
    return b"".join(piece for _, piece in reply)
