"""Frames of variable length among unknown bytes: a header, and behind it a byte with the length."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import IntArray
from imu_rig.devices.unknown.period import ANALYSED_BYTES

LEAST_FRAMES = 10
LINKED = 0.9  # share of the frames behind which another one begins
LIKELY_HEADERS = 16
LENGTH_PLACES = range(1, 8)  # behind the beginning of the frame
LONGEST_OVERHEAD = 24  # bytes that the length does not count
LEAST_LENGTHS = 2
LEAST_OTHERS = 0.05  # share of the frames that must not have the most frequent length


@dataclass(frozen=True)
class VariableFrames:
    """Frames that say how long they are.

    Attributes
    ----------
    header : bytes
    length_at : int
        Place of the byte with the length, from the beginning of the frame.
    overhead : int
        How many bytes a frame is longer than that byte says.
    lengths : dict
        Bytes of a frame to how many were found, the most frequent first.
    share : float
        Of all bytes, those in frames.
    """

    header: bytes
    length_at: int
    overhead: int
    lengths: dict[int, int]
    share: float


def find_frames_of_variable_length(data: bytes) -> VariableFrames | None:
    """Return what such frames begin with and where their length is; None if there are none."""
    data = data[:ANALYSED_BYTES]
    best: VariableFrames | None = None
    for header in _likely_headers(data):
        at = _places(data, header)
        for place in range(len(header), len(header) + len(LENGTH_PLACES)):
            found = _walked(data, header, at, place)
            if found is not None and (best is None or found.share > best.share + 0.02):
                best = found
    return best


def _likely_headers(data: bytes) -> list[bytes]:
    singles = Counter(data).most_common(LIKELY_HEADERS)
    values = np.frombuffer(data, np.uint8).astype(np.int64)
    pairs, counts = np.unique(values[:-1] << 8 | values[1:], return_counts=True)
    likely = pairs[np.argsort(-counts)[:LIKELY_HEADERS]].tolist()
    headers = [pair.to_bytes(2, "big") for pair in likely] + [bytes([byte]) for byte, _ in singles]
    return [header for header in headers if header[0]]  # zeros are the high bytes of small numbers


def _places(data: bytes, header: bytes) -> IntArray:
    values = np.frombuffer(data, np.uint8)
    last = len(values) - len(header) + 1
    match = np.ones(last, bool)
    for offset, byte in enumerate(header):
        match &= values[offset : offset + last] == byte
    return np.flatnonzero(match)


def _walked(data: bytes, header: bytes, at: IntArray, place: int) -> VariableFrames | None:
    """Walk from frame to frame by the byte at ``place``; None if that leads nowhere."""
    values = np.frombuffer(data, np.uint8)
    at = at[at + place < len(values)]
    if len(at) < LEAST_FRAMES:
        return None
    over = np.diff(at) - values[at[:-1] + place]
    possible = over[(over > 0) & (over <= LONGEST_OVERHEAD)]
    if len(possible) < LEAST_FRAMES // 2:
        return None
    overhead = int(np.bincount(possible).argmax())
    if overhead <= place:  # the frame would end before its own length
        return None
    places = at.tolist()
    begins = set(places)
    lengths: Counter[int] = Counter()
    frames, position = 0, places[0]
    while position + place < len(data):
        length = data[position + place] + overhead
        following = position + length
        if following >= len(data):
            break
        frames += 1
        if following in begins:
            lengths[length] += 1
        else:  # something was lost or damaged: go on where a frame may begin
            next_place = bisect_left(places, position + 1)
            if next_place == len(places):
                break
            following = places[next_place]
        position = following
    # what led nowhere is no length: it may be a measurement behind a byte that never changes
    linked = sum(lengths.values())
    if frames < LEAST_FRAMES or linked < LINKED * frames or len(lengths) < LEAST_LENGTHS:
        return None
    if max(lengths.values()) > (1 - LEAST_OTHERS) * linked:
        return None
    share = sum(length * count for length, count in lengths.items()) / len(data)
    if share < 0.5:
        return None
    return VariableFrames(header, place, overhead, dict(lengths.most_common()), min(1.0, share))
