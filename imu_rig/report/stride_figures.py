"""The figures of strides: when the foot stands, how it is held, every stride beside the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from imu_rig.arrays import BoolArray, FloatArray
from imu_rig.gait.trajectory import FootTrack
from imu_rig.report.figures import count_axis
from imu_rig.report.numbers import fixed
from imu_rig.report.svg import AFTER, BEFORE, INK, LEFT_OUT, TRUTH, new_figure, panel
from imu_rig.report.walk_panels import (
    LEFT,
    MANY_STRIDES,
    PANEL_WIDTH,
    STEPS,
    Z_95,
    align_labels,
    at_least,
    legend,
    log_axis,
    stance_bands,
)
from imu_rig.units import DEG

WINDOW_STRIDES, WINDOW_S = 5, 9.0
"""Of the figures that show single strides: so many of them, and at most so long."""
AT_REST = 1.2
"""Strides that last so much longer than usual have a rest between them."""
MARGIN_S = 0.2


def stance(
    track: FootTrack, accel: FloatArray, gyro: FloatArray, motion_unit: str = "m/s"
) -> Figure:
    """Draw what a foot feels over some strides, with the times at which it stands.

    Parameters
    ----------
    track : FootTrack
    accel, gyro : shape (n, 3)
        Specific force [m/s^2] and angular rate [rad/s], sensor axes.
    motion_unit : str
        Of what the detector compares; empty where it has none.
    """
    motion = f"motion [{motion_unit}]" if motion_unit else "motion"
    window = strides_window(track)
    t = track.trajectory.t[window]
    zero = track.zero_velocity
    curves = (
        (np.linalg.norm(accel[window], axis=1), "force [m/s²]", "specific force"),
        (np.linalg.norm(gyro[window], axis=1) / DEG, "rate [deg/s]", "angular rate"),
        (zero.statistic[window], motion, "what the detector compares"),
    )
    figure = new_figure(450.0)
    for row, (values, label, name) in enumerate(curves):
        axes = panel(figure, LEFT, 46.0 + (2 - row) * 132.0, PANEL_WIDTH, 104.0)
        stance_bands(axes, t, zero.still[window], label="stands" if row == 0 else "")
        axes.plot(t, values, color=AFTER, linewidth=1.1, label=name)
        if row == 2:
            axes.plot(
                t, zero.threshold[window], color=LEFT_OUT, linewidth=1.4, label="its threshold"
            )
            log_axis(axes, np.concatenate((values, zero.threshold[window])))
        else:
            axes.set_ylim(bottom=0.0)
            axes.yaxis.set_major_locator(MaxNLocator(5, steps=STEPS))
        axes.set_ylabel(label)
        axes.set_xlim(t[0], t[-1])
        if row < 2:
            axes.tick_params(labelbottom=False)
        legend(axes, 3)
    figure.axes[-1].set_xlabel("time of the recording [s]")
    align_labels(figure)
    return figure


def foot_angles(track: FootTrack, angles: FloatArray, names: Sequence[str]) -> Figure:
    """Draw angles (n, k) [rad], NaN where unknown, over some strides, with the stance times."""
    window = strides_window(track)
    t = track.trajectory.t[window]
    count = angles.shape[1]
    figure = new_figure(64.0 + 122.0 * count)
    for k, name in enumerate(names):
        axes = panel(figure, LEFT, 46.0 + (count - 1 - k) * 122.0, PANEL_WIDTH, 108.0)
        stance_bands(axes, t, track.zero_velocity.still[window], label="stands" if k == 0 else "")
        axes.plot(t, angles[window, k] / DEG, color=AFTER, linewidth=1.2)
        axes.axhline(0.0, color=INK, linewidth=0.7, zorder=1)
        axes.set_ylabel(f"{name} [deg]")
        axes.yaxis.set_major_locator(MaxNLocator(5, steps=STEPS))
        axes.set_xlim(t[0], t[-1])
        if k < count - 1:
            axes.tick_params(labelbottom=False)
        if k == 0:
            legend(axes, 1)
    figure.axes[-1].set_xlabel("time of the recording [s]")
    align_labels(figure)
    return figure


@dataclass(frozen=True, eq=False)
class StrideCurve:
    """One quantity of every stride.

    Attributes
    ----------
    values : shape (k,)
        In the unit of ``label``.
    sigma : shape (k,) or None
        Standard uncertainties.
    label : str
        Of the axis, as ``"length [m]"``.
    seen : shape (k,) or None
        The same by a reference; NaN where it has none.
    decimals : int
        Of the mean.
    least_span : float
        The axis shows at least so much, lest noise looks like something.
    """

    values: FloatArray
    sigma: FloatArray | None
    label: str
    seen: FloatArray | None = None
    decimals: int = 3
    least_span: float = 0.0


def over_strides(curves: Sequence[StrideCurve], is_gait: BoolArray | None = None) -> Figure:
    """Draw quantities over the number of the stride, with their mean.

    Parameters
    ----------
    curves : sequence of StrideCurve
    is_gait : shape (k,), optional
        Of bools: strides that the mean is of; all without it.
    """
    figure = new_figure(64.0 + 138.0 * len(curves))
    count = len(curves[0].values)
    x = np.arange(1.0, count + 1.0)
    chosen = np.ones(count, bool) if is_gait is None else is_gait
    size = 5.5 if count <= 30 else 4.5 if count <= MANY_STRIDES else 2.4
    for k, curve in enumerate(curves):
        bottom = 46.0 + (len(curves) - 1 - k) * 138.0
        axes = panel(figure, LEFT, bottom, PANEL_WIDTH, 108.0)
        values = curve.values
        if np.isfinite(values[chosen]).any():
            mean = float(np.nanmean(values[chosen]))
            told = fixed(mean, curve.decimals)
            axes.axhline(mean, color=INK, linewidth=0.9, label=f"mean {told}")
        if curve.sigma is not None and count <= MANY_STRIDES:
            axes.errorbar(
                x, values, yerr=Z_95 * curve.sigma, fmt="none", ecolor=AFTER, elinewidth=1.2,
                alpha=0.7, capsize=0.6 * size, capthick=1.0, label="95 %",
            )  # fmt: skip
        elif curve.sigma is not None:
            axes.fill_between(
                x, values - Z_95 * curve.sigma, values + Z_95 * curve.sigma, color=AFTER,
                alpha=0.25, linewidth=0, label="95 %",
            )  # fmt: skip
        axes.plot(x[chosen], values[chosen], "o", color=AFTER, markersize=size, label="stride")
        if not np.all(chosen):
            axes.plot(
                x[~chosen], values[~chosen], "o", color=BEFORE, markersize=size,
                markerfacecolor="white", label="not in the mean",
            )  # fmt: skip
        if curve.seen is not None:
            axes.plot(
                x, curve.seen, "D", color=TRUTH, markersize=size, markerfacecolor="none",
                label="reference",
            )  # fmt: skip
        axes.set_ylabel(curve.label)
        at_least(axes, curve.least_span)
        axes.yaxis.set_major_locator(MaxNLocator(5, steps=STEPS))
        count_axis(axes, x)
        if k < len(curves) - 1:
            axes.tick_params(labelbottom=False)
        legend(axes, 5)
    figure.axes[-1].set_xlabel("number of the stride")
    align_labels(figure)
    return figure


def strides_window(track: FootTrack) -> slice:
    """Return the samples of some strides without a rest between them, near the middle."""
    t, rows = track.trajectory.t, track.footfalls.quietest
    if len(rows) < 2:
        return slice(0, int(np.searchsorted(t, t[0] + WINDOW_S)) + 1)
    count = min(WINDOW_STRIDES, len(rows) - 1)
    lasts = t[rows[count:]] - t[rows[:-count]]
    usual = float(np.median(np.diff(t[rows])))
    steady = np.flatnonzero(lasts <= max(AT_REST * usual * count, float(lasts.min())))
    first = int(steady[np.argmin(np.abs(steady - 0.5 * (len(lasts) - 1)))])
    begin = float(t[rows[first]]) - MARGIN_S
    end = min(float(t[rows[first + count]]), begin + WINDOW_S) + MARGIN_S
    edges = np.searchsorted(t, (begin, end))
    return slice(int(edges[0]), max(int(edges[1]), int(edges[0]) + 2))
