"""The live view of a session on a terminal, and plain lines where there is none."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING

from imu_rig.session.progress import Progress, StopRequest

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

REFRESH_S = 0.12
PLAIN_LINE_S = 5.0  # between lines where stderr is no terminal
BAR_WIDTH = 30


class SessionView:
    """Shows `Progress` as it comes; a context manager.

    On a terminal a small table is redrawn in place a few times a second; otherwise a line is
    written for every stop. Notices stay on the screen in either case.
    """

    def __init__(self, *, quiet: bool = False) -> None:
        from rich.console import Console
        from rich.live import Live

        self._console: Console = Console(stderr=True, highlight=False, soft_wrap=False)
        self._quiet = quiet
        self._live = (
            Live(console=self._console, auto_refresh=False, transient=True)
            if self._console.is_terminal and not quiet
            else None
        )
        self._drawn = 0.0
        self._drawn_state = ""
        self._line = 0.0
        self._told = (-1, "")

    def __enter__(self) -> SessionView:
        if self._live is not None:
            self._live.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        if self._live is not None:
            self._live.__exit__(None, None, None)

    def notify(self, sentence: str) -> None:
        """Show a sentence that stays."""
        if not self._quiet:
            self._console.print(sentence, markup=False)

    def observe(self, progress: Progress) -> None:
        """Show progress, at most a few times a second."""
        now = time.monotonic()
        if self._quiet:
            return
        if self._live is None:
            self._write_line(progress, now)
        elif now - self._drawn > REFRESH_S or progress.state != self._drawn_state:
            self._drawn, self._drawn_state = now, progress.state
            self._live.update(_table(progress), refresh=True)

    def _write_line(self, progress: Progress, now: float) -> None:
        key = (progress.step, progress.state)
        if progress.state == "moving" and key != self._told and now - self._line > PLAIN_LINE_S:
            self._line, self._told = now, key
            self._console.print(
                f"pose {progress.step} of {progress.steps} ({progress.name}), "
                f"{_clock(progress.remaining_s)} left",
                markup=False,
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
        table.add_row("pose", f"{progress.step} of {progress.steps}   {progress.name}")
    held = f"   {progress.held_s:.1f} of {progress.hold_s:.1f} s" if progress.held_s else ""
    if progress.state == "recovering":
        table.add_row("now", Text("waiting for a device to be well again", "yellow"))
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
def stop_on_signals(stop: StopRequest) -> Iterator[None]:
    """Turn Ctrl-C, SIGTERM and SIGHUP into a stop request while the block runs."""

    def handle(number: int, frame: FrameType | None) -> None:
        del frame
        again = "; once more to hurry" if stop.cause is None else ""
        stop.make(f"Stopped by {signal.Signals(number).name}.")
        if again and sys.stderr.isatty():
            sys.stderr.write("\nStopping: the jig parks and the file is closed" + again + "\n")

    names = [n for n in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, n)]
    before = {n: signal.signal(getattr(signal, n), handle) for n in names}
    try:
        yield
    finally:
        for name, handler in before.items():
            signal.signal(getattr(signal, name), handler)
