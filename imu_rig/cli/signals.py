"""Signals as requests to stop, or to leave at once and tidily."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from imu_rig.stopping import StopRequest

SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
BRIEF = ("SIGTERM", "SIGHUP")
"""Sent by who ends programs and closes terminals: nobody waits for figures."""


def leave_on_signals() -> None:
    """Let `BRIEF` signals end the program as an exception does, so that no half file is left.

    For commands without a stop of their own. A SIGHUP that is ignored already stays so.
    """

    def leave(number: int, frame: FrameType | None) -> None:
        del frame
        sys.exit(128 + number)

    for name in BRIEF:
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, leave)


@contextmanager
def stop_on_signals(
    stop: StopRequest,
    notify: Callable[[str], None] = lambda sentence: None,
    stopping: str = "Stopping: the jig parks and the file is closed; once more to hurry.",
    *,
    to_the_end: bool = False,
) -> Iterator[None]:
    """Turn Ctrl-C, SIGTERM and SIGHUP into a stop request while the block runs.

    ``stopping`` is said at the first. With ``to_the_end`` a program that was stopped and has
    nothing left to do after the block hears no Ctrl-C any more: it takes some tenths of a second
    to end, and would not with its exit code. A SIGHUP that is ignored already stays so: whoever
    starts a program with ``nohup`` wants it to go on.
    """

    def handle(number: int, frame: FrameType | None) -> None:
        del frame
        if stop.cause is None:
            notify(stopping)
        name = signal.Signals(number).name
        stop.make(f"Stopped by {name}.", brief=name in BRIEF)

    numbers = [getattr(signal, name) for name in SIGNALS if hasattr(signal, name)]
    before = {
        number: signal.signal(number, handle)
        for number in numbers
        if number == signal.SIGINT or signal.getsignal(number) != signal.SIG_IGN
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            deaf = to_the_end and stop.cause is not None and number == signal.SIGINT
            signal.signal(number, signal.SIG_IGN if deaf else handler)
