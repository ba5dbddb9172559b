"""Where samples of a sensor are missing: what its numbers say, and why by what the file says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import AnyArray, FloatArray
from imu_rig.packet_stream import AssembledPackets
from imu_rig.recording.contents import Missing

SILENCE_S = 1.0  # without a packet, after which packets without counter and clock count as missing

LOST = "lost on the way"
RESTARTED = "restarted"
SLEPT = "the computer slept"
SILENT = "silent"


@dataclass(frozen=True)
class Cause:
    """Why bytes of one source may be missing at one place of its stream.

    Attributes
    ----------
    after_s : float
        Arrival of the first bytes after the place [s]; infinite where none came any more.
    since_s : float or None
        Trial time from which they are known to be missing, where it is known [s].
    reason : str
    """

    after_s: float
    since_s: float | None
    reason: str


def missing_samples(
    packets: AssembledPackets, causes: list[Cause], duration_s: float
) -> list[Missing]:
    """Return what is missing, in order of time.

    Where the device counts its packets or sends its clock, only those tell whether something is
    missing between two samples, and the causes tell why. Where it does neither, every cause and
    every silence stand for something unknown.

    Parameters
    ----------
    packets : AssembledPackets
    causes : list of Cause
    duration_s : float
        Trial time of the file's last record [s].
    """
    block = packets.block
    count = len(block)
    if count == 0:
        found = [Missing(c.since_s or 0.0, duration_s, None, c.reason) for c in causes]
        return sorted(found, key=lambda m: m.start_s)
    between = _missing_between(packets)
    reasons = _reasons(block.host_s, causes)
    known = {place: reasons.get(place, [LOST]) for place in np.flatnonzero(between > 0).tolist()}
    for place in (np.flatnonzero(np.diff(packets.segment)) + 1).tolist():
        known[place] = reasons.get(place, _of_new_stretches(packets))
    found = []
    for place, why in reasons.items():
        if not 0 < place < count:  # before the first sample or after the last: any cause counts
            known[place] = why
        elif np.isnan(between[place]):
            known.setdefault(place, why)
    for place, why in sorted(known.items()):
        start = float(block.t[place - 1]) if place else 0.0
        stop = float(block.t[place]) if place < count else max(duration_s, start)
        inside = 0 < place < count and not np.isnan(between[place])
        samples = int(between[place]) if inside else None
        found.append(Missing(start, stop, samples, ", ".join(dict.fromkeys(why))))
    return found


def _of_new_stretches(packets: AssembledPackets) -> list[str]:
    """Why time begins anew, where nobody stated it; of two kinds it may be either."""
    if packets.time_source == "arrival":
        return [SILENT]
    counts = ((packets.stats.restarts, RESTARTED), (packets.stats.leaps, SLEPT))
    return [" or ".join(why for count, why in counts if count)]


def _missing_between(packets: AssembledPackets) -> FloatArray:
    """How many samples are missing just before each; NaN where nothing tells."""
    block = packets.block
    steps: AnyArray = np.full(len(block), np.nan)
    if block.counter is not None:
        steps[1:] = np.diff(block.counter)
    elif block.device_s is not None:
        apart = np.diff(block.device_s)
        forward = apart[apart > 0]
        if len(forward):
            steps[1:] = np.rint(apart / np.median(forward))
    steps[1:][np.diff(packets.segment) != 0] = np.nan
    missing: FloatArray = np.where(np.isnan(steps), np.nan, np.fmax(steps - 1, 0))
    return missing


def _reasons(host_s: FloatArray, causes: list[Cause]) -> dict[int, list[str]]:
    """Reasons by the number of the first sample that came after them."""
    newest = np.maximum.accumulate(host_s)  # a packet that was late stands before its place
    found: dict[int, list[str]] = {}
    for cause in causes:
        place = int(np.searchsorted(newest, cause.after_s))
        found.setdefault(place, []).append(cause.reason)
    return found
