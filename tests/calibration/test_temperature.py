"""Slopes over temperature from simulated sessions with known ones."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_noise import still_block
from simulated_sessions import MILLI_G, random_sensor, record, spread_attitudes

from imu_rig.calibration.certificate import apply_certificate, certificate_of, load_certificate
from imu_rig.calibration.noise import analyse_noise
from imu_rig.calibration.result import CalibrationResult
from imu_rig.calibration.solve import solve
from imu_rig.calibration.temperature_term import at_reference, warmth

DEG = np.pi / 180.0
ACCEL_BIAS, ACCEL_SCALE, GYRO_BIAS = 0.3 * MILLI_G, -1e-4, 0.02 * DEG


def chamber(t):
    """Up, down below the start, and up again."""
    return 25.0 + 12.0 * np.sin(2.0 * np.pi * t / t[-1])


def straight(t):
    return 25.0 + 8.0 * t / t[-1]


def session(seed, profile, *, bias=ACCEL_BIAS, scale=ACCEL_SCALE, gyro_bias=GYRO_BIAS, poses=36):
    """A recording whose biases and accelerometer scale follow the temperature, and its rests."""
    rng = np.random.default_rng(seed)
    truth = random_sensor(rng)
    made = record(
        spread_attitudes(poses, rng), truth, rng, hold_s=1.5, move_s=1.0, walk=0.1 * DEG / 600**0.5
    )
    block = made.block
    temperature = profile(block.t - block.t[0])
    dT = (temperature - 25.0)[:, None]
    exact = truth.accel.apply(block.accel)
    raised = (1.0 - scale * dT) * exact + truth.accel.b + bias * dT
    accel = np.linalg.solve(truth.accel.K, raised.T).T
    gyro = block.gyro + np.linalg.solve(truth.gyro.K, np.full(3, gyro_bias)) * dT
    return replace(block, accel=accel, gyro=gyro, temperature=temperature), made.holds, truth


def solved(seed, profile, **slopes) -> CalibrationResult:
    block, holds, _ = session(seed, profile, **slopes)
    return solve(block, holds)


def test_slopes_are_found_within_their_stated_uncertainty() -> None:
    z = []
    for seed in range(5):
        term = solved(seed, chamber).temperature
        assert term is not None
        assert term.accel_scale is not None
        assert term.gyro_bias is not None
        for found, truth in (
            (term.accel_bias, ACCEL_BIAS),
            (term.accel_scale, ACCEL_SCALE),
            (term.gyro_bias, GYRO_BIAS),
        ):
            assert found.offered.all()
            z.append((found.value - truth) / found.sigma)
            # and the correction at the edge of the span is bigger than its own uncertainty
            assert np.all(found.sigma < np.abs(truth))
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.5
    assert np.max(np.abs(z)) < 4.0


def test_a_sensor_that_does_not_mind_gets_no_large_slope() -> None:
    term = solved(11, chamber, bias=0.0, scale=0.0, gyro_bias=0.0).temperature
    assert term is not None
    assert term.gyro_bias is not None
    for found in (term.accel_bias, term.gyro_bias):
        assert np.all(np.abs(found.value) < 4.0 * found.sigma)
        assert np.sum(found.offered) <= 1


def test_drift_in_time_is_not_taken_for_temperature() -> None:
    result = solved(12, straight)
    assert result.temperature is not None
    assert not result.temperature.is_offered
    assert any("cannot be told apart" in w for w in result.warnings)
    assert certificate_of(result).temperature is None


def test_little_change_of_temperature_says_nothing() -> None:
    result = solved(13, lambda t: 25.0 + np.sin(t / 9.0))
    assert result.temperature is None


def test_the_calibration_holds_at_the_reference_and_elsewhere(tmp_path) -> None:
    block, holds, truth = session(14, chamber)
    result = solve(block, holds)
    term = result.temperature
    assert term is not None
    noise = analyse_noise(still_block(3000)).model
    certificate_of(result, noise=noise).save(tmp_path / "certificate.json")
    certificate = load_certificate(tmp_path / "certificate.json")
    assert certificate.noise == noise
    assert certificate.temperature is not None

    def errors(calibrated):
        rests = [calibrated.accel[(block.t > a) & (block.t < b)].mean(axis=0) for a, b in holds]
        return np.abs(np.linalg.norm(rests, axis=1) - 9.80665)

    with_term = errors(apply_certificate(certificate, block))
    without = errors(apply_certificate(certificate.model_copy(update={"temperature": None}), block))
    assert np.sqrt(np.mean(with_term**2)) < 0.3 * np.sqrt(np.mean(without**2))
    # K and b are those of the reference temperature
    off = term.reference_c - 25.0
    expected = truth.accel.K * (1.0 + ACCEL_SCALE * off)
    assert np.max(np.abs(result.accel.K - expected) / result.accel.K_uncertainty.max()) < 5.0
    b = truth.accel.b + ACCEL_BIAS * off
    assert np.all(np.abs(result.accel.b - b) < 5.0 * result.accel.b_uncertainty)
    # a block without temperatures is calibrated as before
    plain = apply_certificate(certificate, replace(block, temperature=None))
    np.testing.assert_array_equal(plain.accel, result.accel.apply(block.accel))


def test_the_line_is_followed_no_further_than_its_length() -> None:
    dT = warmth(np.array([-300.0, 10.0, 20.0, 25.0, 900.0]), 20.0, 10.0, 30.0)
    np.testing.assert_allclose(dT[:, 0], [-30.0, -10.0, 0.0, 5.0, 30.0])


def test_a_temperature_that_is_sent_seldom_holds_until_the_next() -> None:
    nan = np.nan
    dT = warmth(np.array([nan, nan, 25.0, nan, nan, 26.0, nan]), 20.0, 10.0, 30.0)
    np.testing.assert_allclose(dT[:, 0], [5.0, 5.0, 5.0, 5.0, 5.0, 6.0, 6.0])
    np.testing.assert_array_equal(warmth(np.full(3, nan), 20.0, 10.0, 30.0), np.zeros((3, 1)))


def test_at_the_reference_nothing_changes() -> None:
    x = np.arange(6.0).reshape(2, 3)
    same = at_reference(x, np.ones(3), np.zeros((2, 1)), np.ones(3), np.ones(3))
    np.testing.assert_array_equal(same, x)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_temperature_that_is_no_number_is_no_temperature(bad: float) -> None:
    block, holds, _ = session(15, chamber)
    temperature = block.temperature.copy()
    temperature[:] = bad
    result = solve(replace(block, temperature=temperature), holds)
    assert result.temperature is None


@pytest.mark.parametrize("glitch", [1e200, -1e200, 201.0])
def test_an_impossible_temperature_is_unknown_and_said(glitch: float) -> None:
    """One wrong value costs neither the slopes nor the page its width."""
    block, holds, _ = session(15, chamber)
    temperature = block.temperature.copy()
    temperature[len(temperature) // 2] = glitch
    result = solve(replace(block, temperature=temperature), holds)
    assert result.temperature is not None
    assert result.temperature_c[0] > 10.0
    assert result.temperature_c[1] < 40.0
    told = [warning for warning in result.warnings if "taken for unknown" in warning]
    assert len(told) == 1
    assert all(len(warning) < 400 for warning in result.warnings)
