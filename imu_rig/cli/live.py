"""The live view of a session on a terminal, and plain lines where there is none."""

from __future__ import annotations

import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING

from imu_rig.session.progress import Progress
from imu_rig.stopping import StopRequest

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

REFRESH_S = 0.15
LAST_WORDS_S = 1.0  # for a terminal to take what is left to say
MOST_SENTENCES = 200
PLAIN_LINE_S = 5.0  # between lines where stderr is no terminal
BAR_WIDTH = 30


class SessionView:
    """Shows a session from a thread of its own; a context manager.

    Whoever observes only leaves the latest word here, so that a terminal which does not take its
    text never holds up the jig. On a terminal a small table is redrawn in place a few times a
    second; otherwise a line is written now and then. Notices stay on the screen in either case.
    """

    def __init__(self, *, quiet: bool = False) -> None:
        self._quiet = quiet
        self._progress = Progress()
        self._sentences: deque[str] = deque(maxlen=MOST_SENTENCES)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._show, name="session-view", daemon=True)

    def __enter__(self) -> SessionView:
        if not self._quiet:
            self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._ended.set()
        if not self._quiet:
            self._thread.join(timeout=LAST_WORDS_S)

    def notify(self, sentence: str) -> None:
        """Show a sentence that stays; also from a signal handler."""
        self._sentences.append(sentence)

    def observe(self, progress: Progress) -> None:
        """Show progress, at most a few times a second."""
        self._progress = progress

    def _show(self) -> None:
        from rich.console import Console
        from rich.live import Live

        console = Console(stderr=True, highlight=False)
        try:
            if console.is_terminal:
                with Live(console=console, auto_refresh=False, transient=True) as live:
                    while self._wait(console):
                        live.update(_table(self._progress), refresh=True)
            else:
                self._write_lines(console)
        except (OSError, ValueError):  # nobody reads any more; the session goes on unseen
            return

    def _wait(self, console: Console) -> bool:
        """Wait for the next refresh and print what must stay; False at the end."""
        going = not self._ended.wait(REFRESH_S)
        while self._sentences:
            console.print(self._sentences.popleft(), markup=False)
        return going

    def _write_lines(self, console: Console) -> None:
        told, line_s = 0, 0.0
        while self._wait(console):
            progress, now = self._progress, time.monotonic()
            if progress.step > told and now - line_s > PLAIN_LINE_S:
                told, line_s = progress.step, now
                console.print(
                    f"pose {progress.step} of {progress.steps} ({progress.name}), "
                    f"{_clock(progress.remaining_s)} left",
                    markup=False,
                    soft_wrap=True,
                )


def _table(progress: Progress) -> RenderableType:
    from rich.table import Table
    from rich.text import Text

    done = 0.0
    if progress.steps:
        part = min(1.0, progress.held_s / progress.hold_s) if progress.hold_s else 0.0
        done = min(1.0, max(0.0, (progress.step - 1 + part) / progress.steps))
    bar = "━" * round(done * BAR_WIDTH)
    still = "still" if progress.motion < 1 else "moving"
    table = Table.grid(padding=(0, 2))
    table.add_column(justify="right", style="dim")
    table.add_column(no_wrap=True)
    table.add_row(
        "session", Text.assemble((bar.ljust(BAR_WIDTH, "╌"), "cyan"), f" {done * 100:3.0f} %")
    )
    if progress.step:
        kind = "check" if progress.kind == "check" else "pose"
        table.add_row(kind, f"{progress.step} of {progress.steps}   {progress.name}")
    held = f"   {progress.held_s:.1f} of {progress.hold_s:.1f} s" if progress.held_s else ""
    if progress.state == "recovering":
        table.add_row("now", Text("waiting for a device to be well again", "yellow"))
    elif progress.state == "remounting":
        table.add_row("now", Text("parked; turn the IMU over, then press Enter", "yellow"))
    else:
        table.add_row("now", f"{progress.state}   sensor {still}{held}")
    trouble = "red" if progress.lost or progress.corrupt else "green"
    table.add_row(
        "packets",
        Text.assemble(
            f"{progress.rate_hz:.0f} per second   ",
            (f"{progress.lost} lost   {progress.corrupt} corrupt", trouble),
        ),
    )
    table.add_row(
        "time", f"{_clock(progress.elapsed_s)} gone   {_clock(progress.remaining_s)} left"
    )
    return table


def _clock(seconds: float) -> str:
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


@contextmanager
def stop_on_signals(
    stop: StopRequest,
    notify: Callable[[str], None] = lambda sentence: None,
    stopping: str = "Stopping: the jig parks and the file is closed; once more to hurry.",
) -> Iterator[None]:
    """Turn Ctrl-C, SIGTERM and SIGHUP into a stop request while the block runs.

    ``stopping`` is said at the first.
    """

    def handle(number: int, frame: FrameType | None) -> None:
        del frame
        if stop.cause is None:
            notify(stopping)
        stop.make(f"Stopped by {signal.Signals(number).name}.")

    names = [n for n in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, n)]
    before = {n: signal.signal(getattr(signal, n), handle) for n in names}
    try:
        yield
    finally:
        for name, handler in before.items():
            signal.signal(getattr(signal, name), handler)
