"""An ADIS16405 behind its SPI port: registers, burst, commands, self-test, faults.

Frames of 16 bits go both ways at once; what a frame asks for comes with the next one.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Iterator

import numpy as np

from firmware_protocols.adis16405 import (
    BURST,
    BURST_WORDS,
    ERROR,
    GYRO_COUNT_DPS,
    GYRO_OFFSET_DPS,
    NEW_DATA,
    PRODUCT_ID,
    Command,
    Diag,
    Misc,
    Register,
    max_spi_hz,
    sample_ticks,
    signed,
)
from firmware_protocols.unconfirmed import (
    ADIS16405_ALARM_SOURCES,
    ADIS16405_DIAG_CLEARS_ON_READ,
    ADIS16405_FLASH_S,
    ADIS16405_GYRO_OFFSET_BITS,
    ADIS16405_PRECISION_AUTONULL_S,
    ADIS16405_RESET_S,
    ADIS16405_SELF_TEST_RESPONSE,
    ADIS16405_SELF_TEST_S,
    ADIS16405_SLEEP_UNIT_S,
    ADIS16405_SOFT_IRON_ONE,
)
from imu_rig.arrays import FloatArray
from simulators.adis16405_signal import Alarm, Settings, SignalPath, natural
from simulators.inertial_sensor import Readings

FEED_HZ = 819.2
"""Samples per second of the motion that the chip is given."""

TICKS_PER_FEED = 2
"""Ticks of its own clock, 1638.4 per second, between them."""

FACTORY = {
    Register.XMAGN_SIF: 0x0800,
    Register.YMAGN_SIF: 0x0800,
    Register.ZMAGN_SIF: 0x0800,
    Register.MSC_CTRL: 0x0006,
    Register.SMPL_PRD: 0x0001,
    Register.SENS_AVG: 0x0402,
}
"""Control registers that are not 0 as the chip leaves the factory."""

GYRO_OFFSETS = (Register.XGYRO_OFF, Register.YGYRO_OFF, Register.ZGYRO_OFF)
ACCEL_OFFSETS = (Register.XACCL_OFF, Register.YACCL_OFF, Register.ZACCL_OFF)
HARD_IRON = (Register.XMAGN_HIF, Register.YMAGN_HIF, Register.ZMAGN_HIF)
SOFT_IRON = (Register.XMAGN_SIF, Register.YMAGN_SIF, Register.ZMAGN_SIF)
CALIBRATION = (*GYRO_OFFSETS, *ACCEL_OFFSETS, *HARD_IRON, *SOFT_IRON)

WRITABLE = (
    *CALIBRATION,
    Register.GPIO_CTRL,
    Register.MSC_CTRL,
    Register.SMPL_PRD,
    Register.SENS_AVG,
    Register.SLP_CNT,
    Register.ALM_MAG1,
    Register.ALM_MAG2,
    Register.ALM_SMPL1,
    Register.ALM_SMPL2,
    Register.ALM_CTRL,
    Register.AUX_DAC,
)

POWER_OFF = 0x0100
"""Bit of SLP_CNT: sleep until the reset line is pulled."""

_OUTPUTS = {int(register): place for place, (register, _, _) in enumerate(BURST)}
_MASKS = tuple((1 << bits) - 1 for _, bits, _ in BURST)
_ALL_NEW = (1 << BURST_WORDS) - 1


class Adis16405Chip:
    """One chip with its registers, fed with what its sensors feel.

    Attributes
    ----------
    failing : Diag
        What a self-test finds wrong.
    flash_broken, flash_corrupt : bool
        Whether a flash update fails, and whether a memory test finds the flash changed.
    connected : bool
        Whether its lines are; without them every answer is 0 and nothing is ready.
    spi_hz : float
        How fast the port is clocked; too fast a frame is an SPI error.
    """

    def __init__(self) -> None:
        self.failing = Diag(0)
        self.flash_broken = self.flash_corrupt = False
        self.connected = True
        self.spi_hz = 0.3e6
        self._flash = {int(register): FACTORY.get(register, 0) for register in WRITABLE}
        self._flash_writes = 0
        self._supply_v, self._aux_v = 5.0, 0.0
        self._path = SignalPath()
        self._row = 0  # of the feed, from the start
        self._numbers = itertools.count()
        self._start()

    def _start(self) -> None:
        self._registers = dict(self._flash)
        self._path = SignalPath()
        self._diag = 0
        self._counts = [0] * BURST_WORDS
        self._new = 0  # bit i: word i of a burst has not been read since it was written
        self._answer = 0
        self._burst: list[int] = []  # words still to come, the last one first
        self._ticks = 0
        self._sampling = True
        self._changed = True  # whether outputs worked out before hold no more
        self._events: list[tuple[int, int, Callable[[], None]]] = []
        self._nulling: list[list[int]] | None = None
        self._apply()

    def _apply(self) -> None:
        """Work out what the registers mean for every sample and frame: they are many."""
        smpl_prd = self._registers[Register.SMPL_PRD]
        self._period = max(TICKS_PER_FEED, sample_ticks(smpl_prd))
        self._max_hz = max_spi_hz(smpl_prd, burst=False)
        self._max_burst_hz = max_spi_hz(smpl_prd, burst=True)
        self._signals = bool(self._misc & Misc.READY_ENABLED)
        self._changed = True

    def reset(self) -> None:
        """Begin anew from the flash, as after a pull of the reset line or a software reset."""
        self._start()
        self._pause(ADIS16405_RESET_S)

    @property
    def supply_v(self) -> float:
        """Supply [V]; 5 unless set."""
        return self._supply_v

    @supply_v.setter
    def supply_v(self, volts: float) -> None:
        self._supply_v, self._changed = volts, True

    @property
    def aux_v(self) -> float:
        """Voltage at the auxiliary input [V]; 0 unless set."""
        return self._aux_v

    @aux_v.setter
    def aux_v(self, volts: float) -> None:
        self._aux_v, self._changed = volts, True

    def play(self, readings: Readings) -> Iterator[bool]:
        """Live through a motion, and stop at every sample of it to be talked to.

        Parameters
        ----------
        readings : Readings
            What the sensors feel, `FEED_HZ` per second, not rounded.

        Yields
        ------
        bool
            Whether the data-ready line was pulsed: the output registers have just been written.
        """
        felt = natural(readings)
        ahead: _Ahead | None = None
        for row in range(len(felt)):
            self._row += 1
            while self._events and self._events[0][0] <= self._row:
                heapq.heappop(self._events)[2]()
            ready = False
            if self._sampling and self._tick():
                if ahead is None or self._changed:
                    if ahead is not None:
                        ahead.settle()
                    ahead = self._look_ahead(felt[row:])
                self._write_outputs(*ahead.next())
                ready = self.connected and self._signals
            yield ready
        if ahead is not None:
            ahead.settle()

    def transfer(self, word: int, *, clocks: int = 16) -> int:
        """Exchange one SPI frame.

        Parameters
        ----------
        word : int
            What the master sends.
        clocks : int
            Clock pulses while the chip was selected; anything but 16 is an SPI error.

        Returns
        -------
        int
            What the chip sends: the answer to the frame before.
        """
        if not (self.connected and self._sampling):
            self._answer = 0
            self._burst.clear()
            return 0
        answer, self._answer = self._answer, 0
        if clocks != 16 or self.spi_hz > (self._max_burst_hz if self._burst else self._max_hz):
            self._diag |= Diag.SPI
            self._burst.clear()
        elif self._burst:
            self._answer = self._burst.pop()
        elif word & 0x8000:
            self._write(word >> 8 & 0x7F, word & 0xFF)
        else:
            self._answer = self._read(word >> 8 & 0x7E)
        return answer

    @property
    def _misc(self) -> int:
        return self._registers[Register.MSC_CTRL]

    def _tick(self) -> bool:
        """Let the clock go on to the next row of the feed; return whether a sample is due."""
        self._ticks += TICKS_PER_FEED
        if self._ticks < self._period:
            return False
        self._ticks %= self._period
        return True

    def _look_ahead(self, felt: FloatArray) -> _Ahead:
        """Work out the outputs from a row at which a sample is due to the last, all at once."""
        self._changed = False
        period = self._period
        number = len(felt) * TICKS_PER_FEED // period + 2
        later = np.arange(number, dtype=np.int64) * period - self._ticks
        rows = np.maximum(0, -(-later // TICKS_PER_FEED))
        return _Ahead(self._path, self._moved(felt[rows[rows < len(felt)]]), self._settings())

    def _moved(self, felt: FloatArray) -> FloatArray:
        """Add what a self-test does to the sensors."""
        sign = bool(self._misc & Misc.POSITIVE_SELF_TEST) - bool(
            self._misc & Misc.NEGATIVE_SELF_TEST
        )
        if not sign:
            return felt
        turn, push = (ADIS16405_SELF_TEST_RESPONSE[key] for key in ("gyro_dps", "accel_g"))
        moved: FloatArray = felt + sign * np.repeat((turn, push, 0.0), (3, 3, 4))
        return moved

    def _settings(self) -> Settings:
        registers = self._registers
        chosen = registers[Register.SENS_AVG]
        return Settings(
            gyro_range=_range(chosen),
            m=min(chosen & 7, 6),
            gyro_offsets_dps=tuple(
                GYRO_OFFSET_DPS * signed(registers[r], ADIS16405_GYRO_OFFSET_BITS)
                for r in GYRO_OFFSETS
            ),
            accel_offsets=tuple(signed(registers[r], 12) for r in ACCEL_OFFSETS),
            mag_offsets=tuple(signed(registers[r], 14) for r in HARD_IRON),
            mag_factors=tuple((registers[r] & 0x0FFF) / ADIS16405_SOFT_IRON_ONE for r in SOFT_IRON),
            supply_v=self._supply_v,
            aux_v=self._aux_v,
            alarms=tuple(self._alarms()),
        )

    def _alarms(self) -> Iterator[Alarm]:
        control = self._registers[Register.ALM_CTRL]
        for shift, register, flag in (
            (8, Register.ALM_MAG1, Diag.ALARM_1),
            (12, Register.ALM_MAG2, Diag.ALARM_2),
        ):
            source = control >> shift & 0xF
            if 1 <= source <= ADIS16405_ALARM_SOURCES:
                limit = self._registers[register]
                _, bits, has_sign = BURST[source - 1]
                threshold = signed(limit, bits) if has_sign else limit & _MASKS[source - 1]
                yield Alarm(source - 1, threshold, bool(limit & 0x8000), flag)

    def _write_outputs(self, counts: list[int], diag: int) -> None:
        self._counts = counts
        self._new = _ALL_NEW
        self._diag |= diag
        if self._nulling is not None:
            self._nulling.append(counts[1:4])

    def _read(self, address: int) -> int:
        if address == Register.GLOB_CMD:
            words = self._outputs()
            self._new = 0
            self._burst = words[:0:-1]
            return words[0]
        if address in _OUTPUTS:
            place = _OUTPUTS[address]
            word = self._output(place)
            self._new &= ~(1 << place)
            return word
        match address:
            case Register.DIAG_STAT:
                diag = self._diag
                if ADIS16405_DIAG_CLEARS_ON_READ:
                    self._diag = 0
                return diag
            case Register.PRODUCT_ID:
                return PRODUCT_ID
            case Register.FLASH_CNT:
                return self._flash_writes & 0xFFFF
        return self._registers.get(address, 0)

    def _outputs(self) -> list[int]:
        if self._new == _ALL_NEW:  # as after every sample
            flags = NEW_DATA | ERROR if self._diag else NEW_DATA
            pairs = zip(self._counts, _MASKS, strict=True)
            return [number & mask | flags for number, mask in pairs]
        return [self._output(place) for place in range(BURST_WORDS)]

    def _output(self, place: int) -> int:
        flags = (NEW_DATA if self._new >> place & 1 else 0) | (ERROR if self._diag else 0)
        return self._counts[place] & _MASKS[place] | flags

    def _write(self, address: int, byte: int) -> None:
        register = address & 0x7E
        if register == Register.GLOB_CMD:
            if address == register:
                self._command(Command(byte))
            return
        if register not in self._registers:
            return  # an output, or nothing at all
        value = self._registers[register]
        value = (value & 0x00FF | byte << 8) if address & 1 else (value & 0xFF00 | byte)
        self._registers[register] = value
        self._apply()
        if register == Register.MSC_CTRL:
            self._begin_tests()
        elif register == Register.SLP_CNT and value:
            self._sleep(value)

    def _begin_tests(self) -> None:
        if self._misc & Misc.INTERNAL_SELF_TEST:
            self._after(ADIS16405_SELF_TEST_S, self._end_self_test)
        if self._misc & Misc.MEMORY_TEST:
            self._after(ADIS16405_SELF_TEST_S, self._end_memory_test)

    def _end_self_test(self) -> None:
        self._clear(Misc.INTERNAL_SELF_TEST)
        if self.failing:
            self._diag |= Diag.SELF_TEST | self.failing

    def _end_memory_test(self) -> None:
        self._clear(Misc.MEMORY_TEST)
        if self.flash_corrupt:
            self._diag |= Diag.FLASH_CHECKSUM

    def _clear(self, bit: Misc) -> None:
        self._registers[Register.MSC_CTRL] &= ~int(bit)

    def _command(self, command: Command) -> None:
        if Command.SOFTWARE_RESET in command:
            self.reset()
            return
        if Command.FACTORY_RESTORE in command:
            self._registers.update({int(r): FACTORY.get(r, 0) for r in CALIBRATION})
            self._changed = True
        if Command.AUTONULL in command:
            self._null([self._counts[1:4]])
        if Command.PRECISION_AUTONULL in command:
            self._nulling = []
            self._after(ADIS16405_PRECISION_AUTONULL_S, self._end_nulling)
        if Command.FLASH_UPDATE in command:
            self._pause(ADIS16405_FLASH_S)
            if self.flash_broken:
                self._diag |= Diag.FLASH_UPDATE
            else:
                self._flash = dict(self._registers)
                self._flash_writes += 1

    def _end_nulling(self) -> None:
        seen, self._nulling = self._nulling, None
        if seen:
            self._null(seen)

    def _null(self, seen: list[list[int]]) -> None:
        """Set the gyroscope offsets so that what was seen would have been zero."""
        count_dps = GYRO_COUNT_DPS[_range(self._registers[Register.SENS_AVG])]
        half = 1 << (ADIS16405_GYRO_OFFSET_BITS - 1)
        for register, mean in zip(GYRO_OFFSETS, np.mean(seen, axis=0).tolist(), strict=True):
            was = signed(self._registers[register], ADIS16405_GYRO_OFFSET_BITS)
            is_now = round(was - mean * count_dps / GYRO_OFFSET_DPS)
            self._registers[register] = max(-half, min(half - 1, is_now)) & (2 * half - 1)
        self._changed = True

    def _sleep(self, value: int) -> None:
        self._sampling = False
        if not value & POWER_OFF:
            self._after((value & 0xFF) * ADIS16405_SLEEP_UNIT_S, self._wake)

    def _pause(self, duration_s: float) -> None:
        self._sampling = False
        self._after(duration_s, self._wake)

    def _wake(self) -> None:
        self._sampling = self._changed = True
        self._registers[Register.SLP_CNT] = 0

    def _after(self, duration_s: float, action: Callable[[], None]) -> None:
        row = self._row + math.ceil(duration_s * FEED_HZ)
        heapq.heappush(self._events, (row, next(self._numbers), action))


class _Ahead:
    """Outputs that have been worked out before their time, for as long as nothing changes."""

    def __init__(self, path: SignalPath, felt: FloatArray, settings: Settings) -> None:
        self._path, self._felt = path, felt
        counts, diag = path.outputs(felt, settings)
        self._counts, self._diag = counts.tolist(), diag.tolist()
        self._used = 0

    def next(self) -> tuple[list[int], int]:
        """Return the next outputs: the words' numbers, and what they set in DIAG_STAT."""
        self._used += 1
        return self._counts[self._used - 1], self._diag[self._used - 1]

    def settle(self) -> None:
        """Let be past what was used."""
        self._path.take(self._felt[: self._used])


def _range(sens_avg: int) -> int:
    """Return the range bits of SENS_AVG, or those of +-300 deg/s where they are none."""
    bits = sens_avg >> 8 & 7
    return bits if bits in GYRO_COUNT_DPS else 4
