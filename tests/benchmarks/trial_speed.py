"""How fast trials are written and read, beside CSV and MCAP, in one run.

``python tests/benchmarks/trial_speed.py`` writes one hour of a 400 Hz sensor (1.44 million packets
of 28 bytes, synthetic) in every format, reads each back into arrays and prints one table; with
``--minutes 3`` it is over in a minute. Writing is CPU time of the whole process, threads included;
reading is wall time from opening the file to arrays in SI units with a time for every sample, the
best of up to three in a row.
"""

from __future__ import annotations

import argparse
import csv
import json
import shutil
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice, pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np

from firmware_protocols.decoder import StreamDecoder
from firmware_protocols.layout import load_layout
from firmware_protocols.packets import encode
from imu_rig.clock import Clock, SteppedClock, SystemClock
from imu_rig.imu_scaling import field_values
from imu_rig.recording import RecordingOptions, TrialWriter, open_trial

RATE_HZ = 400
LAYOUT = load_layout("mpu9150-28")
FULL_BYTES = 2 << 20  # waiting in the writer's queue, above which this program waits too
READ_AGAIN_S = 20.0  # reading that takes longer is done once

Packet = tuple[int, int, bytes]  # source, arrival [ns], bytes
Row = TypeVar("Row")


@dataclass(frozen=True)
class Figures:
    """One line of the table."""

    what: str
    write_us: float | None = None
    read_per_s: float | None = None
    size_bytes: int = 0
    note: str = ""


def say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


# --- what is written -----------------------------------------------------------------------------


def packets_of(sensors: int, number: int) -> list[Packet]:
    """Make packets of several sensors in the order of their arrival, ``number`` in all."""
    each = number // sensors
    index = np.arange(each)
    merged: list[Packet] = []
    for source in range(sensors):
        rng = np.random.default_rng(source)
        data = encode(
            LAYOUT,
            {
                "seq": index % 256,
                "status": 0,
                "time": index * (1_000_000 // RATE_HZ) % 2**32,
                "accel": rng.integers(-8192, 8192, (each, 3)),
                "gyro": rng.integers(-8192, 8192, (each, 3)),
                "mag": rng.integers(-300, 300, (each, 3)),
            },
        )
        late_s = rng.uniform(0.001, 0.004, each)
        arrival = np.maximum.accumulate((index / RATE_HZ + late_s) * 1e9).astype(np.int64)
        cuts = range(0, (each + 1) * LAYOUT.length, LAYOUT.length)
        pieces = [data[a:b] for a, b in pairwise(cuts)]
        merged += zip([source] * each, arrival.tolist(), pieces, strict=True)
    return sorted(merged, key=lambda packet: packet[1]) if sensors > 1 else merged


def decoded(packets: list[Packet]) -> Iterator[tuple[float, list[float]]]:
    """Yield what a program that stores numbers has to store: time and all fields in SI units."""
    data = b"".join(data for _, _, data in packets)
    fields, _ = field_values(LAYOUT, StreamDecoder(LAYOUT).feed(data).rows)
    table = np.column_stack([fields["accel"], fields["gyro"], fields["mag"], fields["status"]])
    for (_, t_ns, _), row in zip(packets, table, strict=True):
        yield t_ns / 1e9, row.tolist()


def timed(rows: Iterable[Row], write: Callable[[Row], object]) -> float:
    """Write rows one by one and return the CPU time of that, without that of making the rows."""
    spent = 0.0
    waiting = iter(rows)
    while batch := list(islice(waiting, 8192)):
        begin = time.process_time()
        for row in batch:
            write(row)
        spent += time.process_time() - begin
    return spent


# --- the formats ---------------------------------------------------------------------------------


def new_trial(path: Path, sensors: int, clock: Clock) -> tuple[TrialWriter, list[int]]:
    writer = TrialWriter.create(
        path, {"kind": "trial"}, clock=clock, options=RecordingOptions(reserve_bytes=0)
    )
    descriptor = {"layout": LAYOUT.to_dict()}
    return writer, [writer.add_source(f"imu {n}", "imu", descriptor) for n in range(sensors)]


def write_trial(path: Path, packets: list[Packet]) -> float:
    clock = SteppedClock()
    writer, sources = new_trial(path, 1 + max(source for source, _, _ in packets), clock)
    origin_ns = clock.now_ns()
    begin = time.process_time()
    for count, (source, t_ns, data) in enumerate(packets):
        writer.bytes_in(sources[source], origin_ns + t_ns, data)
        if count % 1024 == 0:
            while writer.queued_bytes > FULL_BYTES:
                time.sleep(0.005)
    writer.close()
    spent = time.process_time() - begin
    if writer.unwritten_records:
        raise SystemExit(f"{writer.unwritten_records} records were not written")
    return spent


def read_trial(path: Path) -> int:
    trial = open_trial(path)
    return sum(len(trial.imu(name).t) for name in trial.sensors)


def write_csv(path: Path, packets: list[Packet]) -> float:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        return timed(decoded(packets), lambda row: writer.writerow([row[0], *row[1]]))


def read_csv(path: Path) -> int:
    return len(np.loadtxt(path, delimiter=",", ndmin=2))


def write_mcap_raw(path: Path, packets: list[Packet]) -> float:
    return _write_mcap(path, packets, "", lambda packet: (packet[1], packet[2]))


def read_mcap_raw(path: Path) -> int:
    times, pieces = [], []
    for message in _mcap_messages(path):
        times.append(message.log_time)
        pieces.append(message.data)
    fields, _ = field_values(LAYOUT, StreamDecoder(LAYOUT).feed(b"".join(pieces)).rows)
    return min(len(fields["accel"]), len(np.array(times) / 1e9))


def write_mcap_json(path: Path, packets: list[Packet]) -> float:
    def message(row: tuple[float, list[float]]) -> tuple[int, bytes]:
        t, numbers = row
        fields = {
            "accel": numbers[0:3],
            "gyro": numbers[3:6],
            "mag": numbers[6:9],
            "status": numbers[9],
        }
        return round(t * 1e9), json.dumps(fields).encode()

    return _write_mcap(path, decoded(packets), "json", message)


def read_mcap_json(path: Path) -> int:
    times, rows = [], []
    for message in _mcap_messages(path):
        fields = json.loads(message.data)
        times.append(message.log_time)
        rows.append([*fields["accel"], *fields["gyro"], *fields["mag"], fields["status"]])
    return min(len(np.array(rows)), len(np.array(times) / 1e9))


def _write_mcap(
    path: Path, rows: Iterable[Row], encoding: str, message: Callable[[Row], tuple[int, bytes]]
) -> float:
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/imu", encoding, schema_id=0)

        def add(row: Row) -> None:
            t_ns, data = message(row)
            writer.add_message(channel, log_time=t_ns, data=data, publish_time=t_ns)

        spent = timed(rows, add)
        begin = time.process_time()
        writer.finish()
        return spent + time.process_time() - begin


def _mcap_messages(path: Path) -> Iterator:
    from mcap.reader import make_reader

    with path.open("rb") as file:
        for _, _, message in make_reader(file).iter_messages():
            yield message


# --- the measurements ----------------------------------------------------------------------------


def measured(
    what: str,
    path: Path,
    packets: list[Packet],
    write: Callable[[Path, list[Packet]], float],
    read: Callable[[Path], int],
) -> Figures:
    say(f"{what}: writing")
    spent = write(path, packets)
    size = path.stat().st_size
    say(f"{what}: reading")
    took: list[float] = []
    while len(took) < 3 and sum(took) < READ_AGAIN_S:
        begin = time.perf_counter()
        count = read(path)
        took.append(time.perf_counter() - begin)
        if count != len(packets):
            raise SystemExit(f"{what}: {count} samples of {len(packets)} came back")
    return Figures(what, 1e6 * spent / len(packets), len(packets) / min(took), size)


def paced_write_us(folder: Path, seconds: float) -> tuple[float, float]:
    """CPU per packet [us] of writing 4 x 400 Hz as life goes, and of waiting for it alone."""
    packets = packets_of(4, round(4 * RATE_HZ * seconds))
    clock = SystemClock()
    writer, sources = new_trial(folder / "paced.imu-trial", 4, clock)

    def run(take: Callable[[int, int, bytes], None]) -> float:
        origin_ns, begin = clock.now_ns(), time.process_time()
        for source, t_ns, data in packets:
            ahead_ns = origin_ns + t_ns - clock.now_ns()
            if ahead_ns > 0:
                time.sleep(ahead_ns / 1e9)
            take(sources[source], origin_ns + t_ns, data)
        return 1e6 * (time.process_time() - begin) / len(packets)

    with writer:
        written = run(writer.bytes_in)
    return written, run(lambda _source, _t_ns, _data: None)


def peak_of_reading(path: Path) -> tuple[int, int]:
    """Most memory that reading a trial takes, and the size of its arrays [bytes]."""
    trial = open_trial(path)
    name = trial.sensors[0]
    tracemalloc.start()
    block = trial.imu(name)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    columns = (block.t, block.host_s, block.device_s, block.counter)
    axes = (block.accel, block.gyro, block.mag)
    return peak, sum(c.nbytes for c in (*columns, *axes) if c is not None)


def table(rows: list[Figures]) -> str:
    first = rows[0]
    lines = [
        f"{'':34} {'write':>10} {'ratio':>6} {'read':>12} {'ratio':>6} {'size':>9} {'ratio':>6}",
        f"{'':34} {'us/packet':>10} {'':6} {'packets/s':>12} {'':6} {'MB':>9} {'':6}",
    ]
    for row in rows:
        if row.write_us is None or row.read_per_s is None:
            lines.append(f"{row.what:34} {row.note}")
            continue
        lines.append(
            f"{row.what:34} {row.write_us:10.1f} {row.write_us / (first.write_us or 1):6.1f} "
            f"{row.read_per_s:12,.0f} {row.read_per_s / (first.read_per_s or 1):6.2f} "
            f"{row.size_bytes / 1e6:9.1f} {row.size_bytes / first.size_bytes:6.2f}"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60.0, help="of a 400 Hz sensor (60)")
    parser.add_argument("--paced-s", type=float, default=10.0, help="of writing as life goes (10)")
    parser.add_argument("--only-trials", action="store_true", help="leave CSV and MCAP out")
    arguments = parser.parse_args()
    number = round(arguments.minutes * 60 * RATE_HZ) // 4 * 4
    folder = Path(tempfile.mkdtemp(prefix="trial-speed-"))
    try:
        one, four = packets_of(1, number), packets_of(4, number)
        rows = [
            measured("trial, one sensor", folder / "1.imu-trial", one, write_trial, read_trial),
            measured("trial, four sensors", folder / "4.imu-trial", four, write_trial, read_trial),
        ]
        del four
        peak, arrays = peak_of_reading(folder / "1.imu-trial")
        if not arguments.only_trials:
            what = "CSV (csv.writer, numpy.loadtxt)"
            rows.append(measured(what, folder / "1.csv", one, write_csv, read_csv))
            raw, text = "MCAP, raw packets (mcap)", "MCAP, JSON (mcap)"
            try:
                import mcap  # noqa: F401
            except ImportError:
                rows += [
                    Figures(what, note="not installed: pip install mcap") for what in (raw, text)
                ]
            else:
                path = folder / "1.mcap"
                rows.append(measured(raw, path, one, write_mcap_raw, read_mcap_raw))
                rows.append(measured(text, path, one, write_mcap_json, read_mcap_json))
        say(f"writing 4 x {RATE_HZ} Hz for {arguments.paced_s:g} s")
        paced, waiting = paced_write_us(folder, arguments.paced_s)
    finally:
        shutil.rmtree(folder)
    print(f"{number} packets of {LAYOUT.length} bytes")
    print(table(rows))
    print(
        f"Written as they come, 4 x {RATE_HZ} Hz: {paced - waiting:.1f} us/packet, besides "
        f"{waiting:.1f} us for waiting until they come."
    )
    print(
        f"Reading takes {peak / arrays:.1f} times the memory of its arrays ({arrays / 1e6:.0f} MB)."
    )


if __name__ == "__main__":
    main()
