"""Writing to a standard stream whose reader may have stopped reading, or gone."""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from typing import TextIO

PATIENCE_S = 2.0


def write_line(stream: TextIO, line: str) -> None:
    """Write a line without the stream's lock.

    A writer that is held up would keep that lock for ever, and the program could not end.

    Raises
    ------
    OSError, ValueError
        If the reader has gone or the stream is closed.
    """
    try:
        descriptor = stream.fileno()
    except (OSError, ValueError):  # it is no file
        stream.write(line + "\n")
        return
    data = memoryview(f"{line}\n".encode(stream.encoding or "utf-8", "backslashreplace"))
    while data:
        data = data[os.write(descriptor, data) :]


def last_words(stream: TextIO, lines: Sequence[str], patience_s: float = PATIENCE_S) -> bool:
    """Write lines, if anybody still takes them; False if somebody who might does not."""

    def write() -> None:
        try:
            for line in lines:
                write_line(stream, line)
        except (OSError, ValueError):
            return

    writer = threading.Thread(target=write, name="last words", daemon=True)
    writer.start()
    writer.join(patience_s)
    return not writer.is_alive()
