"""One line on stderr that tells how far something is."""

from __future__ import annotations

import shutil
import sys
import time

TERMINAL_S, PLAIN_S = 0.2, 5.0
"""Time between two lines on a terminal, where one is written over, and in a log."""


class StatusLine:
    """A line written over on a terminal, and elsewhere one now and then.

    Parameters
    ----------
    quiet : bool
        Nothing at all.
    silent_s : float
        Nothing before that: what is done soon needs no telling.
    terminal_s, plain_s : float
        Time between two lines.
    """

    def __init__(
        self,
        *,
        quiet: bool = False,
        silent_s: float = 0.0,
        terminal_s: float = TERMINAL_S,
        plain_s: float = PLAIN_S,
    ) -> None:
        self._quiet = quiet
        self._terminal = sys.stderr.isatty()
        self._pause_s = terminal_s if self._terminal else plain_s
        self._next_s = time.monotonic() + silent_s
        self._shown = False

    @property
    def due_s(self) -> float:
        """How long until it is time for the next line [s]."""
        return max(0.0, self._next_s - time.monotonic())

    def show(self, line: str, *, now: bool = False) -> None:
        """Show a line, if it is time or if it must be ``now``."""
        if self._quiet or (self.due_s > 0 and not now):
            return
        self._next_s = time.monotonic() + self._pause_s
        if self._terminal:
            width = shutil.get_terminal_size().columns
            sys.stderr.write(f"\r\x1b[K{line[: width - 1]}")
        else:
            sys.stderr.write(f"{line}\n")
        sys.stderr.flush()
        self._shown = True

    def close(self) -> None:
        """Leave a clean line."""
        if self._shown and self._terminal:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()
