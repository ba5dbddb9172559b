"""The tail of chi-square against scipy's."""

import numpy as np
import pytest
from scipy.stats import chi2

from imu_rig.calibration.chance import chi_square_tail


@pytest.mark.parametrize("dof", range(1, 12))
def test_the_tail_is_that_of_chi_square(dof):
    for square in (0.0, 1e-6, 0.3, dof, 3.0 * dof, 60.0, 300.0):
        assert chi_square_tail(square, dof) == pytest.approx(
            chi2.sf(square, dof), rel=1e-9, abs=1e-300
        )


def test_nothing_is_improbable_below_nothing():
    assert chi_square_tail(-1.0, 4) == 1.0
    assert not np.isnan(chi_square_tail(1e6, 9))
