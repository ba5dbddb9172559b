"""The noise report: Allan deviation of a sensor at rest in one HTML file."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from imu_rig.calibration.allan import KINDS, terms
from imu_rig.calibration.noise import AxisCurve, NoiseAnalysis
from imu_rig.calibration.noise_model import NoiseModel
from imu_rig.report.noise_units import UNITS, SensorUnits, duration_of, noise_rows, noise_sensors
from imu_rig.report.numbers import MISSING, duration, fixed, significant
from imu_rig.report.page import Html, card, document, element, facts, header, section, table
from imu_rig.report.svg import (
    AFTER,
    BEFORE,
    INK,
    LEFT_OUT,
    TRUTH,
    Figures,
    new_figure,
    panel,
    report_style,
)

ASYMPTOTES = {
    "quantization": ("quantization, slope −1", "#6a4c93", (0, (1, 1.5))),
    "white": ("white noise, slope −1/2", LEFT_OUT, (0, (6, 2))),
    "flicker": ("bias instability, flat", "#2e7d32", (0, (1, 1.5))),
    "walk": ("random walk, slope +1/2", TRUTH, (0, (4, 2, 1, 2))),
    "ramp": ("drift, slope +1", BEFORE, (0, (8, 3))),
}
PANEL_HEIGHT, PANEL_GAP, BOTTOM = 190.0, 26.0, 48.0
LEGEND_ROW, LEGEND_COLUMNS = 18.0, 2


def noise_report(analysis: NoiseAnalysis, *, title: str = "Noise report") -> str:
    """Return a report of a sensor's noise as the text of one HTML file that needs nothing else."""
    model = analysis.model
    device = model.device
    named = [device.name or "unnamed sensor"]
    named += [f"serial {device.serial}"] if device.serial else []
    named += [f"{model.date:%Y-%m-%d %H:%M %Z}"]
    return document(
        f"{title}: {device.name}" if device.name else title,
        header("noise of a sensor at rest", title, " · ".join(named)),
        _verdict(model),
        element("div", *_cards(model), class_="cards"),
        _coefficients(model),
        _figures(analysis),
        _provenance(model),
    )


def allan_figure(axes_of_sensor: tuple[AxisCurve, ...], units: SensorUnits) -> Figure:
    """Allan deviation of three axes with 95 % intervals, the model and its asymptotes."""
    count = len(axes_of_sensor)
    seen = {
        kind
        for axis in axes_of_sensor
        for kind, found in enumerate(axis.fit.coefficients)
        if found.value is not None
    }
    above = 14.0 + LEGEND_ROW * math.ceil((3 + len(seen)) / LEGEND_COLUMNS)
    height = above + count * PANEL_HEIGHT + (count - 1) * PANEL_GAP + BOTTOM
    figure = new_figure(height)
    handles: dict[str, Artist] = {}
    for number, (letter, axis) in enumerate(zip("xyz", axes_of_sensor, strict=True)):
        top = height - above - number * (PANEL_HEIGHT + PANEL_GAP)
        axes = panel(figure, 66.0, top - PANEL_HEIGHT, 442.0, PANEL_HEIGHT)
        _draw_axis(axes, axis, units.factor)
        axes.set_ylabel(f"{letter} [{units.unit}]")
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    axes.set_xlabel("averaging time [s]")
    figure.legend(
        list(handles.values()), list(handles), loc="upper left", bbox_to_anchor=(0.0, 1.0),
        ncols=LEGEND_COLUMNS, borderaxespad=0.1, handletextpad=0.5, columnspacing=1.4,
        handlelength=2.2,
    )  # fmt: skip
    return figure


def _draw_axis(axes: Axes, axis: AxisCurve, factor: float) -> None:
    curve, fit = axis.curve, axis.fit
    low, high = fit.interval(curve)
    axes.fill_between(
        curve.tau, low / factor, high / factor, color=AFTER, alpha=0.2, linewidth=0,
        label="95 % interval",
    )  # fmt: skip
    axes.plot(
        curve.tau, curve.deviation / factor, "o", color=AFTER, markersize=3.0,
        label="Allan deviation",
    )  # fmt: skip
    tau = np.geomspace(curve.tau[0], curve.tau[-1], 120)
    axes.plot(tau, np.sqrt(fit.variance(tau)) / factor, color=INK, linewidth=1.2, label="model")
    bottom = 0.6 * float(np.min(curve.deviation)) / factor
    above = 1.8 * float(np.max(curve.deviation)) / factor
    every = terms(tau, curve.period) * fit.squares
    for kind, name in enumerate(KINDS):
        if fit.coefficients[kind].value is None:
            continue
        label, colour, dashes = ASYMPTOTES[name]
        line = np.sqrt(every[:, kind]) / factor
        shown = np.where((line > bottom) & (line < above), line, np.nan)
        axes.plot(tau, shown, color=colour, linewidth=1.4, linestyle=dashes, label=label)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(curve.tau[0] / 1.2, curve.tau[-1] * 1.2)
    axes.set_ylim(bottom, above)
    subs = (1.0,) if above / bottom > 300.0 else (1.0, 2.0, 5.0)
    axes.yaxis.set_major_locator(LogLocator(subs=subs))
    axes.xaxis.set_major_locator(LogLocator())
    for one in (axes.xaxis, axes.yaxis):
        one.set_major_formatter(FuncFormatter(lambda value, _: _tick(value)))
        one.set_minor_locator(NullLocator())


def _tick(value: float) -> str:
    return significant(value, 1)


def _verdict(model: NoiseModel) -> Html:
    length = duration(model.duration_s)
    headline = f"Noise over {length} at rest"
    if model.warnings:
        points = element("ul", *(element("li", warning) for warning in model.warnings))
        return element("div", element("h2", headline), points, class_="verdict care")
    sentence = element("p", "The record determines white noise and what limits longer averaging.")
    return element("div", element("h2", headline), sentence, class_="verdict")


def _cards(model: NoiseModel) -> list[Html]:
    cards = []
    for units, noise in noise_sensors(model):
        white = units.rows[0]
        worst = float(np.nanmax(np.append(noise.values("white"), -np.inf)))
        known = np.isfinite(worst)
        cards.append(
            card(
                f"{units.title} white noise",
                significant(worst / white.factor) if known else MISSING,
                white.unit if known else "",
                "largest of the axes" if known else "not determined",
            )
        )
        lowest = max(noise, key=lambda axis: axis.floor)
        about = f"smallest Allan deviation, worst axis, at {duration_of(lowest.floor_s)}"
        cards.append(
            card(
                f"{units.title} floor", significant(lowest.floor / units.factor), units.unit, about
            )
        )
    return cards


def _coefficients(model: NoiseModel) -> Html:
    tables = [
        table(["", "x", "y", "z"], noise_rows(units, noise), caption=units.title)
        for units, noise in noise_sensors(model)
    ]
    return section(
        "Coefficients",
        *tables,
        element(
            "p",
            "Estimate ± one standard uncertainty; “<” is an upper bound (95 %) of what the record "
            "does not determine. White noise, integrated, is the random walk of angle or velocity. "
            "Bias instability is the coefficient of flicker noise: the smallest Allan deviation "
            "that it allows is 0.664 times as large.",
            class_="note",
        ),
        _correlation_times(model),
    )


def _correlation_times(model: NoiseModel) -> Html:
    rows = [
        (units.title, ", ".join(_time(axis.correlation_time_s) for axis in noise))
        for units, noise in noise_sensors(model)
    ]
    return element(
        "div",
        element("h3", "Correlation time of the bias, for a Gauss-Markov model (x, y, z)"),
        facts(rows),
    )


def _time(seconds: float | None) -> str:
    return "not determined" if seconds is None else duration_of(seconds)


def _figures(analysis: NoiseAnalysis) -> Html:
    drawn = Figures()
    with report_style():
        for name, axes in analysis.curves.items():
            units = UNITS[name]
            drawn.add(
                name,
                allan_figure(axes, units),
                f"Allan deviation, {units.title.lower()}",
                "How much means over the averaging time differ from one to the next, over √2. "
                "The model is the sum of the kinds of noise the data show; broken lines are its "
                "parts.",
            )
    return section("Allan deviation", element("div", *drawn.parts, class_="figures"))


def _provenance(model: NoiseModel) -> Html:
    recording = model.recording
    stated: list[tuple[str, str]] = [
        ("Sensor", model.device.name or MISSING),
        ("Serial number", model.device.serial or MISSING),
        ("Recording", MISSING if recording is None else recording.file),
    ]
    if recording is not None:
        stated.append(
            ("SHA-256 of the recording", element("span", recording.sha256, class_="mono"))
        )
    stated.append(
        ("Data", f"{fixed(model.rate_hz, 2)} samples/s, {duration(model.duration_s)} at rest")
    )
    if model.temperature_c is not None:
        low, high = model.temperature_c
        stated.append(("Sensor temperature", f"{fixed(low, 1)} to {fixed(high, 1)} °C"))
    stated += [("Date", model.date.isoformat(sep=" ")), ("Software", model.software)]
    return section("Provenance", facts(stated))
