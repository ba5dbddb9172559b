"""How exactly a replay keeps to the recorded times, seen from a client in another process.

Run ``python tests/simulators/replay_timing.py [--seconds 30] [--devices 4] [--rate 400] [--tcp]``.
It writes a trial of devices that send a packet at known times, replays it at 1x, and stamps every
packet when the client has read it. Printed are the differences between arrival and recorded time,
the smallest of all taken as the common offset of the two clocks' origins; and, for the share of it
that is the machine's, how late a process that only sleeps was woken meanwhile.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import socket
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from imu_rig.clock import SteppedClock
from imu_rig.recording.writer import TrialWriter
from imu_rig.testing import replayed

PACKET = 28


def write_trial(path: Path, devices: int, rate_hz: float, seconds: float) -> None:
    """Packets that carry their own time, each device a little later than the one before."""
    clock = SteppedClock()
    with TrialWriter.create(path, {"kind": "trial"}, clock=clock) as trial:
        sources = [trial.add_source(f"device {n}", "test", {}) for n in range(devices)]
        for row in range(int(seconds * rate_hz)):
            for number, source in enumerate(sources):
                t_ns = round((row + number / devices) / rate_hz * 1e9)
                trial.bytes_in(source, t_ns, struct.pack("<q", t_ns).ljust(PACKET, b"\0"))
            if row % 1000 == 0:
                trial.flush()


def client() -> None:
    """Read all ports named on the command line and print each packet's time and arrival."""
    readers: dict[int, bytearray] = {}
    kept = []
    for url in sys.argv[2:]:
        if url.startswith("socket://"):
            host, _, port = url.removeprefix("socket://").partition(":")
            opened = socket.create_connection((host, int(port)))
            kept.append(opened)
            readers[opened.fileno()] = bytearray()
        else:
            readers[os.open(url, os.O_RDWR | os.O_NOCTTY)] = bytearray()
    found: list[tuple[int, int]] = []
    while readers:
        ready, _, _ = select.select(list(readers), [], [])
        now = time.monotonic_ns()
        for descriptor in ready:
            try:
                data = os.read(descriptor, 65536)
            except OSError:
                data = b""
            if not data:
                del readers[descriptor]
                continue
            buffer = readers[descriptor]
            buffer += data
            while len(buffer) >= PACKET:
                found.append((struct.unpack_from("<q", buffer)[0], now))
                del buffer[:PACKET]
    json.dump(found, sys.stdout)


def sleeper() -> None:
    """Sleep in short pieces until asked to stop and print how late each ended [ms]."""
    late = []
    print("asleep", flush=True)
    while not select.select([sys.stdin], [], [], 0)[0]:
        begin = time.monotonic()
        time.sleep(0.0025)
        late.append((time.monotonic() - begin - 0.0025) * 1e3)
    json.dump([float(np.percentile(late, share)) for share in (50, 99, 100)], sys.stdout)


def measured(devices: int, rate_hz: float, seconds: float, transport: str) -> dict[str, float]:
    """Return the figures of one run [ms]."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "timed.imu-trial"
        write_trial(path, devices, rate_hz, seconds)
        with replayed(path, transport=transport) as replay:  # type: ignore[arg-type]
            reading = subprocess.Popen(
                [sys.executable, __file__, "--client", *replay.ports().values()],
                stdout=subprocess.PIPE,
            )
            sleeping = subprocess.Popen(
                [sys.executable, __file__, "--sleeper"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
            cpu = time.process_time()
            output, _ = reading.communicate(timeout=seconds + 60)
            cpu = time.process_time() - cpu
            said, _ = sleeping.communicate(b"stop\n")
            late_ms = np.array(replay.lateness_s()) * 1e3
    t_ns, arrival_ns = np.array(json.loads(output), np.int64).T
    asleep = json.loads(said.removeprefix(b"asleep\n"))
    error_ms = (arrival_ns - t_ns - (arrival_ns - t_ns).min()) / 1e6
    return {
        "packets": len(t_ns),
        "expected": int(seconds * rate_hz) * devices,
        "p50_ms": float(np.percentile(error_ms, 50)),
        "p99_ms": float(np.percentile(error_ms, 99)),
        "max_ms": float(error_ms.max()),
        "sent_late_p50_ms": float(np.percentile(late_ms, 50)),
        "sent_late_p99_ms": float(np.percentile(late_ms, 99)),
        "sleeper_late_p50_ms": asleep[0],
        "sleeper_late_p99_ms": asleep[1],
        "sleeper_late_max_ms": asleep[2],
        "cpu_share": cpu / seconds,
    }


if __name__ == "__main__":
    if sys.argv[1:2] == ["--client"]:
        client()
    elif sys.argv[1:2] == ["--sleeper"]:
        sleeper()
    else:
        parser = argparse.ArgumentParser(description=__doc__)
        parser.add_argument("--seconds", type=float, default=30.0)
        parser.add_argument("--devices", type=int, default=4)
        parser.add_argument("--rate", type=float, default=400.0)
        parser.add_argument("--tcp", action="store_true")
        given = parser.parse_args()
        print(
            json.dumps(
                measured(given.devices, given.rate, given.seconds, "tcp" if given.tcp else "pty"),
                indent=2,
            )
        )
