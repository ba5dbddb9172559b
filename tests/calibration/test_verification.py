"""Poses kept out of the fit: never part of it, judged truthfully, and void where they are."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from simulated_sessions import DEG, MILLI_G, Recording, random_sensor, record, spread_attitudes

from imu_rig.calibration.certificate import certificate_of, load_certificate
from imu_rig.calibration.result import CalibrationResult
from imu_rig.calibration.session import CommandedPoses
from imu_rig.calibration.solve import solve
from imu_rig.calibration.verification import Limits, Verification, as_normal
from imu_rig.errors import DataError

FITTED, CHECKS = 20, 5
GRAVITY = 9.80665


@cache
def session(seed: int) -> Recording:
    rng = np.random.default_rng([seed, 77])
    attitudes = np.concatenate((spread_attitudes(FITTED, rng), spread_attitudes(CHECKS, rng)))
    sensor = random_sensor(rng)
    return record(attitudes, sensor, rng, rate=50.0, hold_s=1.5, move_s=1.2, walk=0.004 * DEG)


def calibrated(
    recording: Recording, check: object = None, mounting: tuple[int, ...] = (), **options: object
) -> CalibrationResult:
    count = len(recording.holds)
    marks = np.arange(count) >= FITTED if check is None else np.isin(np.arange(count), check)
    commanded = CommandedPoses(
        np.zeros((count, 3)),
        check=tuple(marks.tolist()),
        mounting=mounting,
        mounting_turns=((0.0, 0.0, 0.0),) * (max(mounting) + 1) if mounting else (),
    )
    return solve(
        recording.block,
        recording.holds,
        commanded=commanded,
        gravity=GRAVITY,
        method="multi-position",
        **options,
    )


def verified(recording: Recording, **options: object) -> Verification:
    verification = calibrated(recording, **options).verification
    assert verification is not None
    return verification


def rows_of(recording: Recording, first: int) -> np.ndarray:
    """Samples from the end of the hold before ``first`` on."""
    return recording.block.t > recording.holds[first - 1, 1]


def spoiled(recording: Recording, **columns: np.ndarray) -> Recording:
    return Recording(replace(recording.block, **columns), recording.holds, recording.attitudes)


def test_good_calibrations_pass_and_the_errors_are_as_large_as_predicted() -> None:
    found = [verified(session(seed)) for seed in range(8)]
    assert all(verification.passed for verification in found)
    for kind in ("pose", "move"):
        rows = [r for v in found for r in v.rows if r.kind == kind]
        sigmas = np.array([r.sigmas for r in rows if r.sigmas is not None])
        assert len(sigmas) >= 36
        assert 0.7 < np.sqrt(np.mean(sigmas**2)) < 1.25
        assert np.mean(sigmas < 1.96) > 0.88


def test_a_check_has_no_influence_on_the_fit() -> None:
    recording = session(1)
    rng = np.random.default_rng(5)
    late = rows_of(recording, FITTED)[:, None]
    wild = spoiled(
        recording,
        accel=np.where(late, recording.block.accel * 1.02 + 0.3, recording.block.accel),
        gyro=np.where(late, rng.normal(0, 0.3, (len(late), 3)), recording.block.gyro),
    )
    one, other = calibrated(recording), calibrated(wild)
    for sensor in ("accel", "gyro"):
        before, after = getattr(one, sensor), getattr(other, sensor)
        assert np.array_equal(before.K, after.K)
        assert np.array_equal(before.b, after.b)
        assert np.array_equal(before.covariance, after.covariance)
    assert len(one.poses) == FITTED
    assert len(one.moves) == FITTED - 1
    assert other.verification is not None
    assert not other.verification.passed


def test_no_move_of_the_fit_leads_across_a_check_in_the_middle() -> None:
    result = calibrated(session(2), check=[8, 24])
    moves = {(move.start, move.stop) for move in result.moves}
    assert ("pose 7", "pose 8") in moves
    assert ("pose 8", "pose 10") not in moves
    assert len(result.moves) == 25 - 1 - 2 - 1
    assert result.verification is not None
    names = [row.name for row in result.verification.rows]
    assert names == [
        "pose 9",
        "pose 25",
        "pose 8 → pose 9",
        "pose 9 → pose 10",
        "pose 24 → pose 25",
    ]


def test_no_move_leads_from_one_mounting_to_another() -> None:
    result = calibrated(session(2), check=[24], mounting=(0,) * 10 + (1,) * 15)
    assert ("pose 10", "pose 11") not in {(move.start, move.stop) for move in result.moves}
    late = calibrated(session(2), check=[10, 24], mounting=(0,) * 10 + (1,) * 15).verification
    assert late is not None
    assert "pose 10 → pose 11" not in {row.name for row in late.rows}
    assert late.passed


@pytest.mark.parametrize(
    ("sensor", "change", "words"),
    [
        ("accel", (0.0, 0.0, 5 * MILLI_G), "gravity's size"),
        ("gyro", (0.0, 0.0, 0.0), "gravity's direction"),
    ],
)
def test_a_sensor_that_changed_before_the_checks_fails_with_the_reason(
    sensor: str, change: tuple[float, float, float], words: str
) -> None:
    recording = session(3)
    late = rows_of(recording, FITTED)[:, None]
    values = getattr(recording.block, sensor)
    gain = 1.0 if sensor == "accel" else 1.012
    changed = spoiled(recording, **{sensor: np.where(late, values * gain + change, values)})
    verification = verified(changed)
    assert verification.state == "failed"
    assert "FAILED" in verification.headline
    assert any(words in reason and "allowed" in reason for reason in verification.reasons)


def test_a_check_that_cannot_be_used_is_void_and_none_that_count_is_not_a_pass() -> None:
    recording = session(4)
    t, accel = recording.block.t, recording.block.accel.copy()
    begin, end = recording.holds[FITTED]
    inside = (t >= begin) & (t <= end)
    accel[inside, 0] += np.linspace(0.0, 1.0, int(inside.sum()))
    moved = verified(spoiled(recording, accel=accel))
    assert moved.rows[-1].void or any("moved" in row.void for row in moved.rows)
    assert any("pose 21 counts for nothing: the sensor moved" in r for r in moved.reasons)
    assert not any("pose pose" in reason for reason in moved.reasons)
    assert moved.passed

    accel = recording.block.accel.copy()
    late = rows_of(recording, FITTED)
    accel[late] = np.sign(accel[late]) * np.maximum(np.abs(accel[late]), 11.0)
    clipped = verified(spoiled(recording, accel=accel), accel_limit=11.0)
    assert clipped.state == "not verified"
    assert not clipped.passed
    assert "NOT verified" in clipped.headline
    assert sum("range limit" in reason for reason in clipped.reasons) == CHECKS


def test_limits_are_those_that_were_asked_for() -> None:
    strict = Limits(accel=1e-9, turn=1e-9, sigma=1e-6)
    verification = verified(session(5), limits=strict)
    assert {row.state for row in verification.rows} == {"failed"}
    assert all("predicted standard deviations" in reason for reason in verification.reasons)
    # an error may exceed its limit by what the noise of the check explains
    noisy = verified(session(5), limits=Limits(accel=1e-9, turn=1e-9, sigma=100.0))
    for row in noisy.rows:
        assert row.error is not None
        assert row.noise is not None
        assert (row.state == "passed") == (abs(row.error) <= 1e-9 + 2.0 * row.noise)


def test_nothing_but_checks_is_refused() -> None:
    with pytest.raises(DataError, match="nothing is left to calibrate"):
        calibrated(session(1), check=range(25))


def test_the_certificate_keeps_the_verification(tmp_path: object) -> None:
    result = calibrated(session(6))
    path = tmp_path / "certificate.json"  # type: ignore[operator]
    certificate_of(result).save(path)
    kept = load_certificate(path).verification
    assert result.verification is not None
    assert kept is not None
    assert kept.state == "passed"
    assert kept.accel_limit == pytest.approx(1.0 * MILLI_G, rel=1e-4)
    assert [c.error for c in kept.checks] == [r.error for r in result.verification.rows]


@pytest.mark.parametrize(
    ("t", "dof", "z"),
    # Student's t and the normal deviate of the same tail: tables of either.
    [(2.776, 4, 1.960), (4.604, 4, 2.576), (2.086, 20, 1.960), (2.845, 20, 2.576)],
)
def test_students_t_becomes_the_normal_deviate_of_the_same_probability(
    t: float, dof: float, z: float
) -> None:
    assert as_normal(t, dof) == pytest.approx(z, rel=0.01)
    assert as_normal(t, np.inf) == t
