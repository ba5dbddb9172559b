"""The faults that simulated devices can have, under one small vocabulary."""

from __future__ import annotations

import math
from typing import Annotated, Self

from pydantic import Field, model_validator

from simulators.models import Model, NotNegative

LINK_WORDS = {
    "off": "powered, but sends and answers nothing",
    "stuck": "repeats its last sample, or answers with frozen positions",
    "garbage": "random bytes in place of packets or replies",
    "wrong": "well-formed but wrong: samples 1.5 times too large, positions 400 quarter-us high",
    "slow": "half the packet rate, or replies 0.3 s late",
    "delayed": "bytes arrive 0.6 s late",
    "intermittent": "silent for 0.35 s of every second",
    "unplug": "the port is gone until the fault ends",
    "brownout": "the supply dips: silence, then a restart",
    "reset": "restarts at once",
}
"""Faults of the two devices that have a port."""

SERVO_WORDS = {
    "off": "no force: limp, stays where it is",
    "stuck": "does not move",
    "wrong": "goes 15 degrees off",
    "slow": "moves at a quarter of its speed",
    "intermittent": "limp for 0.35 s of every second",
}
"""Faults of a servo."""

SUPPORTED = {
    "imu": LINK_WORDS,
    "maestro": LINK_WORDS,
    "pan": SERVO_WORDS,
    "tilt": SERVO_WORDS,
    "roll": SERVO_WORDS,
}

RESTARTS = ("brownout", "reset")
"""Faults that happen at a moment, after which the device works again."""

WRONG_FACTOR = 1.5
WRONG_POSITION = 400
WRONG_ANGLE_DEG = 15.0
SLOW_REPLY_S = 0.3
SLOW_SERVO = 0.25
DELAY_S = 0.6
SILENT_SHARE_S = 0.35
IMU_BROWNOUT_S = 0.8
MAESTRO_BROWNOUT_S = 0.5


def check_device(device: str) -> None:
    """Raise :class:`ValueError` for a device that the rig does not have."""
    if device not in SUPPORTED:
        raise ValueError(f"there is no device {device!r}; take one of {', '.join(SUPPORTED)}.")


def check_fault(device: str, word: str, duration_s: float | None) -> None:
    """Raise :class:`ValueError`, saying what is supported, for a fault that cannot be had."""
    check_device(device)
    if word not in SUPPORTED[device]:
        raise ValueError(
            f"{device} cannot have the fault {word!r}; it supports {', '.join(SUPPORTED[device])}."
        )
    if duration_s is None:
        return
    if word == "reset":
        raise ValueError(f"{device}: a reset is over at once; leave its duration out.")
    if not (math.isfinite(duration_s) and duration_s > 0):
        raise ValueError(f"{device}: a fault's duration must be above 0 s, not {duration_s}.")


class PlannedFault(Model):
    """A fault that begins by itself.

    Attributes
    ----------
    at_s : float
        Time since the start of the world.
    device, word : str
    duration_s : float or None
        How long it lasts; for a brownout, how long the device is silent. None is for ever, and
        the usual silence.
    """

    at_s: NotNegative
    device: str
    word: str
    duration_s: Annotated[float, Field(gt=0.0)] | None = None

    @model_validator(mode="after")
    def _supported(self) -> Self:
        check_fault(self.device, self.word, self.duration_s)
        return self


class FaultSet:
    """The faults in effect on one device, in world time."""

    def __init__(self) -> None:
        self._since: dict[str, float] = {}
        self._until: dict[str, float] = {}

    def start(self, word: str, now_s: float, duration_s: float | None) -> None:
        """Put a fault into effect; a second one of the same word replaces the first."""
        self._since[word] = now_s
        self._until[word] = math.inf if duration_s is None else now_s + duration_s

    def clear(self) -> None:
        """End them all."""
        self._since.clear()
        self._until.clear()

    def expire(self, now_s: float) -> None:
        """End those whose time is over."""
        for word in [w for w, until in self._until.items() if until <= now_s + 1e-9]:
            del self._since[word], self._until[word]

    def has(self, word: str) -> bool:
        """Return whether a fault is in effect."""
        return word in self._since

    def silent(self, now_s: float) -> bool:
        """Return whether the device is mute at this moment."""
        if "off" in self._since:
            return True
        since = self._since.get("intermittent")
        return since is not None and (now_s - since) % 1.0 < SILENT_SHARE_S

    def __bool__(self) -> bool:
        """Return whether any fault is in effect."""
        return bool(self._since)
