"""The `imu-rig` program: its one way to report an error.

The commands are imported where an error, or a Ctrl-C meanwhile, is reported already.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
from typing import NoReturn, TextIO

from imu_rig.cli.signals import leave_on_signals
from imu_rig.cli.terminal import fitted
from imu_rig.errors import ImuRigError, StorageError
from imu_rig.foreign_text import printable

# Before numpy is imported: matrices are small here, and threads would wait for each other longer
# than they work.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def run() -> None:
    """Run the program; every foreseen error is one sentence on stderr and an exit code."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by whoever started us
            setattr(sys, name, io.StringIO())
        elif isinstance(stream, io.TextIOWrapper):  # names in files may hold anything
            stream.reconfigure(errors="backslashreplace")
    leave_on_signals()
    try:
        from imu_rig.cli.commands import app

        app()
        sys.stdout.flush()
    except ImuRigError as error:
        if "--json" in sys.argv:
            answer = json.dumps({"error": str(error), "exit_code": error.exit_code})
            _say(sys.stdout, answer)
        _say(sys.stderr, fitted(f"imu-rig: {printable(str(error))}"))
        _leave(error.exit_code)
    except KeyboardInterrupt:
        _say(sys.stderr, "imu-rig: interrupted")
        _leave(130)
    except BrokenPipeError:  # the reader of our output went away, as with `| head`
        _leave(0)
    except OSError as error:
        _say(sys.stderr, f"imu-rig: the output cannot be written ({error.strerror}).")
        _leave(StorageError.exit_code)


def _say(stream: TextIO, text: str) -> None:
    """Write a last line, if anybody still takes it."""
    with contextlib.suppress(OSError, ValueError):
        stream.write(text + "\n")
        stream.flush()


def _leave(code: int) -> NoReturn:
    """Exit without another attempt to write what could not be written."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    sys.exit(code)
