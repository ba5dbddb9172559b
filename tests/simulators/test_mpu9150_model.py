"""The sensor model: its truth inverts it, and its noise is what the data sheet says."""

from dataclasses import replace

import numpy as np
import pytest

from imu_rig.units import DEG, MILLI_G, STANDARD_GRAVITY
from simulators.config import RigConfig
from simulators.models import SensorModel
from simulators.mpu9150 import ACCEL_COUNT, GYRO_COUNT, MAG_COUNT, Mpu9150, Vibration
from simulators.rig import RigTruth
from simulators.sampling import Means

PERIOD_S = 0.01


def at_rest(n: int, force=(0.0, 0.0, 9.8), rate=(0.0, 0.0, 0.0), field=(10.0, 20.0, -40.0)):
    return Means(
        t=PERIOD_S * np.arange(1, n + 1),
        duration=np.full(n, PERIOD_S),
        force=np.broadcast_to(np.asarray(force, float), (n, 3)),
        rate=np.broadcast_to(np.asarray(rate, float), (n, 3)),
        field=np.broadcast_to(np.asarray(field, float), (n, 3)),
    )


def sensor(seed: int = 1, **changes) -> Mpu9150:
    return Mpu9150(RigConfig.ideal().sensor.model_copy(update=changes), np.random.default_rng(seed))


def allan_deviation(x: np.ndarray, clusters: int) -> np.ndarray:
    """Allan deviation per axis for averages of ``clusters`` samples (IEEE 952, appendix C)."""
    means = x[: len(x) // clusters * clusters].reshape(-1, clusters, 3).mean(axis=1)
    return np.sqrt(0.5 * np.mean(np.diff(means, axis=0) ** 2, axis=0))


@pytest.mark.parametrize("seed", range(5))
def test_the_truth_turns_readings_into_what_the_sensor_felt(seed):
    config = RigConfig.random(seed)
    still = {
        "accel_noise_ug": 0.0,
        "gyro_noise_dps": 0.0,
        "mag_noise_ut": 0.0,
        "accel_walk_mg": 0.0,
        "gyro_walk_dps": 0.0,
        "warm_up_c": 0.0,
    }
    quiet = config.model_copy(update={"sensor": config.sensor.model_copy(update=still)})
    rng = np.random.default_rng(seed)
    n = 200
    means = Means(
        t=PERIOD_S * np.arange(1, n + 1),
        duration=np.full(n, PERIOD_S),
        force=rng.uniform(-20, 20, (n, 3)),
        rate=rng.uniform(-5, 5, (n, 3)),
        field=rng.uniform(-50, 50, (n, 3)),
    )
    readings = Mpu9150(quiet.sensor, rng).read(means, None)
    truth = RigTruth.of(quiet)
    # Half a count, spread over three axes by the gain, is all that may be missing.
    assert truth.accel.apply(readings.accel) == pytest.approx(means.force, abs=0.6 * ACCEL_COUNT)
    assert truth.gyro.apply(readings.gyro) == pytest.approx(means.rate, abs=0.6 * GYRO_COUNT)
    assert truth.mag.apply(readings.mag) == pytest.approx(means.field, abs=0.7 * MAG_COUNT)


def test_white_noise_falls_with_the_root_of_the_averaging_time():
    readings = sensor(accel_noise_ug=400.0, gyro_noise_dps=0.005).read(at_rest(60_000), None)
    for averaged in (1, 10, 50):
        # A one-sided density d leaves a mean over the time T the variance d^2 / (2 T).
        root_tau = np.sqrt(2.0 * averaged * PERIOD_S)
        accel = allan_deviation(readings.accel, averaged) / MILLI_G
        gyro = allan_deviation(readings.gyro, averaged) / DEG
        assert accel * root_tau == pytest.approx(0.4, rel=0.1)
        # Rounding to 0.03 deg/s adds a little of its own.
        assert gyro * root_tau == pytest.approx(0.005, rel=0.1)
    # The data sheet's 0.05 deg/s is over 100 Hz; samples at 100 Hz hold 50 Hz of it.
    assert readings.gyro.std(axis=0) / DEG == pytest.approx(0.05 / np.sqrt(2.0), rel=0.1)


def test_offsets_walk_as_far_as_their_name_says():
    ends = []
    for seed in range(80):
        walker = sensor(seed, gyro_walk_dps=0.1, accel_walk_mg=0.1)
        for start in (0.0, 200.0, 400.0):  # in batches, as the firmware reads it
            t = start + np.arange(1.0, 201.0)
            walker.read(replace(at_rest(200), t=t, duration=np.ones(200)), None)
        ends.append(walker.offsets(600.0, 600.0) / np.repeat((MILLI_G, DEG), 3))
    assert np.std(ends, axis=0) == pytest.approx(0.1, rel=0.3)
    assert np.sqrt(np.mean(np.square(ends))) == pytest.approx(0.1, rel=0.1)


def test_remembered_offsets_are_those_the_readings_had():
    drifting = sensor(quantized=False, gyro_walk_dps=50.0, accel_offset=(1.0, 2.0, 3.0))
    assert drifting.offsets(0.0, 1.0) == pytest.approx([1.0, 2.0, 3.0, 0.0, 0.0, 0.0])
    readings = drifting.read(at_rest(6000), None)
    mean = drifting.offsets(20.0, 50.0)
    assert mean[3:] == pytest.approx(readings.gyro[2000:5000].mean(axis=0), abs=0.05)
    assert np.abs(readings.gyro.std(axis=0)).min() > 0.05
    assert drifting.offsets(30.0, 30.0)[3:] == pytest.approx(readings.gyro[2999], abs=0.02)


def test_readings_are_whole_counts_and_stop_at_the_range():
    force = np.array([3.0 * STANDARD_GRAVITY, 100.0, -100.0])
    readings = sensor().read(at_rest(1, force, (1.0, 30.0, -30.0), (3000.0, -3000.0, 3000.0)), None)
    assert readings.accel[0] / ACCEL_COUNT == pytest.approx([12288, 32767, -32768])
    assert readings.gyro[0] / GYRO_COUNT == pytest.approx([1879, 32767, -32768])
    # The AK8975 has 13 bits, and its z axis points the other way.
    assert readings.mag[0] / MAG_COUNT == pytest.approx([4095, -4096, 4096])
    assert readings.saturated.all()
    assert not sensor().read(at_rest(1), None).saturated.any()


def test_nonlinearity_bends_by_its_share_of_one_g():
    bent = sensor(accel_quadratic=(0.002, 0.0, 0.0), accel_cubic=(0.0, 0.005, 0.0), quantized=False)
    for g in (-1.0, 0.5, 1.0):
        force = np.full(3, g * STANDARD_GRAVITY)
        error_g = (bent.read(at_rest(1, force), None).accel[0] - force) / STANDARD_GRAVITY
        assert error_g == pytest.approx([0.002 * g**2, 0.005 * g**3, 0.0], abs=1e-12)


def test_force_feigns_rate_through_the_g_sensitivity():
    sensitive = sensor(g_sensitivity=((0.0, 0.1, 0.0), (0.0,) * 3, (0.0,) * 3), quantized=False)
    readings = sensitive.read(at_rest(1, (0.0, 2 * STANDARD_GRAVITY, 0.0)), None)
    assert readings.gyro[0] / DEG == pytest.approx([0.2, 0.0, 0.0])


def test_a_cold_sensor_is_off_and_a_warm_one_is_true():
    model = {
        "warm_up_c": 10.0,
        "warm_up_tau_s": 100.0,
        "powered_s": 0.0,
        "accel_offset_mg_per_c": 0.5,
        "accel_gain_percent_per_c": 0.0,
        "gyro_offset_dps_per_c": 0.03,
        "quantized": False,
    }
    readings = sensor(**model).read(at_rest(100_000), None)
    assert readings.temperature[0] == pytest.approx(25.0, abs=0.01)
    assert readings.temperature[-1] == pytest.approx(35.0, abs=0.01)
    assert readings.accel[0, 0] / MILLI_G == pytest.approx(-5.0, rel=0.01)
    assert readings.gyro[0, 1] / DEG == pytest.approx(-0.3, rel=0.01)
    assert readings.accel[-1, 0] / MILLI_G == pytest.approx(0.0, abs=0.01)
    after_one_tau = int(100.0 / PERIOD_S)
    assert readings.gyro[after_one_tau, 1] / DEG == pytest.approx(-0.3 * np.exp(-1), rel=0.01)


def test_a_buzzing_pose_shakes_with_its_amplitude_less_what_the_average_takes():
    buzz = Vibration(np.array([0.0, 2.0 * MILLI_G, 0.0]), hz=20.0, phase=0.4)
    means = at_rest(1000)
    readings = sensor(quantized=False).read(means, buzz)
    shaken = readings.accel - means.force
    expected = 2.0 / np.sqrt(2.0) * np.sin(0.2 * np.pi) / (0.2 * np.pi)
    assert shaken[:, 1].std() / MILLI_G == pytest.approx(expected, rel=1e-3)
    assert not shaken[:, [0, 2]].any()


def test_the_same_seed_gives_the_same_readings_in_any_batches():
    whole = sensor(7, accel_noise_ug=400.0, gyro_walk_dps=0.1).read(at_rest(300), None)
    split = sensor(7, accel_noise_ug=400.0, gyro_walk_dps=0.1)
    means = at_rest(300)
    parts = [
        split.read(
            Means(*(getattr(means, f)[a:b] for f in ("t", "duration", "force", "rate", "field"))),
            None,
        )
        for a, b in ((0, 1), (1, 120), (120, 120), (120, 300))
    ]
    assert np.array_equal(np.vstack([p.accel for p in parts]), whole.accel)
    assert np.array_equal(np.vstack([p.gyro for p in parts]), whole.gyro)


def test_the_default_sensor_is_within_its_data_sheet():
    model = SensorModel()
    for gain in (model.accel_gain, model.gyro_gain):
        sensitivity = np.linalg.inv(np.array(gain)) - np.eye(3)
        assert np.abs(np.diag(sensitivity)).max() <= 0.03
        assert np.abs(sensitivity - np.diag(np.diag(sensitivity))).max() <= 0.02
    assert np.abs(model.accel_offset).max() / MILLI_G <= 80.0
    assert np.abs(model.gyro_offset).max() / DEG <= 20.0
