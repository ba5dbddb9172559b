"""What a session tells while it runs and what is left when it ended."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Progress:
    """What a person watching the session wants to see now.

    ``motion`` is the largest motion figure over its limit: below 1 the sensor is still.
    Times in seconds of the session's clock.
    """

    state: str = "starting"
    step: int = 0
    steps: int = 0
    name: str = ""
    motion: float = float("inf")
    held_s: float = 0.0
    hold_s: float = 0.0
    rate_hz: float = 0.0
    lost: int = 0
    corrupt: int = 0
    elapsed_s: float = 0.0
    remaining_s: float = 0.0


def ignore(progress: Progress) -> None:
    """Observe nothing."""


@dataclass
class SessionOutcome:
    """How a session ended: indices of finished stops, and all it had to say on the way."""

    finished: list[int] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)
    recoveries: int = 0
    elapsed_s: float = 0.0


class StopRequest:
    """The wish to end a session, made from a signal handler or another thread.

    ``cause`` is None until it is made; a second request asks to hurry.
    """

    def __init__(self) -> None:
        self.cause: str | None = None
        self.hurry = False

    def make(self, cause: str) -> None:
        """Ask for the end."""
        self.hurry = self.cause is not None
        self.cause = cause
