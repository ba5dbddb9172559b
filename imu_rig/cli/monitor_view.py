"""The live table of `imu-rig monitor` on a terminal, plain lines elsewhere, JSON for programs."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from imu_rig.cli.monitor_json import status_line
from imu_rig.cli.monitor_screen import plain_line, screen
from imu_rig.cli.unheld import write_line
from imu_rig.cli.view import View
from imu_rig.monitor.status import MonitorStatus

if TYPE_CHECKING:
    from rich.console import RenderableType

    from imu_rig.monitor.window import PlotWindow

PLAIN_LINE_S = 10.0  # between lines where stderr is no terminal and nothing changes
JSON_LINE_S = 1.0


class MonitorView(View):
    """Shows devices; see `View`.

    Parameters
    ----------
    quiet : bool
        Nothing on stderr.
    as_json : bool
        A JSON object with the status every second on stdout.
    """

    def __init__(self, *, quiet: bool = False, as_json: bool = False) -> None:
        super().__init__(quiet=quiet)
        if as_json:
            self.in_thread(self._write_json)
        self._status: MonitorStatus | None = None
        self._states_told: tuple[str, ...] = ()
        self._window: PlotWindow | None = None

    def observe(self, status: MonitorStatus) -> None:
        """Take the latest status."""
        self._status = status
        if self._window is not None and not self._window.is_open:
            self._window = None
            self.notify("The plot was closed; the figures go on.")

    def has_window(self, window: PlotWindow) -> None:
        """Tell when this window is closed."""
        self._window = window

    def screen(self, width: int, height: int) -> RenderableType | None:
        """Draw the latest status."""
        return None if self._status is None else screen(self._status, width, height)

    def log_lines(self, since_s: float) -> list[str]:
        """Tell each change of a state, and how it goes now and then."""
        status = self._status
        if status is None:
            return []
        states = tuple(row.state for row in status.rows)
        if states == self._states_told and since_s < PLAIN_LINE_S:
            return []
        self._states_told = states
        return [plain_line(status)]

    def _write_json(self) -> None:
        try:
            while not self.ended.wait(JSON_LINE_S):
                if self._status is not None:
                    write_line(sys.stdout, status_line(self._status))
        except (OSError, ValueError):  # nobody reads any more
            return
