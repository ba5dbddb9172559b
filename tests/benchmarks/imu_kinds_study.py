"""How well each kind of IMU is calibrated on the jig, and what its counts cost.

Whole sessions with known truth, each kind with its own noise, errors and counts; beside them the
same sensors with readings that are not rounded, and with so little noise that counts are all that
is seen of gravity::

    python tests/benchmarks/imu_kinds_study.py --sessions 10
    python tests/benchmarks/imu_kinds_study.py --kinds adis16405,mavlink-scaled --json kinds.json

A figure is the root mean square error over axes and sessions, in brackets the root mean square of
the stated standard uncertainties. What the filters of a device's firmware do to its noise is left
out; see `simulators.quick_session`.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from calibration_study import GROUPS, PROCESSES, Score, designed, run, score, session_of, table
from calibration_study import with_sensor as changed

from imu_rig.units import DEG, MILLI_G
from simulators.imu_kinds import DEFAULT_KIND, IMU_KINDS
from simulators.inertial_sensor import SensorRange

SHOWN = ("accel scale", "accel non-orth", "accel bias", "gyro scale", "gyro cross", "gyro bias")

ROUNDED, UNROUNDED, HUSHED = "", "not rounded", "a twentieth of the noise"
HUSH = 0.05

Task = tuple[str, int, str, str]


def job(task: Task) -> tuple[Task, Score]:
    """Solve one session of a kind in one of its variants."""
    kind, seed, protocol, variant = task
    config = designed(seed, imu=kind)
    if variant == UNROUNDED:
        config = changed(config, quantized=False)
    if variant == HUSHED:
        sensor = config.sensor
        config = changed(
            config,
            accel_noise_ug=HUSH * sensor.accel_noise_ug,
            gyro_noise_dps=HUSH * sensor.gyro_noise_dps,
        )
    return task, score(session_of(config, protocol), "joint")


def variants(kind: str) -> tuple[str, ...]:
    """Return what there is to try of a kind: readings without counts cannot be unrounded."""
    ranges = IMU_KINDS[kind].ranges
    counted = any(part is not None and part.count > 0 for part in (ranges.accel, ranges.gyro))
    return (ROUNDED, UNROUNDED, HUSHED) if counted else (ROUNDED,)


def figures(scores: list[Score], group: str) -> tuple[float, float] | None:
    """Return root mean square error and stated standard uncertainty; None where none is known."""
    error = np.array([e for s in scores for e in s.error.get(group, [])])
    sigma = np.array([e for s in scores for e in s.sigma.get(group, [])])
    if not error.size:
        return None
    return float(np.sqrt(np.mean(error**2))), float(np.sqrt(np.mean(sigma**2)))


def cost(rounded: list[Score], unrounded: list[Score], group: str) -> float | None:
    """Return how much larger the stated uncertainty is for the counts [%]."""
    with_counts, without = figures(rounded, group), figures(unrounded, group)
    if with_counts is None or without is None:
        return None
    return 100.0 * (with_counts[1] / without[1] - 1.0)


def _cell(pair: tuple[float, float] | None) -> str:
    return "-" if pair is None else f"{pair[0]:.3g} ({pair[1]:.3g})"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:+.0f} %"


def _count(part: SensorRange | None, unit: float) -> str:
    return "-" if part is None else f"{part.count / unit:.3g}"


def study(kinds: list[str], seeds: range, protocol: str, processes: int) -> dict[str, Any]:
    """Run the sessions, print the tables, and return every figure."""
    tasks: list[Task] = [
        (kind, seed, protocol, variant)
        for kind in kinds
        for variant in variants(kind)
        for seed in seeds
    ]
    results = run(job, tasks, processes)
    of: dict[tuple[str, str], list[Score]] = {}
    for (kind, _, _, variant), scored in results:
        of.setdefault((kind, variant), []).append(scored)
    names = {key: ", ".join(filter(None, key)) for key in of}
    table(
        f"{len(seeds)} sessions each: rms error (rms stated standard uncertainty)",
        ["", *(f"{group} [{GROUPS[group]}]" for group in SHOWN), "refused"],
        [
            [
                names[key],
                *(_cell(figures(scores, group)) for group in SHOWN),
                str(sum(bool(s.refused) for s in scores)),
            ]
            for key, scores in of.items()
        ],
    )
    table(
        "what the counts cost: growth of the stated standard uncertainties",
        ["", "count [mg]", "count [deg/s]", *SHOWN],
        [
            [
                kind,
                _count(IMU_KINDS[kind].ranges.accel, MILLI_G),
                _count(IMU_KINDS[kind].ranges.gyro, DEG),
                *(_percent(cost(of[kind, ROUNDED], of[kind, UNROUNDED], group)) for group in SHOWN),
            ]
            for kind in kinds
            if UNROUNDED in variants(kind)
        ],
    )
    for key, scores in of.items():
        for sentence in sorted({s.refused for s in scores if s.refused}):
            print(f"{names[key]} was refused: {sentence}")
    return {
        names[key]: {group: figures(scores, group) for group in SHOWN} for key, scores in of.items()
    }


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sessions", type=int, default=10, help="of each kind")
    parser.add_argument("--seed", type=int, default=1000, help="of the first session")
    parser.add_argument("--kinds", default="", help="with commas between; all by default")
    parser.add_argument("--protocol", default="full", help="a built-in protocol")
    parser.add_argument("--processes", type=int, default=PROCESSES)
    parser.add_argument("--json", type=Path, help="where to write every figure")
    arguments = parser.parse_args()
    kinds = [kind for kind in arguments.kinds.split(",") if kind] or list(IMU_KINDS)
    kinds.sort(key=lambda kind: kind != DEFAULT_KIND)
    seeds = range(arguments.seed, arguments.seed + arguments.sessions)
    found = study(kinds, seeds, arguments.protocol, arguments.processes)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(found, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
