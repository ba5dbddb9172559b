"""A certificate as a page that a person reads in a terminal, and the same figures as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from imu_rig.cli.summary import FIXED_BELOW, paragraph, verification_lines
from imu_rig.foreign_text import LONGEST_PARAGRAPH, one_line, printable, wrapped
from imu_rig.units import DEG, MILLI_G

if TYPE_CHECKING:
    from imu_rig.arrays import FloatArray
    from imu_rig.calibration.accuracy import DirectionalError
    from imu_rig.calibration.certificate import Certificate
    from imu_rig.calibration.certificate_magnetometer import MagEntry
    from imu_rig.calibration.certificate_parts import SlopesEntry, StagesEntry, TemperatureEntry
    from imu_rig.calibration.compare import Comparison
    from imu_rig.calibration.model import Affine, PhysicalFigures

WIDTH = 78
LABEL = 13
COLUMN = 21
VALUE = 10
STAGES = ("raw", "fitted", "left out")
MILLIRADIAN = 1e-3


def certificate_lines(certificate: Certificate) -> list[str]:
    """Lines that show a certificate."""
    from imu_rig.calibration.accuracy import sphere_error, turn_error
    from imu_rig.calibration.model import physical_figures
    from imu_rig.cli.noise import noise_lines

    accel = certificate.accel.affine()
    lines = _head(certificate)
    if certificate.has_accel:
        lines += _model("Accelerometer", accel, "m/s^2")
        lines += _figures(physical_figures(accel), MILLI_G, "mg", accel.coverage_factor)
        error = sphere_error(accel, certificate.gravity.value)
        lines += _directional("at rest", error, MILLI_G, "mg", "all attitudes", "up along")
    else:
        lines += ["", "Accelerometer: not calibrated"]
    if certificate.gyro is not None:
        gyro = certificate.gyro.affine()
        lines += _model("Gyroscope", gyro, "rad/s")
        lines += _figures(physical_figures(gyro, accel), DEG, "deg/s", gyro.coverage_factor)
        error = turn_error(gyro)
        lines += _directional("90 deg turn", error, DEG, "deg", "all axes", "about")
    if certificate.mag is not None:
        lines += _magnetometer(certificate.mag, accel)
    if certificate.temperature is not None:
        lines += _temperature(certificate.temperature)
    lines += _errors(certificate)
    lines += _verification(certificate)
    if certificate.noise is not None:
        lines += ["", *noise_lines(certificate.noise)[:-1]]
    for warning in certificate.warnings:
        lines += ["", *paragraph(one_line(warning, LONGEST_PARAGRAPH), mark="! ")]
    return [printable(line) for line in lines]


def certificate_figures(certificate: Certificate) -> dict[str, Any]:
    """Return a certificate's content and the figures that its page derives, SI, for JSON."""
    from imu_rig.calibration.accuracy import sphere_error, turn_error
    from imu_rig.calibration.model import physical_figures

    accel = certificate.accel.affine()
    error = sphere_error(accel, certificate.gravity.value)
    derived: dict[str, Any] = {
        "accel": _figures_json(physical_figures(accel)),
        "reading_at_rest": _directional_json(error),
    }
    if certificate.gyro is not None:
        gyro = certificate.gyro.affine()
        derived["gyro"] = _figures_json(physical_figures(gyro, accel))
        derived["turn_90_deg"] = _directional_json(turn_error(gyro))
    if certificate.mag is not None:
        own = certificate.mag.alignment == "none"
        found = physical_figures(certificate.mag.affine.affine(), None if own else accel)
        derived["mag"] = _figures_json(found)
    return {
        "certificate": certificate.model_dump(mode="json", by_alias=True),
        "derived": derived,
    }


def comparison_lines(first: Certificate, second: Certificate, found: Comparison) -> list[str]:
    """Lines that put two certificates side by side."""
    lines = [f"A  {_named(first)}", f"B  {_named(second)}", ""]
    lines.append(f"  {'':33}{'A':>10}{'B':>11}{'B - A':>11}{'std. dev.':>11}")
    for row in found.differences:
        decimals = _decimals(row.sigma)
        numbers = (
            f"{row.first:10.{decimals}f}{row.second:11.{decimals}f}{row.change:+11.{decimals}f}"
        )
        deviations = "fixed" if row.deviations is None else f"{row.deviations:+.1f}"
        mark = " !" if row.drifted else ""
        label = f"{row.sensor} {row.name} [{row.unit}]".replace("orthogonality", "orth.")
        lines.append(f"  {label:33}{numbers}{deviations:>11}{mark}")
    days = (second.date - first.date).total_seconds() / 86400
    sentences = [f"B was made {abs(days):.1f} days {'after' if days >= 0 else 'before'} A."]
    if found.drifted:
        names = ", ".join(f"{row.sensor} {row.name}" for row in found.drifted)
        sentences.append(f"More than chance explains (3 standard deviations): {names}.")
    else:
        sentences.append(
            f"None of {len(found.differences)} parameters differs by more than chance explains "
            "(3 standard deviations)."
        )
    change = f"With B in place of A, readings at rest change by up to {found.reading / MILLI_G:.3f}"
    turn = "" if found.turn is None else f" and a 90 deg turn by up to {found.turn / DEG:.3f} deg"
    sentences.append(f"{change} mg{turn}.")
    for sentence in sentences:
        lines += ["", *paragraph(sentence)]
    for note in found.notes:
        lines += ["", *paragraph(note, mark="! ")]
    return lines


def comparison_figures(found: Comparison) -> dict[str, Any]:
    """Return a comparison as one JSON object."""
    return {
        "parameters": [
            {
                "sensor": row.sensor,
                "name": row.name,
                "unit": row.unit,
                "first": row.first,
                "second": row.second,
                "change": row.change,
                "change_standard_uncertainty": row.sigma,
                "standard_deviations": row.deviations,
                "drifted": row.drifted,
            }
            for row in found.differences
        ],
        "drifted": [f"{row.sensor} {row.name}" for row in found.drifted],
        "reading_at_rest_change": found.reading,
        "turn_90_deg_change": found.turn,
        "notes": list(found.notes),
    }


def _named(certificate: Certificate) -> str:
    device = certificate.device
    serial = f", serial {device.serial}" if device.serial else ""
    made = f"{certificate.date:%Y-%m-%d %H:%M %Z}, {certificate.method}"
    return one_line(f"{device.name or 'a sensor without a name'}{serial}, {made}", WIDTH)


def _head(certificate: Certificate) -> list[str]:
    device = certificate.device
    serial = f", serial {device.serial}" if device.serial else ""
    layout = f" (packets {device.layout})" if device.layout else ""
    title = f"Certificate of {device.name or 'a sensor without a name'}{serial}{layout}"
    made = (
        f"{certificate.date:%Y-%m-%d %H:%M %Z} by {certificate.software}, method "
        f"{certificate.method}"
    )
    basis = f"{len(certificate.poses)} poses, {len(certificate.moves)} moves"
    source = "" if certificate.recording is None else f"{certificate.recording.file}, "
    facts = [
        ("made", made),
        ("from", f"{source}{basis}, {certificate.rate_hz:.2f} samples per second"),
    ]
    units = device.device().recorded_units
    if units:
        facts.append(("units", f"of the recording: {units}; raw is that in SI units"))
    if certificate.temperature_c is not None:
        low, high = certificate.temperature_c
        facts.append(("temperature", f"{low:.1f} to {high:.1f} degC"))
    if certificate.has_accel:
        facts.append(("gravity", certificate.gravity.gravity().statement))
    frame = {
        "sensor": "the sensor's own: x is the accelerometer's x axis, y lies in its x-y plane",
        "jig": "the jig's, as far as its angles were right",
    }
    facts.append(("frame", frame[certificate.frame]))
    lines = wrapped(title, WIDTH)
    for label, text in facts:
        lines += _labelled(label, text)
    return lines


def _model(name: str, affine: Affine, unit: str) -> list[str]:
    """K and b with standard uncertainties, as a matrix."""
    lines = ["", f"{name}: calibrated = K raw - b, with standard uncertainties"]
    for i, (row, sigma) in enumerate(zip(affine.K, affine.K_uncertainty, strict=True)):
        lines.append(_row("K" if i == 0 else "", row, sigma))
    lines.append(_row(f"b [{unit}]", affine.b, affine.b_uncertainty))
    lines.append("")
    return lines


def _figures(
    figures: PhysicalFigures, bias_unit: float, bias_name: str, factor: float
) -> list[str]:
    lines = [_row("scale [%]", figures.scale_percent, figures.scale_percent_u, "xyz")]
    lines.append(f"  {figures.angles} [mrad]")
    for start in range(0, len(figures.cross_names), 3):
        part = slice(start, start + 3)
        lines.append(
            _row(
                "",
                figures.cross_rad[part] / MILLIRADIAN,
                figures.cross_rad_u[part] / MILLIRADIAN,
                figures.cross_names[part],
            )
        )
    bias, sigma = figures.bias / bias_unit, figures.bias_u / bias_unit
    lines.append(_row(f"bias [{bias_name}]", bias, sigma, "xyz"))
    return [*lines, *_labelled("95 %", f"intervals reach {factor:.2f} standard uncertainties")]


def _row(
    label: str,
    values: FloatArray,
    sigmas: FloatArray,
    names: Sequence[str] = ("", "", ""),
) -> str:
    estimated = [sigma for sigma in sigmas if sigma > FIXED_BELOW]
    decimals = _decimals(min(estimated, default=0.0))
    cells = []
    for value, sigma, name in zip(values, sigmas, names, strict=True):
        if sigma > FIXED_BELOW:
            cell = f"{name}{value:{VALUE - len(name)}.{decimals}f} ± {sigma:.{decimals}f}"
        else:
            cell = f"{name}{value:{VALUE - len(name)}.4g} fixed"
        cells.append(f"{cell:{COLUMN}}")
    return f"  {label:{LABEL}}{' '.join(cells)}".rstrip()


def _magnetometer(mag: MagEntry, accel: Affine) -> list[str]:
    from imu_rig.calibration.model import physical_figures

    affine = mag.affine.affine()
    own = mag.alignment == "none"
    figures = physical_figures(affine, None if own else accel)
    lines = _model("Magnetometer", affine, "uT")
    lines += _figures(figures, 1.0, "uT", affine.coverage_factor)
    known = "as stated" if mag.field_known else "where the mean gain is taken as 1"
    source = "still poses" if mag.from_stills else "samples"
    lines += _labelled("field", f"{mag.field_ut:.2f} uT {known}, from {mag.count} {source}")
    if mag.dip is not None and mag.dip_standard_uncertainty is not None:
        dip, sigma = mag.dip / DEG, mag.dip_standard_uncertainty / DEG
        lines += _labelled("dip", f"{dip:.2f} ± {sigma:.2f} deg below the horizontal")
    axes = "not aligned: readings are in axes of the magnetometer's own"
    if mag.alignment_standard_uncertainty is not None:
        sigma = mag.alignment_standard_uncertainty / DEG
        axes = f"aligned with the accelerometer's to {sigma:.2f} deg, by {mag.alignment}"
    lines += _labelled("axes", axes)
    errors = (mag.before_percent, mag.residual_percent, mag.left_out_percent)
    texts = (f"{error:.2f} % {name}" for error, name in zip(errors, STAGES, strict=True))
    lines += _labelled("magnitude", f"rms error {', '.join(texts)}")
    for note in mag.notes:
        lines += paragraph(one_line(note, LONGEST_PARAGRAPH))
    return lines


def _temperature(term: TemperatureEntry) -> list[str]:
    import numpy as np

    rows: tuple[tuple[str, SlopesEntry | None, float], ...] = (
        ("bias [mg]", term.accel_bias, MILLI_G),
        ("scale [%]", term.accel_scale, 0.01),
        ("gyro [deg/s]", term.gyro_bias, DEG),
    )
    lines = wrapped(
        f"Temperature: K and b hold at {term.reference_c:.1f} degC; change per degree, measured "
        f"from {term.low_c:.1f} to {term.high_c:.1f} degC",
        WIDTH,
    )
    for label, slopes, unit in rows:
        if slopes is not None:
            value = np.array(slopes.value) / unit
            lines.append(_row(label, value, np.array(slopes.standard_uncertainty) / unit, "xyz"))
    return ["", *lines]


def _directional(
    label: str, error: DirectionalError, unit: float, name: str, over: str, where: str
) -> list[str]:
    direction = ", ".join(f"{component:.2f}" for component in error.worst)
    return _labelled(
        label,
        f"standard uncertainty {error.rms / unit:.2g} {name} rms over {over}, "
        f"{error.maximum / unit:.2g} {name} at most ({where} {direction})",
    )


def _errors(certificate: Certificate) -> list[str]:
    lines = []
    rows: tuple[tuple[str, StagesEntry, float], ...] = (
        ("gravity's magnitude [mg]", certificate.accel_errors, MILLI_G),
        ("gravity's direction per move [deg]", certificate.gyro_errors, DEG),
    )
    for label, stages, unit in rows:
        found = [
            f"{'-':>10}" if entry is None else f"{entry.rms / unit:10.3f}"
            for entry in (stages.before, stages.after, stages.held_out)
        ]
        if stages.after is not None:
            lines.append(f"  {label:36}{''.join(found)}")
    if not lines:
        return []
    header = f"  {'':36}{''.join(f'{stage:>10}' for stage in STAGES)}"
    return ["", "Errors over poses and moves, rms", header, *lines]


def _verification(certificate: Certificate) -> list[str]:
    if certificate.verification is None:
        return []
    found = certificate.verification.verification(has_gyro=certificate.gyro is not None)
    return ["", *verification_lines(found, reported=False, every="are shown by --json")]


def _figures_json(figures: PhysicalFigures) -> dict[str, Any]:
    return {
        "scale_percent": figures.scale_percent.tolist(),
        "scale_percent_u": figures.scale_percent_u.tolist(),
        "cross_names": list(figures.cross_names),
        "cross_rad": figures.cross_rad.tolist(),
        "cross_rad_u": figures.cross_rad_u.tolist(),
        "bias": figures.bias.tolist(),
        "bias_u": figures.bias_u.tolist(),
    }


def _directional_json(error: DirectionalError) -> dict[str, Any]:
    return {"rms": error.rms, "maximum": error.maximum, "worst": error.worst.tolist()}


def _decimals(sigma: float) -> int:
    from imu_rig.report.numbers import decimals_for

    return min(decimals_for(sigma), 7)


def _labelled(label: str, text: str) -> list[str]:
    parts = wrapped(text, WIDTH - LABEL - 2)
    return [f"  {label if i == 0 else '':{LABEL}}{part}" for i, part in enumerate(parts)]
