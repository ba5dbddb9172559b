"""Keys pressed while something records, or lines on a standard input that is no terminal.

Whoever presses keys and whoever records never wait for each other. The terminal gives out keys one
by one meanwhile, and is as it was afterwards, whatever happens.
"""

from __future__ import annotations

import codecs
import contextlib
import os
import re
import select
import signal
import sys
import threading
import time
from collections.abc import Callable
from types import FrameType
from typing import Any, Protocol, Self

from imu_rig.foreign_text import one_line

if sys.platform != "win32":
    import termios

READ_BYTES = 4096
LONGEST_LINE = 200
STOP_KEY = "q"
POLL_S = 0.05  # where keys cannot be waited for
PAUSE_S = 0.01  # after a full read, so that an input without end does not keep a processor busy
MOST_AT_ONCE = 10_000  # markers; more would crowd out what the devices send
MOST_PER_S = 100

_ESCAPE = re.compile(r"\x1b(\[[0-?]*[ -/]*[@-~]|O.|[^\[O])?", re.DOTALL)
"""What an arrow or function key sends; its letters are nobody's marker."""


class Marked(Protocol):
    """Takes a marker."""

    def __call__(self, label: str) -> None:
        """Mark this moment; an empty label is a plain marker."""


class Keys:
    """Listens while its block runs; a context manager.

    On a terminal the space bar is a plain marker, a letter or digit a marker of that name, and
    ``q`` asks for the end. A standard input that is no terminal gives one marker with each line,
    and its end means nothing. A program in the background listens to nothing.

    Parameters
    ----------
    mark : callable
        Takes each marker; called in this object's thread.
    stop : callable
        Called when the end is asked for.
    notify : callable
        Shows a sentence, such as of markers that came too fast to be taken.
    """

    def __init__(
        self, mark: Marked, stop: Callable[[], None], notify: Callable[[str], None]
    ) -> None:
        self._take = mark
        self._stop = stop
        self._notify = notify
        self._room, self._room_s = float(MOST_AT_ONCE), time.monotonic()
        self._dropped = 0
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None
        self._undo = contextlib.ExitStack()
        self.by_key = False
        """Whether keys are listened to one by one."""

    def __enter__(self) -> Self:
        descriptor = _standard_input()
        if descriptor is None:
            return self
        terminal = os.isatty(descriptor)
        if terminal and not _in_foreground(descriptor):
            return self
        self.by_key = terminal
        if sys.platform == "win32":
            listen = self._listen_on_windows if terminal else self._listen_to_lines_blocking
            arguments: tuple[int, ...] = () if terminal else (descriptor,)
        else:
            if terminal:
                self._undo.enter_context(_KeyByKey(descriptor))
            awake, wake = os.pipe()
            self._undo.callback(os.close, awake)
            self._undo.callback(self._wake, wake)
            listen, arguments = self._listen, (descriptor, awake)
        self._thread = threading.Thread(target=listen, args=arguments, name="keys", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._ended.set()
        self._undo.close()
        if self._dropped:
            self._notify(
                f"{self._dropped} markers were not recorded: more than {MOST_AT_ONCE} at once and "
                f"{MOST_PER_S} a second are not taken."
            )

    def _mark(self, label: str) -> None:
        """Hand on a marker at once, as long as there are not too many."""
        now = time.monotonic()
        self._room = min(MOST_AT_ONCE, self._room + MOST_PER_S * (now - self._room_s))
        self._room_s = now
        if self._room < 1:
            if not self._dropped:
                self._notify("Markers come faster than they can be recorded; some are left out.")
            self._dropped += 1
            return
        self._room -= 1
        self._take(label)

    def _wake(self, wake: int) -> None:
        """End the thread, which waits on the other end of this pipe."""
        os.close(wake)
        if self._thread is not None:
            self._thread.join()

    def _listen(self, descriptor: int, awake: int) -> None:
        decoder = codecs.getincrementaldecoder("utf-8")("replace")
        pending = ""
        with contextlib.suppress(OSError, ValueError):  # the terminal has gone
            while not self._ended.is_set():
                ready, _, _ = select.select([descriptor, awake], [], [])
                if awake in ready:
                    return
                data = os.read(descriptor, READ_BYTES)
                if self.by_key:
                    self._press(decoder.decode(data))
                else:
                    pending = self._take_lines(pending + decoder.decode(data), ended=not data)
                if not data:
                    return
                if len(data) == READ_BYTES:
                    self._ended.wait(PAUSE_S)

    def _press(self, text: str) -> None:
        for key in _ESCAPE.sub("", text):
            if key == STOP_KEY:
                self._stop()
            elif key == " ":
                self._mark("")
            elif key.isalnum():
                self._mark(key)

    def _take_lines(self, text: str, *, ended: bool) -> str:
        """Mark each whole line and return what is left."""
        *lines, rest = text.split("\n")
        if ended and rest:
            lines, rest = [*lines, rest], ""
        for line in lines:
            if self._ended.is_set():
                break
            self._mark(one_line(line, LONGEST_LINE))
        return rest[: 2 * LONGEST_LINE]

    def _listen_on_windows(self) -> None:
        if sys.platform == "win32":
            import msvcrt

            while not self._ended.wait(POLL_S):
                while msvcrt.kbhit():
                    key = msvcrt.getwch()
                    if key in "\x00\xe0":  # an arrow or function key; its second half follows
                        msvcrt.getwch()
                    else:
                        self._press(key)

    def _listen_to_lines_blocking(self, descriptor: int) -> None:
        decoder = codecs.getincrementaldecoder("utf-8")("replace")
        pending = ""
        with contextlib.suppress(OSError, ValueError):
            while not self._ended.is_set():
                data = os.read(descriptor, READ_BYTES)
                pending = self._take_lines(pending + decoder.decode(data), ended=not data)
                if not data:
                    return
                if len(data) == READ_BYTES:
                    self._ended.wait(PAUSE_S)


def _standard_input() -> int | None:
    try:
        return sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):  # there is none
        return None


def _in_foreground(descriptor: int) -> bool:
    """Whether the terminal is this program's to change; in the background it would be stopped."""
    if sys.platform == "win32":
        return True
    try:
        return os.tcgetpgrp(descriptor) == os.getpgrp()
    except OSError:
        return False


if sys.platform != "win32":

    class _KeyByKey:
        """A terminal that gives out keys one by one and shows none; a context manager.

        Ctrl-Z does nothing: a recorder that is halted loses what its devices send. One halted by a
        signal leaves the terminal as it was meanwhile.
        """

        def __init__(self, descriptor: int) -> None:
            self._descriptor = descriptor
            self._before: list[Any] | None = None
            self._handlers: dict[int, Any] = {}

        def __enter__(self) -> Self:
            try:
                self._before = termios.tcgetattr(self._descriptor)
            except termios.error:
                return self
            self._change()
            if threading.current_thread() is threading.main_thread():
                self._handlers = {
                    signal.SIGTSTP: signal.signal(signal.SIGTSTP, self._halt),
                    signal.SIGCONT: signal.signal(signal.SIGCONT, self._go_on),
                }
            return self

        def __exit__(self, *exception: object) -> None:
            for number, handler in self._handlers.items():
                signal.signal(number, handler)
            self._restore()

        def _change(self) -> None:
            if self._before is None or not _in_foreground(self._descriptor):
                return
            changed = [*self._before[:6], list(self._before[6])]
            changed[3] &= ~(termios.ICANON | termios.ECHO)
            changed[6][termios.VMIN], changed[6][termios.VTIME] = 1, 0
            changed[6][termios.VSUSP] = b"\0"
            with contextlib.suppress(termios.error):
                termios.tcsetattr(self._descriptor, termios.TCSANOW, changed)

        def _restore(self) -> None:
            if self._before is None or not _in_foreground(self._descriptor):
                return
            with contextlib.suppress(termios.error):
                termios.tcsetattr(self._descriptor, termios.TCSANOW, self._before)

        def _halt(self, number: int, frame: FrameType | None) -> None:
            del number, frame
            self._restore()
            os.kill(os.getpid(), signal.SIGSTOP)

        def _go_on(self, number: int, frame: FrameType | None) -> None:
            del number, frame
            self._change()
