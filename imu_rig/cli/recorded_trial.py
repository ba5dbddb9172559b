"""What a recorded trial holds, for `imu-rig info`: who, when, every device, what is missing."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from imu_rig.cli.words import clock, counted, losses, size, uncertainty
from imu_rig.clock import utc_text
from imu_rig.errors import InputError
from imu_rig.foreign_text import one_line, wrapped
from imu_rig.recording.format import SET_UP, TRIAL_KIND

if TYPE_CHECKING:
    from imu_rig.recording.reader import Trial

WORDS = ("subject", "session", "trial", "note")
MOST_MISSING = 6  # stretches told of each device, the longest
MOST_MARKERS = 12
MOST_NOTES = 12
COUNTED = ("corrupt", "duplicates", "restarts", "reconnects")
WIDTH = 80
LABEL_WIDTH = 10
NAME_WIDTH = 22


def is_recorded(trial: Trial) -> bool:
    """Whether a trial was made by `imu-rig record`."""
    return trial.config.get("kind") == TRIAL_KIND


def recorded_facts(trial: Trial) -> dict[str, Any]:
    """Return what there is to tell as plain JSON values; nothing is shortened."""
    from imu_rig.cli.working import Working

    with Working("Reading every packet") as working:
        devices = {}
        for name in _names(trial):
            working.now(f"Reading every packet of {one_line(name, 40)}")
            devices[name] = _device(trial, name)
    config, start = trial.config, trial.utc()
    return {
        **{word: text for word in WORDS if isinstance(text := config.get(word), str) and text},
        "start_utc": None if start is None else utc_text(start, "milliseconds"),
        "duration_s": trial.duration_s,
        "file_bytes": trial.path.stat().st_size,
        "recorded_by": f"imu-rig {config.get('imu_rig', '')}".strip(),
        "origin": _origin(config.get("origin")),
        "devices": devices,
        "markers": [{"t_s": m.t, "label": m.label} for m in trial.markers],
    }


def _names(trial: Trial) -> list[str]:
    """Names of all sources, in the place of one with several streams those of its sensors."""
    sensors = trial.sensors
    return [
        name
        for source in trial.sources
        for name in [s for s in sensors if trial.source(s).name == source] or [source]
    ]


def _device(trial: Trial, name: str) -> dict[str, Any]:
    source = trial.source(name)
    described = source.descriptor
    facts: dict[str, Any] = {"kind": source.kind, "port": described.get("url")}
    if name not in trial.sensors:
        facts["bytes"] = len(trial.wire(name).data)
        return facts
    if source.name in trial.renamed:
        facts["recorded_as"] = trial.renamed[source.name]
    layout = described["layout"]
    facts["layout"] = layout.get("name") if isinstance(layout, dict) else None
    facts["required"] = described.get("required", True)
    try:
        facts["certificate"] = _certificate(trial.kept_certificate(name))
        samples, missing = trial.samples(name), trial.missing(name)
    except InputError as error:
        return {**facts, "problem": str(error)}
    count = len(samples.t)
    span = float(samples.t[-1] - samples.t[0]) if count > 1 else 0.0
    gone = sum(m.samples or 0 for m in missing)
    lost = gone - sum(m.samples or 0 for m in missing if m.reason == SET_UP)
    facts |= {
        "packets": count,
        "first_s": float(samples.t[0]) if count else None,
        "last_s": float(samples.t[-1]) if count else None,
        # what it makes: packets that are missing took their time all the same
        "rate_hz": (count - 1 + gone) / span if span > 0 else None,
        "lost": lost,
        "loss": lost / (count + lost) if count else 0.0,
    }
    statistics = trial.device_statistics(name)
    if statistics:
        last = statistics[-1][1]
        facts |= {key: last.get(key) for key in COUNTED}
        faults = last.get("faults")
        facts["faults"] = [str(fault) for fault in faults] if isinstance(faults, dict) else []
    facts["imported"] = trial.imported(name)
    uncertainty = trial.time_uncertainty_s(name) if count else math.nan
    facts["time_uncertainty_s"] = uncertainty if math.isfinite(uncertainty) else None
    facts["time_problem"] = trial.time_problem(name)
    facts["missing"] = [
        {"start_s": m.start_s, "stop_s": m.stop_s, "samples": m.samples, "reason": m.reason}
        for m in missing
    ]
    return facts


def _origin(kept: Any) -> dict[str, Any] | None:
    """Tell where an imported trial is from; anything may stand in its file."""
    if not isinstance(kept, dict):
        return None
    lists = {key: v for key in ("files", "notes") if isinstance(v := kept.get(key), list)}
    return {
        "format": str(kept.get("format", "")),
        "files": [str(f.get("name", "")) for f in lists.get("files", []) if isinstance(f, dict)],
        "notes": [str(note) for note in lists.get("notes", [])],
    }


def _certificate(kept: Any) -> str | None:
    """Name a certificate by what it says of its sensor."""
    if not isinstance(kept, dict):
        return None
    device = kept.get("device")
    words = (
        [str(device.get(key, "")) for key in ("name", "serial")] if isinstance(device, dict) else []
    )
    return " ".join(word for word in words if word) or "unnamed"


def recorded_lines(facts: dict[str, Any]) -> list[str]:
    """Lines that tell the facts to a person; long lists are shortened, and say so."""
    devices: dict[str, dict[str, Any]] = facts["devices"]
    markers = facts["markers"]
    start = (facts["start_utc"] or "unknown").replace("T", " ").replace("Z", " UTC")
    lines = _row("started", start)
    origin = facts["origin"]
    if origin is not None:
        lines += _row("imported", f"{', '.join(origin['files'])} ({origin['format']})")
    count = counted(len(markers), "marker")
    lines += _row("length", f"{clock(facts['duration_s'])}, {size(facts['file_bytes'])}, {count}")
    for word in WORDS:
        if word in facts:
            lines += _row(word, facts[word])
    if any(device.get("imported") for device in devices.values()):
        lines += _row("times", "as in the file they were imported from; nobody knows how sure")
    for note in [] if origin is None else origin["notes"][:MOST_NOTES]:
        lines += _row("note", note)
    lines += ["", *_table(devices)]
    for name, device in devices.items():
        lines += _missing(name, device.get("missing", []))
    if markers:
        lines += ["", "markers"]
        lines += [
            f"  {m['t_s']:12.3f} s  {one_line(m['label'], 50)}".rstrip()
            for m in markers[:MOST_MARKERS]
        ]
        lines += _more(len(markers) - MOST_MARKERS)
    return lines


def _row(label: str, text: str) -> list[str]:
    first, *rest = wrapped(text, WIDTH - LABEL_WIDTH) or [""]
    return [f"{label:{LABEL_WIDTH}}{first}", *(" " * LABEL_WIDTH + line for line in rest)]


def _table(devices: dict[str, dict[str, Any]]) -> list[str]:
    names = {name: one_line(name, NAME_WIDTH) for name in devices}
    width = max([6, *map(len, names.values())])
    head = ("packets", "Hz", "lost", "corrupt", "reopened", "time")
    widths = (9, 8, 16, 8, 9, 10)
    lines = [
        f"{'device':{width}}" + "".join(f"{h:>{w}}" for h, w in zip(head, widths, strict=True))
    ]
    for name, device in devices.items():
        if "problem" in device:
            lines += wrapped(device["problem"], WIDTH)
            continue
        if "packets" not in device:
            lines.append(
                f"{names[name]:{width}}  {one_line(device['kind'], 20)}, {device['bytes']} bytes"
            )
            continue
        rate = device["rate_hz"]
        cells = (
            str(device["packets"]),
            f"{rate:.2f}" if rate else "–",
            losses(device["lost"], device["loss"]),
            _count(device.get("corrupt")),
            _count(device.get("reconnects")),
            uncertainty(device["time_uncertainty_s"]),
        )
        lines.append(
            f"{names[name]:{width}}"
            + "".join(f"{c:>{w}}" for c, w in zip(cells, widths, strict=True))
        )
    for name, device in devices.items():
        if device.get("time_problem") is not None:
            lines += wrapped(f"{name}: {device['time_problem']}.", WIDTH)
    for name, device in devices.items():
        if device.get("faults"):
            faults = ", ".join(one_line(fault, 60) for fault in device["faults"])
            lines += wrapped(f"{name} reported: {faults}.", WIDTH)
    for name, device in devices.items():
        if "recorded_as" in device:
            was = one_line(device["recorded_as"], 60)
            lines += wrapped(
                f"{name} was recorded as {was!r}, the name of another's stream.", WIDTH
            )
    certified = {n: d["certificate"] for n, d in devices.items() if d.get("certificate")}
    for name, sensor in certified.items():
        lines += wrapped(f"{name} has the certificate of {sensor}.", WIDTH)
    return lines


def _count(value: Any) -> str:
    return str(value) if isinstance(value, int) else "–"


def _missing(name: str, missing: list[dict[str, Any]]) -> list[str]:
    """Tell the longest stretches without a device, in the order of time."""
    if not missing:
        return []
    longest = sorted(missing, key=lambda m: m["start_s"] - m["stop_s"])[:MOST_MISSING]
    of_all = f"{len(missing)} times" if len(missing) > 1 else "once"
    few = f"; the {MOST_MISSING} longest:" if len(missing) > MOST_MISSING else ""
    lines = ["", f"{one_line(name, 40)} was missing {of_all}{few}"]
    for m in sorted(longest, key=lambda m: m["start_s"]):
        samples = "" if m["samples"] is None else f"  {counted(m['samples'], 'sample')}"
        lines.append(
            f"  {m['start_s']:12.3f} s to {m['stop_s']:.3f} s{samples}  {one_line(m['reason'], 40)}"
        )
    return [*lines, *_more(len(missing) - MOST_MISSING)]


def _more(count: int) -> list[str]:
    return [f"  ... and {count} more; --json lists all"] if count > 0 else []
