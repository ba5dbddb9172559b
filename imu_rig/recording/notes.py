"""The records that a recorder writes about itself: clocks, statistics, end, resumption."""

from collections.abc import Collection, Mapping
from typing import Any

from imu_rig.clock import NS_PER_S
from imu_rig.errors import InputError
from imu_rig.recording.contents import Source
from imu_rig.recording.format import CLOCK_PAIR, RESUMED, TRIAL, Kind, encode_json
from imu_rig.recording.log import Count, Entry, RecordingOptions, RecordLog
from imu_rig.recording.reader import Trial

_WIRE_NAMES = {Kind.BYTES_IN: "in", Kind.BYTES_OUT: "out"}


def clock_pair(host_ns: int, wall_ns: int, origin_ns: int) -> Entry:
    """Return the record that ties trial time to the host's two clocks [ns]."""
    return Kind.CLOCK_PAIR, TRIAL, host_ns - origin_ns, CLOCK_PAIR.pack(host_ns, wall_ns)


def source_description(source: Source, time_ns: int = 0) -> Entry:
    """Return the record that describes a source."""
    value = {"name": source.name, "kind": source.kind, "descriptor": source.descriptor}
    payload = encode_json(value, f"The description of the source {source.name!r}")
    return Kind.SOURCE, source.id, time_ns, payload


def statistics(log: RecordLog, options: RecordingOptions, time_ns: int) -> Entry:
    """Return the record that tells how the recorder is doing."""
    peak_bytes, slowest_write_s, latency = log.take_peaks()
    try:
        free_bytes: int | None = options.file_system.free_bytes(log.path.parent)
    except OSError:
        free_bytes = None
    value = {
        **_totals(log),
        "synced_bytes": log.synced_offset,
        "queue_peak_bytes": peak_bytes,
        "slowest_write_s": slowest_write_s,
        "latency_p99_s": latency.p99_s if latency.records else None,
        "latency_max_s": latency.max_s if latency.records else None,
        "disk_free_bytes": free_bytes,
    }
    return Kind.STATISTICS, TRIAL, time_ns, encode_json(value, "The statistics")


def device_statistics(source: int, values: Mapping[str, Any], time_ns: int) -> Entry:
    """Return the record that tells how a device is doing."""
    return Kind.STATISTICS, source, time_ns, encode_json(dict(values), "The device's statistics")


def end(log: RecordLog, sources: Collection[Source], reason: str, time_ns: int) -> Entry:
    """Return the record that ends a trial; what the disk did outweighs ``reason``."""
    names = {source.id: source.name for source in sources}
    wires = wire_counts(log.counts, names)
    value = {"reason": log.end_reason or reason, **_totals(log), "sources": wires}
    return Kind.END, TRIAL, time_ns, encode_json(value, "The end")


def wire_counts(
    counts: Mapping[tuple[int, int], Count], names: Mapping[int, str]
) -> dict[str, dict[str, int]]:
    """Return what each source sent and was sent, by its name, as an end record states it."""
    wires: dict[str, dict[str, int]] = {}
    for kind, number in sorted(counts):
        if direction := _WIRE_NAMES.get(Kind(kind)):
            count = counts[kind, number]
            of_source = wires.setdefault(names.get(number, f"source-{number}"), {})
            of_source |= {f"records_{direction}": count.records, f"bytes_{direction}": count.bytes}
    return wires


def resumed(trial: Trial, now_ns: int) -> Entry:
    """Return the event that stands where a trial was continued."""
    fields = {
        "ended": trial.ended,
        "pause_s": (now_ns - int(trial.records.time_ns.max())) / NS_PER_S,
        "records_before": len(trial.records),
        "records_lost_before": trial.damage.records_lost,
        "bytes_cut": trial.damage.tail_bytes,
    }
    payload = encode_json({"name": RESUMED, "fields": fields}, "The event 'resumed'")
    return Kind.EVENT, TRIAL, now_ns, payload


LONGEST_NS = 100 * 365 * 86_400 * NS_PER_S
"""A time [ns] that no trial reaches."""


def time_after(trial: Trial, wall_ns: int) -> int:
    """Return the trial time [ns] at which a trial goes on at a wall clock time [ns]."""
    newest = int(trial.records.time_ns.max())
    if newest > LONGEST_NS:
        raise InputError(
            f"{trial.path} ends {newest / 1e9:.3g} s after its start, which no recording does: it "
            "is damaged and cannot be continued."
        )
    pairs = trial.clock_pairs
    if not len(pairs.t):
        return newest
    passed_ns = wall_ns - int(pairs.wall_ns[-1])
    later = round(float(pairs.t[-1]) * NS_PER_S) + passed_ns
    return max(newest, later if later < LONGEST_NS else newest)


def _totals(log: RecordLog) -> dict[str, int]:
    return {
        "records": log.sequence,
        "bytes": log.offset,
        "unwritten_records": log.unwritten,
    }
