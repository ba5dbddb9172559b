"""Make the golden trial of several devices: ``python make_golden_devices.py FILE``.

It has what a recorder of many devices writes: statistics of each, a device that was unplugged,
markers, a certificate. Like the first golden trial, the file in tests/data must never change.
"""

import json
import struct
import sys
import zlib
from pathlib import Path

from make_golden_trial import LAYOUT, crc16, packet

CREATED_NS = 1_790_000_000_000_000_000
HOST_NS = 4_000_000_000_000
STEP_NS = 10_000_000
SAMPLES = 300
UNPLUGGED = range(120, 180)  # numbers of the packets that the right shoe sent to nobody
LATE_NS = 2_000_000
CONFIG = {
    "kind": "trial",
    "subject": "P07",
    "session": "morning",
    "trial": "walk 3",
    "note": "Schuhgröße 42, left knee °",
    "imu_rig": "0.1.0",
}
CERTIFICATE = {"schema": "imu-rig/certificate", "version": 1, "device": {"serial": "007"}}
PRESSURE_LAYOUT = {
    "name": "baro-16",
    "title": "Barometer",
    "byte_order": "little",
    "header": "A5 5C",
    "counter": "seq",
    "clock": "time",
    "clock_tick_s": 1e-06,
    "rate_hz": 10.0,
    "fields": [
        {"name": "seq", "type": "u8"},
        {"name": "battery", "type": "u8", "unit": "%"},
        {"name": "time", "type": "u32", "unit": "us"},
        {"name": "pressure", "type": "u32", "unit": "Pa", "counts_per_unit": 100.0},
        {"name": "temperature", "type": "i16", "unit": "degC", "counts_per_unit": 100.0},
    ],
    "checksum": {"kind": "crc16-ccitt-false"},
}
SOURCES = {
    1: ("left shoe", {"layout": LAYOUT, "url": "usb:007", "certificate": CERTIFICATE}),
    2: ("right shoe", {"layout": LAYOUT, "url": "usb:008"}),
    3: ("barometer", {"layout": PRESSURE_LAYOUT, "url": "socket://127.0.0.1:9"}),
}


def pressure_packet(number):
    fields = number, 90, 100_000 * number, 10_132_500 + number, 2150
    body = struct.pack("<2sBBIIh", b"\xa5\x5c", *fields)
    return body + struct.pack("<H", crc16(body))


def device_statistics(packets, lost, reconnects):
    return {
        "state": "live",
        "rate_hz": 100.0,
        "packets": packets,
        "lost": lost,
        "corrupt": 0,
        "duplicates": 0,
        "restarts": 0,
        "reconnects": reconnects,
        "gaps": reconnects,
    }


def golden_devices():
    file_id = b"golden\x00\x02"
    head = struct.pack("<8sHH8sq", b"\x89IMU\r\n\x1a\n", 1, 64, file_id, CREATED_NS)
    parts = 2 * [head + struct.pack("<I", zlib.crc32(head))]

    def record(kind, source, time_ns, payload):
        if isinstance(payload, dict):
            payload = json.dumps(payload, ensure_ascii=False).encode()
        fields = struct.pack("<BBIIq", kind, source, len(payload), len(parts) - 2, time_ns)
        head_crc = struct.pack("<I", zlib.crc32(file_id + fields))
        crc = struct.pack("<I", zlib.crc32(file_id + fields + payload))
        parts.append(b"\xd3\x91" + fields + head_crc + payload + crc)

    def clock_pair(time_ns):
        record(7, 0, time_ns, struct.pack("<qq", HOST_NS + time_ns, CREATED_NS + time_ns))

    def describe():
        for number, (name, descriptor) in SOURCES.items():
            kind = "imu" if "accel" in str(descriptor) else "sensor"
            record(2, number, 0, {"name": name, "kind": kind, "descriptor": descriptor})

    for _ in range(2):
        record(1, 0, 0, CONFIG)
    clock_pair(0)
    describe()
    describe()
    record(5, 0, 5_000_000, {"name": "all_live", "fields": {}})
    gap_ns = UNPLUGGED.start * STEP_NS
    for number in range(SAMPLES):
        time_ns = number * STEP_NS + LATE_NS
        record(3, 1, time_ns, packet(number))
        if number not in UNPLUGGED:
            record(3, 2, time_ns, packet(number))
        if number % 10 == 0:
            record(3, 3, time_ns + 1, pressure_packet(number // 10))
        if number == UNPLUGGED.start:
            record(6, 2, gap_ns, {"reason": "unplugged"})
        if number == UNPLUGGED.stop:
            gap = {
                "reason": "unplugged",
                "until_s": time_ns / 1e9,
                "counter_before": UNPLUGGED.start - 1,
                "counter_after": UNPLUGGED.stop % 256,
                "restarted": False,
            }
            record(6, 2, gap_ns, gap)
        if number in (90, 210):
            record(5, 0, time_ns, {"name": "marker", "fields": {"label": f"turn {number} °"}})
        if number % 100 == 99:
            second_ns = (number + 1) * STEP_NS
            lost = len([n for n in UNPLUGGED if n <= number])
            recorder = {
                "records": len(parts) - 2,
                "unwritten_records": 0,
                "latency_p99_s": 0.004,
                "latency_max_s": 0.006,
            }
            clock_pair(second_ns)
            record(8, 0, second_ns, recorder)
            record(8, 1, second_ns, device_statistics(number + 1, 0, 0))
            record(8, 2, second_ns, device_statistics(number + 1 - lost, lost, int(lost > 0)))
    record(1, 0, 0, CONFIG)
    describe()
    record(9, 0, SAMPLES * STEP_NS, {"reason": "complete", "records": len(parts) - 2})
    return b"".join(parts)


if __name__ == "__main__":
    Path(sys.argv[1]).write_bytes(golden_devices())
