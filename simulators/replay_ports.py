"""One source of a replay on its port: who has it open, what it is sent, what it wrote."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field

from simulators.ports import SimulatedPort
from simulators.recorded_answers import RecordedAnswers, Reply

# Constants of time, by the machine's clock.
SETTLE_S = 0.25  # a program that opens a terminal throws away what came before it was set up
SOCKET_SETTLE_S = 0.1  # and pyserial what came through a socket before it was
QUIET_S = 0.1  # for which a terminal must look empty to be empty
TAIL_S = 1.0  # for which a port stays at the end: a read that it cuts off may drop what it has

SEND_BYTES = 16 * 1024
RECEIVED_BYTES = 1 << 20


@dataclass
class ServedSource:
    """One source, its port and its client.

    Attributes
    ----------
    name : str
    port : SimulatedPort
    settle_s : float
        How long a client takes to set its port up.
    answers : RecordedAnswers or None
        Of a source that answers requests.
    queue : bytearray
        What the client is still to be sent.
    replies : deque of (int, bytes)
        Answers under way, and when each is due [ns].
    received : bytearray
        What clients wrote, the last mebibyte of it.
    sent, lost : int
        Bytes that a client's side took, and that had no client.
    since_s : float or None
        When the client came; None without one.
    returning_ns : float or None
        When the port was plugged in again, in replay time, until its client is back.
    told_end : bool
        Whether the client knows that nothing more will come.
    empty_since_s : float or None
        Since when the client seems to have read everything.
    """

    name: str
    port: SimulatedPort
    settle_s: float
    answers: RecordedAnswers | None
    queue: bytearray = field(default_factory=bytearray)
    replies: deque[tuple[int, bytes]] = field(default_factory=deque)
    received: bytearray = field(default_factory=bytearray)
    sent: int = 0
    lost: int = 0
    since_s: float | None = None
    returning_ns: float | None = None
    told_end: bool = False
    empty_since_s: float | None = None

    @property
    def ready(self) -> bool:
        """Whether a client is there and has had the time to set its port up."""
        return self.since_s is not None and time.monotonic() - self.since_s >= self.settle_s

    def look(self, now_s: float, *, keep: bool) -> None:
        """See whether the client has come or gone; ``keep`` what it left for the next."""
        if not self.port.connected:
            self.since_s = None
            self.replies.clear()
            if self.answers is not None:
                self.answers.forget()
            if not keep:
                self.lost += len(self.queue)
                self.queue.clear()
        elif self.since_s is None:
            self.since_s = now_s

    def hear(self, data: bytes) -> None:
        """Take note of what the client writes, which shows that it has set its port up."""
        if self.since_s is not None:
            self.since_s = min(self.since_s, time.monotonic() - self.settle_s)
        self.received += data
        del self.received[:-RECEIVED_BYTES]

    def reply(self, reply: Reply, now_ns: int, speed: float) -> None:
        """Put a reply on its way; replies never overtake one another."""
        for delay_ns, data in reply:
            due = now_ns + int(delay_ns / speed)
            if self.replies:
                due = max(due, self.replies[-1][0])
            self.replies.append((due, data))

    def quiet(self) -> bool:
        """Whether the client has read everything; a read takes what is there bit by bit."""
        return self.all_taken(min(self.settle_s, QUIET_S))

    def at_end(self) -> bool:
        """Whether the client has read everything and had the time to hand it on.

        `serial.Serial.read` of more bytes than there are waits for its timeout, and forgets those
        it has if the port goes meanwhile.
        """
        return self.all_taken(0.0 if self.told_end else TAIL_S)

    def all_taken(self, for_s: float) -> bool:
        """Whether the client has left nothing unread for a while."""
        now_s = time.monotonic()
        if not self.port.all_taken():
            self.empty_since_s = None
            return False
        if self.empty_since_s is None:
            self.empty_since_s = now_s
        return self.since_s is None or now_s - self.empty_since_s >= for_s

    def flush(self) -> None:
        """Send what the client has room for."""
        while self.queue and self.ready:
            count = self.port.offer(bytes(self.queue[:SEND_BYTES]))
            if not count:
                break
            del self.queue[:count]
            self.sent += count
            self.empty_since_s = None
