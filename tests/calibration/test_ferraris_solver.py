"""Six faces and three turns: what they determine, what is trusted, what is no turn."""

import json

import numpy as np
import pytest
from simulated_sessions import DEG, MILLI_G, random_sensor, record

from imu_rig import rotation
from imu_rig.blocks import ImuBlock
from imu_rig.calibration.known import Known, Part
from imu_rig.calibration.solve import solve
from imu_rig.errors import DataError, InputError
from imu_rig.importing.column_map import ColumnMap
from imu_rig.importing.parts import read_annotated, read_part_list
from imu_rig.importing.read_table import read_table

FACES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]])
TURN_AFTER = {1: 0, 3: 1, 5: 2}


def placed(up, rng, sigma):
    """Attitude of a face that stands level to ``sigma`` [rad]."""
    up = up + sigma * rng.standard_normal(3)
    up = up / np.linalg.norm(up)
    axis = np.cross(up, [0, 0, 1.0])
    size = np.linalg.norm(axis)
    axis = axis / size if size > 1e-6 else np.array([1.0, 0, 0])
    return rotation.from_rotation_vector(np.arctan2(size, up[2]) * axis)


def session(
    rng, truth, *, angles=(2 * np.pi,) * 3, level=0.5 * DEG, square=0.0, scatter=0.0, repeat=1
):
    """Faces twice per turn: the block stands, is turned on the spot, and stands again."""
    lean = square * rng.standard_normal((3, 3))
    attitudes, turns = [], []
    for _ in range(repeat):
        for face, up in enumerate(FACES):
            axis = face // 2
            here = placed(
                up + np.sign(up[axis]) * np.where(np.arange(3) == axis, 0.0, lean[axis]), rng, level
            )
            if attitudes:
                back = rotation.multiply(rotation.conjugate(attitudes[-1]), here)
                turns.append(rotation.to_rotation_vector(back))
            attitudes.append(here)
            if face in TURN_AFTER:
                angle = angles[axis] + 0.7 * DEG * rng.standard_normal()
                vertical = rotation.rotate(rotation.conjugate(here), np.array([0, 0, 1.0]))
                turns.append(angle * vertical)
                attitudes.append(
                    rotation.multiply(here, rotation.from_rotation_vector(angle * vertical))
                )
    recording = record(attitudes, truth, rng, move_s=3.0, turns=turns, hold_s=2.0)
    shift = scatter * rng.standard_normal((len(attitudes), 3))
    accel = recording.block.accel.copy()
    for (t0, t1), offset in zip(recording.holds, shift, strict=True):
        accel[(recording.block.t >= t0) & (recording.block.t <= t1)] += offset
    t = recording.block.t
    return ImuBlock(t, accel, recording.block.gyro, t)


def z_of(affine, true, rows):
    """Errors in standard uncertainties of the elements ``rows`` of ``[K, b]``."""
    error = np.concatenate(((affine.K - true.K).ravel(), affine.b - true.b))[rows]
    return error / np.sqrt(np.diag(affine.covariance))[rows]


def test_stated_uncertainties_cover_the_truth():
    rng = np.random.default_rng(1)
    accel, gyro = [], []
    for _ in range(12):
        truth = random_sensor(rng)
        block = session(rng, truth, scatter=0.4 * MILLI_G, square=0.3 * DEG)
        result = solve(block, method="ferraris")
        factor = result.accel.coverage_factor
        accel.append(
            np.abs(z_of(result.accel, truth.accel, [0, 1, 2, 4, 5, 8, 9, 10, 11])) < factor
        )
        gyro.append(np.abs(z_of(result.gyro, truth.gyro, range(12))) < result.gyro.coverage_factor)
    assert np.mean(accel) > 0.93
    assert np.mean(gyro) > 0.93


def test_scale_and_bias_do_not_depend_on_how_the_faces_stand():
    rng = np.random.default_rng(2)
    truth = random_sensor(rng)
    result = solve(session(rng, truth, level=1.0 * DEG), method="ferraris")
    assert np.all(result.accel_figures.scale_percent_u < 0.15)
    assert np.all(result.accel_figures.bias_u < 1.5 * MILLI_G)
    assert np.all(result.accel_figures.cross_rad_u > 0.5 * DEG)
    assert np.abs(
        result.accel_figures.bias - np.linalg.solve(truth.accel.K, truth.accel.b)
    ).max() < (3 * MILLI_G)


def test_repeating_the_faces_does_not_make_the_block_square():
    rng = np.random.default_rng(3)
    truth = random_sensor(rng)
    once = solve(session(rng, truth), method="ferraris").accel_figures.cross_rad_u
    often = solve(session(rng, truth, repeat=4), method="ferraris").accel_figures.cross_rad_u
    assert np.all(often > 0.5 * DEG)
    assert np.all(often < once)


@pytest.mark.parametrize("angles", [(1, 1, 1), (-1, -1, -1), (1, -1, 1)])
def test_turns_either_way_give_the_same_gain(angles):
    rng = np.random.default_rng(4)
    truth = random_sensor(rng)
    result = solve(session(rng, truth, angles=2 * np.pi * np.array(angles)), method="ferraris")
    assert np.all(np.diag(result.gyro.K) > 0.8)
    assert np.abs(np.diag(result.gyro.K) - np.diag(truth.gyro.K)).max() < 0.015


@pytest.mark.parametrize(("factor", "axis"), [(0.5, "x"), (2.0, "y"), (0.75, "z")])
def test_a_turn_that_was_not_whole_is_refused_by_name(factor, axis):
    rng = np.random.default_rng(5)
    angles = np.full(3, 2 * np.pi)
    angles["xyz".index(axis)] *= factor
    with pytest.raises(
        DataError, match=f"turn about {axis} measures {360 * factor:.0f}|{axis} mea"
    ):
        solve(session(rng, random_sensor(rng), angles=angles), method="ferraris")


def test_turns_of_another_angle_can_be_stated_and_are_asked_for():
    rng = np.random.default_rng(6)
    truth = random_sensor(rng)
    block = session(rng, truth, angles=(4 * np.pi,) * 3)
    with pytest.raises(DataError, match="--turn-angle"):
        solve(block, method="ferraris")
    result = solve(block, method="ferraris", known=Known(turn_angle=4 * np.pi))
    assert np.abs(np.diag(result.gyro.K) - np.diag(truth.gyro.K)).max() < 0.01


def test_a_missing_face_and_a_missing_turn_are_named():
    rng = np.random.default_rng(7)
    truth = random_sensor(rng)
    block = session(rng, truth)
    with pytest.raises(DataError, match="-z on top"):
        solve(block[block.t < 34.5], method="ferraris")
    no_turn = session(rng, truth, angles=(2 * np.pi, 0.1, 2 * np.pi))
    with pytest.raises(DataError, match="no turn about y"):
        solve(no_turn, method="ferraris")


def test_swapped_gyroscope_columns_are_seen_without_any_move_between_faces():
    rng = np.random.default_rng(8)
    block = session(rng, random_sensor(rng))
    swapped = ImuBlock(block.t, block.accel, block.gyro[:, [1, 0, 2]], block.t)
    with pytest.raises(DataError, match="order"):
        solve(swapped, method="ferraris")


def test_six_faces_without_the_method_are_refused_and_the_method_is_named():
    rng = np.random.default_rng(9)
    with pytest.raises(DataError, match="--method ferraris"):
        solve(session(rng, random_sensor(rng)))


def face_of(result, i):
    """Name of the face on top, such as x_p."""
    up = result.poses[i].direction
    k = int(np.argmax(np.abs(up)))
    return f"{'xyz'[k]}_{'p' if up[k] > 0 else 'a'}"


def test_what_is_trusted_is_said_every_time_and_what_checks_the_rest():
    rng = np.random.default_rng(10)
    block = session(rng, random_sensor(rng))
    result = solve(block, method="ferraris")
    # The three faces on which it was turned stand twice, so each can be left out.
    (said,) = [w for w in result.warnings if "is trusted" in w]
    assert said.startswith("The left-out errors of 6 rests check scale and bias")
    assert "nothing to check" not in said
    assert result.accel_errors.held_out.count == 6
    spans = [(p.t0, p.t1) for p in result.poses]
    ends = [j for j in range(9) if j + 1 == 9 or face_of(result, j) != face_of(result, j + 1)]
    faces = [Part(face_of(result, j), *spans[j]) for j in ends]
    turns = [
        Part(f"{face_of(result, j)[0]}_rot", spans[j][1] - 0.1, spans[j + 1][0] + 0.1)
        for j in range(8)
        if face_of(result, j) == face_of(result, j + 1)
    ]
    # Cut out of the recording, nothing else is left.
    inside = np.any([(block.t >= p.t0) & (block.t <= p.t1) for p in (*faces, *turns)], axis=0)
    bare = solve(block[inside], method="ferraris", known=Known((*faces, *turns)))
    assert bare.accel_errors.held_out is None
    assert any("nothing to check themselves by" in w for w in bare.warnings)
    assert len(result.poses) == 9
    assert len(result.moves) == 8
    assert sum(m.held_out_rad is None for m in result.moves) == 3


def test_parts_have_known_names_and_an_order_in_time(tmp_path):
    with pytest.raises(InputError, match="x_up"):
        Part("x_up", 0.0, 1.0)
    path = tmp_path / "parts.json"
    path.write_text(json.dumps({"x_p": {"start": 5, "end": 900}}))
    with pytest.raises(InputError, match="5 to 900"):
        read_part_list(path, np.arange(100.0))
    path.write_text(json.dumps({"x_p": {"start": 0, "end": 1}}))
    with pytest.raises(InputError, match="x_p is a single sample"):
        read_part_list(path, np.arange(100.0))
    path.write_text("[1")
    with pytest.raises(InputError, match="no JSON"):
        read_part_list(path, np.arange(100.0))


FERRARIS = "calibration/imucal/example_ferraris_session"


def test_real_continuous_session(imu_rig_data):
    stated = ColumnMap().updated(rate_hz=102.4, accel_unit="m/s2", gyro_unit="deg/s")
    block = read_table(imu_rig_data / f"{FERRARIS}.csv", stated)
    parts = read_part_list(imu_rig_data / f"{FERRARIS}_list.json", block.t)
    given = solve(block, method="ferraris", known=Known(parts))
    assert given.accel_errors.held_out.count == 7
    assert given.accel_errors.held_out.rms < 0.5 * MILLI_G
    found = solve(block, method="ferraris")
    assert found.accel_errors.held_out.rms < 0.5 * MILLI_G
    # Both see the same turns: about -370, -354 and -359 degrees.
    difference = np.abs(given.gyro.K - found.gyro.K) / given.gyro.K_uncertainty
    assert difference.max() < 1.0


def test_real_annotated_session(imu_rig_data):
    stated = ColumnMap().updated(
        rate_hz=204.8, accel_unit="2048 LSB/g", gyro_unit="16.4 LSB/(deg/s)"
    )
    path = imu_rig_data / "calibration" / "imucal" / "annotated_session.csv"
    block, parts = read_annotated(path, stated)
    result = solve(block, method="ferraris", known=Known(parts))
    assert len(result.poses) == 6
    assert not result.moves
    # The turns here are positive; their sign must not end up in the gain.
    assert np.diag(result.gyro.K) == pytest.approx([0.983, 1.013, 1.009], abs=0.01)
    assert np.all(result.accel_errors.after.rms < 0.1 * MILLI_G)
