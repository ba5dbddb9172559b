"""A Pololu Maestro: executes the bytes of its command port and sends pulses to its channels."""

from __future__ import annotations

import numpy as np

from firmware_protocols.maestro import (
    Command,
    CommandParser,
    GetErrors,
    GetMovingState,
    GetPosition,
    GetScriptStatus,
    GoHome,
    MaestroErrors,
    MiniSscTarget,
    RestartScript,
    RestartScriptWithParameter,
    SetAcceleration,
    SetMultipleTargets,
    SetPwm,
    SetSpeed,
    SetTarget,
    encode_reply_u16,
)
from simulators.faults import SLOW_REPLY_S, WRONG_POSITION, FaultSet
from simulators.link import Outbox
from simulators.maestro_motion import Channel
from simulators.models import MaestroMode, MaestroModel

MICRO_CHANNELS = 6
SCRIPT_STOPPED = b"\x01"
LIMIT_STEP_US = 16
QUARTERS = 4


class MaestroBoard:
    """The board with all its channels.

    Parameters
    ----------
    model : MaestroModel
    mode : str
        Serial mode; in "uart-detect" bytes of the command port are ignored.
    garbage_rng : numpy Generator
        For the bytes of the fault "garbage".
    """

    def __init__(
        self, model: MaestroModel, mode: MaestroMode, garbage_rng: np.random.Generator
    ) -> None:
        self.model = model
        self.mode = mode
        self.faults = FaultSet()
        self.outbox = Outbox()
        self._garbage_rng = garbage_rng
        self._least = round(model.min_us / LIMIT_STEP_US) * LIMIT_STEP_US * QUARTERS
        self._greatest = round(model.max_us / LIMIT_STEP_US) * LIMIT_STEP_US * QUARTERS
        self._powered = True
        self.boot()

    def boot(self) -> None:
        """Start as after power-up: no pulses, no limits, no errors."""
        model = self.model
        self._parser = CommandParser(
            model.device, model.crc, model.mini_ssc_offset, channels=model.channels
        )
        self.channels = [Channel() for _ in range(model.channels)]
        self.errors = MaestroErrors(0)
        self._frozen: list[int] | None = None
        self._command_at_s: float | None = None
        self._powered = True
        self.outbox.clear()

    def power_down(self) -> None:
        """Stop pulses and answers."""
        self.boot()
        self._powered = False

    def pulses_us(self) -> list[float]:
        """Return the pulse width of every channel [us]; 0 for none."""
        return [channel.position / QUARTERS for channel in self.channels]

    def set_stuck(self, stuck: bool) -> None:
        """Answer with the positions of now from now on, or no longer."""
        self._frozen = [channel.position for channel in self.channels] if stuck else None

    def receive(self, data: bytes, now_s: float) -> None:
        """Take bytes that reach the command port and put the replies into the outbox."""
        if self.mode == "uart-detect" or not self._powered or self.faults.silent(now_s):
            return
        for event in self._parser.feed(data):
            if isinstance(event, MaestroErrors):
                self._fail(event)
                continue
            self._command_at_s = now_s
            reply = self._execute(event)
            if reply:
                self._answer(reply, now_s)

    def _answer(self, reply: bytes, now_s: float) -> None:
        if self.faults.has("garbage"):
            reply = self._garbage_rng.bytes(len(reply))
        late_s = SLOW_REPLY_S if self.faults.has("slow") else 0.0
        self.outbox.put(reply, now_s + late_s, self.faults)

    def tick(self, now_s: float) -> None:
        """Update the positions, every 10 ms, and notice a serial timeout."""
        for channel in self.channels:
            if channel.moving:
                channel.tick()
        timeout_s = self.model.timeout_s
        if timeout_s and self._command_at_s is not None and now_s - self._command_at_s > timeout_s:
            self._command_at_s = None
            self._fail(MaestroErrors.SERIAL_TIMEOUT)

    def _fail(self, error: MaestroErrors) -> None:
        """Latch an error, which sends every channel home."""
        self.errors |= error
        self._go_home()

    def _go_home(self) -> None:
        if self.model.home == "off":
            for channel in self.channels:
                channel.release()

    def _execute(self, command: Command) -> bytes:
        match command:
            case SetTarget(channel, target):
                self._aim(channel, target)
            case MiniSscTarget(channel, _):
                self._aim(channel, command.target())
            case SetSpeed(channel, speed):
                self.channels[channel].speed = speed
            case SetAcceleration(channel, acceleration):
                self.channels[channel].acceleration = acceleration
            case SetMultipleTargets() | SetPwm() if self.model.channels == MICRO_CHANNELS:
                self._fail(MaestroErrors.SERIAL_PROTOCOL)
            case SetMultipleTargets(first, targets):
                for channel, target in enumerate(targets, first):
                    self._aim(channel, target)
            case GetPosition(channel):
                return encode_reply_u16(self._position(channel))
            case GetMovingState():
                return bytes((any(channel.moving for channel in self.channels),))
            case GetErrors():
                latched, self.errors = self.errors, MaestroErrors(0)
                return encode_reply_u16(int(latched))
            case GoHome():
                self._go_home()
            case RestartScript() | RestartScriptWithParameter():
                # There is no subroutine to go to: the board holds an empty script.
                self._fail(MaestroErrors.SCRIPT_PROGRAM_COUNTER)
            case GetScriptStatus():
                return SCRIPT_STOPPED
            case _:
                pass
        return b""

    def _aim(self, channel: int, target: int) -> None:
        if target == 0:
            self.channels[channel].release()
        else:
            self.channels[channel].aim(min(max(target, self._least), self._greatest))

    def _position(self, channel: int) -> int:
        position = (
            self._frozen[channel] if self._frozen is not None else self.channels[channel].position
        )
        return position + WRONG_POSITION if self.faults.has("wrong") else position
