"""The Maestro's ramps: the published moves, and laws that hold for every move."""

import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.maestro_motion import TICK_S, Channel, fastest_stop

SPEED_US_PER_S = 25.0
ACCELERATION_US_PER_S2 = 312.5

speeds = st.one_of(st.just(0), st.integers(5, 300))
accelerations = st.integers(0, 255)
targets = st.integers(2560, 9000)


def moving_s(distance_us: int, speed: int, acceleration: int, start: int = 4000) -> float:
    channel = Channel()
    channel.aim(start)
    channel.speed, channel.acceleration = speed, acceleration
    channel.aim(start + 4 * distance_us)
    ticks = 0
    while channel.moving:
        channel.tick()
        ticks += 1
    assert channel.position == start + 4 * distance_us
    return ticks * TICK_S


@pytest.mark.parametrize(
    ("distance_us", "speed", "acceleration", "seconds"),
    [
        (350, 140, 0, 0.10),
        (1000, 1, 0, 40.0),
        (1000, 0, 1, 3.58),
        (1000, 20, 5, 2.32),
        (500, 10, 5, 2.16),
        (900, 40, 4, 1.70),
    ],
)
def test_moves_take_the_published_time(distance_us, speed, acceleration, seconds):
    there = moving_s(distance_us, speed, acceleration)
    back = moving_s(-distance_us, speed, acceleration, start=8000)
    assert there == pytest.approx(seconds, abs=0.03 + 0.02)
    assert back == there


@given(distance=st.integers(1, 6000), speed=st.integers(1, 200), acceleration=st.integers(1, 255))
def test_times_follow_the_closed_form(distance, speed, acceleration):
    v, a = SPEED_US_PER_S * speed, ACCELERATION_US_PER_S2 * acceleration
    expected = 2 * math.sqrt(distance / a) if distance < v * v / a else distance / v + v / a
    assert moving_s(distance, speed, acceleration) == pytest.approx(expected, abs=0.05)


@settings(deadline=None)
@given(
    moves=st.lists(st.tuples(targets, st.integers(1, 60)), min_size=1, max_size=6),
    speed=speeds,
    acceleration=accelerations,
)
def test_whatever_is_asked_limits_hold_and_the_target_is_reached(moves, speed, acceleration):
    channel = Channel()
    channel.aim(6000)
    channel.speed, channel.acceleration = speed, acceleration
    positions = [6000]
    for target, ticks in moves:
        channel.aim(target)
        for _ in range(ticks):
            channel.tick()
            positions.append(channel.position)
    final = moves[-1][0]
    for _ in range(300_000):
        if not channel.moving:
            break
        channel.tick()
        positions.append(channel.position)
    assert channel.position == final
    steps = [b - a for a, b in pairwise(positions)]
    if speed:
        assert max(map(abs, steps), default=0) <= speed + 1
    if acceleration:
        # An acceleration of 1 is an eighth of a quarter microsecond per tick and tick; twice that
        # where a move begins in the tick after another landed.
        changes = [abs(b - a) for a, b in pairwise([0, *steps])]
        assert max(changes, default=0) <= acceleration / 4 + 2


@given(distance=st.integers(0, 5000), acceleration=st.integers(1, 255))
def test_the_fastest_stop_is_the_greatest_speed_that_still_lands(distance, acceleration):
    def way(velocity: int) -> int:
        return sum(range(velocity, 0, -acceleration))

    velocity = fastest_stop(distance, acceleration)
    assert way(velocity) <= distance < way(velocity + 1)


def test_the_first_target_after_power_up_or_release_is_reached_at_once():
    channel = Channel()
    channel.speed, channel.acceleration = 1, 1
    channel.aim(7000)
    assert channel.position == 7000
    channel.aim(6000)
    channel.tick()
    assert 6990 < channel.position <= 7000
    channel.release()
    assert channel.position == 0
    channel.tick()
    assert channel.position == 0
    channel.aim(5000)
    assert channel.position == 5000


def test_without_limits_the_target_is_reached_at_once_and_nothing_moves():
    channel = Channel()
    channel.aim(7000)
    channel.aim(5000)
    assert channel.position == 5000
    assert not channel.moving
