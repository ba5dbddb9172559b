"""The live table of a recording on a terminal, plain lines elsewhere, JSON lines for programs."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from imu_rig.cli.record_json import json_line, status_json
from imu_rig.cli.record_screen import LONGEST_SENTENCE, plain_line, screen
from imu_rig.cli.unheld import write_line
from imu_rig.cli.view import View
from imu_rig.foreign_text import one_line
from imu_rig.recorder.status import RecorderStatus

if TYPE_CHECKING:
    from rich.console import RenderableType

PLAIN_LINE_S = 10.0  # between lines where stderr is no terminal and nothing changes
JSON_LINE_S = 1.0


class RecordView(View):
    """Shows a recording; see `View`.

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
        self._status: RecorderStatus | None = None
        self._state_told = ""
        self._marker = ""
        self._keys = False

    def observe(self, status: RecorderStatus) -> None:
        """Take the latest status."""
        self._status = status

    def marked(self, label: str) -> None:
        """Tell of a marker."""
        self._marker = label

    def listens_to_keys(self, *, on_terminal: bool) -> None:
        """Tell from now on which keys do what, where there are keys."""
        self._keys = on_terminal

    def screen(self, width: int, height: int) -> RenderableType | None:
        """Draw the latest status."""
        if self._status is None:
            return None
        return screen(self._status, width, height, keys=self._keys, marker=self._marker)

    def log_lines(self, since_s: float) -> list[str]:
        """Tell each new state, and how it goes now and then."""
        status = self._status
        if status is None or (status.state == self._state_told and since_s < PLAIN_LINE_S):
            return []
        first = not self._state_told
        self._state_told = status.state
        path = one_line(str(status.path), LONGEST_SENTENCE)
        return [*([f"Recording to {path}."] if first else []), plain_line(status)]

    def _write_json(self) -> None:
        try:
            while not self.ended.wait(JSON_LINE_S):
                if self._status is not None:
                    write_line(sys.stdout, json_line("status", status_json(self._status)))
        except (OSError, ValueError):  # nobody reads any more
            return
