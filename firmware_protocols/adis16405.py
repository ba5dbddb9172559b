"""The ADIS16405's words: registers, SPI frames, the burst of twelve, and what their bits mean.

The sensor speaks SPI in 16-bit frames. Every output register is a right-aligned number below two
flags: ND, data that have not been read yet, and EA, a fault that ``DIAG_STAT`` names. A burst is
twelve such words. They travel on unchanged in the frame of the layout ``adis16405-36``, the same
numbers that a logic analyser shows on the SPI lines.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from firmware_protocols.unconfirmed import ADIS16405_GYRO_FAULT_BITS

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
WordArray = npt.NDArray[np.uint16]

NEW_DATA: Final = 1 << 15
"""ND: the register has been written since it was last read."""

ERROR: Final = 1 << 14
"""EA: a bit of DIAG_STAT is set. Linux defines both masks as this bit, which is a slip."""

PRODUCT_ID: Final = 0x4015
GYRO_OFFSET_DPS: Final = 0.0125
"""One count of a gyroscope offset register [deg/s], in every range."""

GYRO_COUNT_DPS: Final = {4: 0.05, 2: 0.025, 1: 0.0125}
"""One count of a gyroscope [deg/s] by the range in ``SENS_AVG``."""

GYRO_RANGE_DPS: Final = {4: 300.0, 2: 150.0, 1: 75.0}
"""Full scale [deg/s] by the range in ``SENS_AVG``."""

ACCEL_COUNT_G: Final = 3.333e-3
MAG_COUNT_G: Final = 0.5e-3
"""One count of the magnetometer [gauss]."""

SUPPLY_COUNT_V: Final = 2.418e-3
AUX_COUNT_V: Final = 0.806e-3
TEMPERATURE_COUNT_C: Final = 0.14
TEMPERATURE_ZERO_C: Final = 25.0

BASE_RATE_HZ: Final = 1638.4
"""Ticks per second of the fast time base; the slow one ticks every `SLOW_BASE` of them."""

SLOW_BASE: Final = 31

BITS_PER_BYTE: Final = 10
"""Bits that a byte takes on a serial line with one start bit, one stop bit and no parity."""


class Register(IntEnum):
    """Addresses; a register takes two bytes, the low one at the even address."""

    FLASH_CNT = 0x00
    SUPPLY_OUT = 0x02
    XGYRO_OUT = 0x04
    YGYRO_OUT = 0x06
    ZGYRO_OUT = 0x08
    XACCL_OUT = 0x0A
    YACCL_OUT = 0x0C
    ZACCL_OUT = 0x0E
    XMAGN_OUT = 0x10
    YMAGN_OUT = 0x12
    ZMAGN_OUT = 0x14
    TEMP_OUT = 0x16
    AUX_ADC = 0x18
    XGYRO_OFF = 0x1A
    YGYRO_OFF = 0x1C
    ZGYRO_OFF = 0x1E
    XACCL_OFF = 0x20
    YACCL_OFF = 0x22
    ZACCL_OFF = 0x24
    XMAGN_HIF = 0x26
    YMAGN_HIF = 0x28
    ZMAGN_HIF = 0x2A
    XMAGN_SIF = 0x2C
    YMAGN_SIF = 0x2E
    ZMAGN_SIF = 0x30
    GPIO_CTRL = 0x32
    MSC_CTRL = 0x34
    SMPL_PRD = 0x36
    SENS_AVG = 0x38
    SLP_CNT = 0x3A
    DIAG_STAT = 0x3C
    GLOB_CMD = 0x3E
    ALM_MAG1 = 0x40
    ALM_MAG2 = 0x42
    ALM_SMPL1 = 0x44
    ALM_SMPL2 = 0x46
    ALM_CTRL = 0x48
    AUX_DAC = 0x4A
    PRODUCT_ID = 0x56


class Diag(IntFlag):
    """Bits of ``DIAG_STAT``."""

    SUPPLY_LOW = 1 << 0
    SUPPLY_HIGH = 1 << 1
    FLASH_UPDATE = 1 << 2
    SPI = 1 << 3
    OVER_RANGE = 1 << 4
    SELF_TEST = 1 << 5
    FLASH_CHECKSUM = 1 << 6
    ALARM_1 = 1 << 8
    ALARM_2 = 1 << 9
    Z_GYRO = 1 << ADIS16405_GYRO_FAULT_BITS["z"]
    Y_GYRO = 1 << ADIS16405_GYRO_FAULT_BITS["y"]
    X_GYRO = 1 << ADIS16405_GYRO_FAULT_BITS["x"]
    X_ACCEL = 1 << 13
    Y_ACCEL = 1 << 14
    Z_ACCEL = 1 << 15


class Command(IntFlag):
    """Bits of ``GLOB_CMD``, each a command."""

    AUTONULL = 1 << 0
    FACTORY_RESTORE = 1 << 1
    DAC_LATCH = 1 << 2
    FLASH_UPDATE = 1 << 3
    PRECISION_AUTONULL = 1 << 4
    SOFTWARE_RESET = 1 << 7


class Misc(IntFlag):
    """Bits of ``MSC_CTRL``."""

    READY_ON_DIO2 = 1 << 0
    READY_ACTIVE_HIGH = 1 << 1
    READY_ENABLED = 1 << 2
    POINT_OF_PERCUSSION = 1 << 6
    GYRO_G_COMPENSATION = 1 << 7
    POSITIVE_SELF_TEST = 1 << 8
    NEGATIVE_SELF_TEST = 1 << 9
    INTERNAL_SELF_TEST = 1 << 10
    MEMORY_TEST = 1 << 11


BURST: Final = (
    (Register.SUPPLY_OUT, 14, False),
    (Register.XGYRO_OUT, 14, True),
    (Register.YGYRO_OUT, 14, True),
    (Register.ZGYRO_OUT, 14, True),
    (Register.XACCL_OUT, 14, True),
    (Register.YACCL_OUT, 14, True),
    (Register.ZACCL_OUT, 14, True),
    (Register.XMAGN_OUT, 14, True),
    (Register.YMAGN_OUT, 14, True),
    (Register.ZMAGN_OUT, 14, True),
    (Register.TEMP_OUT, 12, True),
    (Register.AUX_ADC, 12, False),
)
"""Register, bits and signedness of each word of a burst, in order."""

BURST_WORDS: Final = len(BURST)
BURST_BYTES: Final = 2 * BURST_WORDS

_MASKS = np.array([(1 << bits) - 1 for _, bits, _ in BURST])
_SIGNS = np.array([(1 << bits >> 1) if signed else 0 for _, bits, signed in BURST])
_LEAST = -_SIGNS
_GREATEST = _MASKS - _SIGNS


@dataclass(frozen=True)
class Bursts:
    """The numbers and flags of ``n`` bursts.

    Attributes
    ----------
    counts : shape (n, 12)
        Supply, gyroscope x y z, accelerometer x y z, magnetometer x y z, temperature, auxiliary
        input; sign-extended.
    new, error : shape (n, 12)
        The flags ND and EA of every word.
    """

    counts: IntArray
    new: BoolArray
    error: BoolArray


def pack_bursts(
    counts: npt.ArrayLike, new: npt.ArrayLike = True, error: npt.ArrayLike = False
) -> bytes:
    """Return bursts as they come over SPI, high byte first.

    Parameters
    ----------
    counts : shape (12,) or (n, 12)
        In the order of `BURST`.
    new, error : broadcast to ``counts``
        The flags ND and EA.

    Raises
    ------
    ValueError
        For a count that does not fit into its word.
    """
    table = np.atleast_2d(np.asarray(counts, dtype=np.int64))
    wrong = (table < _LEAST) | (table > _GREATEST)
    if wrong.any():
        row, place = np.argwhere(wrong)[0].tolist()
        raise ValueError(
            f"{BURST[place][0].name} takes counts of {_LEAST[place]} to {_GREATEST[place]}, "
            f"not {table[row, place]}."
        )
    words = table & _MASKS
    words = words | np.where(new, NEW_DATA, 0) | np.where(error, ERROR, 0)
    packed: bytes = words.astype(">u2").tobytes()
    return packed


def unpack_bursts(data: bytes | bytearray | memoryview) -> Bursts:
    """Return what whole bursts of 24 bytes say: the inverse of :func:`pack_bursts`.

    Raises
    ------
    ValueError
        For a number of bytes that makes no whole bursts.
    """
    if len(data) % BURST_BYTES:
        raise ValueError(f"{len(data)} bytes are no whole bursts of {BURST_BYTES} bytes.")
    words = np.frombuffer(data, dtype=">u2").reshape(-1, BURST_WORDS).astype(np.int64)
    numbers = words & _MASKS
    return Bursts(
        counts=numbers - ((numbers & _SIGNS) << 1),
        new=(words & NEW_DATA) != 0,
        error=(words & ERROR) != 0,
    )


def signed(word: int, bits: int) -> int:
    """Return the low bits of a register as a number of two's complement."""
    number = word & ((1 << bits) - 1)
    return number - ((number & (1 << (bits - 1))) << 1)


def read_frame(register: int) -> int:
    """Return the SPI frame that asks for a register, which comes with the next frame.

    Asking for ``GLOB_CMD`` instead starts a burst: the next twelve frames bring its words.
    """
    return (register & 0x7F) << 8


def write_frames(register: int, value: int) -> tuple[int, int]:
    """Return the two SPI frames that write both bytes of a register, the low one first."""
    return write_frame(register, value & 0xFF), write_frame(register + 1, value >> 8)


def write_frame(address: int, byte: int) -> int:
    """Return the SPI frame that writes one byte."""
    if not (0 <= address < 0x80 and 0 <= byte <= 0xFF):
        raise ValueError(f"no byte of a register: address {address}, value {byte}.")
    return 0x8000 | address << 8 | byte


def sample_rate_hz(smpl_prd: int) -> float:
    """Return the samples per second that a value of ``SMPL_PRD`` gives."""
    return BASE_RATE_HZ / sample_ticks(smpl_prd)


def sample_ticks(smpl_prd: int) -> int:
    """Return the ticks of 1/1638.4 s between samples: bits 6:0 plus one, bit 7 the slow base."""
    return ((smpl_prd & 0x7F) + 1) * (SLOW_BASE if smpl_prd & 0x80 else 1)


def sens_avg(range_bits: int, m: int) -> int:
    """Return ``SENS_AVG`` for a range (4, 2 or 1) and an averager of 2**m taps per stage."""
    if range_bits not in GYRO_RANGE_DPS or not 0 <= m <= 6:
        raise ValueError(f"no SENS_AVG for range {range_bits} and m = {m}: take 4, 2, 1 and 0..6.")
    return range_bits << 8 | m


def averager(m: int) -> npt.NDArray[np.float64]:
    """Return the weights of the averager: two running means of 2**m samples one after the other.

    Returns
    -------
    shape (2**(m+1) - 1,)
        Newest sample first; they sum to 1.
    """
    stage = np.full(1 << m, 1.0 / (1 << m))
    return np.convolve(stage, stage)


def max_spi_hz(smpl_prd: int, *, burst: bool) -> float:
    """Return how fast SPI may be clocked: 2 MHz, 1 MHz in a burst, 0.3 MHz at slow sampling."""
    if smpl_prd & 0x80 or (smpl_prd & 0x7F) >= 0x0A:
        return 0.3e6
    return 1e6 if burst else 2e6


def line_load(frame_bytes: int, rate_hz: float, baud: int = 115_200) -> float:
    """Return the share of a serial line that frames take; above 1 they do not fit."""
    return frame_bytes * BITS_PER_BYTE * rate_hz / baud


def diag_names(diag_stat: int) -> tuple[str, ...]:
    """Return what the set bits of ``DIAG_STAT`` mean, in human words."""
    return tuple(words for flag, words in DIAG_WORDS.items() if diag_stat & flag)


DIAG_WORDS: Final[dict[Any, str]] = {
    Diag.SUPPLY_LOW: "supply below 4.75 V",
    Diag.SUPPLY_HIGH: "supply above 5.25 V",
    Diag.FLASH_UPDATE: "flash update failed",
    Diag.SPI: "SPI transfer of wrong length",
    Diag.OVER_RANGE: "sensor over range",
    Diag.SELF_TEST: "self-test failed",
    Diag.FLASH_CHECKSUM: "flash checksum wrong",
    Diag.ALARM_1: "alarm 1",
    Diag.ALARM_2: "alarm 2",
    Diag.Z_GYRO: "self-test failed: gyroscope z",
    Diag.Y_GYRO: "self-test failed: gyroscope y",
    Diag.X_GYRO: "self-test failed: gyroscope x",
    Diag.X_ACCEL: "self-test failed: accelerometer x",
    Diag.Y_ACCEL: "self-test failed: accelerometer y",
    Diag.Z_ACCEL: "self-test failed: accelerometer z",
}
"""What each bit of ``DIAG_STAT`` means; the layout names its faults in the same words."""
