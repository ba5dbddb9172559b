"""Tables of distances beside an optical system, against the published ones."""

import json

import numpy as np
import pytest

from imu_rig.errors import DataError
from imu_rig.reference.alignment import align
from imu_rig.reference.reference import Reference
from imu_rig.reference.tables import axis_tables, distance_tables

PUBLISHED_M = {  # three trials each: by the optical system, by the sensor, and the RMSE
    "x": ((3.93, 3.76, 3.82), (3.77, 3.73, 3.76), 0.10),
    "y": ((0.14, 0.08, 0.09), (-0.11, 0.16, 0.02), 0.16),
    "z": ((-0.04, -0.04, -0.04), (-0.05, 0.16, -0.05), 0.12),
}
PUBLISHED_ERRORS_M = {"x": (0.16, 0.03, 0.06), "y": (0.25, 0.08, 0.07), "z": (0.01, 0.20, 0.01)}


def test_the_published_tables_come_out_again():
    """Errors and RMSE of Tables 4 to 6."""
    there = np.array([PUBLISHED_M[axis][0] for axis in "xyz"]).T
    here = np.array([PUBLISHED_M[axis][1] for axis in "xyz"]).T
    for table in distance_tables(["1", "2", "3"], there, here):
        assert table.error == pytest.approx(PUBLISHED_ERRORS_M[table.axis], abs=1e-9)
        assert round(table.rmse, 2) == PUBLISHED_M[table.axis][2]
        lines = table.lines()
        assert len(lines) == 5
        assert f"{PUBLISHED_M[table.axis][2]:.2f}" in lines[-1]
        json.dumps(table.to_dict(), allow_nan=False)


def test_trials_bring_their_own_distances():
    """A way of 4 m that is measured 1 % short, in the axes of the reference."""
    t = np.arange(200) * 0.01
    way = np.column_stack((2.0 * t, 0.2 * np.sin(t), 0.0 * t))
    found = align(t, 0.99 * way, Reference(t, way))
    x, _, z = axis_tables({"one": found, "two": found})
    assert x.trials == ("one", "two")
    assert x.reference == pytest.approx([3.98, 3.98])
    assert x.error == pytest.approx([0.0398, 0.0398], rel=0.02)
    assert x.mean_path_rmse == pytest.approx(0.01 * 4.0 / np.sqrt(12.0), rel=0.05)
    assert z.rmse == pytest.approx(0.0, abs=1e-12)


def test_no_trials_make_no_table():
    """A sentence."""
    with pytest.raises(DataError, match="at least one trial"):
        axis_tables({})
