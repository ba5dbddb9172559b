"""How fast counts of a barometer become pressures, beside one row at a time.

``pytest tests/benchmarks/test_barometer_speed.py --benchmark-enable`` gives the statistics.
"""

import numpy as np
import pytest

from firmware_protocols.ms5803 import compensate
from simulators.ms5803_chip import draw_prom, typical_prom

NUMBER = 100_000
ONE_BY_ONE = 200


def rows(number, *, proms):
    rng = np.random.default_rng(1)
    prom = np.tile(typical_prom(), (number, 1))
    for row in range(proms):
        prom[row] = draw_prom(rng)
    return prom, rng.integers(4e6, 8e6, number), rng.integers(7e6, 9e6, number)


@pytest.mark.parametrize("proms", [0, 2], ids=["one PROM", "several PROMs"])
def test_compensate(benchmark, proms):
    number = NUMBER if benchmark.enabled else 1000
    prom, d1, d2 = rows(number, proms=proms)
    pressure, temperature = benchmark(compensate, "02BA", prom, d1, d2)
    assert np.isfinite(pressure).all()
    assert np.isfinite(temperature).all()
    benchmark.extra_info["rows"] = number


def test_compensate_one_by_one(benchmark):
    prom, d1, d2 = rows(ONE_BY_ONE, proms=0)

    def each():
        pairs = zip(prom, d1, d2, strict=True)
        return [compensate("02BA", words, [one], [two])[0][0] for words, one, two in pairs]

    assert benchmark(each) == compensate("02BA", prom, d1, d2)[0].tolist()
    benchmark.extra_info["rows"] = ONE_BY_ONE
