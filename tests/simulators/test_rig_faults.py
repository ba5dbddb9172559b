"""Every fault word does what it says, seen through the bytes of the devices."""

import numpy as np
import pytest

from firmware_protocols.maestro import GetPosition, SetSpeed, SetTarget, decode_reply_u16
from imu_rig.units import DEG
from simulators.config import RigConfig
from simulators.encoders import STATUS_RESTARTED
from simulators.faults import SUPPORTED, PlannedFault

ROLL = 2


@pytest.fixture
def host(talk):
    """A rig without errors but for a little noise, already running."""
    ideal = RigConfig.ideal()
    noisy = ideal.sensor.model_copy(update={"accel_noise_ug": 400.0})
    started = talk(ideal.model_copy(update={"sensor": noisy}))
    started.send(SetTarget(0, 6000), SetTarget(1, 5700), SetTarget(ROLL, 6000))
    started.run(1.0)
    return started


def seconds_of(rows) -> np.ndarray:
    return rows["time"].astype(np.int64) * 1e-6


def position(host) -> int:
    return decode_reply_u16(host.send(GetPosition(ROLL)))


def roll_deg(host) -> float:
    return host.world.state().angles_deg["roll"]


def test_an_imu_that_is_off_says_nothing_and_counts_on(host):
    host.world.fault("imu", "off", 0.5)
    assert len(host.run(0.5)) == 0
    rows = host.run(0.5)
    assert len(rows) == 50
    assert rows["time"][0] == 1_510_000
    assert rows["seq"][0] == 150
    assert host.decoder.stats.lost == 50


def test_a_stuck_imu_repeats_its_last_sample_while_counter_and_clock_go_on(host):
    before = host.run(0.1)
    host.world.fault("imu", "stuck")
    rows = host.run(0.5)
    assert (rows["accel"] == before["accel"][-1]).all()
    assert (np.diff(rows["time"].astype(int)) == 10_000).all()
    assert host.decoder.stats.lost == 0
    host.world.clear("imu")
    assert len(np.unique(host.run(0.5)["accel"], axis=0)) > 40


def test_an_imu_that_sends_garbage_sends_as_much_of_it(host):
    host.world.fault("imu", "garbage", 1.0)
    start = host.decoder.stats.skipped_bytes
    assert len(host.run(1.0)) == 0
    assert len(host.run(0.2)) == 20
    assert host.decoder.stats.skipped_bytes - start == 100 * 28


def test_a_wrong_imu_is_well_formed_and_half_too_large(host):
    host.world.fault("imu", "wrong")
    rows = host.run(0.5)
    assert len(rows) == 50
    assert host.accel(rows).mean(axis=0) == pytest.approx([0, 0, 1.5 * 9.80665], abs=0.02)


def test_a_slow_imu_sends_half_as_often_by_a_right_clock(host):
    host.world.fault("imu", "slow")
    rows = host.run(2.0)
    assert len(rows) == 100
    assert np.diff(seconds_of(rows)) == pytest.approx(np.full(99, 0.02))
    assert host.decoder.stats.lost == 0


def test_a_delayed_imu_arrives_0_6_s_late_and_loses_nothing(host):
    host.world.fault("imu", "delayed")
    assert len(host.run(0.6)) == 0
    rows = host.run(1.0)
    assert seconds_of(rows)[-1] == pytest.approx(2.0, abs=0.011)
    host.world.clear("imu")
    host.run(1.0)
    assert host.decoder.stats.lost == 0
    assert host.decoder.stats.good == 360


def test_an_intermittent_imu_is_silent_for_0_35_s_of_every_second(host):
    host.world.fault("imu", "intermittent")
    t = seconds_of(host.run(4.0))
    gaps = np.diff(t)
    assert (gaps > 0.3).sum() == 3
    assert gaps.max() == pytest.approx(0.36, abs=0.011)
    assert len(t) == pytest.approx(4 * 65, abs=4)


@pytest.mark.parametrize(("word", "silent_s"), [("brownout", 0.8), ("reset", 0.0)])
def test_a_restarted_imu_begins_from_zero_after_its_silence(host, word, silent_s):
    host.world.fault("imu", word)
    assert len(host.run(silent_s)) == 0
    rows = host.run(1.5)
    assert rows["time"][0] == 10_000
    assert rows["seq"][0] == 0
    assert len(rows) == 150
    assert (rows["status"][:99] == STATUS_RESTARTED).all()
    assert not rows["status"][100:].any()
    # The first sample after the restart knows nothing of the time before it.
    assert host.accel(rows)[0] == pytest.approx([0, 0, 9.8], abs=0.3)


def test_a_maestro_that_is_off_neither_answers_nor_obeys(host):
    host.world.fault("maestro", "off")
    assert host.send(GetPosition(ROLL), SetTarget(ROLL, 7000)) == b""
    host.world.clear("maestro")
    assert position(host) == 6000


def test_a_stuck_maestro_answers_with_positions_of_the_past(host):
    host.world.fault("maestro", "stuck")
    host.send(SetTarget(ROLL, 6600))
    host.run(2.0)
    assert position(host) == 6000
    assert roll_deg(host) == pytest.approx(95.0, abs=0.1)
    host.world.clear("maestro")
    assert position(host) == 6600


def test_a_maestro_that_sends_garbage_answers_two_random_bytes(host):
    host.world.fault("maestro", "garbage")
    replies = {host.send(GetPosition(ROLL)) for _ in range(20)}
    assert {len(reply) for reply in replies} == {2}
    assert len(replies) > 15


def test_a_wrong_maestro_reports_400_too_much(host):
    host.world.fault("maestro", "wrong")
    assert position(host) == 6400


@pytest.mark.parametrize(("word", "late_s"), [("slow", 0.3), ("delayed", 0.6)])
def test_late_replies_come_in_order_after_their_delay(host, word, late_s):
    host.world.fault("maestro", word)
    assert host.send(GetPosition(ROLL)) == b""
    host.run(late_s - 0.01)
    assert host.send(SetTarget(ROLL, 6004)) == b""
    host.world.clear("maestro")
    assert host.send(GetPosition(ROLL)) == b""
    host.run(0.02)
    assert host.world.take("maestro") == bytes.fromhex("70 17 74 17")


def test_an_intermittent_maestro_answers_only_at_times(host):
    host.world.fault("maestro", "intermittent")
    answered = []
    for _ in range(100):
        answered.append(len(host.send(GetPosition(ROLL))) == 2)
        host.run(0.02)
    assert sum(answered) == pytest.approx(65, abs=3)
    assert not any(answered[:17])


@pytest.mark.parametrize(("word", "silent_s"), [("brownout", 0.5), ("reset", 0.0)])
def test_a_restarted_maestro_forgets_positions_and_settings_and_drops_the_servos(
    host, word, silent_s
):
    host.send(SetSpeed(ROLL, 4), SetTarget(ROLL, 6600))
    host.run(1.0)
    host.world.fault("maestro", word)
    if silent_s:
        host.run(silent_s - 0.02)
        assert host.send(GetPosition(ROLL)) == b""
        host.run(0.03)
    assert position(host) == 0
    host.run(1.0)
    limp = roll_deg(host)
    assert 5.0 < limp < 90.0
    host.run(1.0)
    assert roll_deg(host) == limp
    host.send(SetTarget(ROLL, 6000))
    assert position(host) == 6000  # at once: neither position nor speed limit is known any more


@pytest.mark.parametrize("word", ["off", "stuck"])
def test_a_dead_servo_stays_where_it_is_and_recovers(host, word):
    host.world.fault("roll", word, 2.0)
    host.send(SetTarget(ROLL, 6600))
    host.run(1.9)
    assert roll_deg(host) == pytest.approx(0.0, abs=0.01)
    assert position(host) == 6600
    host.run(2.0)
    assert roll_deg(host) == pytest.approx(95.0, abs=0.1)


def test_a_wrong_servo_goes_15_degrees_off(host):
    host.world.fault("roll", "wrong")
    host.run(1.0)
    assert roll_deg(host) == pytest.approx(15.0, abs=0.01)
    host.world.clear("roll")
    host.run(1.0)
    assert roll_deg(host) == pytest.approx(0.0, abs=0.01)


def test_a_slow_servo_turns_at_a_quarter_of_its_speed(host):
    host.world.fault("roll", "slow")
    host.send(SetTarget(ROLL, 6600))
    rows = host.run(2.0)
    fastest = host.gyro(rows)[:, 0].max() / DEG
    assert fastest == pytest.approx(108.0 / 4, rel=0.02)


def test_an_intermittent_servo_stops_on_the_way(host):
    host.world.fault("roll", "intermittent")
    host.send(SetTarget(ROLL, 6900))
    rate = np.abs(host.gyro(host.run(3.0))[:, 0]) / DEG
    moving = rate > 1.0
    assert (np.diff(moving.astype(int)) == 1).sum() >= 2
    assert roll_deg(host) == pytest.approx(142.5, abs=0.1)


def test_unplugged_devices_are_gone_from_the_host_and_run_on(host):
    host.world.fault("imu", "unplug", 0.5)
    assert not host.world.plugged("imu")
    assert host.world.plugged("maestro")
    host.run(0.5)
    assert host.world.plugged("imu")


def test_faults_add_up_and_clearing_ends_them_all(host):
    host.world.fault("imu", "wrong")
    host.world.fault("imu", "slow", 1.0)
    rows = host.run(1.0)
    assert len(rows) == 50
    assert host.accel(rows)[:, 2].mean() == pytest.approx(1.5 * 9.80665, abs=0.02)
    assert host.world.state().faults["imu"]
    assert len(host.run(1.0)) == 100
    host.world.clear("imu")
    assert not host.world.state().faults["imu"]
    assert host.accel(host.run(0.5))[:, 2].mean() == pytest.approx(9.80665, abs=0.01)


def test_planned_faults_come_by_themselves(talk):
    plan = (
        PlannedFault(at_s=1.0, device="imu", word="off", duration_s=0.5),
        PlannedFault(at_s=2.0, device="imu", word="reset"),
    )
    host = talk(RigConfig.ideal().model_copy(update={"faults": plan}))
    t = seconds_of(host.run(3.0))
    assert t[99:101] == pytest.approx([1.0, 1.51])
    # What the radio still holds at a reset, here the sample of that moment, is never sent.
    assert t[148:150] == pytest.approx([1.99, 0.01])
    assert len(t) == 249


@pytest.mark.parametrize(
    ("device", "word", "duration_s", "says"),
    [
        ("imu", "tired", None, "it supports off, stuck, garbage, wrong, slow, delayed"),
        ("pan", "unplug", None, "it supports off, stuck, wrong, slow, intermittent"),
        ("arm", "off", None, "take one of imu, maestro, pan, tilt, roll"),
        ("imu", "off", 0.0, "above 0 s|greater than 0"),
        ("imu", "off", float("nan"), "above 0 s|finite number"),
        ("maestro", "reset", 1.0, "leave its duration out"),
    ],
)
def test_what_cannot_be_had_is_refused_with_what_can(host, device, word, duration_s, says):
    with pytest.raises(ValueError, match=says):
        host.world.fault(device, word, duration_s)
    with pytest.raises(ValueError, match=says):
        PlannedFault(at_s=0.0, device=device, word=word, duration_s=duration_s)


def test_every_promised_word_is_accepted_by_its_device(host):
    for device, words in SUPPORTED.items():
        for word in words:
            host.world.fault(device, word)
            host.run(0.05)
            host.world.clear(device)
    host.run(1.0)
    assert len(host.run(1.0)) == 100
