"""What a ground station says to a flight controller, as bytes; pymavlink encodes it."""

from __future__ import annotations

from typing import Any

from firmware_protocols.mavlink_messages import Message
from imu_rig.mavlink_dialect import mavlink, mavlink_1, packed, sender

OUR_SYSTEM, OUR_COMPONENT = 255, mavlink.MAV_COMP_ID_MISSIONPLANNER

Address = tuple[int, int]
"""System and component."""


class Voice:
    """Encodes our messages, with one sequence of numbers for each version of MAVLink.

    Attributes
    ----------
    versions : tuple of int
        In which every message is said, one after the other.
    """

    def __init__(self) -> None:
        self.versions: tuple[int, ...] = (2,)
        self._senders: dict[int, Any] = {}

    def heartbeat(self) -> bytes:
        """Say that a ground station is there."""
        return self._say(
            "heartbeat",
            mavlink.MAV_TYPE_GCS,
            mavlink.MAV_AUTOPILOT_INVALID,
            0,
            0,
            mavlink.MAV_STATE_ACTIVE,
            3,
        )

    def message_interval(self, to: Address, message: Message, rate_hz: float) -> bytes:
        """Ask for a message at a rate; answered by COMMAND_ACK."""
        interval_us = round(1e6 / rate_hz)
        return self._command(to, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message.number, interval_us)

    def once(self, to: Address, message: Message) -> bytes:
        """Ask for a message once."""
        return self._command(to, mavlink.MAV_CMD_REQUEST_MESSAGE, message.number)

    def raw_sensors(self, to: Address, rate_hz: float) -> bytes:
        """Ask for the whole group of raw sensors, as was done before there were intervals."""
        return self._say(
            "request_data_stream",
            *to,
            mavlink.MAV_DATA_STREAM_RAW_SENSORS,
            min(round(rate_hz), 0xFFFF),
            1,
        )

    def parameter(self, to: Address, name: str) -> bytes:
        """Ask for a parameter."""
        return self._say("param_request_read", *to, name.encode("ascii"), -1)

    def _command(self, to: Address, command: int, *parameters: float) -> bytes:
        seven = (*map(float, parameters), *[0.0] * (7 - len(parameters)))
        return self._say("command_long", *to, command, 0, *seven)

    def _say(self, name: str, *fields: Any) -> bytes:
        said = b""
        for version in self.versions:
            if version not in self._senders:
                self._senders[version] = sender(OUR_SYSTEM, OUR_COMPONENT, version=version)
            dialect = mavlink if version == 2 else mavlink_1()
            message = getattr(dialect, f"MAVLink_{name}_message")(*fields)
            said += packed(self._senders[version], message)
        return said
