"""Served devices in a process of their own, so that what a recorder costs is measured alone.

Run as a program it serves what its first line of input asks for, prints the addresses and then
obeys one line after the other: ``["unplug", "shoe"]`` calls that method and prints what it returns.
"""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any, Self

from simulators.served_devices import ServedDevices


class DeviceProcess:
    """The same devices as `ServedDevices`, elsewhere.

    Parameters
    ----------
    devices : dict
        Name to the arguments of `ServedDevices.add`: layout, rate_hz and so on.
    servos : str or None
        Name of a servo controller to serve too.
    """

    def __init__(self, devices: dict[str, dict[str, Any]], *, servos: str | None = None) -> None:
        self._asked = {"devices": devices, "servos": servos}
        self.urls: dict[str, str] = {}

    def __enter__(self) -> Self:
        self._process = subprocess.Popen(
            [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.urls = self._ask(self._asked)
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.stdin is not None and self._process.stdout is not None:
            self._process.stdin.close()
            self._process.stdout.close()
        self._process.wait()

    def call(self, method: str, *arguments: Any) -> Any:
        """Call a method of the served devices and return what it returns."""
        return self._ask([method, *arguments])

    def _ask(self, question: Any) -> Any:
        pipe_in, pipe_out = self._process.stdin, self._process.stdout
        if pipe_in is None or pipe_out is None:
            raise RuntimeError("the process has no pipes")
        pipe_in.write(json.dumps(question) + "\n")
        pipe_in.flush()
        return json.loads(pipe_out.readline())


def main() -> None:
    asked = json.loads(sys.stdin.readline())
    with ServedDevices() as served:
        urls = {name: served.add(name, **how) for name, how in asked["devices"].items()}
        if asked["servos"]:
            urls[asked["servos"]] = served.add_servos(asked["servos"])
        print(json.dumps(urls), flush=True)
        for line in sys.stdin:
            method, *arguments = json.loads(line)
            print(json.dumps(getattr(served, method)(*arguments)), flush=True)


if __name__ == "__main__":
    main()
