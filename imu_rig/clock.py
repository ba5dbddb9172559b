"""Monotonic time as a value that can be handed in, so that a simulated hour need not take one."""

import threading
import time
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Protocol

NS_PER_S = 1_000_000_000
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def utc_of(utc_ns: int) -> datetime:
    """Return a wall clock time [ns since 1970 UTC] to the microsecond."""
    return _EPOCH + timedelta(microseconds=round(utc_ns / 1000))


def utc_text(utc: datetime, timespec: str = "microseconds") -> str:
    """Write a moment of UTC as ``2026-05-04T12:00:00.000000Z``."""
    return utc.isoformat(timespec=timespec).replace("+00:00", "Z")


class Clock(Protocol):
    """A monotonic clock and the means to wait on it."""

    @property
    def speed(self) -> float:
        """Seconds on this clock per second of the machine's."""
        ...

    def now_ns(self) -> int:
        """Nanoseconds on this clock; the origin is arbitrary."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait for ``seconds`` of this clock's time."""
        ...


class SystemClock:
    """The machine's monotonic clock."""

    speed = 1.0

    def now_ns(self) -> int:
        """Nanoseconds of ``time.monotonic_ns``."""
        return time.monotonic_ns()

    def sleep(self, seconds: float) -> None:
        """Sleep for ``seconds``."""
        time.sleep(max(0.0, seconds))


class ScaledClock:
    """A clock that runs ``speed`` times as fast as the machine's, for simulated hardware.

    A stall of the whole process (no thread looked at the clock for ``STALL_S``) is left out, so
    that a busy machine does not look like hardware that went silent; and what is simulated by it
    may hold it, to come along.

    Parameters
    ----------
    speed : float
        Seconds on this clock per second of the machine's clock, above 0.
    """

    STALL_S = 0.02
    SHORTEST_SLEEP_S = 0.0002

    def __init__(self, speed: float) -> None:
        if not speed > 0:
            raise ValueError(f"a clock's speed must be above 0, not {speed}")
        self.speed = speed
        self._lock = threading.Lock()
        self._seen = time.monotonic_ns()
        self._now = float(self._seen)
        self._held: dict[object, float] = {}

    def now_ns(self) -> int:
        """Nanoseconds on the scaled clock, continuous from the moment it was made."""
        with self._lock:
            seen = time.monotonic_ns()
            passed = min(seen - self._seen, self.STALL_S * NS_PER_S) * self.speed
            allowed = min(self._held.values(), default=self._now + passed)
            self._now = max(self._now, min(self._now + passed, allowed))
            self._seen = seen
            return int(self._now)

    def hold(self, holder: object, at_ns: float | None) -> None:
        """Stand still at a moment until the same holder names another; None lets the clock go."""
        with self._lock:
            if at_ns is None:
                self._held.pop(holder, None)
            else:
                self._held[holder] = at_ns

    def sleep(self, seconds: float) -> None:
        """Sleep for ``seconds`` of scaled time."""
        end = self.now_ns() + seconds * NS_PER_S
        while (left := end - self.now_ns()) > 0:
            wait_s = min(left / NS_PER_S / self.speed, self.STALL_S / 2)
            time.sleep(max(wait_s, self.SHORTEST_SLEEP_S))


class SteppedClock:
    """A clock that moves only when told to, for deterministic tests.

    ``sleep`` moves it, so that code which waits runs through at once. For what waits by the
    machine's clock all the same, it counts as one that runs as fast.
    """

    speed = 1.0

    def __init__(self, start_ns: int = 0) -> None:
        self._now = start_ns

    def now_ns(self) -> int:
        """Nanoseconds as last set."""
        return self._now

    def sleep(self, seconds: float) -> None:
        """Move the clock forward by ``seconds``."""
        self.advance(max(0.0, seconds))

    def advance(self, seconds: float) -> None:
        """Move the clock forward by ``seconds`` (not negative)."""
        if seconds < 0:
            raise ValueError("a monotonic clock cannot go back")
        self._now += round(seconds * NS_PER_S)


@dataclass(frozen=True)
class Deadline:
    """A moment on a clock, ``seconds`` after it was made."""

    clock: Clock
    seconds: float
    _end_ns: int = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_end_ns", self.clock.now_ns() + int(self.seconds * NS_PER_S))

    @property
    def remaining(self) -> float:
        """Seconds left, never below 0."""
        return max(0.0, (self._end_ns - self.clock.now_ns()) / NS_PER_S)

    @property
    def expired(self) -> bool:
        """Whether the moment has passed."""
        return self.clock.now_ns() >= self._end_ns
