"""The installed program on a terminal of its own, as if somebody sat there."""

import fcntl
import os
import select
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path
from typing import Any

import pytest
from program import PROGRAM

PATIENCE_S = 30.0
TAKE_TERMINAL = (
    "import fcntl, os, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0); "
    "os.execv(sys.argv[1], sys.argv[1:])"
)


class Terminal:
    """Runs `imu-rig` with arguments on a pseudo-terminal that is its controlling one."""

    def __init__(
        self, *arguments: object, cwd: Path, columns: int = 100, lines: int = 30, **files: Any
    ) -> None:
        self.master, slave = os.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
        self.slave = slave
        self.modes = termios.tcgetattr(slave)
        self.modes[3] |= termios.NOFLSH  # Ctrl-C would throw away what nobody has read yet
        termios.tcsetattr(slave, termios.TCSANOW, self.modes)
        self.process = subprocess.Popen(
            [sys.executable, "-ISc", TAKE_TERMINAL, PROGRAM, *map(str, arguments)],
            **{"stdin": slave, "stdout": slave, "stderr": slave, **files},
            cwd=cwd,
            env={**os.environ, "TMPDIR": str(cwd), "TERM": "xterm"},
            start_new_session=True,
        )
        self.output = b""

    def press(self, keys: str) -> None:
        os.write(self.master, keys.encode())

    def read(self, wait_s: float = 0.05) -> None:
        if select.select([self.master], [], [], wait_s)[0]:
            self.output += os.read(self.master, 65536)

    def read_until(self, text: str) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while text.encode() not in self.output:
            if self.process.poll() is not None or time.monotonic() > deadline:
                pytest.fail(f"no {text!r} in {self.output.decode(errors='replace')}")
            self.read()

    def modes_now(self) -> list[Any]:
        return termios.tcgetattr(self.slave)

    def hang_up(self) -> None:
        """Close the terminal's window."""
        os.close(self.slave)
        os.close(self.master)
        self.slave = self.master = -1

    def wait(self) -> int:
        """Read to the end and return the exit code."""
        deadline = time.monotonic() + PATIENCE_S
        while self.process.poll() is None:
            assert time.monotonic() < deadline, self.output.decode(errors="replace")
            if self.master >= 0:
                self.read()
            else:
                time.sleep(0.02)
        while self.master >= 0 and select.select([self.master], [], [], 0.0)[0]:
            self.read()
        return self.process.returncode

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        for descriptor in (self.slave, self.master):
            if descriptor >= 0:
                os.close(descriptor)
        self.slave = self.master = -1

    @property
    def text(self) -> str:
        return self.output.decode(errors="replace")
