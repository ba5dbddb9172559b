"""Make the golden trial of version 1, once and for all: ``python make_golden_trial.py FILE``.

The file in tests/data was made by this and must never change. Everything in it is written out here,
so that the maker cannot drift along with the code it checks.
"""

import json
import struct
import sys
import zlib
from pathlib import Path

SAMPLES = 150
CREATED_NS = 1_790_000_000_000_000_000
HOST_NS = 81_000_000_000_000
CONFIG = {"kind": "golden", "operator": "Jürgen °", "jig": {"pan": [-180, 180.5]}}
LAYOUT = {
    "name": "mpu9150-28",
    "title": "MPU-9150",
    "byte_order": "little",
    "header": "A5 5A",
    "counter": "seq",
    "clock": "time",
    "clock_tick_s": 1e-06,
    "rate_hz": 100.0,
    "fields": [
        {"name": "seq", "type": "u8"},
        {"name": "status", "type": "u8"},
        {"name": "time", "type": "u32", "unit": "us"},
        {"name": "accel", "type": "i16", "count": 3, "unit": "g", "counts_per_unit": 4096.0},
        {"name": "gyro", "type": "i16", "count": 3, "unit": "deg/s", "counts_per_unit": 32.8},
    ],
    "checksum": {"kind": "crc16-ccitt-false"},
}


def crc16(data):
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def packet(number):
    body = struct.pack(
        "<2sBBI6h", b"\xa5\x5a", number % 256, 0, 10_000 * number, 0, number, 4096, -number, 328, 0
    )
    return body + struct.pack("<H", crc16(body))


def golden_trial():
    file_id = b"golden\x00\x01"
    head = struct.pack("<8sHH8sq", b"\x89IMU\r\n\x1a\n", 1, 64, file_id, CREATED_NS)
    parts = 2 * [head + struct.pack("<I", zlib.crc32(head))]

    def record(kind, source, time_ns, payload):
        fields = struct.pack("<BBIIq", kind, source, len(payload), len(parts) - 2, time_ns)
        head_crc = struct.pack("<I", zlib.crc32(file_id + fields))
        crc = struct.pack("<I", zlib.crc32(file_id + fields + payload))
        parts.append(b"\xd3\x91" + fields + head_crc + payload + crc)

    def text(value):
        return json.dumps(value, ensure_ascii=False).encode()

    imu = text({"name": "imu", "kind": "imu", "descriptor": {"layout": LAYOUT, "url": "/dev/x"}})
    servo = text({"name": "maestro", "kind": "servo", "descriptor": {}})
    record(1, 0, 0, text(CONFIG))
    record(1, 0, 0, text(CONFIG))
    record(7, 0, 0, struct.pack("<qq", HOST_NS, CREATED_NS))
    for _ in range(2):
        record(2, 1, 1000, imu)
        record(2, 2, 1000, servo)
    record(5, 0, 2000, text({"name": "pose", "fields": {"index": 3, "angles": [0, 90.5, -1e-3]}}))
    stream = b"".join(map(packet, range(SAMPLES)))
    start = 0
    while start < len(stream):  # pieces of changing length, as a port delivers them
        stop = min(len(stream), start + 24 + start % 7)
        last = (stop - 1) // 24
        record(3, 1, 10_000_000 * last + 2_000_000, stream[start:stop])
        start = stop
    record(4, 2, 100_000_000, b"\x84\x00\x70\x2e")
    record(3, 2, 101_000_000, b"\x70\x2e")
    record(6, 1, 1_510_000_000, text({"reason": "unplugged", "until_s": 2.5}))
    record(200, 9, 1_600_000_000, b"a kind of later times")
    record(8, 0, 1_700_000_000, text({"records": 1, "unwritten_records": 0}))
    record(7, 0, 1_800_000_000, struct.pack("<qq", HOST_NS + 1_800_000_000, CREATED_NS + 18))
    record(9, 0, 1_800_000_000, text({"reason": "interrupted", "records": 1}))
    return b"".join(parts)


if __name__ == "__main__":
    Path(sys.argv[1]).write_bytes(golden_trial())
