"""What the live views of a session and of a recording have in common."""

from __future__ import annotations

import math
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Generic, Self, TypeVar

from imu_rig.cli.unheld import write_line

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

REFRESH_S = 0.2
PLAIN_LINE_S = 10.0  # between lines where stderr is no terminal and nothing changes
JSON_LINE_S = 1.0
LAST_WORDS_S = 1.0  # for a terminal to take what is left to say
MOST_SENTENCES = 200
BAR_WIDTH = 30


class View(ABC):
    """Shows something that runs, from a thread of its own; a context manager.

    Whoever feeds it only leaves the latest word here, so that neither a terminal nor a program that
    does not read ever holds up what runs. On a terminal a screen is redrawn in place a few times a
    second; otherwise a line is written now and then. Sentences stay in either case.

    Parameters
    ----------
    quiet : bool
        Nothing on stderr.
    """

    def __init__(self, *, quiet: bool = False) -> None:
        self.ended = threading.Event()
        self._sentences: deque[str] = deque(maxlen=MOST_SENTENCES)
        self._threads: list[threading.Thread] = []
        if not quiet:
            self.in_thread(self._show)

    @abstractmethod
    def screen(self, width: int, height: int) -> RenderableType | None:
        """Draw the latest word; None while there is none."""

    @abstractmethod
    def log_lines(self, since_s: float) -> list[str]:
        """Return lines for a log, so long after the last ones; none where it is not time yet."""

    def notify(self, sentence: str) -> None:
        """Show a sentence that stays; also from a signal handler."""
        self._sentences.append(sentence)

    def in_thread(self, task: Callable[[], None]) -> None:
        """Run this too, from the beginning of the block until ``ended`` is set."""
        self._threads.append(threading.Thread(target=task, name=task.__name__, daemon=True))

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.ended.set()
        deadline = time.monotonic() + LAST_WORDS_S
        for thread in self._threads:
            thread.join(timeout=max(0.0, deadline - time.monotonic()))

    @property
    def held_up(self) -> bool:
        """Whether a terminal or program that does not read still holds one of the threads."""
        return any(thread.is_alive() for thread in self._threads)

    def _show(self) -> None:
        from rich.console import Console

        console = Console(stderr=True, highlight=False)
        try:
            if console.is_terminal:
                self._draw(console)
            else:
                self._write_lines(console)
        except (OSError, ValueError):  # nobody reads any more; what runs goes on unseen
            return

    def _draw(self, console: Console) -> None:
        from rich.live import Live

        with Live(
            console=console,
            auto_refresh=False,
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        ) as live:
            while self._wait(console):
                drawn = self.screen(console.width, console.height)
                if drawn is not None:
                    live.update(drawn, refresh=True)

    def _write_lines(self, console: Console) -> None:
        last_s = -math.inf
        while self._wait(console):
            now = time.monotonic()
            for line in self.log_lines(now - last_s):
                console.print(line, markup=False, soft_wrap=True)
                last_s = now

    def _wait(self, console: Console) -> bool:
        """Wait for the next refresh and print what must stay; False at the end."""
        going = not self.ended.wait(REFRESH_S)
        while self._sentences:
            console.print(
                self._sentences.popleft(), markup=False, soft_wrap=not console.is_terminal
            )
        return going


Status = TypeVar("Status")


class StatusView(View, Generic[Status]):
    """Shows what tells its status now and then, to programs too.

    Parameters
    ----------
    quiet : bool
        Nothing on stderr.
    as_json : bool
        A JSON object with the status every second on stdout.
    """

    def __init__(self, *, quiet: bool = False, as_json: bool = False) -> None:
        super().__init__(quiet=quiet)
        self.status: Status | None = None
        if as_json:
            self.in_thread(self._write_json)

    def observe(self, status: Status) -> None:
        """Take the latest status."""
        self.status = status

    @abstractmethod
    def json_text(self, status: Status) -> str:
        """Return a status as one JSON object."""

    def _write_json(self) -> None:
        try:
            while not self.ended.wait(JSON_LINE_S):
                if self.status is not None:
                    write_line(sys.stdout, self.json_text(self.status))
        except (OSError, ValueError):  # nobody reads any more
            return


def bar(share: float, width: int = BAR_WIDTH) -> tuple[str, str]:
    """Return the part of a bar that is done and the part that is left."""
    done = max(0, min(width, round(share * width)))
    return "━" * done, "╌" * (max(0, width) - done)
