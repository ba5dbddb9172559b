"""The live view of a session on a terminal, and plain lines where there is none."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imu_rig.cli.view import View, bar
from imu_rig.cli.words import clock
from imu_rig.session.progress import Progress

if TYPE_CHECKING:
    from rich.console import RenderableType

PLAIN_LINE_S = 5.0  # at least, between lines where stderr is no terminal


class SessionView(View):
    """Shows a session; see `View`."""

    def __init__(self, *, quiet: bool = False) -> None:
        super().__init__(quiet=quiet)
        self._progress = Progress()
        self._told = 0

    def observe(self, progress: Progress) -> None:
        """Take the latest progress."""
        self._progress = progress

    def screen(self, width: int, height: int) -> RenderableType:
        """Draw where the session is."""
        del width, height
        return _table(self._progress)

    def log_lines(self, since_s: float) -> list[str]:
        """Tell of a new pose, but not of each where they follow each other fast."""
        progress = self._progress
        if progress.step <= self._told or since_s <= PLAIN_LINE_S:
            return []
        self._told = progress.step
        return [
            f"pose {progress.step} of {progress.steps} ({progress.name}), "
            f"{clock(progress.remaining_s)} left"
        ]


def _table(progress: Progress) -> RenderableType:
    from rich.table import Table
    from rich.text import Text

    done = 0.0
    if progress.steps:
        part = min(1.0, progress.held_s / progress.hold_s) if progress.hold_s else 0.0
        done = min(1.0, max(0.0, (progress.step - 1 + part) / progress.steps))
    gone, left = bar(done)
    still = "still" if progress.motion < 1 else "moving"
    table = Table.grid(padding=(0, 2))
    table.add_column(justify="right", style="dim")
    table.add_column(no_wrap=True)
    table.add_row(
        "session",
        Text.assemble((gone, "cyan"), (left, "dim cyan"), f" {done * 100:3.0f} %"),
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
    table.add_row("time", f"{clock(progress.elapsed_s)} gone   {clock(progress.remaining_s)} left")
    return table
