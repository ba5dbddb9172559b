"""Clocks: they never go back, scaled time keeps its pace, deadlines expire once."""

import time

import pytest

from imu_rig.clock import NS_PER_S, Deadline, ScaledClock, SteppedClock, SystemClock


@pytest.mark.parametrize("clock", [SystemClock(), ScaledClock(10.0), SteppedClock()])
def test_time_never_goes_back_and_sleep_takes_what_it_says(clock: SystemClock) -> None:
    before = clock.now_ns()
    clock.sleep(0.05)
    slept = (clock.now_ns() - before) / NS_PER_S
    assert slept >= 0.05 * 0.999
    clock.sleep(-1.0)
    readings = [clock.now_ns() for _ in range(100)]
    assert readings == sorted(readings)


def test_a_stall_of_the_process_is_left_out_of_scaled_time() -> None:
    clock = ScaledClock(10.0)
    before = clock.now_ns()
    time.sleep(0.2)  # nobody looks at the clock meanwhile
    passed = (clock.now_ns() - before) / NS_PER_S
    assert passed == pytest.approx(10.0 * ScaledClock.STALL_S, rel=0.1)


def test_scaled_time_stands_where_it_is_held_and_goes_on_without_a_leap() -> None:
    clock = ScaledClock(100.0)
    holder = object()
    held_at = clock.now_ns() + NS_PER_S // 10
    clock.hold(holder, held_at)
    for _ in range(5):
        time.sleep(0.01)
        clock.now_ns()
    assert clock.now_ns() == held_at
    clock.hold(holder, held_at + NS_PER_S)
    assert clock.now_ns() < held_at + NS_PER_S, "the time it was held for is gone"
    clock.sleep(0.8)
    assert held_at + 0.8 * NS_PER_S <= clock.now_ns() <= held_at + NS_PER_S
    clock.hold(holder, None)
    clock.sleep(2.0)
    assert clock.now_ns() >= held_at + 2.8 * NS_PER_S


def test_a_clock_cannot_stand_or_go_back() -> None:
    with pytest.raises(ValueError, match="above 0"):
        ScaledClock(0.0)
    with pytest.raises(ValueError, match="back"):
        SteppedClock().advance(-1.0)


def test_a_deadline_expires_when_its_time_has_come() -> None:
    clock = SteppedClock()
    deadline = Deadline(clock, 2.0)
    clock.advance(1.5)
    assert not deadline.expired
    assert deadline.remaining == pytest.approx(0.5)
    clock.advance(0.6)
    assert deadline.expired
    assert deadline.remaining == 0.0
