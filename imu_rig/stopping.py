"""The wish to end something that runs, made where it cannot be fulfilled."""

from __future__ import annotations


class StopRequest:
    """The wish to end a session or a recording, made from a signal handler or another thread.

    ``cause`` is None until it is made; a second request asks to hurry.
    """

    def __init__(self) -> None:
        self.cause: str | None = None
        self.hurry = False

    def make(self, cause: str) -> None:
        """Ask for the end."""
        self.hurry = self.cause is not None
        self.cause = cause
