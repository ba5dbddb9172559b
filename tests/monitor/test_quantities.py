"""What people are shown of a stream: names, units, digits."""

import numpy as np
import pytest

from firmware_protocols.known import builtin_protocols
from imu_rig.monitor.engine import measured
from imu_rig.monitor.quantities import Quantity, quantities_of


def units_of(name, stream=""):
    layout = builtin_protocols()[name].streams[stream]
    return {quantity.name: quantity.unit for quantity in measured(layout)}


def test_every_built_in_stream_is_shown_in_units_that_people_use():
    imu = {"accel": "g", "gyro": "deg/s", "mag": "uT"}
    assert units_of("mpu9150-28") == imu
    assert units_of("two-imu", "waist") == imu
    assert units_of("adis16405-36") == {**imu, "temperature": "degC", "aux": "V"}
    assert units_of("ms5803-32") == {"pressure": "hPa", "temperature": "degC"}
    assert units_of("waist-unit", "accel") == {"accel": "g"}
    for protocol in builtin_protocols().values():
        for layout in protocol.streams.values():
            assert measured(layout)


@pytest.mark.parametrize(
    ("value", "unit", "shown", "as_unit"),
    [
        (9.80665, "m/s2", 1.0, "g"),
        (np.pi, "rad/s", 180.0, "deg/s"),
        (101_325.0, "Pa", 1013.25, "hPa"),
        (21.5, "degC", 21.5, "degC"),
        (3.0, "kg", 3.0, "kg"),
    ],
)
def test_values_are_converted_as_their_units_say(value, unit, shown, as_unit):
    values = {"thing": np.full(2, value)}
    (quantity,) = quantities_of(values, {"thing": unit})
    assert quantity.unit == as_unit
    assert quantity.shown(values) == pytest.approx(np.full((2, 1), shown))


def test_counts_and_supplies_are_left_out_unless_nothing_else_is_there():
    values = {"battery": np.zeros(1), "status": np.zeros(1), "accel": np.zeros((1, 3))}
    units = {"battery": "V", "status": "", "accel": "m/s2"}
    assert [q.name for q in quantities_of(values, units)] == ["accel"]
    del values["accel"]
    assert [q.name for q in quantities_of(values, units)] == ["status"]
    assert quantities_of({"prom": np.zeros((1, 8))}, {"prom": ""}, ["prom"]) == ()


def test_numbers_that_nobody_has_named_yet_are_shown_beside_those_that_are():
    values = {"accel": np.zeros((1, 3)), "raw2": np.zeros((1, 3)), "status": np.zeros(1)}
    shown = quantities_of(values, {"accel": "m/s2", "raw2": "", "status": ""})
    assert [(q.name, q.unit) for q in shown] == [("accel", "g"), ("raw2", "")]


def test_well_known_quantities_come_first():
    values = {name: np.zeros(1) for name in ("torque", "temperature", "pressure")}
    units = {"torque": "Nm", "temperature": "degC", "pressure": "Pa"}
    assert [q.name for q in quantities_of(values, units)] == ["pressure", "temperature", "torque"]


def test_words_for_people():
    assert Quantity("accel", "g").title == "acceleration"
    assert Quantity("grip_force", "N").title == "grip force"
    assert Quantity("mag", "uT").spoken_unit == "µT"
