"""Known rates: gains and bias they determine, and what they leave open or contradict."""

import numpy as np
import pytest
from simulated_sessions import DEG, MILLI_G, random_sensor, record, spread_attitudes

from imu_rig.blocks import ImuBlock
from imu_rig.calibration.known import Known, RateTable
from imu_rig.calibration.solve import solve
from imu_rig.errors import DataError, InputError
from imu_rig.importing.rates import read_rates

EVERY_AXIS = [
    (0, 0, 0),
    *(tuple(s * row) for row in 60.0 * np.eye(3) for s in (1, -1, 2)),
]


def table_run(rng, truth, rates_dps, *, segment_s=4.0, fs=100.0, shift=0.0, share=0.0):
    """A recording of steady rates, and the table of what they were said to be."""
    said = np.array(rates_dps, float) * DEG
    true = said * (1 + share * rng.standard_normal((len(said), 1)))
    n = round(segment_s * fs)
    t = np.arange(n * len(said)) / fs
    w = np.repeat(true, n, axis=0)
    gyro = truth.gyro.undo(w) + 0.05 * DEG * rng.standard_normal(w.shape)
    accel = truth.accel.undo(np.tile([0, 0, 9.80665], (len(t), 1)))
    accel = accel + 0.028 * rng.standard_normal(w.shape)
    t0 = np.arange(len(said)) * segment_s + 0.3 + shift
    return ImuBlock(t, accel, gyro, t), RateTable(t0, t0 + segment_s - 0.6, said)


def solved(block, rates):
    return solve(block, method="turntable", known=Known(rates=rates))


def test_stated_uncertainties_cover_the_truth():
    rng = np.random.default_rng(1)
    inside = []
    for _ in range(25):
        truth = random_sensor(rng)
        result = solved(*table_run(rng, truth, EVERY_AXIS, share=1e-3))
        error = np.concatenate(
            ((result.gyro.K - truth.gyro.K).ravel(), result.gyro.b - truth.gyro.b)
        )
        sigma = np.sqrt(np.diag(result.gyro.covariance))
        inside.append(np.abs(error) < result.gyro.coverage_factor * sigma)
    assert np.mean(inside) > 0.93
    assert result.gyro_figures.scale_percent_u.max() < 0.2
    assert not result.poses


def test_the_accelerometer_stays_nominal_and_says_so():
    rng = np.random.default_rng(2)
    result = solved(*table_run(rng, random_sensor(rng), EVERY_AXIS))
    assert np.array_equal(result.accel.K, np.eye(3))
    assert result.accel_figures.bias_u.min() > 50 * MILLI_G
    assert any("accelerometer was not calibrated" in w for w in result.warnings)


def test_one_axis_leaves_the_others_to_the_data_sheet():
    rng = np.random.default_rng(3)
    truth = random_sensor(rng)
    result = solved(*table_run(rng, truth, [(0, 0, 0), (0, 0, 90), (0, 0, -90)]))
    u = result.gyro_figures.scale_percent_u
    assert u[2] < 0.2
    assert np.all(u[:2] > 2.0)
    assert any("about x and y" in w for w in result.warnings)


@pytest.mark.parametrize(
    ("rates", "said"),
    [
        ([(50, 0, 0)] * 3, "all known rates are alike"),
        ([(60, 0, 0), (0, 60, 0), (0, 0, 60)], "add a rest"),
    ],
)
def test_rates_that_determine_nothing_are_refused(rates, said):
    rng = np.random.default_rng(4)
    with pytest.raises(DataError, match=said):
        solved(*table_run(rng, random_sensor(rng), rates))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda g: -g, "opposite sign"),
        (lambda g: g / DEG, "deg/s, not rad/s"),
        (lambda g: 2 * g, "2 times|2.0. times|1.9. times"),
        (lambda g: g[:, [1, 0, 2]], "gyroscope's y"),
    ],
)
def test_readings_that_contradict_the_rates_are_named(change, said):
    rng = np.random.default_rng(5)
    block, rates = table_run(rng, random_sensor(rng), EVERY_AXIS)
    with pytest.raises(DataError, match=said):
        solved(ImuBlock(block.t, block.accel, change(block.gyro), block.t), rates)


def test_segments_outside_the_recording_and_missing_rates_are_refused():
    rng = np.random.default_rng(6)
    block, rates = table_run(rng, random_sensor(rng), EVERY_AXIS, shift=5.0)
    with pytest.raises(DataError, match="segment 10"):
        solved(block, rates)
    with pytest.raises(InputError, match="--rates"):
        solve(block, method="turntable")


def test_files_of_rates(tmp_path):
    path = tmp_path / "rates.csv"
    path.write_text("t0, t1, axis, rate_dps\n1, 2, x, 60\n3, 4, -z, 90\n")
    rates = read_rates(path)
    assert rates.rate / DEG == pytest.approx(np.array([[60, 0, 0], [0, 0, -90.0]]))
    toml = tmp_path / "rates.toml"
    toml.write_text("[[segment]]\nt0 = 1\nt1 = 2\nx_dps = 1.0\ny_dps = 2\nz_dps = 3\n")
    assert read_rates(toml).rate / DEG == pytest.approx(np.array([[1.0, 2, 3]]))
    for text, said in (
        ("t0,t1,axis,rate_dps\n1,2,w,60\n", "segment 1: the axis"),
        ("t0,t1,axis,rate_dps\n1,2,x,fast\n", "no number"),
        ("t0,t1,axis,rate_dps\n2,1,x,60\n", "row 1"),
        ("t0,t1,axis\n1,2,x\n", "no rate_dps"),
        ("\n", "no rates"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=said):
            read_rates(path)


def test_an_accelerometer_alone():
    rng = np.random.default_rng(7)
    truth = random_sensor(rng)
    block = record(spread_attitudes(18, rng), truth, rng).block
    bare = ImuBlock(block.t, block.accel, np.zeros_like(block.gyro), block.t)
    result = solve(bare, method="static")
    assert result.gyro is None
    z = (result.accel.b - truth.accel.b) / result.accel.b_uncertainty
    assert np.abs(z).max() < 4
    assert solve(block, method="static").gyro is None
