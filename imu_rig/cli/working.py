"""A sign of life on stderr while a command computes for longer than two seconds."""

from __future__ import annotations

import sys
import threading
import time
from types import TracebackType

from imu_rig.cli.status_line import StatusLine

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
        self._line = StatusLine(silent_s=FIRST_S, terminal_s=TERMINAL_S, plain_s=PLAIN_S)

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
        self._line.close()

    def _tell(self) -> None:
        begin = time.monotonic()
        while not self._done.wait(self._line.due_s):
            what = _compiling() or self._what
            self._line.show(f"{what} ... {time.monotonic() - begin:.0f} s")


def _compiling() -> str | None:
    """Return what is to be said where inner loops are being compiled, None where they are not."""
    compiled = sys.modules.get("imu_rig.kernels.compiled")  # not loaded for this: it takes long
    if compiled is None or not compiled.compiling():
        return None
    if compiled.kept():
        return "Compiling, in the first run only"
    return "Compiling in every run, as no folder for it can be written"
