"""The live picture: every stream with its units, and lines alone drawn as all would be."""

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg

from imu_rig.monitor.figure import LiveFigure, StreamPlan
from imu_rig.monitor.quantities import Quantity
from imu_rig.monitor.rings import Ring
from imu_rig.monitor.scales import SHRINK_S, Scale, round_range
from imu_rig.monitor.window import framer

ACCEL, GYRO = Quantity("accel", "g", 1.0, 3), Quantity("gyro", "deg/s", 1.0, 3)
PRESSURE = Quantity("pressure", "hPa")
SHOE = StreamPlan("left $hoe", (ACCEL, GYRO))
BARO = StreamPlan("belt/barometer", (PRESSURE,))


def rows(plan, amplitude=1.0, now_s=10.0):
    t = np.linspace(now_s - 10.0, now_s, 300)
    waves = [amplitude * np.sin(t + at) for at in range(plan.columns)]
    return np.column_stack((t, *waves))


def figure(*plans):
    live = LiveFigure(plans, 10.0)
    FigureCanvasAgg(live.figure)
    return live


def pixels(live):
    return np.asarray(live.figure.canvas.buffer_rgba()).copy()


@pytest.mark.parametrize("copies", [1, 4])
def test_every_quantity_of_every_stream_has_a_panel_with_its_unit(copies):
    plans = [
        StreamPlan(f"{plan.name} {number}", plan.quantities)
        for number in range(copies)
        for plan in (SHOE, BARO)
    ]
    live = figure(*plans)
    titles = [axes.get_title(loc="right") for axes in live.figure.axes]
    assert sorted(set(titles)) == ["acceleration [g]", "angular rate [°/s]", "pressure [hPa]"]
    assert len(titles) == 3 * copies
    live.figure.canvas.draw()
    boxes = [axes.get_tightbbox() for axes in live.figure.axes]
    names = [text.get_window_extent() for text in live.figure.texts + live.figure.artists]
    for at, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[at + 1 :])
        assert not any(box.overlaps(legend.get_window_extent()) for legend in live.figure.legends)
        assert live.figure.bbox.x0 <= box.x0 < box.x1 <= live.figure.bbox.x1
        assert live.figure.bbox.y0 <= box.y0 < box.y1 <= live.figure.bbox.y1
    assert len(names) == 2 * copies


def test_lines_alone_look_as_if_everything_had_been_drawn():
    live = figure(SHOE, BARO)
    live.update({"left $hoe": rows(SHOE), "belt/barometer": rows(BARO)}, 10.0)
    live.draw()
    later = {"left $hoe": rows(SHOE, 0.9, 11.0), "belt/barometer": rows(BARO, 0.8, 11.0)}
    assert not live.update(later, 11.0)  # the ranges fit
    whole = live.redraws
    live.draw_lines()
    assert live.redraws == whole
    lines_alone = pixels(live)
    live.draw()
    assert np.array_equal(lines_alone, pixels(live))
    live.update({}, 12.0)
    live.draw_lines()
    assert not np.array_equal(lines_alone, pixels(live))


def test_a_range_that_no_longer_fits_is_drawn_anew_and_only_then():
    live = figure(SHOE)
    ring = Ring(2000, SHOE.columns)
    frame = framer(live, {SHOE.name: ring})
    import time

    now = time.monotonic()
    first = rows(SHOE, 1.0, now)
    ring.write(first[:, 0], [first[:, 1:]])
    frame()
    drawn = live.redraws
    frame()
    frame()
    assert live.redraws == drawn
    ring.write(np.array([time.monotonic()]), [np.full((1, SHOE.columns), 77.0)])
    frame()
    assert live.redraws == drawn + 1
    assert live.figure.axes[0].get_ylim()[1] >= 77.0


def test_what_is_no_number_breaks_nothing():
    live = figure(SHOE)
    live.draw()
    broken = rows(SHOE)
    broken[:, 1:] = np.nan
    broken[0, 1] = np.inf
    assert not live.update({SHOE.name: broken}, 10.0)
    live.draw_lines()
    live.update({SHOE.name: np.empty((0, 7))}, 10.0)
    live.draw_lines()


@pytest.mark.parametrize(("kind", "begin"), [("png", b"\x89PNG"), ("svg", b"<?xml")])
def test_the_saved_picture_has_the_lines(kind, begin):
    def saved(samples):
        live = figure(BARO)
        live.update(samples, 10.0)
        file = io.BytesIO()
        live.save(file, kind)
        return file.getvalue()

    with_lines = saved({BARO.name: rows(BARO)})
    assert with_lines.startswith(begin)
    assert with_lines != saved({})


finite = st.floats(-1e9, 1e9, allow_nan=False)


@given(a=finite, b=finite, least=st.floats(1e-3, 1e3))
def test_a_range_holds_the_data_and_is_not_much_wider(a, b, least):
    low, high = min(a, b), max(a, b)
    bottom, top = round_range(low, high, least)
    assert bottom <= low <= high <= top
    assert top - bottom <= 2.6 * max(high - low, least) + 1e-6 * max(abs(low), abs(high))


@given(
    ends=st.tuples(st.floats(allow_nan=False), st.floats(allow_nan=False)).filter(
        lambda ends: np.isfinite(ends).all()
    )
)
def test_any_finite_numbers_have_a_range(ends):
    bottom, top = round_range(min(ends), max(ends), 0.1)
    assert np.isfinite(top - bottom)
    assert bottom < top


@pytest.mark.parametrize("value", [3e38, -1.7e308, np.inf])
def test_a_device_out_of_its_mind_breaks_no_picture(value):
    live = figure(SHOE)
    mad = rows(SHOE)
    mad[:, 1:4] = value
    mad[::2, 1:4] *= -1.0
    live.update({SHOE.name: mad}, 10.0)
    live.save(io.BytesIO(), "png")
    constant = figure(BARO)
    held = rows(BARO)
    held[:, 1] = value
    constant.update({BARO.name: held}, 10.0)
    constant.save(io.BytesIO(), "png")


def test_what_comes_with_few_packets_is_a_line_all_the_same():
    live = figure(BARO)
    few = rows(BARO)
    few[np.arange(len(few)) % 7 != 0, 1] = np.nan
    live.update({BARO.name: few}, 10.0)
    [line] = live.figure.axes[0].lines
    assert np.array_equal(line.get_ydata(), few[::7, 1])
    assert line.get_marker() == ""
    few[7:, 1] = np.nan
    live.update({BARO.name: few}, 10.0)
    assert (len(line.get_ydata()), line.get_marker()) == (1, ".")  # a line of one point is none


def test_a_range_grows_at_once_and_shrinks_after_a_while():
    scale = Scale(0.1)
    assert scale.fit(-1.0, 1.0, 0.0)
    assert not scale.fit(-0.9, 1.0, 0.1)
    assert scale.fit(-5.0, 1.0, 0.2)
    assert not scale.fit(-0.1, 0.1, 1.0)
    assert not scale.fit(-0.1, 0.1, 1.0 + 0.9 * SHRINK_S)
    assert scale.fit(-0.1, 0.1, 1.0 + SHRINK_S)
    assert scale.range[1] < 1.0
    assert not scale.fit(float("nan"), 1.0, 9.0)
