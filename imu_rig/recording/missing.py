"""What is missing: what the file says of it, and where samples are by a sensor's own numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imu_rig.arrays import AnyArray, BoolArray, FloatArray, IntArray
from imu_rig.clock import NS_PER_S
from imu_rig.packet_stream import AssembledPackets
from imu_rig.recording.contents import Gap, Missing
from imu_rig.recording.format import DAMAGE, SET_UP, SILENT, STREAM, TRIAL, UNREADABLE, Kind
from imu_rig.recording.scan import Records

SILENCE_S = 1.0  # without a packet, after which packets without counter and clock count as missing

LOST = "lost on the way"
RESTARTED = "restarted"
SLEPT = "the computer slept"
INTERRUPTED = "recording interrupted"
LOST_IN_FILE = "lost in the file"

LATE = (SILENT, UNREADABLE, SET_UP)
"""Reasons of gaps over which a port's bytes still belong together."""
ROUNDING_S = 1e-6  # of times in gap records


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


@dataclass(frozen=True, eq=False)
class Losses:
    """What a file says of data that are not in it.

    Attributes
    ----------
    records : Records
        All that is in it.
    stated : list of (int, Gap, int)
        Rows of the gap records, what they say, and the row of the first record of the same gap.
    resumed_rows : shape (n,)
        Rows at which the recording went on after an interruption.
    """

    records: Records
    stated: list[tuple[int, Gap, int]]
    resumed_rows: IntArray

    @staticmethod
    def of(records: Records, gaps: list[tuple[int, Gap]], resumed_rows: IntArray) -> Losses:
        """Bring together gap records, given by row, of the same source, stream and time."""
        firsts: dict[tuple[int, str, int], int] = {}
        stated = []
        for row, gap in gaps:
            key = (gap.source, str(gap.fields.get(STREAM, "")), int(records.time_ns[row]))
            first = firsts.setdefault(key, row)
            stated.append((row, gap, first))
        return Losses(records, stated, resumed_rows)

    @property
    def gaps(self) -> list[Gap]:
        """Each gap once and as last stated."""
        return [gap for _, gap in self._last_stated]

    @property
    def _last_stated(self) -> list[tuple[int, Gap]]:
        """Gaps with the row of the first record of each; a repetition completes the first."""
        return list({first: (first, gap) for _, gap, first in self.stated}.values())

    def breaks(self, rows: IntArray, number: int) -> BoolArray:
        """Tell before which of a source's records something may be missing."""
        lost_before = self.records.sequence[rows].astype(np.int64) - rows
        breaks = np.zeros(len(rows), bool)
        breaks[1:] = np.diff(lost_before) > 0
        own = [
            row
            for row, gap, first in self.stated
            if gap.source in (number, TRIAL)
            and gap.fields.get("reason") not in LATE
            and (first == row or "until_s" not in gap.fields)
        ]
        causes = np.concatenate([np.array(own, np.int64), self.resumed_rows])
        after = np.searchsorted(rows, causes)
        breaks[after[(after > 0) & (after < len(rows))]] = True
        return breaks

    def causes(self, number: int, stream: str, duration_s: float) -> list[Cause]:
        """Return why packets of a stream may be missing, each with the arrival of bytes after it.

        A gap that names no stream is one of every stream of its source.
        """
        records = self.records
        rows = np.flatnonzero((records.kind == Kind.BYTES_IN) & (records.source == number))
        arrival_s = np.maximum.accumulate(records.time_ns[rows]) / NS_PER_S

        def after(row: int) -> float:
            index = int(np.searchsorted(rows, row))
            return float(arrival_s[index]) if index < len(rows) else np.inf

        causes = []
        for row, gap in self._last_stated:
            if gap.source == TRIAL and after(row) < np.inf:  # of any source
                causes.append(Cause(after(row), None, _reason(gap)))
            elif gap.source == number and gap.fields.get(STREAM, stream) == stream:
                until_s, back_s = gap.fields.get("until_s"), after(row)
                if isinstance(until_s, int | float) and 0 <= until_s <= duration_s:
                    back_s = until_s - ROUNDING_S
                causes.append(Cause(back_s, gap.t, _reason(gap)))
        for row in self.resumed_rows.tolist():
            since_s = int(records.time_ns[row]) / NS_PER_S
            causes.append(Cause(after(row), since_s, INTERRUPTED))
        lost_before = records.sequence[rows].astype(np.int64) - rows
        for index in np.flatnonzero(np.diff(lost_before, prepend=0) > 0).tolist():
            causes.append(Cause(float(arrival_s[index]), None, LOST_IN_FILE))
        return causes


def _reason(gap: Gap) -> str:
    """Return why, by the word that also stands for the same loss before the file is repaired."""
    reason = str(gap.fields.get("reason", "unknown"))
    return LOST_IN_FILE if reason == DAMAGE else reason


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
