"""Paths with a known turn, shift, delay, hand and marker, found again."""

import json

import numpy as np
import pytest

from imu_rig.errors import DataError
from imu_rig.reference.alignment import align
from imu_rig.reference.reference import Reference
from imu_rig.rotation import about_z, rotate
from simulators.walker.path import Arc, Straight
from simulators.walker.scenarios import Scenario
from simulators.walker.steps import Stand, Walk
from simulators.walker.walker import Walker

YAW, SHIFT = 2.1, np.array([33.0, -10.0, 0.4])
MARKER = np.array([0.05, -0.03, 0.02])


@pytest.fixture(scope="module")
def foot():
    """A sensor on a foot that walks straight on and round a bend, at 100 Hz."""
    pieces = (Straight(4.0), Arc(1.5, 120.0), Straight(2.0))
    walker = Walker(Scenario("bend", "A bend", (Stand(1.0), Walk(pieces), Stand(1.0))))
    return walker.sensor("left-foot").at(np.arange(0.0, walker.end_s, 0.01))


def seen(foot, *, every=1, marker=None, sign=(1.0, 1.0, 1.0), delay=0.0, noise=0.0):
    """What a laboratory with axes of its own records of the foot."""
    places = foot.position + (0.0 if marker is None else rotate(foot.attitude, marker))
    places = places @ about_z(YAW).T + SHIFT
    places = places + noise * np.random.default_rng(2).normal(size=places.shape)
    return Reference((foot.t - delay)[::every], (places * np.array(sign))[::every])


def test_turn_and_shift_are_found_again(foot):
    """Nothing is left of an estimate that is right."""
    found = align(foot.t, foot.position, seen(foot, every=3))
    assert found.yaw == pytest.approx(YAW, abs=1e-6)
    assert found.translation == pytest.approx(SHIFT, abs=1e-6)
    assert found.rmse == pytest.approx(np.zeros(3), abs=1e-6)
    assert found.notes == ()
    assert found.coverage == 1.0


def test_errors_are_those_that_are_there(foot):
    """An estimate whose heights drift by 0.1 m and that scatters by 2 cm on the plan."""
    rng = np.random.default_rng(3)
    wrong = foot.position + np.linspace(0.0, 0.1, len(foot.t))[:, None] * [0.0, 0.0, 1.0]
    wrong[:, :2] += 0.02 * rng.normal(size=(len(wrong), 2))
    found = align(foot.t, wrong, seen(foot))
    assert found.rmse_horizontal == pytest.approx(0.02 * np.sqrt(2.0), rel=0.05)
    assert found.rmse[:2] == pytest.approx([0.02, 0.02], rel=0.1)
    assert found.rmse_vertical == pytest.approx(0.1 / np.sqrt(12.0), rel=0.01)
    assert found.largest_horizontal < 0.12
    assert found.hands.as_given == pytest.approx(found.rmse_horizontal, rel=1e-6)
    assert found.hands.upright == pytest.approx(found.rmse_vertical, rel=1e-6)
    assert found.closure == pytest.approx(0.1, abs=0.03)
    json.dumps(found.to_dict())
    assert any("RMSE" in line for line in found.lines())


@pytest.mark.parametrize(
    ("sign", "options", "word"),
    [
        ((1, -1, 1), {"mirrored": True}, "left-handed"),
        ((-1, 1, 1), {"mirrored": True}, "left-handed"),
        ((1, -1, -1), {"z_down": True}, "z seems to point down"),
        ((1, 1, -1), {"mirrored": True, "z_down": True}, "left-handed with z down"),
    ],
)
def test_wrong_signs_are_told_and_not_turned_unless_asked(foot, sign, options, word):
    """Both figures are in the sentence; the error shown is that of the file as it is."""
    reference = seen(foot, sign=sign, noise=0.005)
    as_it_is = align(foot.t, foot.position, reference)
    assert word in as_it_is.notes[0]
    assert " instead of " in as_it_is.notes[0]
    assert max(as_it_is.rmse_horizontal, as_it_is.rmse_vertical) > 0.04
    turned = align(foot.t, foot.position, reference, **options)
    assert turned.rmse_horizontal < 0.01
    assert turned.rmse_vertical < 0.01
    assert turned.notes == ()
    assert turned.turned_axes != ""


def test_a_straight_way_does_not_tell_its_hand(foot):
    """It fits mirrored as well, so nothing is said."""
    early = foot.t < 4.0
    reference = seen(foot, sign=(1, -1, 1), noise=0.003)
    reference = Reference(reference.t[early], reference.position[early])
    found = align(foot.t, foot.position, reference)
    assert not found.hands.suspect
    assert found.notes == ()


@pytest.mark.parametrize("delay", [-1.234, 0.0, 0.777])
def test_a_delay_between_the_clocks_is_found(foot, delay):
    """Within a millisecond or two, between samples as well."""
    found = align(foot.t, foot.position, seen(foot, delay=delay, noise=0.002), search_offset_s=2.0)
    assert found.time_offset == pytest.approx(delay, abs=0.002)
    assert found.notes == ()


@pytest.mark.parametrize("sign", [(1, -1, 1), (1, -1, -1), (1, 1, -1)])
def test_wrong_signs_do_not_spoil_the_delay(foot, sign):
    """Found as if the signs were right, so that they can be judged at all."""
    reference = seen(foot, sign=sign, delay=0.3, noise=0.002)
    found = align(foot.t, foot.position, reference, search_offset_s=1.0)
    assert found.time_offset == pytest.approx(0.3, abs=0.002)
    assert found.hands.suspect == (sign[1] < 0)
    assert found.hands.z_suspect == (sign[2] < 0)


def test_a_delay_beyond_the_search_is_told(foot):
    """The bound is no optimum."""
    found = align(foot.t, foot.position, seen(foot, delay=1.0), search_offset_s=0.5)
    assert "at the bound" in found.notes[0]


def test_the_markers_place_is_found_and_only_when_asked(foot):
    """6 cm aside of the sensor, seen with 1 mm of noise."""
    reference = seen(foot, marker=MARKER, noise=0.001)
    plain = align(foot.t, foot.position, reference)
    assert plain.lever is None
    assert plain.rmse_horizontal > 0.01
    fitted = align(foot.t, foot.position, reference, quaternion=foot.attitude, fit_lever=True)
    assert fitted.lever == pytest.approx(MARKER, abs=0.001)
    assert fitted.rmse_horizontal < 0.002


def test_lost_markers_leave_gaps(foot):
    """NaN is no place; what is left is compared."""
    reference = seen(foot)
    reference.position[100:400] = np.nan
    reference.position[450, 1] = np.nan
    found = align(foot.t, foot.position, reference)
    assert found.coverage == pytest.approx(1.0 - 301 / len(foot.t))
    assert found.rmse_horizontal < 1e-6


def test_what_cannot_be_compared_is_told_in_a_sentence(foot):
    """Other times, no positions, a stand, an attitude that is missing."""
    away = Reference(foot.t + 1000.0, foot.position)
    with pytest.raises(DataError, match="share 0 places"):
        align(foot.t, foot.position, away)
    with pytest.raises(DataError, match="no positions"):
        align(foot.t, foot.position, Reference(foot.t))
    with pytest.raises(DataError, match="no sample with a position"):
        align(foot.t, foot.position, Reference(foot.t, np.full_like(foot.position, np.nan)))
    with pytest.raises(DataError, match="stays within 10 cm"):
        align(foot.t, foot.position, Reference(foot.t[:80], foot.position[:80]))
    with pytest.raises(DataError, match="attitude"):
        align(foot.t, foot.position, seen(foot), fit_lever=True)
