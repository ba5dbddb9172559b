"""A Pololu Maestro servo controller on its command port: questions, answers, and limits."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from typing import Literal

from firmware_protocols.maestro import (
    Command,
    GetErrors,
    GetMovingState,
    GetPosition,
    GoHome,
    MaestroErrors,
    SetAcceleration,
    SetSpeed,
    SetTarget,
    StopScript,
    encode,
    reply_length,
)
from imu_rig.clock import Clock, Deadline
from imu_rig.devices.ports import DEFAULT_BAUD, Port, open_port
from imu_rig.errors import DeviceError, DeviceLost, LimitError

# Constants of time.
REPLY_S = 0.5  # until a reply counts as missing
MACHINE_REPLY_S = 0.3  # of the machine's own time at least, for clocks that run faster
READ_S = 0.02  # one read while waiting
LATE_S = 1.0  # after a question: a reply that has not come by then never will
SETTLE_S = 0.05  # of silence on a line where somebody else may have asked before

ATTEMPTS = 2
"""How often a question is asked before the controller counts as lost."""

LEAST_TARGET, GREATEST_TARGET = 256, 16_320
"""What any Maestro can make: 64 to 4080 us, in quarter-us. 0 stands for no pulses."""

KNOWN_ERRORS = sum(MaestroErrors)

Tap = Callable[[int, Literal["in", "out"], bytes], None]


class MaestroClient:
    """Talks to one Maestro. Safe to use from several threads; nobody else reads its port.

    Replies carry no mark of what they answer. So input is flushed before every question, an
    impossible or missing reply is asked for once more, and as long as a missing one may still be
    under way no other question is asked.

    Parameters
    ----------
    url : str
        Its command port.
    clock : Clock
    device : int, optional
        Device number, to use the Pololu protocol where several controllers share a line.
    crc : bool
        Whether the controller expects a CRC byte.
    tap : callable, optional
        Called with stamp [ns], "in" or "out", and the bytes, for everything on the wire.
    timeout_s : float
        How long a reply may take.
    baud : int
        Without meaning for its USB command port.

    Attributes
    ----------
    limits : dict
        Channel to (least, greatest) target [quarter-us]. Once it holds any channel, others are
        refused. No target outside is ever written; 0, which releases the servo, always may.
    """

    def __init__(
        self,
        url: str,
        clock: Clock,
        *,
        device: int | None = None,
        crc: bool = False,
        tap: Tap | None = None,
        timeout_s: float = REPLY_S,
        baud: int = DEFAULT_BAUD,
    ) -> None:
        self.url = url
        self.limits: dict[int, tuple[int, int]] = {}
        self._clock, self._device, self._crc, self._tap = clock, device, crc, tap
        self._timeout_s, self._baud = timeout_s, baud
        self._lock = threading.RLock()
        self._port: Port | None = None
        self._answered = False
        self._owed_bytes = 0  # of replies that may still come ...
        self._owed_until_s = 0.0  # ... until then, on the machine's clock
        self._settled = True

    @property
    def is_open(self) -> bool:
        """Whether the port is open and has not been lost."""
        return self._port is not None

    def open(self) -> None:
        """Open the port; an open one is left as it is.

        Raises
        ------
        PortError
            If it cannot be opened.
        """
        with self._lock:
            if self._port is None:
                self._port = open_port(self.url, baud=self._baud)
                self._settled, self._owed_bytes = False, 0

    def close(self) -> None:
        """Close the port; the controller keeps its targets."""
        with self._lock:
            if self._port is not None:
                self._port.close()
                self._port = None

    # --- commands -----------------------------------------------------------------------------

    def set_target(self, channel: int, quarter_us: int) -> None:
        """Send a channel to a pulse width [quarter-us]; 0 releases it.

        Raises
        ------
        LimitError
            If the target lies outside the limits; nothing was written.
        DeviceLost
            If the port has gone.
        """
        self.set_targets({channel: quarter_us})

    def set_targets(self, targets: Mapping[int, int]) -> None:
        """Send several channels to their targets in one write; all are checked before it.

        Raises
        ------
        LimitError
            If any target lies outside the limits; nothing was written.
        DeviceLost
            If the port has gone.
        """
        for channel, target in targets.items():
            self._check(channel, target)
        self._send(*(SetTarget(channel, target) for channel, target in targets.items()))

    def set_speed(self, channel: int, speed: int) -> None:
        """Limit a channel's speed, in units of 25 us/s; 0 is no limit."""
        self._send(SetSpeed(channel, speed))

    def set_acceleration(self, channel: int, acceleration: int) -> None:
        """Limit a channel's acceleration, in units of 312.5 us/s^2; 0 is no limit."""
        self._send(SetAcceleration(channel, acceleration))

    def go_home(self) -> None:
        """Send all channels home, which by default releases them."""
        self._send(GoHome())

    def stop_script(self) -> None:
        """Stop a script that runs on the controller and might move servos."""
        self._send(StopScript())

    # --- questions ----------------------------------------------------------------------------

    def position(self, channel: int) -> int:
        """Return the pulse that the controller sends to a channel now [quarter-us]; 0 is none.

        The commanded pulse under its speed limit: it says nothing about where the servo is.

        Raises
        ------
        DeviceError
            If the controller answers nonsense, or has never answered.
        DeviceLost
            If it does not answer any more or the port has gone.
        """
        return self._ask(
            GetPosition(channel), lambda v: v == 0 or LEAST_TARGET <= v <= GREATEST_TARGET
        )

    def errors(self) -> MaestroErrors:
        """Return the error register; reading clears it. Raises as `position` does."""
        return MaestroErrors(self._ask(GetErrors(), lambda value: not value & ~KNOWN_ERRORS))

    def moving(self) -> bool:
        """Return whether a speed-limited channel is under way; raises as `position` does.

        A Micro Maestro may say no while one is: compare `position` with the target instead.
        """
        return bool(self._ask(GetMovingState(), lambda value: value <= 1))

    # --- the wire -----------------------------------------------------------------------------

    def _check(self, channel: int, target: int) -> None:
        if target == 0:
            return
        if self.limits and channel not in self.limits:
            raise LimitError(
                f"Channel {channel} of the Maestro is not part of the jig; nothing was sent."
            )
        low, high = self.limits.get(channel, (LEAST_TARGET, GREATEST_TARGET))
        if not low <= target <= high:
            raise LimitError(
                f"Channel {channel} was to go to {target / 4:g} us, outside its limits of "
                f"{low / 4:g} to {high / 4:g} us; nothing was sent."
            )

    def _send(self, *commands: Command) -> None:
        data = b"".join(encode(c, device=self._device, crc=self._crc) for c in commands)
        with self._lock:
            self._write(data)

    def _ask(self, command: Command, possible: Callable[[int], bool]) -> int:
        """Ask until there is a possible answer, twice at most."""
        data = encode(command, device=self._device, crc=self._crc)
        length = reply_length(command)
        reply = b""
        with self._lock:
            self._flush()
            for asked in range(1, ATTEMPTS + 1):
                self._write(data)
                self._owed_bytes += length
                self._owed_until_s = time.monotonic() + LATE_S
                reply = self._collect(length)
                # the second time a late first answer may come along, to the same question
                if length <= len(reply) <= asked * length:
                    value = int.from_bytes(reply[:length], "little")
                    if possible(value):
                        self._answered = True
                        return value
            self._settled = False
        raise self._no_answer(command, reply)

    def _collect(self, length: int) -> bytes:
        """Read until a whole reply is there, and whatever came with it, or until it is overdue."""
        deadline = Deadline(self._clock, self._timeout_s)
        begin = time.monotonic()
        reply = b""
        while len(reply) < length:
            waited = time.monotonic() - begin
            if waited > self._timeout_s or (deadline.expired and waited > MACHINE_REPLY_S):
                break
            reply += self._read(READ_S)
        return reply

    def _flush(self) -> None:
        """Read away what is not an answer to the next question, and wait for what is owed."""
        wait_s = 0.0 if self._settled else SETTLE_S
        enough_s = time.monotonic() + LATE_S  # for a line that never falls silent
        while time.monotonic() < enough_s:
            owed = self._owed_bytes > 0 and time.monotonic() < self._owed_until_s
            if not self._read(READ_S if owed else wait_s) and not owed:
                break
        self._owed_bytes, self._settled = 0, True

    def _read(self, timeout_s: float) -> bytes:
        port = self._require_port()
        try:
            data = port.read(timeout_s)
        except DeviceLost:
            self.close()
            raise
        if data and self._tap is not None:
            self._tap(self._clock.now_ns(), "in", data)
        self._owed_bytes -= len(data)
        return data

    def _write(self, data: bytes) -> None:
        port = self._require_port()
        if self._tap is not None:
            self._tap(self._clock.now_ns(), "out", data)
        try:
            port.write(data)
        except DeviceLost:
            self.close()
            raise

    def _require_port(self) -> Port:
        if self._port is None:
            raise DeviceLost(f"The Maestro's port {self.url} is not open.")
        return self._port

    def _no_answer(self, command: Command, reply: bytes) -> DeviceError:
        if reply:
            return DeviceError(
                f"{self.url} answers {type(command).__name__} with nonsense "
                f"({reply[:8].hex(' ').upper()}): check that this is the Maestro's command port "
                "and that no other program talks to it."
            )
        if self._answered:
            return DeviceLost(
                f"The Maestro on {self.url} does not answer any more: check its USB cable and its "
                "supply."
            )
        crc = "on" if self._crc else "off"
        return DeviceError(
            f"The Maestro on {self.url} does not answer. As it comes from the factory it ignores "
            "this port ('UART, detect baud rate'): in the Maestro Control Center, Serial Settings, "
            "choose 'USB Dual Port' and apply. If that is done, this may be its TTL port: use the "
            f"other of its two ports, and see that its CRC is {crc} as here."
        )
