"""How well the mean of a still is known, against what the mean really was."""

import numpy as np
import pytest
from simulated_sessions import DEG, MILLI_G

from imu_rig.calibration.magnitude import fit_magnitude
from imu_rig.calibration.mean_noise import (
    drawn_together,
    mean_covariances,
    mean_variances,
    slow_terms,
)

G = 9.80665
RATE = 100.0
NOISE = 0.0004 * G * np.sqrt(RATE / 2)


def band(rng, count, centre_hz, width_hz, columns=3):
    """Gaussian noise of standard deviation 1 in a band, shape (count, columns)."""
    f = np.fft.rfftfreq(2048, 1 / RATE)
    shape = np.exp(-0.5 * ((f - centre_hz) / width_hz) ** 2)
    z = rng.standard_normal((len(f), columns)) + 1j * rng.standard_normal((len(f), columns))
    x = np.fft.irfft(shape[:, None] * z, axis=0)
    return x[:count] * 2048 / (2 * np.sqrt(np.sum(shape**2)))


def directions(rng, count):
    k = np.arange(count) + 0.5
    z, phi = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k + rng.uniform(0, 6)
    return np.stack((np.cos(phi) * np.sqrt(1 - z**2), np.sin(phi) * np.sqrt(1 - z**2), z), axis=1)


def holds(rng, *, count=22, length_s=(2.0, 7.0), tremor=0.0, sway=0.0, shake=0.0):
    """Specific force (n, 3) of every hold, true mean magnitude included."""
    force = []
    for up in directions(rng, count):
        n, how = int(RATE * rng.uniform(*length_s)), rng.uniform(0, 1)
        tilt = tremor * how * band(rng, n, rng.uniform(1, 8), 0.4)
        tilt = tilt + sway * how * band(rng, n, 0.0, 0.4)
        turned = G * (up + np.cross(up, tilt) - 0.5 * np.sum(tilt**2, axis=1)[:, None] * up)
        turned = turned + shake * how * band(rng, n, rng.uniform(1, 8), 0.5)
        force.append(turned + NOISE * rng.standard_normal((n, 3)))
    return force


def described(force):
    terms = [slow_terms(f, RATE) for f in force]
    means = np.array([f.mean(axis=0) for f in force])
    return means, mean_covariances(terms, np.array([len(f) for f in force]), means)


KINDS = {
    "short holds": {"length_s": (0.7, 1.6)},
    "trembling table": {"tremor": 0.3 * DEG},
    "hand": {"tremor": 0.2 * DEG, "sway": 0.2 * DEG, "shake": 1.0 * MILLI_G},
}


@pytest.mark.parametrize("kind", KINDS)
def test_the_noise_along_gravity_is_told_truly(kind):
    rng = np.random.default_rng(1)
    z = []
    for _ in range(15):
        means, covs = described(holds(rng, **KINDS[kind]))
        size = np.linalg.norm(means, axis=1)
        up = means / size[:, None]
        z.append((size - G) / np.sqrt(np.einsum("mi,mij,mj->m", up, covs, up)))
    assert 0.88 < np.sqrt(np.mean(np.square(z))) < 1.12


@pytest.mark.parametrize("kind", KINDS)
def test_left_out_poses_and_parameters_are_as_uncertain_as_stated(kind):
    rng = np.random.default_rng(2)
    z, covered = [], []
    for _ in range(10):
        bias = 40 * MILLI_G * rng.standard_normal(3)
        K = np.triu(0.02 * rng.standard_normal((3, 3)), 1) + np.diag([1.02, 0.98, 1.01])
        raw = [np.linalg.solve(K, (f + bias).T).T for f in holds(rng, **KINDS[kind])]
        fit = fit_magnitude(*described(raw), G)
        z.append(fit.left_out / fit.left_out_sigma)
        error = np.concatenate((fit.affine.K - K, (fit.affine.b - bias)[None, :])).ravel()
        sigma = np.sqrt(np.diag(fit.affine.covariance))
        free = sigma > 0
        covered.append(np.abs(error[free]) < fit.affine.coverage_factor * sigma[free])
    assert 0.88 < np.sqrt(np.mean(np.square(z))) < 1.15
    assert 0.89 < np.mean(covered) < 0.995


def test_tremor_is_uncertain_across_gravity_and_not_along_it():
    rng = np.random.default_rng(3)
    means, covs = described(holds(rng, sway=0.3 * DEG))
    up = means / np.linalg.norm(means, axis=1, keepdims=True)
    along = np.einsum("mi,mij,mj->m", up, covs, up)
    across = np.trace(covs, axis1=1, axis2=2) - along
    assert np.median(across) > 20 * np.median(along)
    assert np.all(np.linalg.eigvalsh(covs) > 0)


def test_a_rate_that_trembles_averages_out_faster_than_its_scatter_says():
    rng = np.random.default_rng(4)
    z, scatter = [], []
    for _ in range(40):
        angle = 0.2 * DEG * band(rng, 401, 3.0, 0.4)
        rate = np.diff(angle, axis=0) * RATE + 0.05 * DEG * rng.standard_normal((400, 3))
        variance = mean_variances([slow_terms(rate, RATE)], np.array([400]))[0]
        z.append(rate.mean(axis=0) / np.sqrt(variance))
        scatter.append(rate.std() / (0.05 * DEG))
    assert np.mean(scatter) > 10
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.4


def test_stills_that_agree_share_their_noise_and_others_keep_their_own():
    rng = np.random.default_rng(5)
    dof = np.full(200, 8.0)
    alike = rng.chisquare(8, 200) / 8
    drawn, _ = drawn_together(alike, dof)
    assert np.std(drawn) < 0.25 * np.std(alike)
    assert np.mean(drawn) == pytest.approx(1.0, abs=0.08)
    true = np.where(np.arange(200) < 100, 0.1, 10.0)
    drawn, own = drawn_together(alike * true, dof)
    assert np.all(own > 0.6)
    assert np.median(drawn[100:]) > 20 * np.median(drawn[:100])


def test_the_slow_terms_of_white_noise_have_its_variance_and_the_first_is_the_drift():
    rng = np.random.default_rng(6)
    x = 0.3 * rng.standard_normal((60_000, 3))
    assert np.std(slow_terms(x, RATE)) == pytest.approx(0.3, rel=0.25)
    ramp = np.linspace(0, 1, 500)[:, None] * [1.0, 0, 0]
    terms = slow_terms(ramp, RATE)
    assert np.argmax(np.abs(terms[:, 0])) == 0
    assert not terms[:, 1:].any()
