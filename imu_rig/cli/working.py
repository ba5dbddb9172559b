"""A sign of life on stderr while a command computes for longer than two seconds."""

from __future__ import annotations

import sys
import threading
import time
from types import TracebackType

FIRST_S = 2.0
TERMINAL_S, PLAIN_S = 1.0, 10.0
"""Time between two signs on a terminal, which is written over, and in a log."""


class Working:
    """Tell what is being done and for how long, from the second second on.

    Used as a context; `now` names the next stage.
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._tell, daemon=True)
        self._terminal = sys.stderr.isatty()
        self._told = False

    def now(self, what: str) -> None:
        """Name what is being done from here on."""
        self._what = what

    def __enter__(self) -> Working:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._done.set()
        self._thread.join()
        if self._told and self._terminal:
            sys.stderr.write("\r\x1b[K")

    def _tell(self) -> None:
        begin, wait = time.monotonic(), FIRST_S
        while not self._done.wait(wait):
            line = f"{self._what} ... {time.monotonic() - begin:.0f} s"
            sys.stderr.write(f"\r\x1b[K{line}" if self._terminal else f"{line}\n")
            sys.stderr.flush()
            self._told = True
            wait = TERMINAL_S if self._terminal else PLAIN_S
