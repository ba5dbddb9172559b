"""A device without a gyroscope: its accelerometer is calibrated all the same."""

from dataclasses import replace

import numpy as np
import pytest
from jig_sessions import session_of, solved

from imu_rig.calibration.model import Affine, physical_figures
from imu_rig.calibration.solve import solve
from imu_rig.errors import DataError


def without(session, sensor):
    readings = {sensor: np.full_like(getattr(session.block, sensor), np.nan)}
    return replace(session, block=replace(session.block, **readings))


@pytest.mark.parametrize("method", ["joint", "static", "multi-position"])
def test_on_a_jig_its_figures_are_within_what_they_state(method):
    session = without(session_of(3), "gyro")
    result = solved(session, method)
    assert result.gyro is None
    found = physical_figures(result.accel)
    line = session.accel_line
    true = physical_figures(Affine(line.K, line.b, np.zeros((12, 12))))
    for name, sigma in (("scale_percent", "scale_percent_u"), ("cross_rad", "cross_rad_u")):
        off = np.abs(getattr(found, name) - getattr(true, name))
        assert (off < 4 * getattr(found, sigma)).all()
    assert (np.abs(found.bias - true.bias) < 4 * found.bias_u).all()
    # As good as a calibration of this sensor is: 0.1 % and a milli-g.
    assert np.max(found.scale_percent_u) < 0.1
    assert np.max(found.bias_u) < 0.01


def test_by_hand_too():
    session = without(session_of(3), "gyro")
    block = replace(session.block, mag=None)
    result = solve(block, gravity=session.truth.gravity)
    assert result.method == "multi-position"
    assert result.gyro is None
    assert any("only the accelerometer" in warning for warning in result.warnings)
    assert physical_figures(result.accel).scale_percent == pytest.approx(
        physical_figures(
            Affine(session.accel_line.K, session.accel_line.b, np.zeros((12, 12)))
        ).scale_percent,
        abs=0.1,
    )


def test_a_gyroscope_that_fails_now_and_then_is_not_taken_for_an_absent_one():
    session = session_of(3)
    gyro = session.block.gyro.copy()
    gyro[1000:2000] = np.nan
    with pytest.raises(DataError, match="not numbers"):
        solved(replace(session, block=replace(session.block, gyro=gyro)))


def test_without_an_accelerometer_it_says_what_is_missing():
    with pytest.raises(DataError, match="holds no accelerometer"):
        solved(without(session_of(3), "accel"))
