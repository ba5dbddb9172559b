"""What has to be said to a device so that it sends what is wanted."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Protocol, runtime_checkable

from firmware_protocols.protocol import DeviceProtocol

Write = Callable[[bytes], None]
Hear = Callable[[float], bytes]


class Conversation(Protocol):
    """The host's half of a conversation with one device; one for each time its port is opened.

    Whatever is heard reaches the stream and the recording too, whatever is written the recording.
    """

    def begin(self, write: Write, hear: Hear) -> None:
        """Set the device up; called once the port is open, before it is read.

        Parameters
        ----------
        write : callable
            Takes bytes for the device; raises `DeviceLost` where the port is gone.
        hear : callable
            Waits up to some seconds and returns what came, perhaps nothing; raises as ``write``.

        Raises
        ------
        DeviceError
            One sentence, if the device refuses or cannot send what is wanted.
        """

    def heard(self, data: bytes) -> None:
        """Look at what came; called in the reader's thread with every piece, must be quick."""

    def keep(self, write: Write) -> None:
        """Say what has to be said again; called about once a second while the port is read."""

    @property
    def problem(self) -> str | None:
        """What is wrong with the device now, as a sentence that names neither it nor its port.

        It goes on from "NAME on PORT ", without a stop: "refuses HIGHRES_IMU: use ...". None where
        nothing is known to be.
        """


@runtime_checkable
class Remembers(Protocol):
    """A conversation that goes on from the one before, when the port of a device is opened anew."""

    def remember(self, before: Conversation) -> None:
        """Take over what holds on; called before ``begin``."""


CONVERSATIONS = {
    "xsens-mti": "imu_rig.devices.mti:MtiConversation",
    "mavlink": "imu_rig.devices.mavlink:MavlinkConversation",
}
"""Class for each kind of protocol whose devices must be spoken to, imported when it is needed.

Each is called with the protocol.
"""


def conversation_for(protocol: DeviceProtocol) -> Conversation | None:
    """Return a new conversation with a device of this protocol; None where it sends by itself."""
    place = CONVERSATIONS.get(str(protocol.to_dict().get("kind")))
    if place is None:
        return None
    module, name = place.split(":")
    made: Conversation = getattr(import_module(module), name)(protocol)
    return made
