"""The tables of a calibration report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from imu_rig.calibration.model import AXES, Affine
from imu_rig.calibration.result import CalibrationResult
from imu_rig.report.figures import pose_numbers
from imu_rig.report.numbers import MISSING, decimals_for, fixed
from imu_rig.report.page import Html, element, joined, table
from imu_rig.report.parameters import Parameter, ParameterGroup, Sensor
from imu_rig.units import DEG, MILLI_G

TEXT_POSE, TEXT_COMMANDED, TEXT_FROM, TEXT_TO = (
    element("th", title, scope="col", class_="text")
    for title in ("Pose", "Commanded pan, tilt, roll [°]", "From", "To")
)
"""Heads of columns that hold text."""


def parameter_table(sensor: Sensor) -> Html:
    """Every parameter of a sensor."""
    return group_table(sensor.name, sensor.groups)


def group_table(caption: str, groups: Sequence[ParameterGroup]) -> Html:
    """Estimates with standard uncertainty and 95 % interval; beside the truth where known."""
    has_truth = any(p.truth is not None for group in groups for p in group.parameters)
    head = ["Parameter", "Estimate", "Std. unc.", "95 % interval"]
    head += ["True value", "Error / unc."] if has_truth else []
    rows: list[tuple[str, ...] | Html] = []
    for group in groups:
        title = f"{group.name} [{group.unit}]"
        rows.append(
            element(
                "tr", element("th", title, colspan=str(len(head)), scope="colgroup"), class_="group"
            )
        )
        rows += [_parameter_row(parameter, has_truth=has_truth) for parameter in group.parameters]
    return table(head, rows, caption=caption)


def _parameter_row(parameter: Parameter, *, has_truth: bool) -> Html:
    decimals = decimals_for(parameter.uncertainty)
    low, high = parameter.value - parameter.half_width, parameter.value + parameter.half_width
    cells = [
        fixed(parameter.value, decimals, sign=True),
        "fixed" if parameter.is_fixed else fixed(parameter.uncertainty, decimals),
        MISSING
        if parameter.is_fixed
        else f"{fixed(low, decimals, sign=True)} … {fixed(high, decimals, sign=True)}",
    ]
    row = [element("th", parameter.name, scope="row"), *(element("td", cell) for cell in cells)]
    if has_truth:
        truth, ratio = parameter.truth, parameter.error_in_uncertainties
        row.append(element("td", MISSING if truth is None else fixed(truth, decimals, sign=True)))
        judged = MISSING if ratio is None else fixed(ratio, 1, sign=True)
        outside = {"class_": "outside"} if parameter.holds_truth is False else {}
        row.append(element("td", judged, **outside))
    return element("tr", *row)


def matrix_table(title: str, affine: Affine, unit: str) -> Html:
    """K and b with their standard uncertainties."""
    head = ["Output axis", "K x", "K y", "K z", f"b [{unit}]"]
    rows = []
    for i, axis in enumerate(AXES):
        elements = [_with_uncertainty(affine.K[i, j], affine.K_uncertainty[i, j]) for j in range(3)]
        rows.append([axis, *elements, _with_uncertainty(affine.b[i], affine.b_uncertainty[i])])
    return table(head, rows, caption=title)


def matrix_code(name: str, affine: Affine) -> str:
    """K and b as lines that can be pasted into a program, in full precision."""
    indent = " " * len(f"{name}_K = [")
    rows = f",\n{indent}".join(str(row) for row in affine.K.tolist())
    return f"{name}_K = [{rows}]\n{name}_b = {affine.b.tolist()}"


def pose_table(result: CalibrationResult) -> Html:
    """Every still pose with its errors [mg]."""
    numbers = pose_numbers(result.poses)
    rows = [
        element(
            "tr",
            element("th", str(number), scope="row"),
            element("td", pose.name, class_="text"),
            element("td", _angles(pose.commanded_deg), class_="text"),
            *_cells(
                [pose.before, pose.after, pose.sigma, pose.left_out, pose.left_out_sigma], MILLI_G
            ),
        )
        for number, pose in zip(numbers, result.poses, strict=True)
    ]
    head = [
        "No.", TEXT_POSE, TEXT_COMMANDED,
        "Before [mg]", "After [mg]", "σ mean [mg]", "Left out [mg]", "σ predicted [mg]",
    ]  # fmt: skip
    return table(head, rows)


def move_table(result: CalibrationResult) -> Html:
    """Every move with the angle it turned and its direction errors [deg]."""
    rows = [
        element(
            "tr",
            element("th", str(number), scope="row"),
            element("td", move.start, class_="text"),
            element("td", move.stop, class_="text"),
            element("td", fixed(move.angle_rad / DEG, 1)),
            *_cells([move.before_rad, move.after_rad, move.held_out_rad, move.sigma_rad], DEG),
        )
        for number, move in enumerate(result.moves, start=1)
    ]
    head = [
        "No.", TEXT_FROM, TEXT_TO, "Turned [deg]",
        "Before [deg]", "After [deg]", "Left out [deg]", "σ predicted [deg]",
    ]  # fmt: skip
    return table(head, rows)


def _cells(values: list[float | None], unit: float) -> Iterator[Html]:
    for value in values:
        shown = MISSING if value is None else fixed(value / unit, 3 if unit == DEG else 2)
        yield element("td", shown)


def _angles(commanded: tuple[float, float, float] | None) -> str:
    return MISSING if commanded is None else ", ".join(f"{fixed(a, 1)}" for a in commanded)


def _with_uncertainty(value: float, uncertainty: float) -> Html:
    if not uncertainty > 0.0:
        return joined([fixed(float(value), 6), element("span", " fixed", class_="note")])
    decimals = decimals_for(float(uncertainty))
    stated = f" ± {fixed(float(uncertainty), decimals)}"
    return joined([fixed(float(value), decimals), element("span", stated, class_="note")])
