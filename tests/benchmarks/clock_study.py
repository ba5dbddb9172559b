"""How true the times of samples are, and how true their stated uncertainty.

A study over simulated devices and links with known truth::

    python tests/benchmarks/clock_study.py transport      # every link, rate and kind of layout
    python tests/benchmarks/clock_study.py coverage       # errors in units of the stated sigma
    python tests/benchmarks/clock_study.py day            # 24 hours with a crystal that wanders

Errors are time stamp minus true time of the sample. The simulated links have no constant delay: a
real link's is invisible to anyone who sees arrivals only, and no figure here says anything of it.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from firmware_protocols.layout import PacketLayout, load_layout
from firmware_protocols.packets import encode
from imu_rig.arrays import FloatArray
from imu_rig.packet_stream import PacketBlock, PacketStreams, assemble_packets
from imu_rig.timing import LiveClockFit, fit_clock

ORIGIN_S = 4321.0
SKEW = 50e-6
RATES_HZ = (10.0, 50.0, 100.0, 400.0)
POLL_S = 0.02  # by which arrivals are handed on together

Link = Callable[[FloatArray, np.random.Generator], FloatArray]


# --- links: the arrival of packets made at the true times ----------------------------------------


def _flushed(true_s: FloatArray, flushes_s: FloatArray) -> FloatArray:
    return flushes_s[np.searchsorted(flushes_s, true_s)]


def in_reach(true_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Bluetooth that flushes every 20 to 100 ms."""
    span = float(np.ptp(true_s)) + 10.0
    flushes = true_s[0] + np.cumsum(rng.uniform(0.02, 0.1, int(span / 0.02)))
    host = _flushed(true_s, flushes) + rng.exponential(2e-4, len(true_s))
    return np.maximum.accumulate(host)


def bluetooth(true_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """The same with a drop-out of 1 to 4 s twice a minute."""
    span = float(np.ptp(true_s))
    host = in_reach(true_s, rng)
    starts = np.sort(rng.uniform(true_s[0], true_s[-1], 1 + rng.poisson(span / 30)))
    stops = starts + rng.uniform(1.0, 4.0, len(starts))
    for start, stop in zip(starts, stops, strict=True):
        silent = slice(*np.searchsorted(host, (start, stop)))
        host[silent] = stop
    return np.maximum.accumulate(host)


def usb_serial(true_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A converter that hands on what it has when its latency timer of 16 ms ends."""
    ticks = true_s[0] - rng.uniform(0, 0.016) + 0.016 * np.arange(int(np.ptp(true_s) / 0.016) + 9)
    host = _flushed(true_s, ticks) + rng.exponential(1e-4, len(true_s))
    return np.maximum.accumulate(host)


def polled(true_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A program that looks every 10 ms, and somewhat later when the machine is busy."""
    looks = true_s[0] + np.cumsum(0.01 + rng.exponential(5e-4, int(np.ptp(true_s) / 0.01) + 99))
    return _flushed(true_s, looks)


def heavy_tail(true_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A radio with retries: tiny delays are rare, one in twenty is of any length up to seconds."""
    delay = rng.gamma(2.0, 4e-3, len(true_s))
    retried = rng.random(len(true_s)) < 0.05
    delay[retried] += np.minimum(0.02 * rng.pareto(1.2, int(retried.sum())), 3.0)
    return np.maximum.accumulate(true_s + delay)


LINKS: dict[str, Link] = {
    "Bluetooth": bluetooth,
    "in reach": in_reach,
    "USB 16 ms": usb_serial,
    "polled 10 ms": polled,
    "heavy tail": heavy_tail,
}

# --- devices ------------------------------------------------------------------------------------


def layouts() -> dict[str, PacketLayout]:
    """Return a layout for every source of time."""
    full = load_layout("mpu9150-28")
    counted = replace(full, clock=None)
    return {"clock": full, "counter": counted, "arrival": replace(counted, counter=None)}


def packets(layout: PacketLayout, device_s: FloatArray) -> bytes:
    """Return the bytes of packets made at these times of the device's clock."""
    number = len(device_s)
    return encode(
        layout,
        {
            "seq": np.arange(number) % 256,
            "status": np.zeros(number, int),
            "time": np.round(device_s * 1e6).astype(np.int64) % 2**32,
            "accel": np.zeros((number, 3), int),
            "gyro": np.zeros((number, 3), int),
            "mag": np.zeros((number, 3), int),
        },
    )


@dataclass(frozen=True)
class Timed:
    """Errors [s] of samples and the standard uncertainty stated for each [s], both shape (n,)."""

    error_s: FloatArray
    sigma_s: FloatArray

    @property
    def rms_s(self) -> float:
        """Root mean square of the errors."""
        return float(np.sqrt(np.mean(self.error_s**2)))

    @property
    def worst_s(self) -> float:
        """Largest error."""
        return float(np.max(np.abs(self.error_s)))


def recorded(
    layout: PacketLayout, device_s: FloatArray, true_s: FloatArray, host_s: FloatArray
) -> Timed:
    """Time a whole recording."""
    data = packets(layout, device_s)
    stops = layout.length * np.arange(1, len(device_s) + 1)
    assembled = assemble_packets(layout, data, stops, host_s)[""]
    worst = max(fit.sigma_s for fit in assembled.fits)
    return Timed(assembled.block.t - true_s, np.full(len(true_s), worst))


def live(
    layout: PacketLayout, device_s: FloatArray, true_s: FloatArray, host_s: FloatArray
) -> Timed:
    """Time the same packets as they arrive."""
    data, length = packets(layout, device_s), layout.length
    stream = PacketStreams(layout)
    times, sigmas = [], []
    edges = np.flatnonzero(np.diff(np.floor(host_s / POLL_S), prepend=-1.0, append=np.inf))
    for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        chunks = [
            (round(host_s[i] * 1e9), data[i * length : (i + 1) * length])
            for i in range(start, stop)
        ]
        block = stream.feed_many(chunks).get("", PacketBlock.empty(layout))
        times.append(block.t)
        fit = stream.clock_fit("")
        sigmas.append(np.full(len(block), np.nan if fit is None else fit.sigma_s))
    return Timed(np.concatenate(times) - true_s, np.concatenate(sigmas))


# --- transport ----------------------------------------------------------------------------------


def transport_cases(seeds: int) -> Iterator[tuple[str, str, float, list[Timed], list[Timed]]]:
    """Time half a minute recorded, and live the half minute after the first."""
    for name, link in LINKS.items():
        for kind, layout in layouts().items():
            for rate in RATES_HZ:
                whole, after = [], []
                for seed in range(seeds):
                    rng = np.random.default_rng([seed, int(rate)])
                    device = np.arange(int(60 * rate)) / rate
                    true = ORIGIN_S + device * (1 + SKEW)
                    host = link(true, rng)
                    stated = replace(layout, rate_hz=rate)
                    # what has arrived by then; a link that is out of reach at the end brings none
                    device, true, host = (x[host < ORIGIN_S + 60.0] for x in (device, true, host))
                    half = host < ORIGIN_S + 30.0
                    whole.append(recorded(stated, device[half], true[half], host[half]))
                    timed = live(stated, device, true, host)
                    after.append(Timed(timed.error_s[~half], timed.sigma_s[~half]))
                yield name, kind, rate, whole, after


def pooled(timed: list[Timed]) -> Timed:
    """Join the samples of several records."""
    return Timed(
        np.concatenate([t.error_s for t in timed]), np.concatenate([t.sigma_s for t in timed])
    )


def transport(seeds: int) -> None:
    """Print errors of every link, layout and rate."""
    print(f"Errors [ms] of {seeds} records each, clock off by {SKEW * 1e6:g} ppm")
    print(f"{'':35s}{'30 s recorded':>20s}{'live, 30 to 60 s':>20s}")
    print(f"{'link':14s}{'time from':12s}{'rate':>8s} " + f"{'rms':>10s}{'max':>10s}" * 2)
    for name, kind, rate, whole, after in transport_cases(seeds):
        row = f"{name:14s}{kind:12s}{rate:5.0f} Hz "
        for timed in (pooled(whole), pooled(after)):
            row += f"{timed.rms_s * 1e3:10.3f}{timed.worst_s * 1e3:10.3f}"
        print(row)


# --- coverage -----------------------------------------------------------------------------------


def coverage_cases(
    seeds: int, spans_s: tuple[float, ...], rates_hz: tuple[float, ...] = (10.0, 100.0)
) -> Iterator[tuple[str, float, float, list[Timed]]]:
    """Fit records of several lengths."""
    for name, link in LINKS.items():
        for rate in rates_hz:
            for span in spans_s:
                timed = []
                for seed in range(seeds):
                    rng = np.random.default_rng([seed, int(rate), int(span)])
                    device = np.arange(int(span * rate)) / rate
                    true = ORIGIN_S + device * (1 + rng.uniform(-1, 1) * SKEW)
                    fit = fit_clock(device, link(true, rng))
                    error = fit.host(device) - true
                    timed.append(Timed(error, np.full(len(error), fit.sigma_s)))
                yield name, rate, span, timed


def inside(timed: Timed, sigmas: float) -> float:
    """Return the share of samples whose error is below so many sigmas."""
    return float(np.mean(np.abs(timed.error_s) <= sigmas * timed.sigma_s))


def coverage(seeds: int) -> None:
    """Print errors in units of the stated uncertainty."""
    print(f"{seeds} records each, skew within {SKEW * 1e6:g} ppm; error and sigma in ms")
    print(
        f"{'link':14s}{'rate':>8s}{'record':>9s}{'rms error':>11s}{'med. sigma':>11s}"
        f"{'rms of error/sigma':>20s}{'inside 2':>10s}{'inside 4':>10s}{'max':>6s}"
    )
    shares = []
    for name, rate, span, timed in coverage_cases(seeds, (5.0, 12.0, 30.0, 120.0, 600.0, 3600.0)):
        t = pooled(timed)
        ratio = t.error_s / t.sigma_s
        shares.append((inside(t, 2.0), inside(t, 4.0)))
        print(
            f"{name:14s}{rate:5.0f} Hz{span:7.0f} s{t.rms_s * 1e3:11.3f}"
            f"{float(np.median(t.sigma_s)) * 1e3:11.3f}{float(np.sqrt(np.mean(ratio**2))):20.2f}"
            f"{shares[-1][0]:10.1%}{shares[-1][1]:10.1%}{float(np.abs(ratio).max()):6.1f}"
        )
    two, four = np.mean(shares, axis=0)
    print(f"all cases alike: {two:.1%} inside 2 sigma, {four:.1%} inside 4 sigma")


# --- a day --------------------------------------------------------------------------------------


def wandering(device_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Seconds that a crystal gains by wandering, shape (n,).

    One ppm up and down in some hours as the room warms and cools; every three hours the sensor is
    put on a warm shoe and taken off again, 2 ppm within ten minutes each time.
    """
    grid = np.arange(0.0, device_s[-1] + 20.0, 10.0)
    rate = 1e-6 * np.sin(2 * np.pi * (grid / rng.uniform(3, 6) / 3600 + rng.random()))
    for on in np.arange(1.5 * 3600, grid[-1], 3 * 3600):
        start = on + rng.uniform(-1200, 1200)
        rate += 2e-6 * (
            np.clip((grid - start) / 600, 0, 1) - np.clip((grid - start - 5400) / 600, 0, 1)
        )
    gained = np.concatenate(([0.0], np.cumsum(rate[:-1] * 10.0)))
    return np.interp(device_s, grid, gained)


def day_case(
    link: Link, rate_hz: float, hours: float, seed: int, *, step_s: float = 0.5
) -> tuple[FloatArray, Timed, Timed]:
    """Time a long record; return device times, recorded and live (a fit every ``step_s``)."""
    rng = np.random.default_rng([seed, int(rate_hz)])
    device = np.arange(int(hours * 3600 * rate_hz)) / rate_hz
    true = ORIGIN_S + device * (1 + SKEW) + wandering(device, rng)
    host = link(true, rng)
    fit = fit_clock(device, host)
    whole = Timed(fit.host(device) - true, np.full(len(true), fit.sigma_s))
    growing = LiveClockFit()
    error, sigma = np.empty(len(true)), np.empty(len(true))
    edges = np.searchsorted(device, np.arange(0.0, device[-1] + step_s, step_s)).tolist()
    for start, stop in zip(edges, [*edges[1:], len(device)], strict=True):
        if start < stop:
            part = slice(start, stop)
            now = growing.update(device[part], host[part])
            error[part], sigma[part] = now.host(device[part]) - true[part], now.sigma_s
    return device, whole, Timed(error, sigma)


def drift_s_per_h(device_s: FloatArray, error_s: FloatArray) -> float:
    """Return the largest change of the mean error from one hour to the next [s]."""
    hours = (device_s // 3600).astype(int)
    means = np.bincount(hours, error_s) / np.bincount(hours)
    return float(np.max(np.abs(np.diff(means)), initial=0.0))


def day(seeds: int, hours: float) -> None:
    """Print errors over long records."""
    print(f"{hours:g} h, a crystal that wanders by 1 ppm over hours and 2 ppm in 10 minutes [ms]")
    print(
        f"{'link':14s}{'rate':>8s}  {'':10s}{'rms':>9s}{'max':>9s}{'med. sigma':>12s}"
        f"{'inside 2':>10s}{'drift in 1 h':>14s}"
    )
    for name, link in LINKS.items():
        for rate in (10.0, 100.0):
            for seed in range(seeds):
                begun = time.perf_counter()
                device, whole, growing = day_case(link, rate, hours, seed)
                settled = device >= 30.0
                for kind, timed in (("recorded", whole), ("live", growing)):
                    t = Timed(timed.error_s[settled], timed.sigma_s[settled])
                    print(
                        f"{name:14s}{rate:5.0f} Hz  {kind:10s}{t.rms_s * 1e3:9.3f}"
                        f"{t.worst_s * 1e3:9.3f}{float(np.median(t.sigma_s)) * 1e3:12.3f}"
                        f"{inside(t, 2.0):10.1%}"
                        f"{drift_s_per_h(device[settled], t.error_s) * 1e3:14.3f}",
                        flush=True,
                    )
                print(f"  ({time.perf_counter() - begun:.0f} s)", file=sys.stderr)


def main() -> None:
    """Run the part asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("part", choices=("transport", "coverage", "day"))
    parser.add_argument("--seeds", type=int, default=None, help="records of each case")
    parser.add_argument("--hours", type=float, default=24.0, help="length of a day")
    chosen = parser.parse_args()
    if chosen.part == "transport":
        transport(chosen.seeds or 6)
    elif chosen.part == "coverage":
        coverage(chosen.seeds or 40)
    else:
        day(chosen.seeds or 1, chosen.hours)


if __name__ == "__main__":
    main()
