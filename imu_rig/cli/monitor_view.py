"""The live table of `imu-rig monitor` on a terminal, plain lines elsewhere, JSON for programs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imu_rig.cli.monitor_json import status_line
from imu_rig.cli.monitor_screen import plain_line, screen
from imu_rig.cli.view import PLAIN_LINE_S, StatusView
from imu_rig.monitor.status import MonitorStatus

if TYPE_CHECKING:
    from rich.console import RenderableType

    from imu_rig.monitor.window import PlotWindow


class MonitorView(StatusView[MonitorStatus]):
    """Shows devices; parameters as for `StatusView`."""

    def __init__(self, *, quiet: bool = False, as_json: bool = False) -> None:
        super().__init__(quiet=quiet, as_json=as_json)
        self._states_told: tuple[str, ...] = ()
        self._window: PlotWindow | None = None

    def observe(self, status: MonitorStatus) -> None:
        """Take the latest status."""
        super().observe(status)
        if self._window is not None and not self._window.is_open:
            self._window = None
            self.notify("The plot was closed; the figures go on.")

    def has_window(self, window: PlotWindow) -> None:
        """Tell when this window is closed."""
        self._window = window

    def screen(self, width: int, height: int) -> RenderableType | None:
        """Draw the latest status."""
        return None if self.status is None else screen(self.status, width, height)

    def log_lines(self, since_s: float) -> list[str]:
        """Tell each change of a state, and how it goes now and then."""
        status = self.status
        if status is None:
            return []
        states = tuple(row.state for row in status.rows)
        if states == self._states_told and since_s < PLAIN_LINE_S:
            return []
        self._states_told = states
        return [plain_line(status)]

    def json_text(self, status: MonitorStatus) -> str:
        """Return a status as one JSON object."""
        return status_line(status)
