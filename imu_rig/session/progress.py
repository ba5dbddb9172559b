"""What a session tells while it runs and what is left when it ended."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol


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
    kind: str = "pose"
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


class Hands(Protocol):
    """Whoever turns the sensor over when a session asks for it.

    Asked once per request; `ready` is then looked at many times a second and must return at once.
    """

    def ask(self, request: str, turn: tuple[float, float, float]) -> bool:
        """Ask to bring the sensor into another mounting; False where nobody can do it now.

        Parameters
        ----------
        request : str
            What to do, in words.
        turn : three numbers
            Nominal rotation vector of the sensor on the plate [rad].
        """

    def ready(self) -> bool:
        """Whether it is done."""


class NoHands:
    """Nobody is there."""

    def ask(self, request: str, turn: tuple[float, float, float]) -> bool:
        """Decline."""
        del request, turn
        return False

    def ready(self) -> bool:
        """Never."""
        return False
