"""The live table of a recording on a terminal, plain lines elsewhere, JSON lines for programs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imu_rig.cli.record_json import json_line, status_json
from imu_rig.cli.record_screen import LONGEST_SENTENCE, plain_line, screen
from imu_rig.cli.view import PLAIN_LINE_S, StatusView
from imu_rig.foreign_text import one_line
from imu_rig.recorder.status import RecorderStatus

if TYPE_CHECKING:
    from rich.console import RenderableType


class RecordView(StatusView[RecorderStatus]):
    """Shows a recording; parameters as for `StatusView`."""

    def __init__(self, *, quiet: bool = False, as_json: bool = False) -> None:
        super().__init__(quiet=quiet, as_json=as_json)
        self._state_told = ""
        self._marker = ""
        self._keys = False

    def marked(self, label: str) -> None:
        """Tell of a marker."""
        self._marker = label

    def listens_to_keys(self, *, on_terminal: bool) -> None:
        """Tell from now on which keys do what, where there are keys."""
        self._keys = on_terminal

    def screen(self, width: int, height: int) -> RenderableType | None:
        """Draw the latest status."""
        if self.status is None:
            return None
        return screen(self.status, width, height, keys=self._keys, marker=self._marker)

    def log_lines(self, since_s: float) -> list[str]:
        """Tell each new state, and how it goes now and then."""
        status = self.status
        if status is None or (status.state == self._state_told and since_s < PLAIN_LINE_S):
            return []
        first = not self._state_told
        self._state_told = status.state
        path = one_line(str(status.path), LONGEST_SENTENCE)
        return [*([f"Recording to {path}."] if first else []), plain_line(status)]

    def json_text(self, status: RecorderStatus) -> str:
        """Return a status as one JSON object."""
        return json_line("status", status_json(status))
