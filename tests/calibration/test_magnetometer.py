"""Magnetometer: the truth found, uncertainties that are true, and data that are refused."""

import numpy as np
import pytest
from simulated_fields import (
    DEG,
    FIELD,
    Compass,
    G,
    field,
    jig_matrices,
    pose_list,
    session,
)

from imu_rig import rotation
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.magnetic import calibrate_from_samples, calibrate_from_stills
from imu_rig.calibration.magnetometer import FieldReadings, fit_field, rotation_uncertainty
from imu_rig.calibration.model import Affine
from imu_rig.errors import DataError, InputError

SPHERE = np.random.default_rng(0).standard_normal((200, 3))
SPHERE /= np.linalg.norm(SPHERE, axis=1, keepdims=True)


def calibrate(matrices, compass, rng, *, known=FIELD, attitudes=None, on_jig=False, **options):
    block, stills = session(matrices, compass, rng, **options)
    names = tuple(f"pose {i + 1}" for i in range(len(stills)))
    return calibrate_from_stills(
        block, stills, names, Affine.identity(), field_ut=known, attitudes=attitudes, on_jig=on_jig
    )


def errors(result, compass):
    """Angle [deg] and size [%] by which calibrated readings are off, rms over the sphere."""
    h = FIELD * SPHERE
    off = result.affine.apply(compass.read(h)) / FIELD - SPHERE
    across = np.linalg.norm(np.cross(SPHERE, off), axis=1)
    along = np.sum(SPHERE * off, axis=1)
    return np.sqrt(np.mean(across**2)) / DEG, 100 * np.sqrt(np.mean(along**2))


@pytest.mark.parametrize("rolls", [6, 8, 13])
@pytest.mark.parametrize("dip_deg", [20.0, 60.0, 75.0, -60.0])
def test_gain_offset_and_axes_are_found_at_any_dip(rolls, dip_deg):
    found = []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        compass = Compass.random(rng)
        result = calibrate(jig_matrices(pose_list(rolls)), compass, rng, dip_deg=dip_deg)
        assert result.warnings == ()
        assert result.alignment == "dip"
        assert abs(result.dip_rad - dip_deg * DEG) < 5 * result.dip_u < 1.0 * DEG
        found.append(errors(result, compass))
    angle, size = np.mean(found, axis=0)
    assert angle < 0.12
    assert size < 0.12


def test_known_attitudes_do_better_than_the_dip_alone_where_the_pan_never_turned():
    angles = pose_list(8)
    angles[:, 0] = 0.0
    matrices = jig_matrices(angles)
    rng = np.random.default_rng(3)
    compass = Compass.random(rng)
    # The field lies in the plane in which the jig tilts: the dip does not see the roll axis.
    alone = calibrate(matrices, compass, np.random.default_rng(4), azimuth_deg=0.0)
    turn = rotation.from_rotation_vector(0.25 * DEG * rng.standard_normal((24, 3)))
    measured = matrices @ rotation.to_matrix(turn)
    told = calibrate(
        matrices, compass, np.random.default_rng(4), azimuth_deg=0.0, attitudes=measured
    )
    assert told.alignment == "attitudes"
    assert told.warnings == ()
    assert errors(told, compass)[0] < 0.15
    assert told.alignment_u < 0.15 * DEG
    assert any("two headings" in w or "more headings" in w for w in alone.warnings)


def test_stated_uncertainties_hold_the_truth():
    matrices = jig_matrices(pose_list(8))
    inside, dips = [], []
    for seed in range(60):
        rng = np.random.default_rng(500 + seed)
        compass = Compass.random(rng)
        result = calibrate(matrices, compass, rng, hold_s=1.0)
        affine = result.affine
        truth = np.concatenate((compass.K.ravel(), compass.b))
        off = np.concatenate((affine.K.ravel(), affine.b)) - truth
        sigma = np.concatenate((affine.K_uncertainty.ravel(), affine.b_uncertainty))
        inside.append(np.abs(off) < affine.coverage_factor * sigma)
        dips.append(abs(result.dip_rad - 60 * DEG) < affine.coverage_factor * result.dip_u)
    share = np.mean(inside, axis=0)
    assert 0.93 <= share[:9].mean() <= 0.98
    assert 0.93 <= share[9:].mean() <= 0.98
    assert np.mean(dips) >= 0.9


def test_uncertainties_of_samples_hold_the_truth_though_errors_go_on_for_seconds():
    rng = np.random.default_rng(11)
    inside = []
    for _ in range(12):
        compass = Compass.random(rng)
        block = tumbling(compass, rng, noise=0.004, wander=0.01)
        result = calibrate_from_samples(block, field_ut=FIELD)
        off = np.concatenate(
            (result.affine.K.ravel() - compass.K.ravel(), result.affine.b - compass.b)
        )
        sigma = np.concatenate((result.affine.K_uncertainty.ravel(), result.affine.b_uncertainty))
        inside.append(np.abs(off) < result.affine.coverage_factor * sigma)
    assert 0.9 <= np.mean(inside) <= 0.99


def tumbling(compass, rng, *, seconds=60.0, noise=0.004, wander=0.0, dip_deg=60.0, push=0.03):
    """A sensor turned about by hand; ``wander`` is a slow error of every axis, over the field."""
    n = round(seconds * 100)
    t = np.arange(n) / 100.0

    def slow(step_s, columns):
        knots = rng.standard_normal((round(seconds / step_s) + 4, columns))
        at = np.arange(len(knots)) * step_s
        return np.stack([np.interp(t, at, knots[:, k]) for k in range(columns)], axis=1)

    back = rotation.normalize(slow(1.5, 4))
    h = rotation.rotate(back, field(dip_deg)) + wander * FIELD * slow(0.5, 3)
    mag = compass.read(h) + noise * FIELD * rng.standard_normal((n, 3))
    up = rotation.rotate(back, np.array([0.0, 0.0, G]))
    accel = up + push * G * rng.standard_normal((n, 3))
    return ImuBlock(t, accel, np.zeros((n, 3)), t, mag=mag)


def test_a_turned_sensor_gives_the_same_calibration_turned():
    rng = np.random.default_rng(7)
    compass = Compass.random(rng)
    matrices = jig_matrices(pose_list(8))
    block, stills = session(matrices, compass, rng)
    names = tuple("abcdefghijklmnopqrstuvwx")
    Q = rotation.to_matrix(rotation.from_rotation_vector(np.array([0.2, -0.1, 0.3])))
    plain = calibrate_from_stills(block, stills, names, Affine.identity(), field_ut=FIELD)
    turn = Affine(Q, np.zeros(3), np.zeros((12, 12)))
    turned = calibrate_from_stills(block, stills, names, turn, field_ut=FIELD)
    assert np.allclose(turned.affine.K, Q @ plain.affine.K, atol=1e-6)
    assert np.allclose(turned.affine.b, Q @ plain.affine.b, atol=1e-4)
    assert np.isclose(turned.residual_percent, plain.residual_percent, rtol=1e-4)
    assert np.isclose(turned.alignment_u, plain.alignment_u, rtol=1e-3)


def test_an_uncertain_accelerometer_makes_the_axes_uncertain():
    rng = np.random.default_rng(21)
    block, stills = session(jig_matrices(pose_list(8)), Compass.random(rng), rng)
    found = []
    for lean in (0.0, 0.002):
        C = np.zeros((12, 12))
        C[1, 1] = C[2, 2] = C[5, 5] = lean**2
        accel = Affine(np.eye(3), np.zeros(3), C)
        found.append(calibrate_from_stills(block, stills, ("p",) * 24, accel).alignment_u)
    # An axis that leans by 2 mrad turns "up" by about as much, less what many poses average.
    assert np.sqrt(found[1] ** 2 - found[0] ** 2) == pytest.approx(0.0015, abs=0.0009)


def test_without_a_stated_field_only_the_scale_is_relative():
    rng = np.random.default_rng(8)
    compass = Compass.random(rng)
    matrices = jig_matrices(pose_list(8))
    given = calibrate(matrices, compass, np.random.default_rng(1))
    free = calibrate(matrices, compass, np.random.default_rng(1), known=None)
    assert not free.field_known
    assert any("not stated" in note for note in free.notes)
    assert np.allclose(free.affine.K / free.field_ut, given.affine.K / FIELD, rtol=1e-6)
    assert np.linalg.det(free.affine.K) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize(("share", "seen"), [(0.0, False), (0.02, True), (0.05, True)])
def test_iron_of_the_jig_is_warned_of_where_it_shows(share, seen):
    # A magnet on the pan stage turns with it and not with the sensor.
    angles = pose_list(8)
    pan = rotation.about_z(angles[:, 0] * DEG)
    iron = share * FIELD * pan @ np.array([0.48, 0.6, 0.64])
    rng = np.random.default_rng(9)
    compass = Compass.random(rng)
    result = calibrate(jig_matrices(angles), compass, rng, iron=iron, on_jig=True)
    assert any("disturb" in w for w in result.warnings) == seen
    # What does not show may be there all the same: a jig's result says so.
    assert any("more than any residual shows" in note for note in result.notes)


def test_a_field_that_changes_with_time_is_warned_of():
    rng = np.random.default_rng(10)
    compass = Compass.random(rng)
    matrices = jig_matrices(pose_list(8))
    growing = np.linspace(0.0, 0.02, 24)[:, None] * field(60.0)
    result = calibrate(matrices, compass, rng, iron=growing)
    assert any("in the course of" in w for w in result.warnings)


def test_a_disturbed_pose_is_named_and_set_aside():
    rng = np.random.default_rng(12)
    compass = Compass.random(rng)
    iron = np.zeros((24, 3))
    iron[5] = (3.0, 2.0, -2.0)
    result = calibrate(jig_matrices(pose_list(8)), compass, rng, iron=iron)
    assert any("pose 6 was set aside" in w for w in result.warnings)
    assert errors(result, compass)[0] < 0.12


def test_a_part_of_the_sphere_is_warned_of_by_the_sides_that_are_missing():
    rng = np.random.default_rng(13)
    compass = Compass(np.eye(3), np.array([5.0, -8.0, 3.0]))
    turns = rotation.from_rotation_vector(0.6 * rng.uniform(-1, 1, (24, 3)))
    result = None
    try:
        result = calibrate(rotation.to_matrix(turns), compass, rng)
    except DataError as error:
        message = str(error)
    else:
        message = " ".join(result.warnings)
    assert "until the field points along its" in message


def test_wild_samples_do_not_move_the_fit():
    rng = np.random.default_rng(14)
    compass = Compass.random(rng)
    block = tumbling(compass, rng)
    clean = calibrate_from_samples(block, field_ut=FIELD)
    mag = block.mag.copy()
    mag[::25] = 0.0
    mag[7::50] += 400.0
    result = calibrate_from_samples(ImuBlock(block.t, block.accel, block.gyro, block.t, mag=mag))
    assert any("far from all others" in w for w in result.warnings)
    scaled = result.affine.K * FIELD / result.field_ut
    assert np.allclose(scaled, clean.affine.K, atol=2e-3)
    assert errors(clean, compass)[0] < 0.5


def test_axes_that_contradict_gravity_are_named():
    rng = np.random.default_rng(15)
    compass = Compass.random(rng)
    block, stills = session(jig_matrices(pose_list(8)), compass, rng)
    raw = block.mag[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])
    chip = ImuBlock(block.t, block.accel, block.gyro, block.t, mag=raw)
    with pytest.raises(DataError, match="the accelerometer's y, x, -z"):
        calibrate_from_stills(chip, stills, ("p",) * 24, Affine.identity())


def test_samples_without_a_usable_direction_of_gravity_give_a_symmetric_gain():
    rng = np.random.default_rng(16)
    compass = Compass.random(rng)
    block = tumbling(compass, rng, push=0.6)
    result = calibrate_from_samples(block, field_ut=FIELD)
    assert result.alignment == "none"
    assert result.alignment_u is None
    assert np.allclose(result.affine.K, result.affine.K.T)
    assert rotation_uncertainty(result.affine.K, result.affine.covariance) < 1e-3
    assert any("not aligned" in w for w in result.warnings)
    assert result.left_out_percent < 1.0


def good_readings(rng, count=24):
    compass = Compass.random(rng)
    matrices = jig_matrices(pose_list(8))[:count]
    h = np.einsum("nji,j->ni", matrices, field(60.0))
    raw = compass.read(h) + 0.05 * rng.standard_normal((count, 3))
    return FieldReadings(raw, np.full((count, 3), 0.05), matrices[:, 2, :])


def test_outliers_may_not_be_more_than_a_few():
    rng = np.random.default_rng(17)
    readings = good_readings(rng)
    fit = fit_field(readings, FIELD)
    assert fit.used.all()
    assert max(fit.noise[:2]) < 1.6


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda mag: mag * 0.0, "never changes"),
        (lambda mag: mag * 0.0 + 40.0, "never changes"),
        (lambda mag: np.where(np.arange(len(mag))[:, None] == 5, np.nan, mag), "not numbers"),
        (lambda mag: mag * [1.0, 1.0, 0.0], "axis z never changes"),
        (lambda mag: mag * [1.0, 1.0, 0.001], "in a plane"),
        (lambda mag: np.ones_like(mag) + 1e-13 * mag, "never change"),
        (lambda mag: mag * 1e200, "its unit is wrong"),
        (lambda mag: mag * 1e-9, "its unit is wrong"),
        (lambda mag: 90 * np.sin(1e5 * mag) * [1.0, 0.9, 1.1], "one constant field"),
    ],
)
def test_readings_that_determine_nothing_are_refused_in_one_sentence(spoil, words):
    rng = np.random.default_rng(18)
    block, stills = session(jig_matrices(pose_list(8)), Compass.random(rng), rng, hold_s=0.5)
    block = ImuBlock(block.t, block.accel, block.gyro, block.t, mag=spoil(block.mag))
    with pytest.raises(DataError, match=words) as caught:
        calibrate_from_stills(block, stills, ("p",) * 24, Affine.identity())
    assert "\n" not in str(caught.value)


def test_too_few_poses_and_too_short_recordings_say_what_to_add():
    rng = np.random.default_rng(19)
    compass = Compass.random(rng)
    with pytest.raises(DataError, match=r"10 still poses are too few.*12 poses or more"):
        calibrate(jig_matrices(pose_list(8)[:10]), compass, rng)
    with pytest.raises(DataError, match="20 s are too short"):
        calibrate_from_samples(tumbling(compass, rng, seconds=20.0))


def test_an_impossible_field_is_refused():
    rng = np.random.default_rng(20)
    compass = Compass.random(rng)
    with pytest.raises(InputError, match="22 to 67"):
        calibrate(jig_matrices(pose_list(8)), compass, rng, known=0.48)
    result = calibrate(jig_matrices(pose_list(8)), compass, rng, known=22.0)
    assert any("check its unit" in w for w in result.warnings)
