"""Distances per axis beside a reference, trial by trial: Tables 4 to 6 of the first paper.

Each of its tables is about one axis of the laboratory: how far the optical system and the sensor
say the person came in each trial, the size of the difference, and the root mean square of that over
the trials. Beside it stands what the paper does not have, the error along the whole path.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.errors import DataError
from imu_rig.reference.alignment import Alignment

AXES = ("x", "y", "z")


@dataclass(frozen=True, eq=False)
class AxisTable:
    """One axis over some trials.

    Attributes
    ----------
    axis : str
        "x", "y" or "z" of the reference.
    trials : tuple of str
    reference, estimate : shape (k,)
        From the first place of a trial to its last [m].
    path_rmse : shape (k,)
        Root mean square error along each trial's path after the fit [m]; NaN where unknown.
    """

    axis: str
    trials: tuple[str, ...]
    reference: FloatArray
    estimate: FloatArray
    path_rmse: FloatArray

    @property
    def error(self) -> FloatArray:
        """Size of the difference in each trial, shape (k,) [m]."""
        return np.abs(self.estimate - self.reference)

    @property
    def rmse(self) -> float:
        """Root mean square of the errors over the trials [m]."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def mean_path_rmse(self) -> float:
        """Mean over the trials of the error along the path [m]."""
        known = self.path_rmse[np.isfinite(self.path_rmse)]
        return float(known.mean()) if len(known) else float("nan")

    def to_dict(self) -> dict[str, Any]:
        """Return the table for JSON; in metres."""
        columns = (self.reference, self.estimate, self.error, self.path_rmse)
        return {
            "axis": self.axis,
            "trials": [
                {
                    "name": name,
                    "reference_m": float(there),
                    "imu_m": float(here),
                    "error_m": float(error),
                    "path_rmse_m": None if np.isnan(path) else float(path),
                }
                for name, there, here, error, path in zip(self.trials, *columns, strict=True)
            ],
            "rmse_m": self.rmse,
            "mean_path_rmse_m": None if np.isnan(self.mean_path_rmse) else self.mean_path_rmse,
        }

    def lines(self) -> list[str]:
        """Return the table as text."""
        wide = max(5, *map(len, self.trials))
        head = f"{'trial':<{wide}}  reference m    IMU m  error m  path RMSE m   ({self.axis} axis)"
        rows = [
            f"{name:<{wide}}  {a:11.2f}  {b:7.2f}  {c:7.2f}  {d:11.3f}"
            for name, a, b, c, d in zip(
                self.trials, self.reference, self.estimate, self.error, self.path_rmse, strict=True
            )
        ]
        last = f"{'RMSE':<{wide}}  {'':11}  {'':7}  {self.rmse:7.2f}  {self.mean_path_rmse:11.3f}"
        return [head, *rows, last]


def axis_tables(trials: Mapping[str, Alignment]) -> list[AxisTable]:
    """Make the tables of x, y and z of aligned trials, by name.

    Raises
    ------
    DataError
        No trials.
    """
    if not trials:
        raise DataError("a table needs at least one trial with a reference")
    aligned = list(trials.values())
    there = np.array([one.reference[-1] - one.reference[0] for one in aligned])
    here = np.array([one.estimate[-1] - one.estimate[0] for one in aligned])
    return distance_tables(list(trials), there, here, np.array([one.rmse for one in aligned]))


def distance_tables(
    names: Sequence[str],
    reference: FloatArray,
    estimate: FloatArray,
    path_rmse: FloatArray | None = None,
) -> list[AxisTable]:
    """Make the tables of x, y and z from distances of trials, shapes (k, 3) [m]."""
    along = np.full(reference.shape, np.nan) if path_rmse is None else path_rmse
    return [
        AxisTable(axis, tuple(names), reference[:, i], estimate[:, i], along[:, i])
        for i, axis in enumerate(AXES)
    ]
