"""What a walk says of itself agrees: force and rate integrate to its trajectory."""

import csv

import numpy as np
import pytest
from walk_strapdown import of_means, of_points

from imu_rig.rotation import conjugate, multiply, to_rotation_vector
from imu_rig.units import STANDARD_GRAVITY
from simulators.walker.channels import Track
from simulators.walker.device import Carried
from simulators.walker.path import Arc, Stairs, Straight, Turn
from simulators.walker.record import record_walk
from simulators.walker.scenarios import Scenario
from simulators.walker.steps import Stand, Walk
from simulators.walker.truth import COLUMNS, stride_lengths, write_truth
from simulators.walker.walker import Surroundings, Walker

RATE_HZ = 400.0
STAIRS = (Straight(2.0), Stairs(20), Straight(1.0), Arc(0.6, 180.0), Straight(1.0), Stairs(-20))


def walker(*legs, seed=1):
    return Walker(Scenario("test", "Test", legs), seed, surroundings=Surroundings.ideal())


WALKS = {
    "walking": (Stand(2.0), Walk((Straight(30.0), Turn(-180.0), Straight(40.0)))),
    "running": (Stand(2.0), Walk((Straight(180.0),), (3.2,))),
    "sprinting": (Stand(2.0), Walk((Straight(60.0),), (3.0, 5.5, 5.5, 3.0), cadence=1.12)),
    "stairs": (Stand(2.0), Walk((*STAIRS, Straight(12.0)), (1.0,))),
}


@pytest.mark.parametrize(
    ("walk", "place"),
    [
        ("walking", "left-foot"),
        ("running", "right-foot"),
        ("sprinting", "left-foot"),
        ("stairs", "waist"),
    ],
)
def test_integrating_a_minute_of_means_returns_the_trajectory_within_a_millimetre(walk, place):
    sensor = walker(*WALKS[walk]).sensor(place)
    t = np.arange(60.0 * RATE_HZ + 1.0) / RATE_HZ
    truth = sensor.at(t)
    position, attitude = of_means(sensor.means(t[1:], 0.0), truth, STANDARD_GRAVITY)
    assert np.linalg.norm(truth.position[-1] - truth.position[0]) > 5.0
    assert np.linalg.norm(position - truth.position, axis=1).max() < 1e-3
    turned = to_rotation_vector(multiply(conjugate(truth.attitude), attitude))
    assert np.linalg.norm(turned, axis=1).max() < 1e-6


@pytest.mark.parametrize(("walk", "place"), [("running", "left-foot"), ("stairs", "left-foot")])
def test_integrating_values_at_moments_returns_the_trajectory_too(walk, place):
    sensor = walker(*WALKS[walk]).sensor(place)
    truth = sensor.at(np.arange(60.0 * RATE_HZ + 1.0) / RATE_HZ)
    position, _ = of_points(truth, STANDARD_GRAVITY)
    assert np.linalg.norm(position - truth.position, axis=1).max() < 1e-3


@pytest.mark.parametrize("place", ["left-foot", "waist"])
def test_velocity_force_and_rate_are_the_derivatives_of_position_and_attitude(place):
    sensor = walker(Stand(1.0), Walk((Straight(4.0), Turn(90.0), Straight(3.0)))).sensor(place)
    h = 1e-4
    t = np.random.default_rng(1).uniform(1.0, 8.0, 300)
    before, here, after = sensor.at(t - h), sensor.at(t), sensor.at(t + h)
    velocity = (after.position - before.position) / (2 * h)
    assert np.abs(velocity - here.velocity).max() < 1e-4
    acceleration = (after.velocity - before.velocity) / (2 * h)
    q = here.attitude
    felt = multiply(multiply(q, np.column_stack((np.zeros(300), here.force))), conjugate(q))[:, 1:]
    assert np.abs(felt - (0.0, 0.0, STANDARD_GRAVITY) - acceleration).max() < 2e-2
    turned = to_rotation_vector(multiply(conjugate(before.attitude), after.attitude)) / (2 * h)
    assert np.abs(turned - here.rate).max() < 1e-3


def test_means_do_not_depend_on_how_intervals_are_cut():
    sensor = walker(Stand(1.0), Walk((Straight(4.0),))).sensor("left-foot")
    fine = sensor.means(np.arange(1.0, 4001.0) * 1e-3, 0.0)
    coarse = sensor.means(np.arange(1.0, 101.0) * 0.04, 0.0)
    for name in ("force", "rate", "field"):
        averaged = getattr(fine, name).reshape(100, 40, 3).mean(axis=1)
        np.testing.assert_allclose(averaged, getattr(coarse, name), atol=1e-8)


def test_a_channel_sweeps_what_its_speeds_say_and_is_smooth_at_its_knots():
    track = Track(0.0, 1.0)
    track.run((1.0, 1.3, 1.5, 2.0), (0.0, 2.0, -1.0, 0.0))
    channel = track.channel()
    assert channel.jet(np.array([9.0])).value[0] == pytest.approx(1.0 + 0.3 + 0.1 - 0.25)
    t = np.array([0.5, 1.0, 1.3, 1.5, 2.0, 3.0])
    before, after = channel.jet(t - 1e-9), channel.jet(t + 1e-9)
    np.testing.assert_allclose(after.rate, [0.0, 0.0, 2.0, -1.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(before.rate, after.rate, atol=1e-6)
    np.testing.assert_allclose(after.acceleration, 0.0, atol=1e-5)
    np.testing.assert_allclose(before.acceleration, 0.0, atol=1e-5)


def test_the_written_truth_is_that_of_the_samples(tmp_path):
    person = walker(Stand(0.5), Walk((Straight(2.0), Turn(90.0))))
    records = record_walk(person, [Carried("left-foot", "mpu9150"), Carried("waist", "mpu9150")])
    units = [unit for record in records.values() for unit in record.units]
    written = write_truth(tmp_path / "walk.csv", person, units)
    assert [path.name for path in written] == ["walk.csv", "walk-strides.csv", "walk-turns.csv"]
    samples, strides, turns = (
        list(csv.DictReader(path.read_text().splitlines())) for path in written
    )
    assert tuple(samples[0]) == COLUMNS
    assert len(samples) == sum(map(len, units))
    foot = units[0]
    row = samples[len(foot) // 2]
    assert row["device"] == "left-foot"
    sample = int(np.flatnonzero(foot.counter == int(row["counter"]))[0])
    assert float(row["z_m"]) == pytest.approx(foot.truth.position[sample, 2], abs=1e-9)
    assert float(row["wy_rads"]) == pytest.approx(foot.truth.rate[sample, 1], abs=1e-9)
    assert float(row["mean_fx_ms2"]) == pytest.approx(foot.means.force[sample, 0], abs=1e-9)
    assert {row["phase"] for row in samples} == {"flat", "heel-off", "swing", "strike", ""}
    lengths = [float(row["length_m"]) for row in strides if row["foot"] == "left"]
    np.testing.assert_allclose(lengths, stride_lengths(person.falls[0]), rtol=1e-8)
    assert float(turns[0]["angle_deg"]) == pytest.approx(90.0)
