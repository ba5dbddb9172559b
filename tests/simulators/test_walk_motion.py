"""A simulated person goes as people do: feet that rest and roll, a waist that bobs and sways."""

import itertools

import numpy as np
import pytest

from imu_rig.units import STANDARD_GRAVITY
from simulators.walker.feet import SOLE_M, Phase
from simulators.walker.gait import gait_at
from simulators.walker.jets import add, constant
from simulators.walker.path import Stairs, Station, Straight, Turn, on_pieces, plan_length, through
from simulators.walker.scenarios import CORRIDOR, SCENARIOS, Scenario, scenario_of
from simulators.walker.sensor import Placement
from simulators.walker.steps import Manner, Stand, Walk
from simulators.walker.truth import stride_lengths
from simulators.walker.walker import Surroundings, Walker


def walker(*pieces, speed=1.3, seed=1, manner=None):
    legs = (Stand(1.0), Walk(pieces, (speed,)), Stand(1.0))
    ideal = Surroundings.ideal()
    return Walker(Scenario("test", "Test", legs), seed, manner=manner, surroundings=ideal)


class Sole:
    """Ball and heel of a foot at many moments."""

    def __init__(self, person, foot="left-foot", step_s=0.002):
        mover = person.sensor(foot).mover
        self.t = np.arange(0.0, person.end_s, step_s)
        motion = mover.motion(self.t)
        self.phase = mover.phase(self.t)
        self.pitch = np.degrees(motion.pitch.value)
        heel = add(motion.origin, motion.turned(constant((-SOLE_M, 0, 0), motion.yaw)))
        self.ball, self.heel = (
            np.stack([axis.value for axis in p], axis=1) for p in (motion.origin, heel)
        )
        self.ball_speed, self.heel_speed = (
            np.linalg.norm([axis.rate for axis in p], axis=0) for p in (motion.origin, heel)
        )


STRAIGHT = walker(Straight(20.0))
SOLE = Sole(STRAIGHT)


def test_the_point_of_the_sole_on_the_ground_rests():
    flat, strike = SOLE.phase == Phase.FLAT, SOLE.phase == Phase.STRIKE
    assert flat.sum() > 1000
    assert strike.sum() > 300
    assert SOLE.ball_speed[flat].max() < 1e-9
    assert np.abs(SOLE.ball[flat, 2]).max() < 1e-12
    assert SOLE.heel_speed[strike].max() < 1e-9
    assert np.abs(SOLE.heel[strike, 2]).max() < 1e-12
    # The sole still turns a little about its ball: a sensor above it creeps.
    assert 0.0 < SOLE.heel_speed[flat].max() < 0.05


def test_the_foot_stays_above_level_ground_and_clears_it():
    assert min(SOLE.ball[:, 2].min(), SOLE.heel[:, 2].min()) > -1e-9
    middle = np.flatnonzero(np.diff((SOLE.phase == Phase.SWING).astype(int)) == 1)[2] + 100
    assert SOLE.ball[middle, 2] > 0.01


def test_pitch_goes_from_toe_up_at_the_strike_to_toe_down_after_push_off():
    assert -32.0 < SOLE.pitch.min() < -18.0
    assert 55.0 < SOLE.pitch.max() < 75.0
    strikes = (SOLE.phase[:-1] == Phase.SWING) & (SOLE.phase[1:] == Phase.STRIKE)
    struck = np.flatnonzero(strikes) + 1
    assert len(struck) > 10
    assert np.all(SOLE.pitch[struck] < -15.0)


@pytest.mark.parametrize(
    ("speed", "least", "most", "flies"), [(0.8, 0.6, 0.68, False), (1.3, 0.57, 0.63, False),
     (1.8, 0.54, 0.6, False), (3.0, 0.3, 0.4, True)]
)  # fmt: skip
def test_stance_shares_and_flight(speed, least, most, flies):
    person = walker(Straight(30.0), speed=speed)
    feet = [Sole(person, foot) for foot in ("left-foot", "right-foot")]
    falls = person.falls[0][3:-3]
    stances = [
        (fall.toe_off - fall.contact) / (after.contact - fall.contact)
        for fall, after in itertools.pairwise(falls)
    ]
    assert least < np.mean(stances) < most
    aloft = (feet[0].phase == Phase.SWING) & (feet[1].phase == Phase.SWING)
    assert bool(aloft.any()) == flies


def test_left_and_right_take_turns_at_walking_pace():
    left, right = (np.array([fall.contact for fall in falls[1:]]) for falls in STRAIGHT.falls)
    both = np.sort(np.concatenate((left, right)))
    assert np.all(np.isin(both[::2], left))
    steps = np.diff(both)
    assert 105.0 < 60.0 / steps.mean() < 115.0
    assert 0.005 < steps.std() / steps.mean() < 0.04
    strides = stride_lengths(STRAIGHT.falls[0])[2:-2]
    assert 1.3 < strides.mean() < 1.55
    assert 0.005 < strides.std() / strides.mean() < 0.05


def test_a_foot_moves_and_feels_what_feet_do():
    sensor = STRAIGHT.sensor("left-foot")
    motion = sensor.at(SOLE.t)
    speed = np.linalg.norm(motion.velocity, axis=1)
    assert 2.6 * 1.3 < speed.max() < 3.8 * 1.3
    rate = np.degrees(np.linalg.norm(motion.rate, axis=1))
    assert 400.0 < rate.max() < 700.0
    force = np.linalg.norm(motion.force, axis=1) / STANDARD_GRAVITY
    assert 3.0 < force.max() < 8.0
    still = SOLE.t < 1.0
    assert np.abs(force[still] - 1.0).max() < 0.01


def test_the_waist_bobs_twice_and_sways_once_per_stride():
    person = walker(Straight(30.0), manner=Manner.regular())
    t = np.arange(5.0, 20.0, 0.01)
    place = person.sensor("waist", Placement()).at(t).position
    stride = gait_at(1.3).stride_s
    for axis, period, least, most in ((2, stride / 2, 0.02, 0.06), (1, stride, 0.02, 0.07)):
        moved = place[:, axis] - place[:, axis].mean()
        spectrum = np.abs(np.fft.rfft(moved * np.hanning(len(t))))
        frequency = np.fft.rfftfreq(len(t), 0.01)
        assert frequency[1:][spectrum[1:].argmax()] == pytest.approx(1 / period, abs=0.07)
        assert least < np.percentile(moved, 98) - np.percentile(moved, 2) < most
    # The body is over the feet all the time.
    feet = [person.sensor(foot, Placement()).at(t).position for foot in ("left-foot", "right-foot")]
    assert np.abs(place[:, 0] - 0.5 * (feet[0] + feet[1])[:, 0]).max() < 0.35


def test_a_walk_is_as_long_as_it_says_and_goes_where_it_says():
    person = Walker("straight-50m")
    balls = np.array([falls[-1].ball for falls in person.falls])
    begun = np.array([falls[0].ball for falls in person.falls])
    assert (balls - begun)[:, 0] == pytest.approx([50.0, 50.0], abs=1e-9)
    assert sum(stride_lengths(person.falls[0])) == pytest.approx(50.0, abs=0.05)
    station = Station()
    for piece in through(CORRIDOR, radius_m=1e-6):
        station = (
            station.turned(np.radians(piece.angle_deg)) if isinstance(piece, Turn)
            else on_pieces(station, [piece], plan_length(piece))
        )  # fmt: skip
    assert (station.x, station.y) == pytest.approx(CORRIDOR[-1], abs=1e-4)


def test_sprinters_and_fast_runners_take_strides_of_3_m():
    for name in ("fast-run", "sprint"):
        falls = Walker(name, 2, surroundings=Surroundings.ideal()).falls[0]
        strides = stride_lengths(falls)
        assert np.sum(np.abs(strides - 3.0) < 0.12) > len(strides) // 2, name
    quick = Walk((Straight(30.0),), (4.0,), cadence=1.25)
    person = Walker(Scenario("test", "Test", (Stand(1.0), quick)), manner=Manner.regular())
    usual = gait_at(4.0, "run")
    assert np.median(stride_lengths(person.falls[0])) == pytest.approx(
        2.0 * usual.step_m / 1.25, rel=0.05
    )


def test_a_loop_ends_where_it_began():
    (left, right) = Walker("loop-80m", 2, surroundings=Surroundings.ideal()).falls
    for falls in (left, right):
        assert falls[-1].ball == pytest.approx(falls[0].ball, abs=0.05)
        assert 75.0 < sum(stride_lengths(falls)) < 82.0
        assert falls[-1].yaw - falls[0].yaw == pytest.approx(2.0 * np.pi, abs=0.2)


def test_slopes_stairs_and_turns_are_as_steep_high_and_wide_as_they_say():
    uphill = Sole(Walker("slope-up"))
    assert uphill.ball[-1, 2] == pytest.approx(50.0 * np.tan(np.radians(5.5)), abs=1e-6)
    lying = (uphill.phase == Phase.FLAT) & (uphill.t > 20.0) & (uphill.t < 40.0)
    assert np.median(uphill.pitch[lying]) == pytest.approx(-5.5, abs=0.7)
    climbed = walker(Straight(1.0), Stairs(6), Straight(1.0))
    assert [falls[-1].ball[2] for falls in climbed.falls] == pytest.approx([1.02, 1.02])
    turned = walker(Straight(1.0), Turn(-180.0), Straight(1.0))
    yaws = [np.degrees(falls[-1].yaw - falls[0].yaw) for falls in turned.falls]
    assert yaws == pytest.approx([-180.0, -180.0], abs=15.0)
    (begin, end, angle), = turned.turns  # fmt: skip
    assert np.degrees(angle) == pytest.approx(-180.0)
    assert 1.0 < end - begin < 4.0


def test_a_foot_on_stairs_stays_above_the_treads():
    person = walker(Straight(1.0), Stairs(8), Straight(1.5), speed=1.0, manner=Manner.regular())
    sole = Sole(person)
    for point in (sole.ball, sole.heel):
        tread = np.clip(np.floor((point[:, 0] - 1.0 + 0.14) / 0.28), 0, 8)
        assert (point[:, 2] - 0.17 * tread).min() > -0.01


def test_a_half_circle_of_0_36_m_is_one():
    person = Walker("half-circle", surroundings=Surroundings.ideal())
    t = np.arange(0.0, person.end_s, 0.01)
    motion = person.sensor("left-foot").at(t)
    assert np.linalg.norm(motion.position - (0.0, 0.36, 0.0), axis=1) == pytest.approx(0.36)
    assert motion.position[-1] == pytest.approx([0.0, 0.72, 0.0], abs=1e-12)
    assert np.abs(motion.rate[:, :2]).max() < 1e-12
    assert motion.rate[:, 2].sum() * 0.01 == pytest.approx(np.pi, rel=1e-6)


def test_every_scenario_can_be_walked_and_is_of_human_scale():
    for name in SCENARIOS:
        fast = name in ("fast-run", "sprint")  # a foot goes more than twice as fast as its body
        most_g, most_dps, most_ms = (30.0, 1400.0, 14.0) if fast else (15.0, 1200.0, 9.0)
        person = Walker(name, 2, surroundings=Surroundings.ideal())
        for place in ("left-foot", "waist"):
            motion = person.sensor(place).at(np.arange(0.0, person.end_s, 0.1))
            assert np.linalg.norm(motion.force, axis=1).max() < most_g * STANDARD_GRAVITY, name
            assert np.linalg.norm(motion.rate, axis=1).max() < np.radians(most_dps), name
            assert np.linalg.norm(motion.velocity, axis=1).max() < most_ms, name


def test_seeds_make_the_person():
    one, same, other = (Walker("level-10m", seed) for seed in (3, 3, 4))
    t = np.linspace(0.0, 12.0, 50)
    for place in ("right-foot", "waist"):
        a, b, c = (person.sensor(place).at(t) for person in (one, same, other))
        assert np.array_equal(a.force, b.force)
        assert np.array_equal(a.field, b.field)
        assert np.abs(a.force - c.force).max() > 0.1


def test_unknown_walks_and_places_are_named():
    with pytest.raises(ValueError, match="no walk 'moon'; take one of half-circle, straight-50m"):
        scenario_of("moon")
    with pytest.raises(ValueError, match="no place 'head'; take one of left-foot"):
        STRAIGHT.sensor("head")
    with pytest.raises(ValueError, match="nobody goes at 9 m/s"):
        gait_at(9.0)
