"""The wish to end something that runs, made where it cannot be fulfilled."""

from __future__ import annotations


class StopRequest:
    """The wish to end a session or a recording, made from a signal handler or another thread.

    Attributes
    ----------
    cause : str or None
        Who asked, in a sentence; None until somebody does.
    hurry : bool
        Somebody asked again.
    brief : bool
        Whoever asked waits until the data are safe and no longer.
    """

    def __init__(self) -> None:
        self.cause: str | None = None
        self.hurry = False
        self.brief = False

    def make(self, cause: str, *, brief: bool = False) -> None:
        """Ask for the end."""
        self.hurry = self.cause is not None
        self.brief = self.brief or brief
        self.cause = cause
