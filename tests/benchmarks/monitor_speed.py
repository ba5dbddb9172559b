"""How long one picture of the live plot takes: lines alone, and everything drawn anew.

``python tests/benchmarks/monitor_speed.py`` prints both for 1, 3 and 6 sensors of 100 samples per
second over 10 s, medians, and what the monitor itself spends on handing a block of samples over.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Callable

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from imu_rig.monitor.figure import LiveFigure, StreamPlan
from imu_rig.monitor.quantities import Quantity
from imu_rig.monitor.rings import Ring

SENSOR = (
    Quantity("accel", "g", 1.0, 3),
    Quantity("gyro", "deg/s", 1.0, 3),
    Quantity("mag", "uT", 1.0, 3),
)
SECONDS, RATE_HZ, BLOCK = 10.0, 100.0, 5
LINES, ANEW, HANDED = 40, 8, 400  # times that each is tried


def _median_ms(task: Callable[[], object], times: int) -> float:
    took = []
    for _ in range(times):
        begin = time.perf_counter()
        task()
        took.append(time.perf_counter() - begin)
    return 1e3 * statistics.median(took)


def measure(sensors: int) -> tuple[float, float, float]:
    """Return milliseconds for lines alone, for everything, and to hand over a block."""
    plans = [StreamPlan(f"sensor {number}", SENSOR) for number in range(sensors)]
    live = LiveFigure(plans, SECONDS)
    FigureCanvasAgg(live.figure)
    rings = {plan.name: Ring(int(SECONDS * RATE_HZ), plan.columns) for plan in plans}
    t = np.arange(SECONDS * RATE_HZ) / RATE_HZ
    waves = np.sin(t[:, None] + np.arange(9))
    for ring in rings.values():
        ring.write(t, [waves])

    def frame() -> None:
        live.update({name: ring.read() for name, ring in rings.items()}, SECONDS)
        live.draw_lines()

    live.update({name: ring.read() for name, ring in rings.items()}, SECONDS)
    live.draw()
    ring = Ring(int(SECONDS * RATE_HZ), 9)
    return (
        _median_ms(frame, LINES),
        _median_ms(live.draw, ANEW),
        _median_ms(lambda: ring.write(t[:BLOCK], [waves[:BLOCK]]), HANDED),
    )


def main() -> None:
    argparse.ArgumentParser(description=__doc__).parse_args()
    print(f"{'sensors':>8}{'lines alone [ms]':>18}{'everything [ms]':>17}{'hand over [ms]':>16}")
    for sensors in (1, 3, 6):
        lines, everything, handed = measure(sensors)
        print(f"{sensors:8}{lines:18.1f}{everything:17.1f}{handed:16.3f}")
    load = ", ".join(f"{load:.1f}" for load in os.getloadavg())
    print(f"load of the machine {load} on {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
