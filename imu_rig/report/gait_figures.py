"""The figures of a walk by zero-velocity double integration, and of distances over trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from imu_rig.arrays import FloatArray
from imu_rig.gait.distance import WalkDistance
from imu_rig.report.figures import count_axis
from imu_rig.report.svg import AFTER, BEFORE, INK, LEFT_OUT, new_figure, panel
from imu_rig.report.walk_panels import (
    LEFT,
    PANEL_WIDTH,
    STEPS,
    align_labels,
    legend,
    stance_bands,
    thinned,
)

MOST_SECONDS = 12.0
"""Of the acceleration that is drawn: more strides than that cannot be told apart."""


def integration(
    calibrated: WalkDistance, raw: WalkDistance | None, known_m: float | None
) -> Figure:
    """Draw acceleration with stance and swing, velocity after its resets, and distance.

    Parameters
    ----------
    calibrated : WalkDistance
        The one whose stance is shown.
    raw : WalkDistance or None
        The same trial before calibration.
    known_m : float or None
        How far the walk went along x [m].
    """
    figure = new_figure(478.0)
    t = calibrated.t - calibrated.t[0]
    zero = calibrated.zero_velocity
    walking = np.flatnonzero(~zero.still)
    begin = max(0.0, float(t[walking[0]]) - 0.5) if len(walking) else 0.0
    end = min(float(t[-1]), begin + MOST_SECONDS)
    window = slice(int(np.searchsorted(t, begin)), int(np.searchsorted(t, end)) + 1)
    above = panel(figure, LEFT, 338.0, PANEL_WIDTH, 108.0)
    stance_bands(above, t[window], zero.still[window], "stance")
    above.plot(t[window], calibrated.norm[window], color=AFTER, linewidth=1.0, label="acceleration")
    above.plot(t[window], zero.threshold[window], color=LEFT_OUT, linewidth=1.3, label="threshold")
    above.set_ylabel("|a| [m/s²]")
    above.set_ylim(bottom=0.0)
    above.set_xlim(t[window][0], t[window][-1])
    middle = panel(figure, LEFT, 190.0, PANEL_WIDTH, 96.0)
    middle.plot(t[window], calibrated.velocity[window, 0], color=AFTER, linewidth=1.1)
    if raw is not None:
        middle.plot(t[window], raw.velocity[window, 0], color=BEFORE, linewidth=0.9)
    middle.set_ylabel("velocity x [m/s]")
    middle.set_xlim(t[window][0], t[window][-1])
    below = panel(figure, LEFT, 46.0, PANEL_WIDTH, 96.0)
    rows = thinned(len(t))
    if known_m is not None:
        below.axhline(
            known_m, color=INK, linewidth=1.0, linestyle=(0, (5, 3)), label=f"known, {known_m:g} m"
        )
    if raw is not None:
        below.plot(
            raw.t[rows] - raw.t[0], raw.position[rows, 0], color=BEFORE, linewidth=1.3,
            label="not calibrated",
        )  # fmt: skip
    below.plot(
        t[rows], calibrated.position[rows, 0], color=AFTER, linewidth=1.3,
        label="this sensor" if raw is None else "calibrated",
    )  # fmt: skip
    below.set_ylabel("distance x [m]")
    below.set_xlabel("time of the recording [s]")
    below.set_xlim(t[0], t[-1])
    for axes in (above, middle, below):
        axes.yaxis.set_major_locator(MaxNLocator(5, steps=STEPS))
    for axes in (above, below):
        legend(axes, 4)
    align_labels(figure)
    return figure


@dataclass(frozen=True, eq=False)
class ErrorsOfAxis:
    """Errors of distance along one axis, trial by trial.

    Attributes
    ----------
    name : str
    uncalibrated, calibrated : shape (n,)
        [m]
    ours : shape (n,) or None
        Of the default smoother [m].
    """

    name: str
    uncalibrated: FloatArray
    calibrated: FloatArray
    ours: FloatArray | None = None


def distance_errors(axes_of_trials: Sequence[ErrorsOfAxis]) -> Figure:
    """Draw the errors of each trial before and after calibration, an axis below another."""
    count = len(axes_of_trials)
    figure = new_figure(64.0 + 124.0 * count)
    trials = np.arange(1.0, len(axes_of_trials[0].calibrated) + 1.0)
    size = 5.5 if len(trials) <= 30 else 3.6
    for row, errors in enumerate(axes_of_trials):
        axes = panel(figure, LEFT, 46.0 + (count - 1 - row) * 124.0, PANEL_WIDTH, 100.0)
        axes.axhline(0.0, color=INK, linewidth=0.8)
        for values, colour, mark, label in (
            (errors.uncalibrated, BEFORE, "s", "not calibrated"),
            (errors.calibrated, AFTER, "o", "calibrated"),
            (errors.ours, LEFT_OUT, "D", "default smoother"),
        ):
            if values is not None:
                hollow = mark == "D"
                axes.plot(
                    trials, values, mark, color=colour, markersize=size, label=label,
                    markerfacecolor="none" if hollow else colour,
                )  # fmt: skip
        axes.set_ylabel(f"error {errors.name} [m]")
        axes.yaxis.set_major_locator(MaxNLocator(5, steps=STEPS))
        count_axis(axes, trials)
        if row < count - 1:
            axes.tick_params(labelbottom=False)
        if row == 0:
            legend(axes, 4)
    figure.axes[-1].set_xlabel("number of the trial")
    align_labels(figure)
    return figure
