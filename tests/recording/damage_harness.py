"""Damage a trial in every way a disk can, and compare each decoded row with the one recorded.

``python tests/recording/damage_harness.py`` prints the figures of the full size and ends with 1 if
any row is wrong, or more is lost than the damage took.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from firmware_protocols.layout import load_layout
from imu_rig.clock import SteppedClock
from imu_rig.recording import RecordingOptions, Trial, TrialWriter, open_trial
from simulators.device_packets import DevicePackets

PAGE = 4096
RATE_HZ = 100.0
DESCRIBED_BYTES = 12_000  # where the early flips go: header, configuration, descriptions
LARGEST_SHIFT_S = 0.001
NOTES = RecordingOptions(note_s=3600.0, sync_s=3600.0)
LAYOUTS = {"left": "mpu9150-28", "right": "mpu9150-28", "height": "baro-16"}

Rows = dict[str, dict[int, tuple[bytes, float]]]
"""Rows by source and packet counter: all values as bytes, and the time [s].

The counter is unwrapped from the first packet found, so the start of a trial must survive."""


def write_trial(path: Path, seconds: float, seed: int = 3) -> None:
    """Record two inertial sensors and a barometer, in pieces as ports deliver them."""
    chosen = random.Random(seed)
    clock = SteppedClock()
    with TrialWriter.create(path, {"kind": "trial"}, clock=clock, options=NOTES) as trial:
        ports = []
        for name, layout_name in LAYOUTS.items():
            layout = load_layout(layout_name)
            source = trial.add_source(name, "device", {"layout": layout.to_dict()})
            ports.append((source, DevicePackets(layout, RATE_HZ, seed + source), bytearray()))
        for number in range(round(seconds * RATE_HZ)):
            clock.advance(1 / RATE_HZ)
            for source, packets, waiting in ports:
                waiting += packets.make(number, 1)
                taken = chosen.choice([len(waiting)] * 4 + [len(waiting) // 2])
                trial.bytes_in(source, clock.now_ns() + source, bytes(waiting[:taken]))
                del waiting[:taken]
            if number % 100 == 50:
                trial.event("marker", label=f"step {number}")


def rows_of(trial: Trial) -> Rows:
    found: Rows = {}
    for name in LAYOUTS:
        if name not in trial.sensors:
            found[name] = {}
            continue
        samples = trial.samples(name)
        columns = [np.asarray(v, float).reshape(len(samples), -1) for v in samples.values.values()]
        values = np.hstack([*columns, np.asarray(samples.device_s)[:, np.newaxis]])
        found[name] = {
            int(counter): (row.tobytes(), float(t))
            for counter, row, t in zip(samples.counter, values, samples.t, strict=True)
        }
    return found


@dataclass
class Figures:
    """What happened to the trials of one kind of damage."""

    trials: int = 0
    rows: int = 0
    wrong_rows: int = 0
    most_records_lost: int = 0
    most_rows_lost: int = 0
    most_shifted_s: float = 0.0  # times come from a fit, to which lost rows contribute no more
    unnoticed: int = 0
    problems: list[str] = field(default_factory=list)

    def compare(self, trial: Trial, truth: Rows, records: int, what: str) -> None:
        """Count the rows that are wrong and those that are gone."""
        found = rows_of(trial)
        right = wrong = 0
        for name, rows in found.items():
            for counter, (row, t) in rows.items():
                true_row, true_t = truth[name].get(counter, (b"", 0.0))
                if row == true_row:
                    right += 1
                    self.most_shifted_s = max(self.most_shifted_s, abs(t - true_t))
                else:
                    wrong += 1
        self.trials += 1
        self.rows += right
        self.wrong_rows += wrong
        self.most_records_lost = max(self.most_records_lost, records - len(trial.records))
        self.most_rows_lost = max(self.most_rows_lost, sum(map(len, truth.values())) - right)
        if wrong:
            self.problems.append(f"{what}: {wrong} wrong rows")


class Damager:
    """A sound trial and ways to damage it."""

    def __init__(self, folder: Path, seconds: float) -> None:
        sound = folder / "sound.imu-trial"
        write_trial(sound, seconds)
        self.content = sound.read_bytes()
        self.path = folder / "damaged.imu-trial"
        trial = open_trial(sound)
        self.records = trial.records
        self.truth = rows_of(trial)
        self.count = sum(map(len, self.truth.values()))

    def opened(self, content: bytes | bytearray) -> Trial:
        self.path.write_bytes(content)
        return open_trial(self.path)

    def flips(self, count: int, seed: int = 1) -> Figures:
        """One flipped bit each: at most one record lost, none wrong, always noticed."""
        chosen = random.Random(seed)
        figures = Figures()
        for number in range(count):
            size = DESCRIBED_BYTES if number % 4 == 0 else len(self.content)
            place = chosen.randrange(8 * size)
            content = bytearray(self.content)
            content[place // 8] ^= 1 << place % 8
            trial = self.opened(content)
            figures.compare(trial, self.truth, len(self.records), f"bit {place}")
            figures.unnoticed += not trial.damage
            if len(self.records) - len(trial.records) > 1:
                figures.problems.append(f"bit {place}: more than one record lost")
        if figures.unnoticed:
            figures.problems.append(f"{figures.unnoticed} flipped bits went unnoticed")
        return figures

    def cuts(self, count: int, step: int = 1) -> Figures:
        """A cut at every byte, or each ``step``, of the end: all records before it are kept.

        The rows follow from the records alone, so they are compared where those change.
        """
        figures = Figures()
        self.path.write_bytes(self.content)
        ends = self.records.end
        compared = -1
        for size in range(len(self.content) - 1, len(self.content) - count - 1, -step):
            os.truncate(self.path, size)
            trial = open_trial(self.path)
            kept = int((ends <= size).sum())
            self._require_prefix(trial, kept, f"cut at {size}", figures)
            if kept != compared:
                figures.compare(trial, self.truth, kept, f"cut at {size}")
                compared = kept
            else:
                figures.trials += 1
        return figures

    def zero_tails(self, lengths: Iterator[int] | range) -> Figures:
        """Zeros instead of the last bytes: all records before them are kept."""
        figures = Figures()
        for length in lengths:
            size = len(self.content) - length
            trial = self.opened(self.content[:size] + bytes(length))
            kept = int((self.records.end <= size).sum())
            self._require_prefix(trial, kept, f"{length} zeros", figures)
            figures.compare(trial, self.truth, kept, f"{length} zeros")
        return figures

    def mixed_pages(self, count: int, pages: int, seed: int = 2) -> Figures:
        """The last pages in another order, or older ones in their place."""
        chosen = random.Random(seed)
        figures = Figures()
        whole = [self.content[at : at + PAGE] for at in range(0, len(self.content), PAGE)]
        first = len(whole) - pages
        before = int((self.records.end <= first * PAGE).sum())
        for number in range(count):
            tail = whole[first:]
            if number % 2:
                tail = [chosen.choice([page, bytes(PAGE), chosen.choice(whole)]) for page in tail]
            else:
                chosen.shuffle(tail)
            trial = self.opened(b"".join(whole[:first] + tail))
            same = trial.records.sequence[:before].tolist() == list(range(before))
            if not same:
                figures.problems.append(f"mix {number}: not all before the pages is kept")
            figures.compare(trial, self.truth, before, f"mix {number}")
        return figures

    def _require_prefix(self, trial: Trial, kept: int, what: str, figures: Figures) -> None:
        found = trial.records
        same = (
            len(found) == kept
            and np.array_equal(found.offset, self.records.offset[:kept])
            and np.array_equal(found.sequence, self.records.sequence[:kept])
        )
        if not same:
            figures.problems.append(f"{what}: {len(found)} records instead of {kept}")


def damage(folder: Path, arguments: argparse.Namespace) -> dict[str, Figures]:
    damager = Damager(folder, arguments.seconds)
    if len(damager.content) < arguments.cut_bytes + DESCRIBED_BYTES:
        raise ValueError(f"a trial of {len(damager.content)} bytes is too short for these cuts")
    pages = min(16, len(damager.content) // PAGE - 3)
    return {
        "flipped bits": damager.flips(arguments.flips),
        "cuts": damager.cuts(arguments.cut_bytes, arguments.cut_step),
        "zero-filled tails": damager.zero_tails(range(1, arguments.cut_bytes, arguments.zero_step)),
        "mixed pages": damager.mixed_pages(arguments.mixes, pages),
    }


def problems_of(figures: Figures) -> list[str]:
    shifted = figures.most_shifted_s
    far = [f"rows moved by {shifted:.4f} s"] if shifted > LARGEST_SHIFT_S else []
    return figures.problems + far


def parser() -> argparse.ArgumentParser:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seconds", type=float, default=7.0)
    options.add_argument("--flips", type=int, default=1000)
    options.add_argument("--cut-bytes", type=int, default=1 << 16)
    options.add_argument("--cut-step", type=int, default=1)
    options.add_argument("--zero-step", type=int, default=61)
    options.add_argument("--mixes", type=int, default=1000)
    return options


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        found = damage(Path(folder), parser().parse_args())
    for what, figures in found.items():
        told = {key: value for key, value in vars(figures).items() if key != "problems"}
        print(json.dumps({"damage": what, **told, "bad": len(problems_of(figures))}))
        for problem in problems_of(figures)[:20]:
            print(f"{what}: {problem}", file=sys.stderr)
    return 1 if any(map(problems_of, found.values())) else 0


if __name__ == "__main__":
    sys.exit(main())
