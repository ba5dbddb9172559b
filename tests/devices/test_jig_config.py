"""Jig files: angles to pulses and back, predicted times, and mistakes named by field."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imu_rig.devices.jig import AXES, AxisConfig, load_jig
from imu_rig.errors import InputError

PAPER = load_jig("paper-jig")

AXIS = """[{name}]
channel = {channel}
angle_deg = [-90, 90]
pulse_us = [1000, 2000]
limits_deg = [-90, 90]
speed_dps = 60
acceleration_dps2 = 240
"""


def written(tmp_path, head='name = "mine"\n', **changes):
    """A good jig file with some lines of [pan] changed or added."""
    pan = AXIS.format(name="pan", channel=0)
    for key, value in changes.items():
        lines = [x for x in pan.splitlines() if not x.startswith(f"{key} =")]
        pan = "\n".join(lines + ([] if value is None else [f"{key} = {value}"])) + "\n"
    others = [AXIS.format(name=n, channel=c) for n, c in (("tilt", 1), ("roll", 2))]
    path = tmp_path / "my-jig.toml"
    path.write_text(head + pan + "".join(others), encoding="utf-8")
    return path


def test_the_papers_jig_has_the_papers_servos():
    assert PAPER.pan.pulse(-180) == 1265 * 4
    assert PAPER.pan.pulse(180) == 1735 * 4
    assert PAPER.tilt.pulse(-90) == 900 * 4
    assert PAPER.tilt.pulse(90) == 1950 * 4
    assert PAPER.roll.pulse(0) == 1500 * 4
    assert PAPER.roll.pulse(190) == 1800 * 4
    for axis in PAPER.axes.values():
        assert 40 < axis.speed_units * 25 / abs(axis.us_per_deg) < 110  # what its servos can


@given(axis=st.sampled_from(AXES), share=st.floats(0, 1))
def test_an_angle_comes_back_from_its_pulse_within_half_a_step(axis, share):
    config = PAPER.axes[axis]
    low, high = config.limits_deg
    angle = low + share * (high - low)
    assert abs(config.angle(config.pulse(angle)) - angle) <= config.resolution_deg / 2 + 1e-9
    least, greatest = config.limits_quarter_us
    assert least <= config.pulse(angle) <= greatest


def test_a_servo_may_turn_the_other_way():
    axis = AxisConfig(
        channel=0,
        angle_deg=(-90, 90),
        pulse_us=(2000, 1000),
        limits_deg=(-80, 90),
        speed_dps=60,
        acceleration_dps2=100,
    )
    assert axis.pulse(90) == 4000
    assert axis.angle(8000) == -90
    low, high = axis.limits_quarter_us
    assert low == 4000
    assert high < 8000


@pytest.mark.parametrize(
    ("way_us", "speed", "acceleration", "seconds"),
    [
        (1000, 20, 5, 2.32),
        (500, 10, 5, 2.16),
        (900, 40, 4, 1.70),
        (100, 200, 1, 2 * math.sqrt(100 / 312.5)),
    ],
)
def test_travel_times_are_those_of_the_controllers_motion(way_us, speed, acceleration, seconds):
    axis = AxisConfig(
        channel=0,
        angle_deg=(0, 100),
        pulse_us=(1000, 2000),
        limits_deg=(0, 100),
        speed_dps=speed * 2.5,
        acceleration_dps2=acceleration * 31.25,
    )
    assert (axis.speed_units, axis.acceleration_units) == (speed, acceleration)
    assert axis.travel_time(0, way_us / 10) == pytest.approx(seconds, abs=0.006)


def test_limits_of_speed_are_never_rounded_to_none():
    slow = PAPER.pan.model_copy(update={"speed_dps": 1e-3, "acceleration_dps2": 1e-3})
    assert slow.speed_units == slow.acceleration_units == 1


def test_the_slowest_axis_decides():
    home, there = {"pan": 0.0, "tilt": 0.0, "roll": 0.0}, {"pan": 10.0, "tilt": 90.0, "roll": 0.0}
    assert PAPER.travel_time(home, there) == PAPER.tilt.travel_time(0, 90)
    assert PAPER.travel_time(home, {"pan": 10.0}) == PAPER.pan.travel_time(0, 10)
    assert PAPER.travel_time(home, home) == 0.0


def test_a_good_file_loads(tmp_path):
    jig = load_jig(written(tmp_path, gear_ratio="2.5"))
    assert jig.name == "mine"
    assert jig.park() == {"pan": 0.0, "tilt": 0.0, "roll": 0.0}
    assert jig.overshoot_deg == 6.0


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"limits_deg": "[90, -90]"}, r"pan: limits_deg must rise, but 90 is not below -90"),
        ({"limits_deg": "[-90, 900]"}, r"pan: limits_deg lets .*900 deg.*6500 us.*64 to 4080 us"),
        ({"pulse_us": "[1500, 1500]"}, r"pan: pulse_us must give two different pulses"),
        ({"angle_deg": "[5, 5]"}, r"pan: angle_deg must give two different angles"),
        ({"channel": "1"}, r"pan and tilt both have channel 1"),
        ({"channel": "24"}, r"pan.channel is 24, but it should be less than or equal to 23"),
        ({"channel": "true"}, r"pan.channel is True"),
        ({"speed_dps": "0"}, r"pan.speed_dps is 0, but it should be greater than 0"),
        ({"speed_dps": "inf"}, r"pan.speed_dps is inf"),
        ({"speed_dps": None}, r"pan.speed_dps is missing"),
        ({"sped_dps": "60"}, r"pan.sped_dps is not a field of a jig file"),
        ({"pulse_us": '"wide"'}, r"pan.pulse_us is 'wide'"),
        (
            {"head": 'name = "x"\npark_deg = [0, 120, 0]\n'},
            r"park_deg parks tilt at 120 deg, outside",
        ),
        ({"head": ""}, r"name is missing"),
        ({"head": 'name = "x\n'}, r"not a TOML file"),
    ],
)
def test_mistakes_are_named_by_file_and_field(tmp_path, changes, said):
    with pytest.raises(InputError, match=f"my-jig.toml: {said}"):
        load_jig(written(tmp_path, **changes))


def test_a_missing_file_lists_the_builtin_jigs(tmp_path):
    with pytest.raises(InputError, match=r"no such jig file.*paper-jig"):
        load_jig(tmp_path / "none.toml")
    with pytest.raises(InputError, match="no such jig file"):
        load_jig("no\0where")


def test_huge_and_binary_files_are_refused(tmp_path):
    path = tmp_path / "big.toml"
    path.write_bytes(b"#" * 100_000)
    with pytest.raises(InputError, match="at most"):
        load_jig(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="not a TOML file"):
        load_jig(path)
