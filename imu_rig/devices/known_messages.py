"""Messages of known devices that hold no measurements, or not those of a known layout."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from firmware_protocols.mavlink import IMU_MESSAGES
from firmware_protocols.mavlink_frames import MAVLINK_FORMAT
from firmware_protocols.mavlink_messages import MESSAGES
from firmware_protocols.variable_framing import find_frames
from firmware_protocols.xsens import describe
from firmware_protocols.xsens_frames import Mid, error_words, find_messages

SHARE_OF_BYTES = 0.5
CUT_BYTES = 64  # of a message whose beginning or end was not heard
MOST_NAMED = 5
MAVLINK_1 = 0xFE
MAVLINK_LAYOUTS = {
    "HIGHRES_IMU": "mavlink-highres",
    "SCALED_IMU": "mavlink-scaled",
    "RAW_IMU": "mavlink-raw",
}
MTI_LAYOUTS = ("xsens-mti", "xsens-mti-legacy")


@dataclass(frozen=True)
class KnownMessages:
    """What a device is by its messages.

    Attributes
    ----------
    says : str
        What it is and what to do, in half a sentence.
    layouts : tuple of str
        Layouts to record it with, which ask it for measurements.
    """

    says: str
    layouts: tuple[str, ...] = ()


def known_messages(data: bytes) -> KnownMessages | None:
    """Say what a device is that speaks MAVLink or as an MTi; None for others."""
    return _mavlink(data) or _xsens(data)


def _mavlink(data: bytes) -> KnownMessages | None:
    frames = find_frames(MAVLINK_FORMAT, data)
    starts, lengths = frames.starts.tolist(), frames.lengths.tolist()
    if not starts or sum(lengths) < SHARE_OF_BYTES * (len(data) - max(lengths)):
        return None
    named = {message.number: message.name for message in MESSAGES.values()}
    counted: Counter[str] = Counter()
    old = 0
    for start in starts:
        first = data[start] == MAVLINK_1
        old += first
        place = data[start + 5 : start + 6] if first else data[start + 7 : start + 10]
        number = int.from_bytes(place, "little")
        counted[named.get(number, f"message {number}")] += 1
    shown = ", ".join(name for name, _ in counted.most_common(MOST_NAMED))
    version = "version 1 of MAVLink" if old > len(starts) / 2 else "MAVLink"
    heard = next((name for name in IMU_MESSAGES if name in counted), None)
    if heard is not None:
        layout = MAVLINK_LAYOUTS.get(heard)
        use = layout or f"file that names the message {heard}"
        says = f"speaks {version} with {heard}: use the layout {use}"
        return KnownMessages(says, () if layout is None else (layout,))
    return KnownMessages(
        f"speaks {version} ({shown}) but sends no IMU message by itself: use the layout "
        "mavlink-highres or mavlink-scaled, which ask for it",
        ("mavlink-highres", "mavlink-scaled"),
    )


def _xsens(data: bytes) -> KnownMessages | None:
    messages, _ = find_messages(data)
    if not messages:
        return None
    frames = sum(len(message.data) + 5 for message in messages)
    if frames < SHARE_OF_BYTES * len(data) - CUT_BYTES:
        return None
    measured = describe(messages)
    if measured:
        return KnownMessages(
            f"is an Xsens MTi that sends {measured}: use the layout xsens-mti, or "
            "xsens-mti-legacy for one of the first generation, which set it up",
            MTI_LAYOUTS,
        )
    error = next((m for m in reversed(messages) if m.mid == Mid.ERROR), None)
    if error is not None:
        return KnownMessages(
            f"is an Xsens MTi that reports {error_words(error.data)}: switch it off and on again"
        )
    kinds = {message.mid for message in messages}
    if kinds <= {Mid.WAKE_UP}:
        return KnownMessages(
            "is an Xsens MTi that has just woken up and does not measure yet: wait a second, or "
            "use the layout xsens-mti, which starts it",
            MTI_LAYOUTS,
        )
    return KnownMessages(
        "is an Xsens MTi in its Config state, which answers but does not measure: use the layout "
        "xsens-mti or xsens-mti-legacy, which start it, or switch it off and on",
        MTI_LAYOUTS,
    )
