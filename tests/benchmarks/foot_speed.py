"""How fast the foot smoother is, beside a textbook one; what it needs of memory; its first call.

``python tests/benchmarks/foot_speed.py`` smooths one hour of simulated walking at 200 samples per
second. Times are processor time of one core. ``--compile`` also says how long the very first call
takes, with nothing compiled yet.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # numpy reads it at import

import numpy as np
import textbook_rts

from imu_rig.arrays import FloatArray
from imu_rig.blocks import ImuBlock
from imu_rig.gait.smoother import smooth_foot
from imu_rig.kernels.foot_filter import smooth_foot_states
from imu_rig.kernels.foot_types import FootInputs, FootModel
from simulators.walker.grades import read_as
from simulators.walker.path import Straight
from simulators.walker.scenarios import Scenario
from simulators.walker.steps import Stand, Walk
from simulators.walker.walker import Surroundings, Walker

RATE_HZ = 200.0

STRIDE_S = 0.7
"""Half a stride and a little more."""

MODEL = FootModel(
    gravity=9.81, gyro_noise=5e-4, gyro_motion=3e-3, accel_noise=2e-2, accel_motion=1.5e-2,
    tilt_prior=0.02, velocity_prior=0.05, gyro_bias_prior=np.full(3, 0.02), gyro_bias_walk=0.0,
    accel_bias_prior=0.05, accel_bias_walk=1e-4, pivot_prior=np.array([0.0, 0.0, 0.08]),
    pivot_sigma=0.03, gate=3.0,
)  # fmt: skip

FIRST_CALL = """
import sys, time
begin = time.perf_counter()
import numpy as np
from imu_rig.blocks import ImuBlock
from imu_rig.gait.smoother import smooth_foot
t, accel, gyro = (np.load(sys.argv[1])[name] for name in ("t", "accel", "gyro"))
smooth_foot(ImuBlock(t, accel, gyro, t))
print(time.perf_counter() - begin, time.process_time())
"""


def long_walk(minutes: float, metres: float = 20.0) -> ImuBlock:
    """Return a walk of so many minutes: some simulated metres over and over."""
    parts = (Stand(2.0), Walk((Straight(metres),), (1.3,)), Stand(1.0))
    scenario = Scenario("steady", "Walk at one speed", parts)
    walker = Walker(scenario, seed=2, surroundings=Surroundings.ideal())
    t = np.arange(1, int(walker.end_s * RATE_HZ) + 1) / RATE_HZ
    read = read_as("middle", walker.sensor("left-foot").means(t, 0.0), 1)
    turning = np.convolve(np.linalg.norm(read.gyro, axis=1), np.ones(30), "same")
    rests = []  # the foot lies the same in stances only
    for about in (4.0, t[-1] - 3.0):
        rests.append(t[np.argmin(turning + 1e3 * (np.abs(t - about) > STRIDE_S))])

    def many(fine: FloatArray) -> FloatArray:
        begin, end = rests
        steady = fine[(t > begin) & (t <= end)]
        number = max(1, round(minutes * 60.0 / (end - begin)))
        return np.concatenate((fine[t <= begin], *[steady] * number, fine[t > end]))

    accel, gyro = many(read.accel), many(read.gyro)
    times = np.arange(len(accel)) / RATE_HZ
    return ImuBlock(times, accel, gyro, times)


def spent(work: Callable[[], object], repeats: int) -> float:
    """Return the least processor time of several calls [s]."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        work()
        times.append(time.process_time() - begin)
    return min(times)


def first_call(block: ImuBlock, folder: str, cache: str | None) -> tuple[float, float]:
    """Return wall and processor time [s] of the first call in a new program."""
    file = Path(folder) / "walk.npz"
    np.savez(file, t=block.t, accel=block.accel, gyro=block.gyro)
    environment = os.environ if cache is None else {**os.environ, "NUMBA_CACHE_DIR": cache}
    told = subprocess.run(
        [sys.executable, "-c", FIRST_CALL, file], env=environment, check=True, capture_output=True
    )
    wall, processor = map(float, told.stdout.split())
    return wall, processor


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60.0, help="of 200 Hz (60)")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--compile", action="store_true", help="also time compilation")
    asked = parser.parse_args()
    block = long_walk(asked.minutes)
    n = len(block)
    short = block[: min(n, 4000)]
    sigma = smooth_foot(block).zero_velocity.sigma  # compiles, too
    smooth_foot(short, covariance=True)
    dt, nothing = np.diff(block.t, prepend=0.0), np.full(n, np.inf)
    still = np.isfinite(sigma)
    inputs = FootInputs(
        dt, block.gyro, block.accel, 3.0 * sigma, nothing, nothing, np.zeros(n),
        np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3),
    )  # fmt: skip
    few = slice(0, min(n, 40_000))  # it stores 1.9 kB a sample
    dense = (dt[few], block.gyro[few].copy(), block.accel[few].copy(), still[few])
    textbook_rts.smooth(*dense)

    print(f"{n} samples, {n / RATE_HZ / 60.0:.1f} minutes at {RATE_HZ:.0f} Hz, {still.mean():.0%}")
    print("of them in stance; processor time, best of", asked.repeats)
    print(f"{'':34}{'s':>8}{'samples/s':>12}{'B/sample':>10}")

    def row(name: str, number: int, work: Callable[[], object]) -> float:
        seconds = spent(work, asked.repeats)
        tracemalloc.start()
        work()
        memory = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        size = f"{memory / number:10.0f}" if memory > 50 * number else f"{'':>10}"
        print(f"{name:34}{seconds:8.3f}{number / seconds:12,.0f}{size}")
        return number / seconds

    slow = row("textbook, 9 states, dense", len(dense[0]), lambda: textbook_rts.smooth(*dense))
    row("kernel, 16 states", n, lambda: smooth_foot_states(inputs, MODEL, estimate_gyro_bias=True))
    row("kernel, 13 states", n, lambda: smooth_foot_states(inputs, MODEL, estimate_gyro_bias=False))
    whole = row("whole smoother, two passes", n, lambda: smooth_foot(block))
    row("with covariance", n, lambda: smooth_foot(block, covariance=True))
    print(f"the whole smoother is {whole / slow:.1f} times as fast as the textbook's one pass")
    with tempfile.TemporaryDirectory() as folder:
        first_call(short, folder, None)
        wall, processor = first_call(short, folder, None)
        print(f"first call of a new program: {wall:.2f} s, {processor:.2f} s of processor")
        if asked.compile:
            wall, processor = first_call(short, folder, folder)
            print(f"first call of all, compiling: {wall:.1f} s, {processor:.1f} s of processor")


if __name__ == "__main__":
    main()
