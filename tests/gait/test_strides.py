"""Stride tables against the steps that a simulated person took."""

from dataclasses import replace

import numpy as np
import pytest
from true_tracks import true_track, walk_of

from imu_rig.gait.events import find_contacts
from imu_rig.gait.stride_kinds import StrideFacts, stride_kinds
from imu_rig.gait.strides import Strides, gait_parameters, summarize, summary_of
from imu_rig.gait.trajectory import Footfalls, TrajectoryCovariance
from imu_rig.units import DEG
from simulators.walker.path import Arc, Stairs, Straight, Turn
from simulators.walker.scenarios import Scenario
from simulators.walker.steps import Stand, Walk
from simulators.walker.truth import stride_lengths
from simulators.walker.walker import Walker


@pytest.fixture(scope="module")
def walker():
    return walk_of(Straight(10.0), seed=4)


@pytest.fixture(scope="module")
def track(walker):
    return true_track(walker)


@pytest.fixture(scope="module")
def strides(track):
    return gait_parameters(track)


def test_lengths_are_those_of_the_footprints(walker, strides):
    """The sensor sits 8 cm behind the ball and turns with the foot by some degrees."""
    assert strides.length == pytest.approx(stride_lengths(walker.falls[0]), abs=0.015)
    assert strides.distance == pytest.approx(10.0, abs=0.03)
    assert strides.height == pytest.approx(np.zeros(len(strides)), abs=0.003)


def test_a_stride_has_the_figures_of_a_gait_laboratory(walker, strides):
    """At 1.3 m/s: 110 steps a minute, 60 % stance, 25 deg toe up, 65 deg toe down."""
    one = summarize(strides)
    falls = walker.falls[0]
    cycle = np.diff([fall.contact for fall in falls[1:]])
    assert strides.duration[1:] == pytest.approx(cycle, abs=0.01)
    assert np.isnan(strides.duration[0])  # began from standing: nothing came before
    assert one["cadence"].mean == pytest.approx(110, abs=3)
    assert np.median(strides.velocity[1:]) == pytest.approx(1.3, abs=0.07)
    assert one["stance_share"].mean == pytest.approx(0.60, abs=0.03)
    assert one["contact_pitch"].mean == pytest.approx(25 * DEG, abs=3 * DEG)
    assert one["lowest_pitch"].mean == pytest.approx(-65 * DEG, abs=4 * DEG)
    assert -60 * DEG < one["toe_off_pitch"].mean < -45 * DEG
    assert one["clearance"].mean == pytest.approx(0.075, abs=0.02)
    assert strides.kind.tolist() == ["start"] + ["walk"] * (len(strides) - 2) + ["stop"]
    counts = {one[name].count for name in ("length", "duration", "velocity", "stance_share")}
    assert counts == {len(strides) - 2}


def test_strides_from_and_to_standing_do_not_count_as_variability(track, strides):
    """A person whose strides vary by 2.5 % does not vary by more for having begun with half a
    stride; in a recording that ends as the foot comes down, the last is as good as any."""
    one = summarize(strides)
    assert one["length"].cv < 0.035
    assert one["velocity"].mean == pytest.approx(
        one["length"].mean / one["duration"].mean, rel=0.01
    )
    end = int(np.searchsorted(track.trajectory.t, strides.contact[-2] + 0.4))
    falls = track.footfalls
    kept = Footfalls(
        *(np.minimum(a[:-1], end - 1) for a in (falls.first, falls.last, falls.quietest))
    )
    cut = gait_parameters(replace(track, trajectory=track.trajectory[:end], footfalls=kept))
    assert cut.kind.tolist() == ["start"] + ["walk"] * (len(cut) - 1)


def test_a_pause_parts_two_walks():
    pause = (Stand(2.0), Walk((Straight(6.0),)), Stand(3.0), Walk((Straight(6.0),)), Stand(2.0))
    strides = gait_parameters(true_track(Walker(Scenario("two", "Two walks", pause), seed=3)))
    kinds = [kind for kind in strides.kind.tolist() if kind != "walk"]
    assert kinds == ["start", "stop", "start", "stop"]


@pytest.mark.parametrize("place", ["left-foot", "right-foot"])
def test_single_stairs_are_as_steep_up_as_down(place):
    """Onto stairs and off them a foot climbs one step of 0.17 m in 0.6 to 0.9 m."""
    found = []
    for steps in (7, -7):
        walker = walk_of(Straight(3.0), Stairs(steps), Straight(3.0), speeds=(1.0,), seed=2)
        strides = gait_parameters(true_track(walker, place))
        rising = np.abs(strides.height) > 0.1
        assert set(strides.kind[rising]) == {"up" if steps > 0 else "down"}
        assert set(strides.kind[~rising][1:-1]) == {"walk"}
        found.append(rising.sum())
    assert found[0] == found[1] >= 4


@pytest.mark.parametrize(
    ("height", "kinds"),
    [
        ([0.0, 0.15, 0.0, -0.12, 0.0], ["walk", "up", "walk", "down", "walk"]),
        ([0.0, 0.07, 0.14, 0.14, 0.14, 0.06], ["walk"] * 6),
        ([0.0, 0.09, 0.0], ["walk"] * 3),
    ],
)
def test_curbs_are_steps_and_ramps_are_not(height, kinds):
    """Among strides of 1.4 m; 0.14 m on each is a ramp of 10 %."""
    m = len(height)
    same = {name: np.full(m, value) for name, value in
            {"length": 1.4, "turn": 0.0, "swing_time": 0.4, "duration": 1.1, "stance_share": 0.6,
             "off_foot": 0.0}.items()}  # fmt: skip
    never = np.zeros(m, dtype=bool)
    facts = StrideFacts(height=np.array(height), stood_before=never, stood_after=never, **same)
    assert stride_kinds(facts).tolist() == kinds


@pytest.mark.parametrize(
    ("pieces", "speed"),
    [
        ((Straight(5.0),), 0.5),
        ((Straight(5.0),), 1.3),
        ((Straight(7.0),), 1.8),
        ((Stairs(6),), 1.0),
        ((Stairs(-6),), 1.0),
    ],
)
def test_contact_and_toe_off_are_found_within_30_ms(pieces, speed):
    """Slow, usual and brisk walking, and stairs either way, one rule."""
    walker = walk_of(*pieces, speeds=(speed,))
    track = true_track(walker, place="right-foot")
    events = find_contacts(track.trajectory, track.footfalls)
    falls = walker.falls[1]
    assert events.toe_off == pytest.approx([fall.toe_off for fall in falls[:-1]], abs=0.03)
    assert events.contact == pytest.approx([fall.contact for fall in falls[1:]], abs=0.03)


@pytest.mark.parametrize(("speed", "late"), [(0.5, -0.013), (1.3, 0.0), (3.0, 0.04)])
def test_events_err_alike_as_their_description_says(speed, late):
    """Contacts are early at every pace, toe-offs from early to late; what is left is small."""
    walker = walk_of(Straight(6.0 * max(speed, 1.0)), speeds=(speed,))
    track = true_track(walker)
    events, falls = find_contacts(track.trajectory, track.footfalls), walker.falls[0]
    contact = events.contact - [fall.contact for fall in falls[1:]]
    toe_off = events.toe_off - [fall.toe_off for fall in falls[:-1]]
    assert contact.mean() == pytest.approx(-0.018, abs=0.005)
    assert contact.std() < 0.003
    assert toe_off.mean() == pytest.approx(late, abs=0.006)
    assert toe_off.std() < 0.014
    true = np.array([[fall.contact, fall.toe_off] for fall in falls[1:]])
    share = (true[:-1, 1] - true[:-1, 0]) / np.diff(true[:, 0])
    found = summarize(gait_parameters(track))["stance_share"].mean
    assert found == pytest.approx(share.mean(), abs=0.08 if speed > 2.0 else 0.02)


def test_equal_time_stamps_are_survived(track):
    """Some loggers repeat a stamp."""
    trajectory = track.trajectory
    t = trajectory.t.copy()
    t[300:320] = t[299]
    strides = gait_parameters(replace(track, trajectory=replace(trajectory, t=t)))
    assert np.all(np.isfinite(strides.contact))
    assert np.all(np.isfinite(strides.length))


def test_runners_fly():
    """At 3 m/s a foot is on the ground for less than half of the time; it turns past the vertical
    without folding over."""
    strides = gait_parameters(true_track(walk_of(Straight(9.0), speeds=(3.0,))))
    assert set(strides.kind[1:-1]) == {"run"}
    assert summarize(strides)["stance_share"].mean < 0.46
    assert np.all(strides.lowest_pitch < -80 * DEG)


@pytest.mark.parametrize(
    ("pieces", "speed", "kinds"),
    [
        ((Stairs(8),), 1.0, ["up"] * 5),
        ((Stairs(-8),), 1.0, ["down"] * 5),
        ((Turn(400.0),), 1.0, ["turn"] * 5),
        ((Straight(6.0, -8.0),), 1.0, ["start", *["walk"] * 4, "stop"]),
    ],
)
def test_kinds_of_strides(pieces, speed, kinds):
    """Stairs are no ramps, and turning on the spot is no walking."""
    strides = gait_parameters(true_track(walk_of(*pieces, speeds=(speed,))))
    assert strides.kind.tolist() == kinds
    assert strides.walking.any() == ("walk" in kinds)


def test_a_bend_turns_the_foot_as_the_way_turns():
    """Half a circle to the left on 1 m: the strides share 180 deg and go where the foot points."""
    strides = gait_parameters(true_track(walk_of(Arc(1.0, 180.0), speeds=(1.2,))))
    assert strides.turn.sum() == pytest.approx(np.pi, abs=12 * DEG)
    assert set(strides.kind[1:-1]) == {"walk"}
    assert np.all(strides.turn > 0)
    assert np.all(np.abs(strides.sideways) < 0.08)


def moved_by(track, moved, turned=0.0):
    """A track of two footfalls that are ``moved`` apart."""
    trajectory = track.trajectory[:100]
    share = np.linspace(0.0, 1.0, 100)[:, None]
    level = np.tile([1.0, 0.0, 0.0, 0.0], (100, 1))
    trajectory = replace(
        trajectory,
        position=share * np.array(moved),
        velocity=np.tile(np.array(moved), (100, 1)),
        quaternion=level,
    )
    ends = np.array([0, 99])
    return replace(track, trajectory=trajectory, footfalls=Footfalls(ends, ends, ends))


@pytest.mark.parametrize(
    ("moved", "kind", "counts"),
    [
        ((0.03, 0.0, 0.0), "shift", False),
        ((0.15, 0.0, 0.0), "short", True),
        ((6.5, 0.0, 0.0), "doubtful", True),
        ((0.3, 0.0, 0.17), "up", True),
    ],
)
def test_what_is_no_walking_stride(track, moved, kind, counts):
    """A standing foot set down anew walks no distance."""
    strides = gait_parameters(moved_by(track, moved))
    assert strides.kind.tolist() == [kind]
    assert strides.distance == pytest.approx(np.hypot(*moved[:2]) if counts else 0.0)


def covariance_of(track, stride_error):
    """Covariance of a track whose strides (draws, k - 1, 3) err as given."""
    places = np.cumsum(stride_error, axis=1)
    count = stride_error.shape[1]
    values = np.zeros((count + 1, 9, 9))
    for i in range(count):
        values[i + 1, 6:, 6:] = np.cov(places[:, i].T)
    strides = np.array([np.cov(stride_error[:, i].T) for i in range(count)])
    return TrajectoryCovariance(track.footfalls.quietest, values, strides)


@pytest.mark.parametrize("told", [False, True])
@pytest.mark.parametrize("common", [0.0, 0.5, 1.0])
def test_errors_that_strides_share_add_up_in_the_distance(track, common, told):
    """The distance scatters over 4000 walks as its uncertainty says, however much is shared."""
    rng = np.random.default_rng(5)
    count = len(track.footfalls) - 1
    shared, own = rng.normal(size=(4000, 1, 3)), rng.normal(size=(4000, count, 3))
    error = 0.01 * (np.sqrt(common) * shared + np.sqrt(1.0 - common) * own)
    covariance = covariance_of(track, error)
    if told:
        alike = np.tile(0.01 * np.sqrt(common) * np.eye(3), (count, 1, 1))
        covariance = replace(covariance, common=alike)
    strides = gait_parameters(replace(track, covariance=covariance))
    assert strides.length_sigma == pytest.approx(np.full(count, 0.01), rel=0.05)
    ways = np.column_stack((np.cos(strides.heading), np.sin(strides.heading)))
    truth = np.einsum("nij,ij->n", error[:, :, :2], ways).std()
    assert strides.distance_sigma == pytest.approx(truth, rel=0.12)


def test_without_covariance_no_uncertainty_is_made_up(strides):
    """NaN says so."""
    assert np.all(np.isnan(strides.length_sigma))
    assert np.isnan(strides.distance_sigma)
    assert np.all(strides.duration_sigma[1:] < 0.02)


def test_a_foot_that_never_walks_has_no_strides(track):
    """No row, no distance, a note."""
    one = np.array([5])
    for falls in (Footfalls(one[:0], one[:0], one[:0]), Footfalls(one, one, one)):
        none = gait_parameters(replace(track, footfalls=falls))
        assert len(none) == 0
        assert none.distance == 0.0
        assert none.notes
        assert summarize(none)["length"].count == 0


def test_columns_say_their_units():
    """Every column, and nothing else, has a unit and a meaning."""
    columns = Strides.columns()
    assert columns["length"].unit == "m"
    assert columns["turn"].unit == "rad"
    assert {"axes", "distance", "notes"}.isdisjoint(columns)
    assert all(column.text for column in columns.values())


def test_statistics_of_known_numbers():
    """By hand, and with gaps."""
    found = summary_of(np.array([1.0, 3.0, np.nan]))
    assert (found.mean, found.sd, found.count) == (2.0, pytest.approx(np.sqrt(2.0)), 2)
    assert found.cv == pytest.approx(np.sqrt(2.0) / 2)
    assert np.isnan(summary_of(np.array([])).mean)
