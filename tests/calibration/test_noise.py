"""Allan deviation and what is fitted to it, against definitions, theory and known noise."""

import json
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from simulated_noise import noise, still_block, still_mpu9150

from imu_rig.calibration.allan import KINDS, AllanCurve, Correlation, allan_curve, terms
from imu_rig.calibration.allan_fit import AllanFit, fit_curve
from imu_rig.calibration.noise import analyse_noise
from imu_rig.calibration.noise_model import load_noise_model
from imu_rig.errors import DataError, InputError

DEG = np.pi / 180.0
MICRO_G = 9.80665e-6


def by_definition(x: np.ndarray, m: int) -> float:
    """Half the mean square difference of neighbouring means of m samples, every start."""
    pairs = [x[i + m : i + 2 * m].mean() - x[i : i + m].mean() for i in range(len(x) - 2 * m + 1)]
    return float(np.mean(np.square(pairs)) / 2.0)


def fitted(x: np.ndarray, period: float) -> tuple[AllanCurve, AllanFit]:
    curve = allan_curve([x], period)
    return curve, fit_curve(curve)


def coefficient(fit: AllanFit, kind: str):
    return fit.coefficients[KINDS.index(kind)]


# --- the curve


def test_the_curve_is_that_of_the_definition() -> None:
    x = np.random.default_rng(1).standard_normal(180) + 0.02 * np.arange(180)
    curve = allan_curve([x], 0.1)
    expected = [by_definition(x, int(m)) for m in curve.samples]
    np.testing.assert_allclose(curve.variance, expected, rtol=1e-10)
    np.testing.assert_allclose(curve.tau, 0.1 * curve.samples, rtol=1e-12)


def test_a_ramp_has_the_slope_one_exactly() -> None:
    curve = allan_curve([0.3 * 0.01 * np.arange(5000)], 0.01)
    np.testing.assert_allclose(curve.deviation, 0.3 * curve.tau / np.sqrt(2.0), rtol=1e-9)


def test_the_curve_scales_with_unit_and_time_and_forgets_the_offset() -> None:
    x = np.random.default_rng(2).standard_normal(4000)
    plain = allan_curve([x], 0.01)
    np.testing.assert_allclose(
        allan_curve([100.0 - 3.0 * x], 0.01).deviation, 3.0 * plain.deviation, rtol=1e-7
    )
    slower = allan_curve([x], 0.04)
    np.testing.assert_allclose(slower.deviation, plain.deviation, rtol=1e-12)
    np.testing.assert_allclose(slower.tau, 4.0 * plain.tau, rtol=1e-12)
    np.testing.assert_allclose(allan_curve([x[::-1]], 0.01).deviation, plain.deviation, rtol=1e-2)
    # four times the period with the same samples is twice the density
    a, b = (coefficient(fit_curve(c), "white").value for c in (plain, slower))
    assert b == pytest.approx(2.0 * a, rel=1e-6)


def test_stretches_weigh_by_their_length() -> None:
    rng = np.random.default_rng(3)
    x, y = rng.standard_normal(3000), 2.0 * rng.standard_normal(900)
    curve = allan_curve([x, y], 0.01)
    for k in (0, 5, 12):
        m = int(curve.samples[k])
        starts = [len(s) + 1 - 2 * m for s in (x, y)]
        expected = np.average([by_definition(x, m), by_definition(y, m)], weights=starts)
        assert curve.variance[k] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("kind", "column"), [("white", 1), ("walk", 3)])
def test_the_degrees_of_freedom_tell_the_scatter_of_the_variance(kind: str, column: int) -> None:
    rng = np.random.default_rng(4)
    curves = [allan_curve([noise(2000, 0.01, rng, **{kind: 1.0})], 0.01) for _ in range(300)]
    variance = np.array([c.variance for c in curves])
    shares = np.tile(np.eye(5)[column], (len(curves[0].tau), 1))
    stated = curves[0].freedom(shares)
    seen = 2.0 * variance.mean(axis=0) ** 2 / variance.var(axis=0)
    np.testing.assert_allclose(np.log(seen / stated), 0.0, atol=0.35)
    model = terms(curves[0].tau, 0.01)[:, column]
    assert np.all(np.abs(variance.mean(axis=0) / model - 1) < 5 * np.sqrt(2 / stated / 300) + 0.01)


# --- the coefficients

MIXTURES = {
    "white": {"white": 0.005},
    "white and walk": {"white": 0.005, "walk": 0.0005},
    "flicker": {"white": 0.005, "flicker": 0.004},
    "walk": {"white": 1e-5, "walk": 0.01},
}


@pytest.mark.parametrize("name", MIXTURES)
def test_known_noise_is_found_within_its_stated_uncertainty(name: str) -> None:
    mixture = MIXTURES[name]
    rng = np.random.default_rng(5)
    inside, z, seen = [], [], dict.fromkeys(mixture, 0)
    runs, shared = 16, None
    for _ in range(runs):
        curve = allan_curve([noise(12000, 0.1, rng, **mixture)], 0.1)
        shared = shared or Correlation(curve)
        fit = fit_curve(curve, shared)
        for kind in ("white", "flicker", "walk"):
            truth, found = mixture.get(kind, 0.0), coefficient(fit, kind)
            inside.append(found.low <= truth <= found.high)
            if found.value is not None and truth:
                z.append((found.value - truth) / found.sigma)
                seen[kind] += 1
    assert np.mean(inside) > 0.88
    # where a term is absent its sign bounds the others more tightly than is stated
    assert 0.3 < np.sqrt(np.mean(np.square(z))) < 1.45
    strong = [kind for kind in mixture if (name, kind) != ("walk", "white")]
    assert all(seen[kind] >= 0.8 * runs for kind in strong), seen


def test_nothing_is_invented_where_there_is_only_white_noise() -> None:
    rng = np.random.default_rng(6)
    for _ in range(10):
        _, fit = fitted(noise(6000, 0.01, rng, white=1.0), 0.01)
        for kind in ("quantization", "flicker", "walk", "ramp"):
            assert coefficient(fit, kind).value is None
            assert coefficient(fit, kind).high > 0.0


def test_a_longer_record_bounds_more_tightly() -> None:
    rng = np.random.default_rng(7)
    x = noise(60000, 0.02, rng, white=1.0)
    short, long = fitted(x[:3000], 0.02)[1], fitted(x, 0.02)[1]
    assert coefficient(long, "white").sigma < coefficient(short, "white").sigma / 2.5
    for kind in ("flicker", "walk", "ramp"):
        assert coefficient(long, kind).high < coefficient(short, kind).high


def test_a_low_pass_filter_does_not_pass_for_low_noise() -> None:
    rng = np.random.default_rng(8)
    x = noise(60000, 0.01, rng, white=1.0)
    smooth = np.convolve(x, np.ones(8) / 8, mode="valid")
    _, fit = fitted(smooth, 0.01)
    found = coefficient(fit, "white")
    assert found.value == pytest.approx(1.0, abs=4 * found.sigma + 0.02)
    assert fit.used[0] >= 0.08


def test_a_steady_drift_is_told_from_a_walk() -> None:
    rng = np.random.default_rng(9)
    x = noise(30000, 0.02, rng, white=1.0) + 0.01 * 0.02 * np.arange(30000)
    found = coefficient(fitted(x, 0.02)[1], "ramp")
    assert found.low < 0.01 < found.high


# --- recordings


def test_the_simulated_sensor_has_the_noise_of_its_budget() -> None:
    period = 0.01
    block = still_mpu9150(90000, period, 11)
    model = analyse_noise(block).model
    assert model.accel is not None
    assert model.gyro is not None
    assert model.mag is not None
    # rounding to counts adds white noise of count^2 / 12 per sample
    counts = {
        name: np.min(np.diff(np.unique(values)))
        for name, values in (("accel", block.accel[:, 0]), ("gyro", block.gyro[:, 0]))
    }
    for name, density in (("accel", 400 * MICRO_G), ("gyro", 0.005 * DEG)):
        # the sheet's density is one-sided, sqrt(2) times the random walk coefficient
        truth = np.hypot(density / np.sqrt(2.0), counts[name] * np.sqrt(period / 12.0))
        sensor = getattr(model, name)
        for axis in sensor:
            assert abs(axis.white.value - truth) < 4.5 * axis.white.standard_uncertainty
    walk = 0.1 * DEG / np.sqrt(600.0)
    assert sum(axis.walk.low < walk < axis.walk.high for axis in model.gyro) >= 2
    assert np.all(np.isfinite(model.gyro.values("walk")))
    drift = 0.1e3 * MICRO_G / np.sqrt(600.0)
    assert np.all(model.accel.upper_bounds("walk") > 0.8 * drift)


def test_gaps_divide_the_record_and_cost_no_more_than_they_hold() -> None:
    block = still_block(30000)
    keep = np.ones(len(block), dtype=bool)
    for start in (4000, 12000, 21000):
        keep[start : start + 150] = False
    whole, holed = analyse_noise(block).model, analyse_noise(block[keep]).model
    assert holed.duration_s == pytest.approx(whole.duration_s - 3 * 1.5, abs=0.1)
    assert holed.rate_hz == pytest.approx(100.0, rel=1e-6)
    assert holed.gyro is not None
    for axis in holed.gyro:
        assert abs(axis.white.value - 1e-4) < 4 * axis.white.standard_uncertainty


def test_the_rate_is_that_of_the_time_stamps() -> None:
    block = still_block(6000)
    jitter = 0.3 * 0.01 * (np.random.default_rng(1).random(6000) - 0.5)
    slow = replace(block, t=4.0 * (block.t + jitter))
    assert analyse_noise(slow).model.rate_hz == pytest.approx(25.0, rel=1e-3)


def test_motion_is_left_out_and_said() -> None:
    block = still_block(20000)
    moving = slice(13000, 14000)
    gyro = block.gyro.copy()
    gyro[moving] += 0.5 * np.sin(np.arange(1000) / 30.0)[:, None]
    analysis = analyse_noise(replace(block, gyro=gyro))
    assert analysis.span_s[0] == pytest.approx(block.t[0], abs=0.5)
    assert 180.0 < analysis.model.duration_s < 190.0
    assert any("not at rest all the time" in w for w in analysis.model.warnings)
    assert analysis.model.gyro is not None
    assert analysis.model.gyro.values("white") == pytest.approx(np.full(3, 1e-4), rel=0.05)


def test_axes_are_told_apart() -> None:
    block = still_block(12000)
    gyro = block.gyro * [1.0, 2.0, 4.0]
    found = analyse_noise(replace(block, gyro=gyro)).model.gyro
    plain = analyse_noise(block).model.gyro
    assert found is not None
    assert plain is not None
    np.testing.assert_allclose(found.values("white"), plain.values("white") * [1, 2, 4], rtol=1e-6)


def test_an_accelerometer_alone_will_do() -> None:
    block = still_block(6000)
    model = analyse_noise(replace(block, gyro=np.zeros_like(block.gyro))).model
    assert model.accel is not None
    assert model.gyro is None


def refused(block, words: str) -> None:
    with pytest.raises(DataError, match=words):
        analyse_noise(block)


def test_what_tells_no_noise_is_refused_in_a_sentence() -> None:
    block = still_block(3000)
    bad = block.accel.copy()
    bad[7, 1] = np.nan
    refused(replace(block, accel=bad), "not numbers")
    refused(block[:10], "too short|shorter")
    refused(block[:500], "too short to tell noise")
    refused(replace(block, t=block.t[::-1]), "time does not increase")
    same = np.full_like(block.accel, 1.0)
    refused(replace(block, accel=same, gyro=0 * same), "constant|no still")
    dead = block.gyro.copy()
    dead[:, 2] = 0.0
    refused(replace(block, gyro=dead), "z never changes")
    clipped = np.minimum(block.accel, [9e9, 9e9, 9.80665])
    refused(replace(block, accel=clipped), "z is at its range limit")
    t = np.arange(3000) / 100.0
    swing = np.sin(np.outer(t, [9.0, 7.0, 11.0]))
    refused(replace(block, accel=block.accel + 5 * swing, gyro=swing), "held still|no still|rest")


def test_memory_stays_within_a_few_copies_of_an_axis(monkeypatch) -> None:
    monkeypatch.setattr("imu_rig.calibration.noise.CHUNK", 20_000)
    block = still_block(200_000)
    one_axis = block.t.nbytes
    tracemalloc.start()
    try:
        analyse_noise(block)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 14 * one_axis


# --- the file


def test_the_model_comes_back_from_its_file(tmp_path) -> None:
    model = analyse_noise(still_block(6000), recording=("still.csv", "0" * 64)).model
    model.save(tmp_path / "noise.json")
    assert load_noise_model(tmp_path / "noise.json") == model
    with pytest.raises(InputError, match="exists"):
        model.save(tmp_path / "noise.json")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"version": 2}, "version 2"),
        ({"schema": "imu-rig/certificate"}, "not a noise model"),
        ({"rate_hz": -1.0}, "rate_hz"),
        ({"gyro": {"x": 1}}, "gyro"),
        ({"extra": 1}, "extra"),
    ],
)
def test_a_damaged_file_is_refused_in_a_sentence(tmp_path, change, words: str) -> None:
    content = json.loads(analyse_noise(still_block(6000)).model.model_dump_json(by_alias=True))
    file = tmp_path / "noise.json"
    file.write_text(json.dumps(content | change))
    with pytest.raises(InputError, match=words):
        load_noise_model(file)
    file.write_text("{")
    with pytest.raises(InputError, match="not JSON"):
        load_noise_model(file)


def test_impossible_and_missing_readings_are_refused_in_a_sentence() -> None:
    """Before any arithmetic overflows: warnings of numpy are errors in tests."""
    block = still_block(count=3000)
    accel = block.accel.copy()
    accel[7, 1] = 1e200
    with pytest.raises(DataError, match=r"accelerometer reads up to 1e\+200 m/s\^2"):
        analyse_noise(replace(block, accel=accel))
    with pytest.raises(DataError, match="no samples"):
        analyse_noise(block[:0])
