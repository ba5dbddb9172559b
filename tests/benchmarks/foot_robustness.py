"""The default foot smoother on public recordings made worse: rates, noise, biases, losses, cuts.

    python tests/benchmarks/foot_robustness.py          # folder from IMU_RIG_DATA
    python tests/benchmarks/foot_robustness.py rate     # only those with "rate" in their name

Every recording is changed in one way at a time, and its answer compared with the same truth. What
is refused is named. Nothing here chose a parameter.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from foot_recordings import Recordings, read_recordings
from gait_reference import mocap_lengths

from imu_rig.blocks import ImuBlock
from imu_rig.errors import DataError
from imu_rig.gait.options import FootOptions
from imu_rig.gait.smoother import smooth_foot
from imu_rig.gait.start import level_attitude
from imu_rig.gait.strides import gait_parameters
from imu_rig.reference.alignment import align
from imu_rig.reference.footprints import compare_footprints
from imu_rig.reference.reference import Reference
from imu_rig.rotation import rotate
from imu_rig.units import DEG, STANDARD_GRAVITY

Change = Callable[[ImuBlock, np.random.Generator], ImuBlock]
JOIN_S = 0.005


def slower(rate: float, *, mean: bool) -> Change:
    """Return what leaves so many samples per second, each a mean of those it stands for or not."""

    def change(block: ImuBlock, random: np.random.Generator) -> ImuBlock:
        every = round(1.0 / (rate * float(np.median(np.diff(block.t)))))
        if every < 2:
            return block
        if not mean:
            return block[::every]
        rows = len(block) // every * every
        t = block.t[:rows].reshape(-1, every).mean(axis=1)
        accel, gyro = (
            values[:rows].reshape(-1, every, 3).mean(axis=1) for values in (block.accel, block.gyro)
        )
        return ImuBlock(t, accel, gyro, t)

    return change


def noisy(rate: float, force: float) -> Change:
    """Return what adds white noise [rad/s, m/s^2]."""
    return lambda block, random: replace(
        block,
        gyro=block.gyro + rate * random.standard_normal(block.gyro.shape),
        accel=block.accel + force * random.standard_normal(block.accel.shape),
    )


def biased(rate: float, force: float) -> Change:
    """Return what adds a bias along every axis, signs by chance [rad/s, m/s^2]."""

    def change(block: ImuBlock, random: np.random.Generator) -> ImuBlock:
        signs = random.choice((-1.0, 1.0), (2, 3))
        gyro, accel = block.gyro + rate * signs[0], block.accel + force * signs[1]
        return replace(block, gyro=gyro, accel=accel)

    return change


def scaled(gyro: float, accel: float = 0.0) -> Change:
    """Return what multiplies readings by a little more than 1."""
    return lambda block, _: replace(
        block, gyro=block.gyro * (1.0 + gyro), accel=block.accel * (1.0 + accel)
    )


def clipped(accel: float = np.inf, gyro: float = np.inf) -> Change:
    """Return what ends the ranges of the axes there [m/s^2, rad/s]."""
    return lambda block, _: replace(
        block, gyro=np.clip(block.gyro, -gyro, gyro), accel=np.clip(block.accel, -accel, accel)
    )


def mounted(block: ImuBlock, random: np.random.Generator) -> ImuBlock:
    """Turn the sensor on the foot any way."""
    q = random.standard_normal(4)
    q /= np.linalg.norm(q)
    return replace(block, gyro=rotate(q, block.gyro), accel=rotate(q, block.accel))


def cut(begin: float, end: float) -> Change:
    """Return what leaves out up to so many seconds at the begin and at the end, by chance."""

    def change(block: ImuBlock, random: np.random.Generator) -> ImuBlock:
        first = block.t[0] + begin * random.uniform(0.2, 1.0)
        last = block.t[-1] - end * random.uniform(0.2, 1.0)
        return block[(block.t >= first) & (block.t <= last)]

    return change


def shorter(begin: float, end: float) -> Change:
    """Return what leaves out so many seconds at the begin and at the end."""
    return lambda block, _: block[(block.t >= block.t[0] + begin) & (block.t <= block.t[-1] - end)]


def lossy(share: float) -> Change:
    """Return what loses samples by chance."""
    return lambda block, random: block[random.random(len(block)) >= share]


def jittery(seconds: float) -> Change:
    """Return what gives samples times that are off by chance, in order all the same."""
    return lambda block, random: replace(
        block, t=np.maximum.accumulate(block.t + seconds * random.standard_normal(len(block)))
    )


def late(seconds: float) -> Change:
    """Return what adds so many seconds to the times."""
    return lambda block, _: replace(block, t=block.t + seconds)


def single(block: ImuBlock, _: np.random.Generator) -> ImuBlock:
    """Round to single precision, times since the begin."""
    t = block.t - block.t[0]
    rounded = [x.astype(np.float32).astype(float) for x in (t, block.accel, block.gyro)]
    return replace(block, t=rounded[0] + block.t[0], accel=rounded[1], gyro=rounded[2])


@dataclass(frozen=True)
class Kind:
    """A change, how often it is drawn, whether strides are lost by it, and a shift of time [s]."""

    change: Change
    draws: int = 1
    shortens: bool = False
    shift_s: float = 0.0


G = STANDARD_GRAVITY
KINDS = {
    "as recorded": Kind(lambda block, _: block),
    "rate 100 Hz, means": Kind(slower(100.0, mean=True)),
    "rate 50 Hz, means": Kind(slower(50.0, mean=True)),
    "rate 100 Hz, every other": Kind(slower(100.0, mean=False)),
    "rate 50 Hz, every fourth": Kind(slower(50.0, mean=False)),
    "noise 1 deg/s, .1 m/s2": Kind(noisy(1.0 * DEG, 0.1), 2),
    "bias 1 deg/s, .1 m/s2": Kind(biased(1.0 * DEG, 0.1), 3),
    "bias 5 deg/s, .1 m/s2": Kind(biased(5.0 * DEG, 0.1), 3),
    "gyro scale +.3 %": Kind(scaled(0.003)),
    "gyro scale -.3 %": Kind(scaled(-0.003)),
    "gyro scale +1 %": Kind(scaled(0.01)),
    "gyro scale -1 %": Kind(scaled(-0.01)),
    "accel scale +.3 %": Kind(scaled(0.0, 0.003)),
    "clip 4 g": Kind(clipped(accel=4.0 * G)),
    "clip 8 g": Kind(clipped(accel=8.0 * G)),
    "clip 500 deg/s": Kind(clipped(gyro=500.0 * DEG)),
    "mounting": Kind(mounted, 3),
    "begin cut": Kind(cut(6.0, 0.0), 4, True),
    "end cut": Kind(cut(0.0, 6.0), 4, True),
    "first second off": Kind(shorter(1.0, 0.0), 1, True),
    "last second off": Kind(shorter(0.0, 1.0), 1, True),
    "loss 2 %": Kind(lossy(0.02), 2),
    "jitter 1 ms": Kind(jittery(0.001), 2),
    "epoch times": Kind(late(1e9), shift_s=1e9),
    "single precision": Kind(single),
}


@dataclass
class Outcome:
    """What came of one kind of change, over all draws."""

    optical: dict[str, list[float]]
    footprints: dict[str, list[tuple[int, float, float]]]
    mocap: list[float]
    closure: dict[str, list[float]]
    refused: list[str]

    @property
    def optical_mean(self) -> float:
        """Mean over the optical trials of their horizontal errors [m]."""
        return float(np.mean([np.mean(errors) for errors in self.optical.values() if errors]))

    def line(self) -> str:
        """Tell it in a line."""
        text = f"{self.optical_mean:.4f} m ("
        text += " ".join(f"{np.mean(v):.3f}" for v in self.optical.values() if v) + ")"
        for rows in self.footprints.values():
            if rows:
                wrong = sum(row[0] != 0 for row in rows)
                text += f"  {np.mean([r[1] for r in rows]):+.2f} % "
                text += f"{np.mean([r[2] for r in rows]):4.1f} mm" + (f" {wrong}!" if wrong else "")
        if self.mocap:
            text += f"  {np.mean(self.mocap):4.1f} mm"
        return text + "  " + " ".join(f"{np.mean(v):.2f}" for v in self.closure.values() if v)


def run(recordings: Recordings, kind: Kind, options: FootOptions) -> Outcome:
    """Change every recording and compare."""
    out = Outcome({}, {}, [], {}, [])

    def draws(name: str, block: ImuBlock) -> Iterator[tuple[ImuBlock, object]]:
        for draw in range(kind.draws):
            changed = kind.change(block, np.random.default_rng([draw, len(name)]))
            try:
                yield changed, smooth_foot(changed, options)
            except DataError as refusal:
                out.refused.append(f"{name} ({draw}): {refusal}")

    for name, (block, reference) in recordings.optical.items():
        later = replace(reference, t=reference.t + kind.shift_s)
        out.optical[name] = [
            align(t.trajectory.t, t.trajectory.position, later).rmse_horizontal
            for _, t in draws(name, block)
        ]
    for name, (block, measured) in recordings.footprints.items():
        rows = []
        for _, track in draws(name, block):
            if not kind.shortens:
                c = compare_footprints(gait_parameters(track), measured)
                rows.append((c.count - c.true_count, c.distance_percent, 1e3 * c.mae))
        out.footprints[name] = rows
    for side, block in recordings.mocap.items():
        for _, track in draws(side, block):
            if not kind.shortens and not kind.shift_s:
                c = mocap_lengths(recordings.mocap_folder, side, gait_parameters(track))
                out.mocap.append(1e3 * float(np.abs(c.errors).mean()))
    for name, block in recordings.loops.items():
        ends = [t.trajectory.position[[0, -1]] for _, t in draws(name, block)]
        out.closure[name] = [] if kind.shortens else [float(np.linalg.norm(b - a)) for a, b in ends]
    return out


def joined(a: ImuBlock, b: ImuBlock) -> tuple[ImuBlock, float]:
    """Return two recordings of a foot as one, the second as tilted as the first ended; and when."""
    up = [block.accel[rows].mean(axis=0) for block, rows in ((a, slice(-40, None)), (b, slice(40)))]
    turn = [level_attitude(one) for one in up]
    back = turn[0] * np.array([1.0, -1.0, -1.0, -1.0])
    accel, gyro = (rotate(back, rotate(turn[1], x)) for x in (b.accel, b.gyro))
    shift = a.t[-1] + JOIN_S - b.t[0]
    t = np.concatenate((a.t, b.t + shift))
    both = [np.concatenate(pair) for pair in ((a.accel, accel), (a.gyro, gyro))]
    return ImuBlock(t, both[0], both[1], t), float(shift)


def concatenated(recordings: Recordings) -> Iterator[str]:
    """Join every two optical trials and compare either part with its truth."""
    for one, (a, true_a) in recordings.optical.items():
        for other, (b, true_b) in recordings.optical.items():
            if one == other:
                continue
            block, shift = joined(a, b)
            try:
                way = smooth_foot(block).trajectory
            except DataError as refusal:
                yield f"{one} + {other}: REFUSED {refusal}"
                continue
            left = align(way.t, way.position, true_a).rmse_horizontal
            later = Reference(true_b.t + shift, true_b.position)
            right = align(way.t, way.position, later).rmse_horizontal
            yield f"{one} + {other}: {left:.3f} m, {right:.3f} m"


def main(asked: str) -> None:
    """Print a line for each kind of change."""
    if "IMU_RIG_DATA" not in os.environ:
        raise SystemExit("set IMU_RIG_DATA to the folder of the recordings")
    recordings = read_recordings(Path(os.environ["IMU_RIG_DATA"]) / "foot")
    print(f"{'':<26}optical mean and each; footprints 33, 34; motion capture; loops [m]")
    for name, kind in KINDS.items():
        if asked in name:
            out = run(recordings, kind, FootOptions())
            print(f"{name:<26}{out.line()}", flush=True)
            for refusal in out.refused:
                print(f"    REFUSED {refusal}")
    if asked in "joined":
        print("\n".join(f"joined {line}" for line in concatenated(recordings)))


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "")
