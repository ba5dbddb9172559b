"""A person at the terminal who turns the sensor over when a session asks for it."""

from __future__ import annotations

import select
import sys
from collections.abc import Callable


class TerminalHands:
    """Asks on the terminal and waits for Enter, without ever holding up the session.

    Parameters
    ----------
    notify : callable
        Shows a sentence that stays on the screen.
    """

    def __init__(self, notify: Callable[[str], None]) -> None:
        self._notify = notify

    def ask(self, request: str, turn: tuple[float, float, float]) -> bool:
        """Show the request; False where no person can answer."""
        del turn
        if not (sys.stdin.isatty() and sys.stderr.isatty()):
            return False
        while self._typed():  # what was typed before the question is no answer
            sys.stdin.readline()
        self._notify(f"The jig is parked. {request} Then press Enter; Ctrl-C stops and keeps all.")
        return True

    def ready(self) -> bool:
        """Whether Enter was pressed."""
        if not self._typed():
            return False
        sys.stdin.readline()
        return True

    def _typed(self) -> bool:
        if sys.platform == "win32":
            import msvcrt

            typed = False
            while msvcrt.kbhit():
                typed = msvcrt.getwch() in "\r\n" or typed
            return typed
        return bool(select.select([sys.stdin], [], [], 0.0)[0])
