"""What has to be said to an Xsens MTi: into its Config state, what to send, and off it goes.

An MTi measures and sends from power-up on, as it was told last. To change that it must be brought
into its Config state, in which it sends nothing but answers. What is asked is repeated a few times,
since answers may be lost among data and noise.

A unit that does not answer but sends what is wanted is taken as it is: a replay, a radio that goes
one way, a line whose other half is not connected.
"""

from __future__ import annotations

import struct
import time
from collections import deque
from dataclasses import dataclass

from firmware_protocols.protocol import DeviceProtocol
from firmware_protocols.xsens import LEGACY, PERIOD_HZ, XsensProtocol, describe
from firmware_protocols.xsens_data import (
    MOST_HZ,
    PACKET_COUNTER,
    SAMPLE_TIME_FINE,
    STATUS_BYTE,
    STATUS_WORD,
    find_items,
)
from firmware_protocols.xsens_frames import (
    Message,
    Mid,
    answer_to,
    encode_message,
    error_words,
    find_messages,
)
from imu_rig.devices.conversation import Hear, Write
from imu_rig.devices.recognize import recognize
from imu_rig.errors import DeviceError, DeviceLost

TRIES = 4  # of each message

# Constants of time.
ANSWER_S = 0.4  # for the answer to a message, also over Bluetooth
HEAR_S = 0.05  # of one look at the port
SEND_S = 2.0  # for the first measurement after all is set up

SHORT_BYTES = 4096  # of what came last, to say what it is
MOST_WAITING_BYTES = 1 << 18  # kept between two looks
SHARE_OF_BYTES = 0.5  # that whole messages make up where an MTi speaks
MEASUREMENTS = (Mid.MT_DATA, Mid.MT_DATA2)
EVERY_SAMPLE = 0xFFFF
EXACT_ITEMS = (0x4020, 0x8020)  # whose rate must be the one asked for

_UNKNOWN_MESSAGE = 0x04


class _NoAnswer(Exception):  # noqa: N818  (it never leaves this module)
    """A message that was not answered, however often it was sent."""


@dataclass(frozen=True)
class Answer:
    """What a message was answered with: data, or an error."""

    data: bytes = b""
    error: bytes | None = None


class MtiConversation:
    """The host's half of a conversation with an MTi.

    Parameters
    ----------
    protocol : XsensProtocol
        What it is to send.

    Attributes
    ----------
    device_id : int or None
        What the unit says it is; None until it has.
    """

    def __init__(self, protocol: DeviceProtocol) -> None:
        if not isinstance(protocol, XsensProtocol):
            raise TypeError(f"an MTi does not speak {protocol.name}.")
        self._protocol = protocol
        self.device_id: int | None = None
        self._beginning = False
        self._waiting: list[bytes] = []  # heard while it measures and not looked at yet
        self._waiting_bytes = 0
        self._tail = b""
        self._tail_s = 0.0  # when it began to wait for the rest of a message
        self._recent = b""
        self._bytes = 0
        self._message_bytes = 0
        self._fitting = 0  # measurements as the layout has them
        self._before = 0  # those of them that came before the last answer
        self._inbox: deque[tuple[int, Message]] = deque(maxlen=64)
        self._measurement: Message | None = None
        self._fresh = 0  # measurements since the last look of keep()
        self._problem: str | None = None

    def begin(self, write: Write, hear: Hear) -> None:
        """Set the unit up; see `imu_rig.devices.conversation.Conversation`."""
        self._beginning = True
        try:
            try:
                self._set_up(write, hear)
            except _NoAnswer as silence:
                self._take_as_it_is(hear, str(silence))
        except DeviceLost:
            raise
        except DeviceError:
            write(encode_message(Mid.GO_TO_MEASUREMENT))  # nobody shall find it silent
            raise
        finally:
            self._beginning = False
            self._inbox.clear()

    def heard(self, data: bytes) -> None:
        """Keep what it says while it measures for the next look."""
        if not self._beginning and self._waiting_bytes < MOST_WAITING_BYTES:
            self._waiting_bytes += len(data)
            self._waiting.append(data)

    def keep(self, write: Write) -> None:
        """Look at what it says; send it back to measuring if it fell silent.

        It does when somebody else has set it up.
        """
        waiting, self._waiting = self._waiting, []
        self._waiting_bytes = 0
        if waiting:
            self._take(b"".join(waiting))
            self._judge()
        if not self._fresh:
            write(encode_message(Mid.GO_TO_MEASUREMENT))
        self._fresh = 0

    @property
    def problem(self) -> str | None:
        """What is wrong with it now."""
        return self._problem

    def _set_up(self, write: Write, hear: Hear) -> None:
        """Go through the whole conversation."""
        self._refuse(self._ask(write, hear, Mid.GO_TO_CONFIG), "does not go to its Config state")
        told = self._ask(write, hear, Mid.REQ_DID)
        if len(told.data) >= 4:
            self.device_id = int.from_bytes(told.data[:4], "big")
        if self._protocol.format == LEGACY:
            self._set_up_legacy(write, hear)
        else:
            self._set_up_mtdata2(write, hear)
        answer = self._must(write, hear, Mid.GO_TO_MEASUREMENT)
        self._refuse(answer, "does not begin to measure")
        self._measurement = None
        if not self._listen(hear, SEND_S):
            sends = "sends nothing: switch it off and on again"
            if self._measurement is not None:
                sends = self._other_data()
            raise DeviceError(f"the MTi took every setting, and {sends}.")

    def _set_up_mtdata2(self, write: Write, hear: Hear) -> None:
        wanted = output_configuration(self._protocol)
        data = b"".join(struct.pack(">HH", *entry) for entry in wanted)
        answer = self._set(write, hear, Mid.SET_OUTPUT_CONFIGURATION, data)
        if answer.error is not None and answer.error[:1] == bytes([_UNKNOWN_MESSAGE]):
            raise DeviceError(
                f"the MTi has no MTData2 ({error_words(answer.error)}): it is of the first "
                "generation (mark 3 or before); use the layout xsens-mti-legacy."
            )
        self._refuse(answer, f"does not take the outputs of the layout {self._protocol.name}")
        pairs = [
            struct.unpack_from(">HH", answer.data, at) for at in range(0, len(answer.data) - 3, 4)
        ]
        given = dict(pairs)
        missing = [f"{identifier:04X}" for identifier, _ in wanted if identifier not in given]
        if given and missing:
            raise DeviceError(
                f"the MTi does not have the outputs {', '.join(missing)}: leave them out of the "
                "layout."
            )
        for identifier, rate in wanted:
            if identifier & 0xFFF0 in EXACT_ITEMS and given.get(identifier, rate) != rate:
                raise DeviceError(
                    f"the MTi sends {identifier:04X} at {given[identifier]} Hz where the layout "
                    f"{self._protocol.name} asks for {rate} Hz: set rate_hz in the layout to a "
                    "rate that it has."
                )

    def _set_up_legacy(self, write: Write, hear: Hear) -> None:
        protocol = self._protocol
        # Units of later generations are told to use the legacy format; the first does not know
        # the message and needs no telling.
        answer = self._set(write, hear, Mid.SET_OUTPUT_CONFIGURATION, bytes(4))
        if answer.error is not None and answer.error[:1] != bytes([_UNKNOWN_MESSAGE]):
            self._refuse(answer, "does not change to the legacy format")
        period = round(PERIOD_HZ / protocol.rate_hz)
        settings = (
            (Mid.SET_PERIOD, struct.pack(">H", period), f"does not run at {protocol.rate_hz:g} Hz"),
            (Mid.SET_OUTPUT_SKIP_FACTOR, bytes(2), "does not send every sample"),
            (
                Mid.SET_OUTPUT_MODE,
                struct.pack(">H", protocol.output_mode),
                f"does not have the output mode {protocol.output_mode:#06x}",
            ),
            (
                Mid.SET_OUTPUT_SETTINGS,
                struct.pack(">I", protocol.output_settings),
                f"does not have the output settings {protocol.output_settings:#010x}",
            ),
        )
        for mid, data, failure in settings:
            self._refuse(self._set(write, hear, mid, data), failure)

    def _set(self, write: Write, hear: Hear, mid: Mid, data: bytes) -> Answer:
        """Set something, unless it is so already: the unit writes it into a memory that wears."""
        told = self._ask(write, hear, mid)
        if told.error is None and told.data == data:
            return told
        return self._must(write, hear, mid, data)

    def _must(self, write: Write, hear: Hear, mid: Mid, data: bytes = b"") -> Answer:
        """Ask in the Config state.

        An error may mean that the unit is not in its Config state after all, so it is brought
        there again before it is believed.
        """
        answer = self._ask(write, hear, mid, data)
        if answer.error is not None:
            self._ask(write, hear, Mid.GO_TO_CONFIG)
            answer = self._ask(write, hear, mid, data)
        return answer

    def _refuse(self, answer: Answer, failure: str) -> None:
        if answer.error is not None:
            raise DeviceError(f"the MTi {failure}: {error_words(answer.error)}.")

    def _ask(self, write: Write, hear: Hear, mid: Mid, data: bytes = b"") -> Answer:
        """Send a message until it is answered; raise `_NoAnswer` if it never is."""
        kept = [entry for entry in self._inbox if entry[1].mid != Mid.ERROR]
        self._inbox.clear()
        self._inbox.extend(kept)
        for _ in range(TRIES):
            write(encode_message(mid, data))
            until = time.monotonic() + ANSWER_S
            while time.monotonic() < until:
                while self._inbox:
                    before, message = self._inbox.popleft()
                    if message.mid in (answer_to(mid), Mid.ERROR):
                        self._before = before
                    if message.mid == answer_to(mid):
                        return Answer(data=message.data)
                    if message.mid == Mid.ERROR:
                        return Answer(error=message.data)
                    if message.mid == Mid.WAKE_UP:  # it started anew: hold it in its Config state
                        write(encode_message(Mid.WAKE_UP_ACK))
                        until = 0.0
                if until:
                    self._take(hear(HEAR_S))
        raise _NoAnswer(f"{mid:02X} ({mid.name})")

    def _take(self, data: bytes) -> None:
        """Find the messages in what came.

        What has been awaited for long is not the beginning of a message: it lost its end, or its
        length lies. It is let go, since the next answers may stand in what it claims.
        """
        now_s = time.monotonic()
        self._bytes += len(data)
        if self._beginning:
            self._recent = (self._recent + data)[-SHORT_BYTES:]
        stale = bool(self._tail) and now_s - self._tail_s >= ANSWER_S
        joined = self._tail + data
        self._find(joined, now_s)
        if stale and len(self._tail) == len(joined):
            self._find(self._tail[1:], now_s)

    def _find(self, data: bytes, now_s: float) -> None:
        """Take the messages out of bytes and keep what is undecided as the tail."""
        messages, decided = find_messages(data, self._protocol.form)
        if decided or not self._tail:
            self._tail_s = now_s
        self._tail = data[decided:]
        for message in messages:
            self._message_bytes += 5 + len(message.data)
            if message.mid in MEASUREMENTS:
                self._measurement = message
                self._fresh += 1
                self._fitting += self._beginning and self._fits(message)
            else:
                self._inbox.append((self._fitting, message))

    def _take_as_it_is(self, hear: Hear, unanswered: str) -> None:
        """Accept a unit that does not answer if it sends what is wanted; otherwise say what."""
        if self._listen(hear, ANSWER_S + 2.0 / self._protocol.rate_hz):
            return
        speaks = self._message_bytes >= SHARE_OF_BYTES * self._bytes  # not by chance, in noise
        if speaks and self._measurement is not None and not self._fits(self._measurement):
            raise DeviceError(f"the MTi does not answer, and {self._other_data()}.")
        if speaks and self._message_bytes:
            raise DeviceError(
                f"the MTi does not answer the message {unanswered}: see that the line to it is "
                "connected, then switch it off and on again."
            )
        if self._bytes:
            other = recognize(self._recent)
            if other is not None:
                raise DeviceError(
                    f"no MTi: packets of the layout {other.name} come; use that layout."
                )
            raise DeviceError(
                f"{self._bytes} bytes came that are no messages of an MTi: the baud rate is wrong "
                "(115200 from the factory), or this is another device's port."
            )
        raise DeviceLost(
            "the MTi neither answers nor sends: check its power, its cable, the baud rate and that "
            "this is its port."
        )

    def _listen(self, hear: Hear, seconds: float) -> bool:
        """Wait for a measurement that fits; return whether one has come since the last answer."""
        until = time.monotonic() + seconds
        while self._fitting == self._before and time.monotonic() < until:
            self._take(hear(HEAR_S))
        return self._fitting > self._before

    def _judge(self) -> None:
        """Say what is wrong by what came last."""
        problem = None
        while self._inbox:
            _, message = self._inbox.popleft()
            if message.mid == Mid.ERROR:
                problem = f"reports {error_words(message.data)}"
        if self._measurement is not None and not self._fits(self._measurement):
            problem = self._other_data()
        self._problem = problem

    def _fits(self, measurement: Message) -> bool:
        if self._protocol.format == LEGACY:
            return (
                measurement.mid == Mid.MT_DATA
                and len(measurement.data) == self._protocol.data_bytes
            )
        return measurement.mid == Mid.MT_DATA2 and not self._missing(measurement)

    def _missing(self, measurement: Message) -> list[int]:
        """Return the items without which an MTData2 message is no row."""
        seen = {entry[0] & 0xFFF0 for entry in find_items(measurement.data) or []}
        layout = self._protocol.layout
        needed = [
            identifier
            for identifier, has in (
                (PACKET_COUNTER, layout.counter is not None),
                (SAMPLE_TIME_FINE, layout.clock is not None),
            )
            if has
        ]
        return [identifier for identifier in needed if identifier not in seen]

    def _other_data(self) -> str:
        """Say what it sends in place of what is wanted, and what to do."""
        assert self._measurement is not None
        shown, name = describe([self._measurement]), self._protocol.name
        if self._protocol.format == LEGACY:
            if self._measurement.mid == Mid.MT_DATA2:
                return f"sends {shown}: use the layout xsens-mti or a file with these outputs"
            return (
                f"sends {shown} where the layout {name} has {self._protocol.data_bytes}: write a "
                "layout file with the output mode and settings that it was set up with"
            )
        if self._measurement.mid == Mid.MT_DATA:
            return f"sends {shown}: use the layout xsens-mti-legacy, or a file with its output mode"
        missing = ", ".join(f"{entry:04X}" for entry in self._missing(self._measurement))
        return (
            f"sends {shown}, without {missing or 'anything'} that the layout {name} goes by: set "
            "it up to send them"
        )


def output_configuration(protocol: XsensProtocol) -> list[tuple[int, int]]:
    """Return the identifiers and rates [Hz] to ask an MTi for."""
    always = (PACKET_COUNTER, SAMPLE_TIME_FINE, STATUS_BYTE, STATUS_WORD)
    wanted = int(protocol.rate_hz)
    rates = [
        EVERY_SAMPLE
        if identifier in always
        else min(wanted, MOST_HZ.get(identifier & 0xFFF0, wanted))
        for identifier in protocol.outputs
    ]
    return list(zip(protocol.outputs, rates, strict=True))
