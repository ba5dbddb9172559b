"""Messages of MAVLink as pymavlink, the authority here, puts them on the wire."""

import math
import struct

import numpy as np
from pymavlink.dialects.v10 import common as version_1
from pymavlink.dialects.v20 import common as mavlink

INTEGERS = {"b": 1, "B": 1, "h": 2, "H": 2, "i": 4, "I": 4, "q": 8, "Q": 8}


class Writer:
    """Encodes messages, one sequence number after the other."""

    def __init__(self, system=1, component=1, *, version=2, key=None):
        self.dialect = mavlink if version == 2 else version_1
        self.mav = self.dialect.MAVLink(None, srcSystem=system, srcComponent=component)
        if key is not None:
            self.mav.signing.secret_key = key
            self.mav.signing.sign_outgoing = True
            self.mav.signing.link_id = 3
            self.mav.signing.timestamp = 0x123456789A

    def __call__(self, name, *fields):
        message = getattr(self.dialect, f"MAVLink_{name.lower()}_message")(*fields)
        frame = bytes(message.pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) % 256
        return frame

    def highres(self, t_us=0, acc=(0, 0, -9.81), gyro=(0, 0, 0), mag=(0.2, 0, 0.4), updated=0x1FFF):
        tail = (1013.25, 0.0, 0.0, 25.0, updated)
        return self("HIGHRES_IMU", t_us, *acc, *gyro, *mag, *tail)

    def scaled(
        self, t_ms=0, acc=(0, 0, -1000), gyro=(0, 0, 0), mag=(200, 0, 400), name="SCALED_IMU"
    ):
        return self(name, t_ms, *acc, *gyro, *mag)

    def heartbeat(self, kind=2, autopilot=12):
        return self("HEARTBEAT", kind, autopilot, 0, 0, 3, 3)


def parsed(data):
    """What pymavlink's own parser makes of bytes."""
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    return parser.parse_buffer(bytes(data)) or []


def numbers_of(message):
    """Every number of a message of pymavlink in the order of the wire; texts as bytes."""
    result = []
    for name in message.ordered_fieldnames:
        value = getattr(message, f"_{name}_raw", getattr(message, name))
        result += list(value) if isinstance(value, list | tuple) else [value]
    return result


def random_fields(message, rng):
    """Values over the whole range of every field of a message class, in the order of its fields."""
    made = {}
    codes = struct_codes(message)
    for name, (code, count) in codes.items():
        if code == "s":
            made[name] = bytes(rng.integers(65, 91, rng.integers(0, count + 1), dtype=np.uint8))
            continue
        values = [_random(code, rng) for _ in range(count)]
        made[name] = values if message.array_lengths[list(codes).index(name)] else values[0]
    return [made[name] for name in message.fieldnames]


def struct_codes(message):
    """Code and count of every field in the order of the wire."""
    codes = message.native_format.decode().lstrip("<")
    found = {}
    for name, code, length in zip(
        message.ordered_fieldnames, codes, message.array_lengths, strict=True
    ):
        found[name] = ("s" if code == "c" else code, max(1, length))
    return found


def _random(code, rng):
    if code in INTEGERS:
        bits = 8 * INTEGERS[code]
        low = -(2 ** (bits - 1)) if code.islower() else 0
        high = low + 2**bits - 1
        anything = low + int.from_bytes(rng.bytes(INTEGERS[code]), "little")
        return [low, high, 0, 1, anything, anything][rng.integers(6)]
    exponent = float(rng.uniform(-30, 30))
    value = float(rng.choice([0.0, 1.0, -1.0, math.copysign(10**exponent, rng.normal())]))
    return struct.unpack("<f", struct.pack("<f", value))[0]
