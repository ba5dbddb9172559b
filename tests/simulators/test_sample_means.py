"""Averaging over sample intervals loses nothing of a turn and does not care about batches."""

import numpy as np
import pytest

from simulators.config import RigConfig
from simulators.jig import JOINTS, Jig
from simulators.models import JigModel
from simulators.sampling import Sampler
from simulators.servo import STEP_S

INSTANTS = np.arange(1, 81) * 0.0099997  # off the grid of steps, as a skewed device clock has it


@pytest.fixture
def jig() -> Jig:
    return Jig(JigModel(), gravity=9.8, earth_rate=(0.0, 0.0, 0.0), field=(1.0, 2.0, 3.0))


def turning_steps(axis: int, number: int) -> list[float]:
    """A turn about one joint with constant acceleration: 0.5 * 4 * t^2."""
    table = np.zeros((number, JOINTS, 3))
    t = (np.arange(number) + 0.5) * STEP_S
    table[:, axis, 0] = 2.0 * t**2
    table[:, axis, 1] = 4.0 * t
    table[:, axis, 2] = 4.0
    return table.ravel().tolist()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_rates_times_intervals_sum_to_the_angle(axis):
    ideal = Jig(
        RigConfig.ideal().jig, gravity=9.8, earth_rate=(0.0, 0.0, 0.0), field=(0.0, 0.0, 0.0)
    )
    sampler = Sampler(ideal, 0.0)
    sampler.steps.extend(turning_steps(axis, 1000))
    means = sampler.means(INSTANTS)
    turned = np.cumsum(means.rate * means.duration[:, np.newaxis], axis=0)
    about = {0: 2, 1: 1, 2: 0}[axis]
    assert turned[:, about] == pytest.approx(2.0 * INSTANTS**2, abs=1e-6)
    assert means.duration == pytest.approx(0.0099997, rel=1e-9)


def test_batches_of_any_size_give_the_same_means(jig):
    steps = turning_steps(1, 800)
    whole = Sampler(jig, 0.0)
    whole.steps.extend(steps)
    expected = whole.means(INSTANTS)
    pieces = Sampler(jig, 0.0)
    got = []
    row = 3 * JOINTS
    rng = np.random.default_rng(5)
    start = 0
    while start < 800:
        stop = min(800, start + int(rng.integers(1, 90)))
        pieces.steps.extend(steps[start * row : stop * row])
        first, last = np.searchsorted(INSTANTS, (start * STEP_S, stop * STEP_S), side="right")
        got.append(pieces.means(INSTANTS[first:last]))
        start = stop
    assert np.vstack([m.rate for m in got]) == pytest.approx(expected.rate, abs=1e-10)
    assert np.vstack([m.force for m in got]) == pytest.approx(expected.force, abs=1e-10)
    assert np.concatenate([m.duration for m in got]) == pytest.approx(expected.duration)


def test_a_restart_begins_a_new_interval(jig):
    sampler = Sampler(jig, 0.0)
    sampler.steps.extend(turning_steps(1, 37))
    sampler.restart(0.037)
    sampler.steps.extend([0.0] * (3 * JOINTS * 10))
    means = sampler.means(np.array([0.047]))
    assert means.duration == pytest.approx([0.01])
    assert means.rate == pytest.approx(np.zeros((1, 3)))
