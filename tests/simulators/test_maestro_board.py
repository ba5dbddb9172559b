"""The simulated Maestro, byte by byte, as the guide describes the board."""

import numpy as np
import pytest

from firmware_protocols.maestro import (
    GetErrors,
    GetMovingState,
    GetPosition,
    GetScriptStatus,
    GoHome,
    MaestroErrors,
    MiniSscTarget,
    RestartScript,
    SetAcceleration,
    SetMultipleTargets,
    SetPwm,
    SetSpeed,
    SetTarget,
    StopScript,
    crc7,
    decode_reply_u16,
    encode,
)
from simulators.maestro_board import MaestroBoard
from simulators.models import MaestroModel


class Desk:
    """A board, its wires and a watch."""

    def __init__(self, mode="usb-dual-port", **settings) -> None:
        self.board = MaestroBoard(MaestroModel(**settings), mode, np.random.default_rng(1))
        self.now_s = 0.0

    def send(self, data: bytes) -> bytes:
        self.board.receive(data, self.now_s)
        return self.board.outbox.take(self.now_s)

    def ask(self, command) -> int:
        return decode_reply_u16(self.send(encode(command)))

    def errors(self) -> MaestroErrors:
        return MaestroErrors(self.ask(GetErrors()))

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.01)):
            self.now_s += 0.01
            self.board.tick(self.now_s)


@pytest.fixture
def desk() -> Desk:
    return Desk()


def test_the_dialogue_of_the_guide_byte_for_byte(desk):
    assert desk.send(bytes.fromhex("84 00 70 2E")) == b""
    assert desk.send(bytes.fromhex("90 00")) == bytes.fromhex("70 17")
    assert desk.send(bytes.fromhex("AA 0C 04 02 70 2E")) == b""
    assert desk.send(bytes.fromhex("AA 0C 10 02")) == bytes.fromhex("70 17")
    assert desk.send(bytes.fromhex("9F 02 03 00 00 70 2E")) == b""
    assert desk.send(bytes.fromhex("90 03 90 04")) == bytes.fromhex("00 00 70 17")
    assert desk.send(bytes.fromhex("93")) == b"\x00"
    assert desk.send(bytes.fromhex("A1")) == b"\x00\x00"
    assert desk.send(bytes.fromhex("AE")) == b"\x01"
    assert desk.board.pulses_us()[:5] == [1500.0, 0.0, 1500.0, 0.0, 1500.0]


def test_commands_may_arrive_in_any_pieces(desk):
    stream = encode(SetTarget(1, 7000)) + encode(GetPosition(1), device=12) + b"\xff\x02\x7f"
    assert b"".join(desk.send(bytes((byte,))) for byte in stream) == (7000).to_bytes(2, "little")
    assert desk.board.pulses_us()[2] == 1500.0


def test_another_boards_commands_are_none_of_its_business(desk):
    desk.send(encode(SetTarget(0, 6000), device=13))
    assert desk.ask(GetPosition(0)) == 0
    assert desk.errors() == MaestroErrors(0)


def test_mini_ssc_values_span_the_8_bit_range(desk):
    for value, target in ((0, 4095), (127, 6000), (254, 7905)):
        desk.send(encode(MiniSscTarget(0, value)))
        assert desk.ask(GetPosition(0)) == target


def test_targets_are_clamped_to_limits_kept_in_steps_of_16_us():
    desk = Desk(min_us=992.0, max_us=2000.0)
    for target, got in ((3000, 3968), (9000, 8000), (0, 0)):
        desk.send(encode(SetTarget(5, target)))
        assert desk.ask(GetPosition(5)) == got
    assert Desk(min_us=901.0).board._least == 896 * 4


def test_a_limited_move_ramps_and_shows_in_position_and_moving_state(desk):
    desk.send(encode(SetTarget(0, 6000)))
    desk.send(encode(SetSpeed(0, 40)) + encode(SetAcceleration(0, 4)))
    desk.send(encode(SetTarget(0, 6000 + 3600)))
    assert desk.send(encode(GetMovingState())) == b"\x01"
    greatest = round(desk.board.model.max_us * 4)
    before = 6000
    while desk.send(encode(GetMovingState())) == b"\x01":
        desk.run(0.01)
        now = desk.ask(GetPosition(0))
        assert before <= now <= greatest
        before = now
    assert before == greatest


def test_go_home_and_target_0_stop_the_pulses(desk):
    desk.send(encode(SetMultipleTargets(0, (6000, 6100, 6200))))
    desk.send(encode(SetTarget(1, 0)))
    assert [desk.ask(GetPosition(c)) for c in range(3)] == [6000, 0, 6200]
    desk.send(encode(GoHome()))
    assert [desk.ask(GetPosition(c)) for c in range(3)] == [0, 0, 0]


@pytest.mark.parametrize(
    ("mistake", "error"),
    [
        (bytes.fromhex("80"), MaestroErrors.SERIAL_PROTOCOL),
        (bytes.fromhex("05"), MaestroErrors.SERIAL_PROTOCOL),
        (bytes.fromhex("84 00 70 90 00"), MaestroErrors.SERIAL_PROTOCOL),
        (encode(SetTarget(20, 6000)), MaestroErrors.SERIAL_PROTOCOL),
        (encode(RestartScript(0)), MaestroErrors.SCRIPT_PROGRAM_COUNTER),
    ],
)
def test_any_error_sends_every_servo_home_and_stays_until_read(desk, mistake, error):
    desk.send(encode(SetTarget(0, 6000)) + encode(SetTarget(3, 6000)))
    desk.send(mistake)
    assert [desk.ask(GetPosition(c)) for c in (0, 3)] == [0, 0]
    desk.send(encode(SetTarget(0, 6000)))
    assert desk.ask(GetPosition(0)) == 6000
    assert desk.errors() == error
    assert desk.errors() == MaestroErrors(0)


def test_channels_whose_home_is_ignore_keep_their_position():
    desk = Desk(home="ignore")
    desk.send(encode(SetTarget(0, 6000)))
    desk.send(b"\x05")
    assert desk.ask(GetPosition(0)) == 6000
    assert desk.errors() == MaestroErrors.SERIAL_PROTOCOL


def test_a_wrong_crc_is_refused_and_a_right_one_obeyed():
    desk = Desk(crc=True)
    desk.send(encode(SetTarget(0, 6000), crc=True))
    assert desk.send(encode(GetPosition(0), crc=True)) == bytes.fromhex("70 17")
    good = encode(SetTarget(1, 6000), crc=True)
    desk.send(good[:-1] + bytes((good[-1] ^ 1,)))
    assert decode_reply_u16(desk.send(encode(GetPosition(1), crc=True))) == 0
    reply = desk.send(encode(GetErrors(), crc=True))
    assert MaestroErrors(decode_reply_u16(reply)) == MaestroErrors.SERIAL_CRC
    assert good[-1] == crc7(good[:-1])


def test_silence_longer_than_the_timeout_is_an_error():
    desk = Desk(timeout_s=0.5)
    desk.run(2.0)  # the watch starts with the first command
    desk.send(encode(SetTarget(0, 6000)))
    for _ in range(4):
        desk.run(0.4)
        assert desk.ask(GetPosition(0)) == 6000
    desk.run(0.55)
    assert desk.board.pulses_us()[0] == 0.0
    assert desk.errors() == MaestroErrors.SERIAL_TIMEOUT


def test_from_the_factory_the_command_port_is_deaf():
    desk = Desk(mode="uart-detect")
    assert desk.send(b"\xaa" + encode(SetTarget(0, 6000)) + encode(GetPosition(0))) == b""
    assert desk.board.pulses_us()[0] == 0.0
    chained = Desk(mode="usb-chained")
    assert chained.send(encode(GetErrors())) == b"\x00\x00"


def test_a_micro_maestro_lacks_the_commands_of_the_mini():
    micro = Desk(channels=6)
    assert micro.send(encode(GetErrors())) == b"\x00\x00"
    for command in (SetMultipleTargets(0, (6000,)), SetPwm(100, 200), SetTarget(6, 6000)):
        micro.send(encode(command))
        assert micro.errors() == MaestroErrors.SERIAL_PROTOCOL
    mini = Desk(channels=24)
    mini.send(encode(SetMultipleTargets(22, (6000, 6004))) + encode(SetPwm(100, 200)))
    assert mini.ask(GetPosition(23)) == 6004
    assert mini.errors() == MaestroErrors(0)


def test_the_empty_script_is_stopped(desk):
    desk.send(encode(StopScript()))
    assert desk.send(encode(GetScriptStatus())) == b"\x01"
    assert desk.errors() == MaestroErrors(0)
