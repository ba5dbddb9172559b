"""A device that answers as it did in a recording: the same request gets the same reply."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable

Reply = tuple[tuple[int, bytes], ...]
"""Pieces of an answer, each with its delay after the request [ns]."""

PATIENCE_S = 0.05
"""How long the rest of a request may take that has begun."""

MOST_WAITING = 65_536
"""Bytes that wait for the rest of a request at most."""


class RecordedAnswers:
    """Finds requests in what a client writes, and what was answered to each.

    Requests are told from one another as they were written when recorded: the longest known one
    that the client's bytes begin with counts. Bytes that begin no known request are passed over.

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
        self._known: dict[bytes, _Answers] = {}
        for t_ns, request, reply in exchanges:
            if request:
                self._known.setdefault(request, _Answers()).add(t_ns, reply)
        self._sorted = sorted(self._known)
        self._lengths = sorted({len(request) for request in self._sorted}, reverse=True)
        self._waiting = bytearray()
        self._since_s = 0.0

    def answer(self, data: bytes, t_ns: int, now_s: float) -> list[Reply]:
        """Take in what a client wrote, perhaps nothing, and return the replies that are due.

        Parameters
        ----------
        data : bytes
        t_ns : int
            Replay time: of several recorded replies the nearest counts.
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
                replies.append(self._known[request].nearest(t_ns))
                del self._waiting[: len(request)]
            elif self._may_go_on() and now_s - self._since_s < PATIENCE_S:
                break
            else:
                del self._waiting[0]
                self.unknown_bytes += 1
        return replies

    def forget(self) -> None:
        """Drop the beginning of a request whose client has gone."""
        self._waiting.clear()

    def _first_request(self) -> bytes | None:
        for length in self._lengths:
            if length <= len(self._waiting):
                request = bytes(self._waiting[:length])
                if request in self._known:
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
    """The replies to one request; of a run of equal ones the first and the last."""

    def __init__(self) -> None:
        self._times: list[int] = []
        self._replies: list[Reply] = []
        self._run = 0

    def add(self, t_ns: int, reply: Reply) -> None:
        same = bool(self._replies) and _said(self._replies[-1]) == _said(reply)
        self._run = self._run + 1 if same else 1
        if self._run > 2:
            self._times[-1] = t_ns
            return
        self._times.append(t_ns)
        self._replies.append(self._replies[-1] if same else reply)

    def nearest(self, t_ns: int) -> Reply:
        place = bisect_left(self._times, t_ns)
        if place == len(self._times):
            return self._replies[-1]
        if place and t_ns - self._times[place - 1] <= self._times[place] - t_ns:
            place -= 1
        return self._replies[place]


def _said(reply: Reply) -> bytes:
    return b"".join(piece for _, piece in reply)
