"""Every kind of IMU at rest: what comes out of its bytes is what its budget says."""

import numpy as np
import pytest
from imu_kind_bench import Bench, steady

from firmware_protocols.known import load_protocol
from imu_rig.units import DEG, MILLI_G, STANDARD_GRAVITY
from simulators.config import RigConfig
from simulators.imu_kinds import DEFAULT_KIND, IMU_KINDS
from simulators.inertial_sensor import SensorRange
from simulators.rig import RigTruth
from simulators.world import World

KINDS = list(IMU_KINDS)
CLUSTER_S = 0.2
"""Long beside the filters of any device, short beside its walks."""
CLUSTERS = 400
SENSORS = ("accel", "gyro", "mag")


def allan_deviation(values: np.ndarray, clusters: int) -> float:
    """Allan deviation over adjacent clusters, the axes together."""
    whole = len(values) // clusters * clusters
    means = values[:whole].reshape(clusters, -1, 3).mean(axis=1)
    return float(np.sqrt(0.5 * np.mean(np.square(np.diff(means, axis=0)))))


def parts_of(kind: str) -> dict[str, SensorRange]:
    ranges = IMU_KINDS[kind].ranges
    return {s: r for s in SENSORS if (r := getattr(ranges, s)) is not None}


def sample_noise(config: RigConfig, sensor: str, sample_hz: float) -> float:
    """Standard deviation of one reading, by the budget's densities; SI, uT."""
    model, band = config.sensor, np.sqrt(sample_hz / 2.0)
    return {
        "accel": model.accel_noise_ug * 1e-3 * MILLI_G * band,
        "gyro": model.gyro_noise_dps * DEG * band,
        "mag": model.mag_noise_ut,
    }[sensor]


@pytest.mark.parametrize("kind", KINDS)
def test_noise_is_that_of_the_budget_counts_included(kind):
    """Over 3 axes and 400 clusters the estimate itself is known to 2.5 %.

    Rounding adds a variance of count^2 / 12, as independent as the noise that carries readings
    over several counts makes it.
    """
    assert np.sqrt(1.5 / (2 * 3 * CLUSTERS)) < 0.03
    config = steady(RigConfig.random(4, imu=kind))
    bench = Bench(config)
    readings = bench.readings(CLUSTER_S * CLUSTERS)
    per_cluster = len(readings["accel"]) // CLUSTERS
    for sensor, part in parts_of(kind).items():
        one = sample_noise(config, sensor, bench.encoder.sample_hz)
        white = one**2 / (bench.encoder.sample_hz * CLUSTER_S)
        assert one > 0.4 * part.count, "without noise over its counts this test says nothing"
        expected = np.sqrt(white + part.count**2 / 12.0 / per_cluster)
        assert allan_deviation(readings[sensor], CLUSTERS) == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("kind", KINDS)
def test_bias_and_scale_at_rest_are_the_configured_ones(kind):
    config = steady(RigConfig.random(5, imu=kind))
    truth, bench = RigTruth.of(config), Bench(config)
    parts = parts_of(kind)
    hold_s = 3.0
    for axis in range(3):
        for sign in (-1.0, 1.0):
            force = sign * STANDARD_GRAVITY * np.eye(3)[axis]
            rate = sign * 30.0 * DEG * np.eye(3)[axis]
            bench.readings(0.5, force, rate)  # what filters remember of the pose before
            readings = bench.readings(hold_s, force, rate)
            for sensor, true in (("accel", force), ("gyro", rate)):
                if sensor not in parts:
                    continue
                mean = readings[sensor].mean(axis=0)
                density = sample_noise(config, sensor, 2.0)
                sigma = density / np.sqrt(2.0 * hold_s) + 0.01 * parts[sensor].count
                found = getattr(truth, sensor).apply(mean[np.newaxis])[0]
                assert found == pytest.approx(true, abs=5.0 * sigma)


@pytest.mark.parametrize("kind", KINDS)
def test_drawn_errors_fill_the_budget_and_stay_within_it(kind):
    budget = IMU_KINDS[kind].budget
    drawn = [RigConfig.random(seed, imu=kind).sensor for seed in range(150)]
    sensitivity = np.linalg.inv([[s.accel_gain, s.gyro_gain] for s in drawn]) - np.eye(3)
    diagonal = np.abs(np.diagonal(sensitivity, axis1=2, axis2=3))
    others = np.abs(sensitivity[..., ~np.eye(3, dtype=bool)])
    offsets = np.einsum(
        "nij,nj->ni",
        np.linalg.inv([s.accel_gain for s in drawn]),
        np.array([s.accel_offset for s in drawn]),
    )
    for found, limit in (
        (diagonal, budget.scale),
        (others, budget.cross_axis),
        (np.abs(offsets) / MILLI_G, np.array(budget.accel_bias_mg)),
    ):
        assert np.all(found <= limit + 1e-9)
        assert np.all(found.max(axis=0) >= 0.9 * limit)


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_seed_sends_the_same_bytes_however_time_is_cut(kind):
    whole, cut = (World(RigConfig.random(6, imu=kind)) for _ in range(2))
    whole.advance(1.0)
    for step in range(1, 11):
        cut.advance(0.1 * step)
    data = whole.take("imu")
    assert data
    assert cut.take("imu") == data


@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_sends_the_protocol_it_names(kind):
    chosen = IMU_KINDS[kind]
    assert chosen.name == kind
    protocol = load_protocol(chosen.protocol)
    assert len(protocol.inertial_streams) >= 1
    rate_hz = protocol.streams[protocol.inertial_streams[0]].rate_hz
    assert rate_hz == pytest.approx(chosen.output_hz, rel=0.01)
    assert RigConfig.speaking(protocol, 3).kind.protocol == chosen.protocol


def test_an_unknown_kind_is_refused_with_those_there_are():
    with pytest.raises(ValueError, match=f"no kind of IMU 'gyroscope'.*{DEFAULT_KIND}"):
        RigConfig.random(1, imu="gyroscope")
    with pytest.raises(ValueError, match=f"gyroscope.*{DEFAULT_KIND}"):
        RigConfig(imu="gyroscope")


def test_a_protocol_that_no_kind_speaks_is_refused_with_those_they_do():
    with pytest.raises(ValueError, match=r"no simulated IMU speaks baro-16.*mpu9150-28 \(mpu9150"):
        RigConfig.speaking(load_protocol("baro-16"), 1)


def test_packets_of_any_inertial_layout_are_sent_on_demand():
    config = RigConfig.speaking(load_protocol("mpu9150-burst-30"), 2)
    assert config.imu == DEFAULT_KIND
    assert config.protocol == load_protocol("mpu9150-burst-30")
    world = World(config)
    world.advance(1.0)
    packets = config.protocol.decoder().feed(world.take("imu"))[""]
    assert len(packets) > 80
