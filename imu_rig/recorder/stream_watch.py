"""Watches one stream of a port: its state, its gaps and what the device says is wrong with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from firmware_protocols.packets import values
from firmware_protocols.rows import RowLayout
from imu_rig.clock import NS_PER_S
from imu_rig.devices.stream_device import StreamHealth
from imu_rig.packet_stream import PacketBlock
from imu_rig.recorder.status import DeviceState, DeviceStatus
from imu_rig.recording.format import SET_UP, SILENT, STREAM, STREAMS, UNPLUGGED, UNREADABLE

SILENT_S = 0.6  # without a byte, or five periods of a slow device: something is wrong
UNREADABLE_S = 0.7  # of bytes without a packet, likewise
PERIODS = 5

SUPPLY_WORDS = ("battery", "supply", "voltage")
MOST_STATED = 16  # interruptions by one conversation that are recorded
MOST_FAULTS = 64  # kept of what a device ever told

REASONS: dict[DeviceState, str] = {
    "lost": UNPLUGGED,
    "silent": SILENT,
    "garbled": UNREADABLE,
}

WORST_LAST: tuple[DeviceState, ...] = ("live", "waiting", "garbled", "silent", "lost")

STATISTICS = (
    "state",
    "rate_hz",
    "packets",
    "lost",
    "corrupt",
    "duplicates",
    "restarts",
    "reconnects",
    "gaps",
)
"""What of a status is recorded; with it the faults that there were."""


class KeptLog(Protocol):
    """Where a keeper writes down what it sees; a trial file, or nowhere."""

    def gap(self, source: int, t_ns: int, reason: str, **fields: Any) -> None:
        """Note that data are missing from a moment on; see `TrialWriter.gap`."""

    def device_statistics(self, source: int, values: Mapping[str, Any]) -> None:
        """Note how a device is doing; see `TrialWriter.device_statistics`."""

    def t_s(self, t_ns: int) -> float:
        """Return a time of the host clock [ns] as time of the trial [s]."""


@dataclass
class _Gap:
    """A stretch without packets: when its first is missing, and the counter before it."""

    start_ns: int
    reason: str
    counter: int | None
    restarts: int


class StreamWatch:
    """One stream of a port.

    Parameters
    ----------
    name : str
        Of the stream within its port; empty where there is one.
    device, port : str
        Name of the device, and its port for people.
    layout : RowLayout
    required : bool
        Whether the trial is worth nothing without it.
    log : KeptLog
    source : int
        Number of the device in the trial.
    notify : callable
        Takes a sentence for people.
    """

    def __init__(
        self,
        name: str,
        device: str,
        port: str,
        layout: RowLayout,
        *,
        required: bool,
        log: KeptLog,
        source: int,
        notify: Callable[[str], None],
    ) -> None:
        self.stream = name
        self.name = f"{device}/{name}" if name else device
        self._port, self._layout = port, layout
        self._log, self._source, self._notify = log, source, notify
        self.status = DeviceStatus(self.name, port, required=required)
        """How it does, as of the last look."""
        self.health = StreamHealth()
        self.heard = False
        """Whether a good packet ever came."""
        self.problem: str | None = None
        self._gap: _Gap | None = None
        self._gaps = 0
        self._talk_s: tuple[float, float] | None = None
        self._talked_s, self._talked_counter = np.empty(0), np.empty(0, np.int64)
        self._silenced = 0  # packets that a conversation kept the device from sending
        self._supply: tuple[tuple[str, float, str], ...] = ()
        self._fault_counts: dict[str, int] = {}
        period = 1.0 / layout.rate_hz if layout.rate_hz else 0.0
        self.silent_s = max(SILENT_S, PERIODS * period)
        self.unreadable_s = max(UNREADABLE_S, PERIODS * period)

    @property
    def in_gap(self) -> bool:
        """Whether its packets are missing now."""
        return self._gap is not None

    @property
    def gap_reason(self) -> str | None:
        """Why its packets are missing now."""
        return None if self._gap is None else self._gap.reason

    @property
    def fresh(self) -> bool:
        """Whether packets come."""
        return bool(self.health.good) and self.health.last_packet_age_s <= self.silent_s

    @property
    def going_on(self) -> bool:
        """Whether packets come beyond doubt, also when others fell silent a moment ago."""
        return self.fresh and self.health.last_packet_age_s <= self.silent_s / 2

    def take(self, block: PacketBlock | None, health: StreamHealth) -> bool:
        """Take what came since the last look; True if it was something."""
        self.health = health
        for fault in health.faults:
            if fault in self._fault_counts or len(self._fault_counts) < MOST_FAULTS:
                self._fault_counts[fault] = self._fault_counts.get(fault, 0) + 1
        if block is None or not len(block):
            return False
        self._leave_out_talk(block)
        self._supply = supply_of(self._layout, block)
        if not self.heard:
            self.heard = True
            self.problem = None
        if self._gap is not None and block.host_s[-1] * NS_PER_S > self._gap.start_ns:
            self._end_gap(self._gap, block)
        return True

    def talked(self, begin_s: float, end_s: float) -> None:
        """Note when the device was set up, which may have interrupted it: that is no loss."""
        self._talk_s = begin_s, end_s
        self._talked_s, self._talked_counter = self._talked_s[:0], self._talked_counter[:0]

    def _leave_out_talk(self, block: PacketBlock) -> None:
        if self._talk_s is None or block.counter is None:
            return
        begin_s, end_s = self._talk_s
        host_s = np.concatenate((self._talked_s, block.host_s))
        counter = np.concatenate((self._talked_counter, block.counter))
        steps = np.diff(counter)
        within = (steps > 1) & (host_s[:-1] >= begin_s) & (host_s[1:] <= end_s)
        self._silenced += int((steps[within] - 1).sum())
        for last in np.flatnonzero(within)[:MOST_STATED].tolist():
            interrupted = _Gap(int(host_s[last] * NS_PER_S), SET_UP, int(counter[last]), 0)
            until_s = self._log.t_s(int(host_s[last + 1] * NS_PER_S))
            after = int(counter[last + 1])
            self._record(interrupted, {"until_s": until_s, "counter_after": after})
        self._talked_s, self._talked_counter = host_s[-1:], counter[-1:]
        if host_s[-1] > end_s:
            self._talk_s = None

    def begin_gap(self, state: DeviceState, now_ns: int) -> None:
        """Note that its packets are missing, and why, as far as that is known now."""
        if self._gap is not None:  # was silent, and now its port has gone
            self._gap.reason = REASONS[state]
        else:
            last_ns = now_ns - int(self.health.last_packet_age_s * NS_PER_S)
            self._gap = _Gap(last_ns, REASONS[state], self.health.counter, self.health.restarts)
            self._gaps += 1
        self._record(self._gap, {})
        if self.heard:
            self._notify(self.problem or f"{self.name} is {state}.")
        self.show(state)

    def _end_gap(self, gap: _Gap, block: PacketBlock) -> None:
        fresh = block.host_s * NS_PER_S > gap.start_ns
        first = int(fresh.argmax())
        host_s = float(block.host_s[first])
        restarted = self.health.restarts > gap.restarts
        after = None if block.counter is None else int(block.counter[first])
        self._record(
            gap,
            {
                "until_s": self._log.t_s(int(host_s * NS_PER_S)),
                "counter_after": after,
                "restarted": restarted,
            },
        )
        seconds = host_s - gap.start_ns / NS_PER_S
        told = f"{self.name} is back after {seconds:.1f} s"
        if restarted:
            told += "; it has started anew"
        elif after is not None and gap.counter is not None and after > gap.counter:
            told += f"; {after - gap.counter - 1} packets are missing by its counter"
        self._notify(f"{told}.")
        self._gap, self.problem = None, None

    def _record(self, gap: _Gap, more: dict[str, object]) -> None:
        """Write the gap as far as it is known; a later record of it completes an earlier one."""
        known: dict[str, object] = {"counter_before": gap.counter, **more}
        if self.stream:
            known[STREAM] = self.stream
        self._log.gap(self._source, gap.start_ns, gap.reason, **known)

    def show(self, state: DeviceState) -> None:
        """Make the status that others see."""
        health = self.health
        self.status = DeviceStatus(
            self.name,
            self._port,
            state=state,
            required=self.status.required,
            rate_hz=health.rate_hz,
            packets=health.good,
            lost=max(0, health.lost - self._silenced),
            corrupt=health.corrupt,
            duplicates=health.duplicates,
            restarts=health.restarts,
            reconnects=health.reconnects,
            gaps=self._gaps,
            age_s=health.last_packet_age_s,
            lag_s=health.lag_s,
            stuck=health.stuck and state == "live",
            faults=health.faults if state == "live" else (),
            fault_counts=tuple(self._fault_counts.items()),
            supply=self._supply,
            problem=None if state == "live" else self.problem,
        )


def supply_of(layout: RowLayout, block: PacketBlock) -> tuple[tuple[str, float, str], ...]:
    """Return what the newest packet of a block says of battery or supply: name, value, unit."""
    return tuple(
        (field.name, float(values(layout, block.rows[-1:], field.name).flat[0]), field.unit)
        for field in layout.fields
        if field.name.startswith(SUPPLY_WORDS) and field.type != "pad"
    )


def statistics_of(status: DeviceStatus) -> dict[str, Any]:
    """Return what of a status is recorded, each of several streams under its name."""
    told: dict[str, Any] = {name: getattr(status, name) for name in STATISTICS}
    if status.fault_counts:
        told["faults"] = dict(status.fault_counts)
    if status.streams:
        first = len(status.name) + 1
        told[STREAMS] = {row.name[first:]: statistics_of(row) for row in status.streams}
    return told


def together(name: str, rows: tuple[DeviceStatus, ...], *, required: bool) -> DeviceStatus:
    """Return how a device does as a whole, by how its streams do."""
    if len(rows) == 1 and rows[0].name == name:
        return rows[0]
    worst = max(rows, key=lambda row: WORST_LAST.index(row.state))
    counts: dict[str, int] = {}
    for row in rows:
        for fault, count in row.fault_counts:
            counts[fault] = counts.get(fault, 0) + count
    problems = {row.problem for row in rows if row.problem}
    return DeviceStatus(
        name,
        worst.port,
        state=worst.state,
        required=required,
        rate_hz=sum(row.rate_hz for row in rows),
        packets=sum(row.packets for row in rows),
        lost=sum(row.lost for row in rows),
        corrupt=worst.corrupt,
        duplicates=sum(row.duplicates for row in rows),
        restarts=sum(row.restarts for row in rows),
        reconnects=worst.reconnects,
        gaps=sum(row.gaps for row in rows),
        age_s=max(row.age_s for row in rows),
        lag_s=max(row.lag_s for row in rows),
        stuck=any(row.stuck for row in rows),
        faults=tuple(dict.fromkeys(fault for row in rows for fault in row.faults)),
        fault_counts=tuple(counts.items()),
        supply=next((row.supply for row in rows if row.supply), ()),
        problem=worst.problem if len(problems) != 1 else problems.pop(),
        streams=rows,
    )
