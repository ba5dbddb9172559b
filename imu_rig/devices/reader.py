"""One thread that reads one port and stamps what arrives, before anything else touches it.

A device that must be spoken to is set up before the thread starts and kept going by it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from imu_rig.clock import NS_PER_S, Clock
from imu_rig.devices.conversation import Conversation
from imu_rig.devices.ports import DEFAULT_BAUD, Port, open_port
from imu_rig.errors import DeviceError

# Constants of time.
READ_S = 0.05  # a blocking read; also how long stop() may have to wait
JOIN_S = 5.0  # far beyond a read and a callback
KEEP_S = 1.0  # between what is said again to a device


class PortReader:
    """Reads a port until stopped or until the device is lost.

    Parameters
    ----------
    port : str or callable
        URL to open, or a function that opens a `Port`.
    clock : Clock
        Its ``now_ns()`` is taken right after each read.
    on_bytes : callable
        Called in the reader's thread with the time stamp and the bytes; must return quickly. An
        exception from it ends the reading and is kept in ``error``.
    name : str
        Of the thread.
    baud : int
        For a URL.
    conversation : Conversation, optional
        What is said to the device.
    on_sent : callable, optional
        As ``on_bytes``, with what is written to the device.

    Attributes
    ----------
    error : Exception or None
        What ended the reading: a `DeviceLost`, or what ``on_bytes`` raised.
    """

    def __init__(
        self,
        port: str | Callable[[], Port],
        clock: Clock,
        on_bytes: Callable[[int, bytes], None],
        name: str,
        *,
        baud: int = DEFAULT_BAUD,
        conversation: Conversation | None = None,
        on_sent: Callable[[int, bytes], None] = lambda t_ns, data: None,
    ) -> None:
        self._open: Callable[[], Port] = (
            (lambda: open_port(port, baud=baud)) if isinstance(port, str) else port
        )
        self._clock, self._on_bytes, self._name = clock, on_bytes, name
        self._conversation, self._on_sent = conversation, on_sent
        self._stopping = threading.Event()
        self._starting = threading.Lock()  # held as long as start() takes
        self._starter: threading.Thread | None = None
        self._thread: threading.Thread | None = None
        self.error: Exception | None = None

    @property
    def alive(self) -> bool:
        """Whether the port is being read."""
        return self._thread is not None and self._thread.is_alive() and self.error is None

    def start(self) -> None:
        """Open the port, set the device up where it must be, and begin to read.

        Raises
        ------
        PortError
            If the port cannot be opened.
        DeviceError
            If the device cannot be set up, or if it is stopped meanwhile.
        RuntimeError
            If the reader was started before.
        """
        if self._thread is not None:
            raise RuntimeError("a reader runs once; make a new one")
        with self._starting:
            self._starter = threading.current_thread()
            try:
                self._begin()
            finally:
                self._starter = None

    def _begin(self) -> None:
        port = self._open()
        try:
            if self._conversation is not None:
                self._conversation.begin(
                    lambda data: self._write(port, data), lambda wait_s: self._hear(port, wait_s)
                )
            self._go_on()
        except BaseException:
            port.close()
            raise
        self._thread = threading.Thread(
            target=self._run, args=(port,), name=f"read {self._name}", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """End the reading, wait for the thread and close the port; also while it is set up."""
        self._stopping.set()
        if self._starter is not threading.current_thread() and self._starting.acquire(
            timeout=JOIN_S
        ):
            self._starting.release()  # the port is closed, or the thread runs
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(JOIN_S)

    def _run(self, port: Port) -> None:
        kept_ns = self._clock.now_ns()
        try:
            while not self._stopping.is_set():
                self._take(port, READ_S)
                now = self._clock.now_ns()
                if self._conversation is not None and now - kept_ns >= KEEP_S * NS_PER_S:
                    kept_ns = now
                    self._conversation.keep(lambda data: self._write(port, data))
            self._take(port, 0.0)  # what came while the end was asked for
        except Exception as error:  # whatever it is, the owner raises it again
            self.error = error
        finally:
            port.close()

    def _go_on(self) -> None:
        if self._stopping.is_set():
            raise DeviceError("was stopped while it was being set up.")

    def _hear(self, port: Port, timeout_s: float) -> bytes:
        """Read while the device is set up."""
        self._go_on()
        end_s = time.monotonic() + timeout_s
        while True:
            left_s = end_s - time.monotonic()
            data = self._take(port, max(0.0, min(left_s, READ_S)))
            self._go_on()
            if data or left_s <= READ_S:
                return data

    def _take(self, port: Port, timeout_s: float) -> bytes:
        data = port.read(timeout_s)
        if data:
            self._on_bytes(self._clock.now_ns(), data)
            if self._conversation is not None:
                self._conversation.heard(data)
        return data

    def _write(self, port: Port, data: bytes) -> None:
        self._on_sent(self._clock.now_ns(), data)
        port.write(data)
