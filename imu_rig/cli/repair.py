"""`imu-rig repair`: save what is sound in a damaged trial file to a new one."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imu_rig.cli.options import Json, Quiet

if TYPE_CHECKING:
    from imu_rig.recording.repair import Repair

LARGEST_DECODED_BYTES = 64 << 20  # of a file whose packets are looked at to tell what is lost


def repair(
    file: Annotated[Path, typer.Argument(help="A trial file; it is never altered.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Name of the new file instead of NAME.repaired.imu-trial."
        ),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Save what is sound in a damaged trial file to a new file beside it."""
    from imu_rig.cli.working import Working
    from imu_rig.recording.repair import repair_trial

    if quiet:
        outcome = repair_trial(file, output)
    else:
        with Working("looking for sound records") as working:
            outcome = repair_trial(
                file, output, progress=lambda what, share: working.now(f"{what}, {share:.0%}")
            )
    packets = _packets_lost(outcome)
    if as_json:
        sys.stdout.write(json.dumps(_facts(outcome, packets), allow_nan=False) + "\n")
        return
    for line in _lines(outcome, packets):
        sys.stdout.write(line + "\n")


def _packets_lost(outcome: Repair) -> dict[str, int]:
    """How many packets the numbers of each source's streams say were lost with the damage."""
    from imu_rig.errors import InputError
    from imu_rig.recording.missing import LOST_IN_FILE
    from imu_rig.recording.reader import open_trial

    if outcome.target is None or outcome.target.stat().st_size > LARGEST_DECODED_BYTES:
        return {}
    trial = open_trial(outcome.target)
    lost: dict[str, int] = {}
    for name in trial.sensors:
        try:
            missing = trial.missing(name)
        except InputError:  # a layout that cannot be read is no reason not to repair
            continue
        source = trial.source(name).name
        damaged = [part.samples or 0 for part in missing if part.reason == LOST_IN_FILE]
        lost[source] = lost.get(source, 0) + sum(damaged)
    return lost


def _facts(outcome: Repair, packets: dict[str, int]) -> dict[str, Any]:
    damage = outcome.damage
    return {
        "file": str(outcome.path),
        "repaired": None if outcome.target is None else str(outcome.target),
        "written": outcome.written,
        "ended": outcome.ended,
        "records_kept": outcome.records,
        "records_lost": damage.records_lost,
        "records_repeated": damage.records_repeated,
        "records_reordered": damage.records_reordered,
        "bytes_dropped": outcome.bytes_dropped,
        "duration_s": outcome.duration_s,
        "lost_s": outcome.lost_s,
        "header_damaged": damage.header_damaged,
        "sources": {
            source.name: {
                "records_kept": source.records,
                "bytes_kept": source.bytes,
                "records_lost": source.lost_records,
                "bytes_lost": source.lost_bytes,
                "packets_lost": packets.get(source.name),
            }
            for source in outcome.sources
        },
    }


def _lines(outcome: Repair, packets: dict[str, int]) -> list[str]:
    from imu_rig.foreign_text import one_line, printable

    damage = outcome.damage
    path = printable(str(outcome.path))
    if outcome.target is None:
        return [
            f"{path}: nothing to repair: {_counted(outcome.records, 'record')}, "
            f"{outcome.duration_s:.2f} s, ended: {one_line(str(outcome.ended))}."
        ]
    lines = [
        f"{path}: {damage}" if damage else f"{path}: no damage",
        f"  kept  {_counted(outcome.records, 'record')}, to {outcome.duration_s:.2f} s",
    ]
    if damage.records_lost:
        lost = _counted(damage.records_lost, "record")
        lines.append(f"  lost  {lost}, within {outcome.lost_s:.2f} s in all")
    else:
        lines.append("  lost  no record that was followed by another")
    if outcome.ended is None:
        lines.append("  end   none: the recorder was killed or lost power; given one: interrupted")
    for source in outcome.sources:
        line = f"    {one_line(source.name)}: {_counted(source.records, 'record')} kept"
        if source.lost_records is not None:
            line += f", {source.lost_records} lost"
        if source.name in packets:
            line += f"; by its own numbers {_counted(packets[source.name], 'packet')} lost"
        lines.append(line)
    target = printable(str(outcome.target))
    lines.append(
        f"written to {target}"
        if outcome.written
        else f"nothing written: {target} holds exactly this already"
    )
    return lines


def _counted(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
