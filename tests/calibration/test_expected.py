"""Expected uncertainties against the study's table, fits of noisy data, and plain sense."""

from dataclasses import replace

import numpy as np
import pytest

from imu_rig.calibration.expected import (
    ACCEL_DENSITY,
    GYRO_DENSITY,
    Design,
    ExpectedUncertainty,
    Leg,
    expected_sensors,
    expected_uncertainty,
)
from imu_rig.calibration.expected_paper import expected_of_paper
from imu_rig.calibration.joint_data import JointData
from imu_rig.calibration.joint_fit import default_prior, fit_joint, predict, start
from imu_rig.calibration.joint_model import ACCEL_OFFSET, NONLINEARITY, Prior
from imu_rig.calibration.joint_result import gyro_model, line_over_one_g
from imu_rig.calibration.magnitude import fit_magnitude
from imu_rig.calibration.model import Affine, physical_figures
from imu_rig.errors import DataError

DEG = np.pi / 180.0
MILLI_G = 9.80665e-3
SPEED = 60.0 * DEG


def ring(rolls: int) -> np.ndarray:
    """The studied list: tilt level and two excursions at each roll angle, pan alternating."""
    sizes = ((60, -60), (-45, 45), (90, -90), (-45, 45))
    return np.array(
        [
            (90 * (i % 2), tilt, 360 * i / rolls - 180)
            for i in range(rolls)
            for tilt in (0, *sizes[i % 4])
        ],
        dtype=float,
    )


def design(angles_deg: np.ndarray, hold: float = 2.0, turns=((0, 0, 0),), mounting=None) -> Design:
    angles = np.asarray(angles_deg, float) * DEG
    mounting = np.zeros(len(angles), int) if mounting is None else np.asarray(mounting)
    begin, t, legs = [], 0.0, []
    for i, end in enumerate(angles):
        way = []
        if i:
            middle = np.array([end[0], end[1], angles[i - 1, 2]])
            for a, b in ((angles[i - 1], middle), (middle, end)):
                if np.any(a != b):
                    way.append(Leg(a, b, float(np.abs(b - a).max() / SPEED + 0.1)))
        t += sum(leg.duration for leg in way)
        begin.append(t)
        t += hold
        legs.append(way if i and mounting[i] == mounting[i - 1] else [])
    starts = np.array(begin)
    return Design(angles, mounting, np.array(turns, float), starts, starts + hold, legs, 0.3)


def sizes(expected: ExpectedUncertainty) -> np.ndarray:
    return np.array([group.rms for group in expected.groups()])


def linear(prior: Prior) -> Prior:
    sigma = prior.sigma.copy()
    sigma[NONLINEARITY] = 0.0
    return replace(prior, sigma=sigma)


def figures(accel: Affine, gyro: Affine) -> np.ndarray:
    """Uncertainties of accelerometer scale [%], lean [mrad], bias [mg], and the gyroscope's."""
    a, g = physical_figures(accel), physical_figures(gyro, accel)

    def rms(u):
        return np.sqrt(np.mean(u**2))

    return np.array(
        [
            rms(a.scale_percent_u),
            1e3 * rms(a.cross_rad_u),
            rms(a.bias_u) / MILLI_G,
            rms(g.scale_percent_u),
            1e3 * rms(g.cross_rad_u),
        ]
    )


@pytest.mark.parametrize(
    ("rolls", "study"),
    [
        (8, (0.0098, 0.133, 0.055, 0.0096, 0.111)),
        (10, (0.0084, 0.120, 0.049, 0.0091, 0.098)),
    ],
)
def test_the_studied_lists_are_expected_to_be_as_good_as_the_study_found(rolls, study) -> None:
    data = design(ring(rolls)).data()
    # The study's sensor did not flicker.
    still = data.gyro_sigma[:, 0] / GYRO_DENSITY * ACCEL_DENSITY
    data = replace(data, accel_sigma=still)
    fit = predict(data, linear(default_prior(data)))
    found = figures(line_over_one_g(fit), gyro_model(fit))
    assert found == pytest.approx(study, rel=0.2)


def noisy(ideal: Design, prior: Prior, rng) -> JointData:
    """Readings of a session whose servos and sensors err as the prior and the design say."""
    m = len(ideal)
    deviation = prior.servo * rng.standard_normal((m, 3))
    for i in range(1, m):  # a servo errs anew only where it is driven
        still = ideal.angles[i] == ideal.angles[i - 1]
        deviation[i, still] = deviation[i - 1, still]
    true = ideal.angles + deviation
    legs = [
        [
            replace(leg, start=leg.start + a, end=leg.end + (b if leg is way[-1] else a))
            for leg in way
        ]
        for way, a, b in zip(
            ideal.legs,
            np.vstack((np.zeros(3), (true - ideal.angles)[:-1])),
            true - ideal.angles,
            strict=True,
        )
    ]
    data = replace(ideal, angles=true, legs=legs).data()
    moves = data.moves
    white = GYRO_DENSITY / np.sqrt(2.0 * moves.dt)[:, None]
    return replace(
        data,
        angles=ideal.angles,
        accel=data.accel + data.accel_sigma[:, None] * rng.standard_normal((m, 3)),
        gyro=data.gyro_sigma * rng.standard_normal((m, 3)),
        moves=replace(moves, rate=moves.rate + white * rng.standard_normal(moves.rate.shape)),
    )


def test_fits_of_noisy_sessions_scatter_as_expected() -> None:
    ideal = design(ring(6))
    data = ideal.data()
    prior = replace(linear(default_prior(data)), wobble=np.full(len(data), 1e-6))
    fit = predict(data, prior)
    expected = figures(line_over_one_g(fit), gyro_model(fit))
    rng = np.random.default_rng(5)
    off, upper = ~np.eye(3, dtype=bool), np.triu_indices(3, 1)
    errors = []
    for _ in range(40):
        session = noisy(ideal, prior, rng)
        covariance = session.accel_sigma[:, None, None] ** 2 * np.eye(3)
        begin = fit_magnitude(session.accel, covariance, session.gravity).affine
        state = fit_joint(session, prior, start(session, begin), components=False).state
        T, K, o = state.T, state.K, state.common[ACCEL_OFFSET]
        # Of a nominal sensor; leans in mrad, scales in percent, bias in mg.
        parts = (
            100.0 * (np.diag(T) - 1.0),
            1e3 * T[upper],
            o / MILLI_G,
            100.0 * (np.diag(K) - 1.0),
            1e3 * K[off],
        )
        errors.append([np.mean(part**2) for part in parts])
    assert np.sqrt(np.mean(errors, axis=0)) == pytest.approx(expected, rel=0.25)


def test_longer_holds_and_more_poses_are_expected_to_tell_more() -> None:
    short, long = (sizes(expected_uncertainty(design(ring(8), hold))) for hold in (1.0, 3.0))
    assert np.all(long < short)
    more = sizes(expected_uncertainty(design(ring(12))))
    assert np.all(more < sizes(expected_uncertainty(design(ring(8)))))


def test_how_the_sensor_is_named_on_the_plate_changes_nothing() -> None:
    plain = expected_uncertainty(design(ring(8)))
    turned = expected_uncertainty(design(ring(8), turns=[(0, 0, np.pi / 2)]))
    # Leans and cross-axis terms count from the sensor's x axis, which is another one now.
    assert sizes(turned) == pytest.approx(sizes(plain), rel=0.15)
    # x and y have changed places.
    assert turned.accel.scale_percent_u[[1, 0, 2]] == pytest.approx(
        plain.accel.scale_percent_u, rel=0.02
    )


def test_a_short_reach_costs_much_and_a_second_mounting_gives_it_back() -> None:
    full = sizes(expected_uncertainty(design(ring(8))))
    rolls = np.linspace(-45, 45, 8)
    poses = np.array([(90 * (i % 2), t, r) for i, r in enumerate(rolls) for t in (0, 45, -45)])
    short = sizes(expected_uncertainty(design(poses)))
    assert np.all(short[[0, 2]] > 5 * full[[0, 2]])
    both = design(
        np.concatenate((poses[::2], poses[::2])),
        turns=[(0, 0, 0), (0, np.pi / 2, 0)],
        mounting=np.repeat((0, 1), 12),
    )
    assert np.all(sizes(expected_uncertainty(both))[[0, 2]] < short[[0, 2]] / 3)


def test_a_nominal_sensor_s_figures_are_the_elements_of_its_gain_and_bias() -> None:
    ideal = design(ring(8))
    accel, gyro = expected_sensors(ideal)
    told = expected_uncertainty(ideal)
    assert 100 * np.diag(accel.K_uncertainty) == pytest.approx(told.accel.scale_percent_u, rel=1e-3)
    assert told.gyro is not None
    assert gyro.b_uncertainty == pytest.approx(told.gyro.bias_u, rel=1e-3)


def test_gravity_alone_tells_less_than_the_jig_besides() -> None:
    ideal = design(ring(8))
    alone, joint = expected_uncertainty(ideal, angles_known=False), expected_uncertainty(ideal)
    assert alone.level is None
    assert sizes(alone)[1] > sizes(joint)[1]


def test_the_published_method_is_as_good_as_its_angles() -> None:
    paper, open_turns = expected_of_paper(design(ring(8)), "full")
    assert open_turns is None
    assert np.all(sizes(paper) > 10 * sizes(expected_uncertainty(design(ring(8)))))
    # 2 % of servo gain in a gyroscope's gain is what the jig of the study has, 1 % is assumed.
    assert paper.gyro is not None
    assert np.all(paper.gyro.scale_percent_u > 1.0)
    with pytest.raises(DataError, match="x axis"):
        expected_of_paper(design(np.array([(0, 0, r) for r in range(0, 360, 30)])), "full")
    level = np.array([(0, 0, 0), (0, 0, 90), (0, 0, 180), (0, 0, -90), (0, 90, -90), (0, -90, -90)])
    _, open_turns = expected_of_paper(design(level), "full")
    assert open_turns is not None
