"""The calibration report: verdict, figures, parameters and provenance in one HTML file."""

from __future__ import annotations

import shlex

from imu_rig import __version__
from imu_rig.calibration.certificate import Certificate
from imu_rig.calibration.result import CalibrationResult, DeviceInfo, ErrorStages
from imu_rig.recording.format import SUFFIX
from imu_rig.report import figures
from imu_rig.report.accuracy import accuracy_cards, true_errors, uncertainty_map
from imu_rig.report.facts import SessionSummary, Truth
from imu_rig.report.jig import jig_section
from imu_rig.report.magnetometer import magnetometer_cards, magnetometer_section
from imu_rig.report.nonlinearity import nonlinearity_section
from imu_rig.report.numbers import MISSING, counted, duration, fixed, significant
from imu_rig.report.page import (
    Html,
    card,
    document,
    element,
    facts,
    folded,
    header,
    section,
    write_report,
)
from imu_rig.report.parameters import ParameterGroup, Sensor, compare_with_truth, sensors
from imu_rig.report.svg import Figures, report_style
from imu_rig.report.tables import (
    matrix_code,
    matrix_table,
    move_table,
    parameter_table,
    pose_table,
)
from imu_rig.report.temperature import temperature_section
from imu_rig.report.verdict import Verdict, gravity_sentence, verdict
from imu_rig.report.verification import figure_count, verification_card, verification_section
from imu_rig.units import DEG, MILLI_G

__all__ = ["SessionSummary", "Truth", "calibration_report", "write_report"]

DEFAULT_TITLE = "Calibration report"
DEFAULT_CERTIFICATE_FILE = "certificate.json"


def calibration_report(
    result: CalibrationResult,
    *,
    certificate: Certificate | None = None,
    session: SessionSummary | None = None,
    truth: Truth | None = None,
    title: str = DEFAULT_TITLE,
    certificate_file: str = DEFAULT_CERTIFICATE_FILE,
) -> str:
    """Return a calibration report as the text of one HTML file that needs nothing else.

    Parameters
    ----------
    result : CalibrationResult
        What was found.
    certificate : Certificate, optional
        The certificate made of it: date, software and recording are taken from there.
    session : SessionSummary, optional
        The jig session it was solved from.
    truth : Truth, optional
        What a simulated sensor really is; parameters are then judged against it.
    title : str
        Heading of the report.
    certificate_file : str
        Name of the certificate's file, as the instructions for its use will state it.
    """
    found = sensors(result, truth)
    drawn = Figures(before=figure_count(result.verification))
    evidence = _figures(result, found, drawn)
    jig = jig_section(result, None if truth is None else truth.jig, before=drawn.last)
    by_jig = 0 if result.jig is None else 1
    return document(
        f"{title}: {result.device.name}" if result.device.name else title,
        _header(title, result, certificate),
        _verdict(verdict(result, session)),
        _cards(result, found),
        Html("") if result.verification is None else verification_section(result.verification),
        _parameters(result, found, truth) if found else Html(""),
        nonlinearity_section(result, truth),
        temperature_section(result),
        evidence if drawn.parts else Html(""),
        jig,
        magnetometer_section(result, before=drawn.last + by_jig),
        _session(session),
        _use(certificate, certificate_file),
        _provenance(result, certificate),
    )


def _header(title: str, result: CalibrationResult, certificate: Certificate | None) -> Html:
    device = result.device
    named = [device.name or "unnamed sensor"]
    named += [f"serial {device.serial}"] if device.serial else []
    named += [f"{certificate.date:%Y-%m-%d %H:%M %Z}"] if certificate is not None else []
    return header("inertial sensor calibration", title, " · ".join(named))


def _verdict(words: Verdict) -> Html:
    attention = [element("ul", *(element("li", point) for point in words.attention))]
    return element(
        "div",
        element("h2", words.headline),
        *(attention if words.attention else []),
        *(element("p", sentence) for sentence in words.sentences),
        class_="verdict care" if words.attention else "verdict",
    )


def _cards(result: CalibrationResult, found: tuple[Sensor, ...]) -> Html:
    cards = [] if result.only_magnetometer else [verification_card(result.verification)]
    cards += accuracy_cards(result)
    if result.has_accel:
        cards.append(
            _error_card("Gravity magnitude error", result.accel_errors, MILLI_G, "mg", "pose")
        )
    if result.gyro is not None:
        cards.append(
            _error_card("Direction error per move", result.gyro_errors, DEG, "deg", "move")
        )
    for sensor in found:
        cards += [_uncertainty_card(sensor, group) for group in (sensor.scale, sensor.bias)]
    if result.mag is not None:
        cards += magnetometer_cards(result.mag)
    return element("div", *cards, class_="cards")


def _error_card(label: str, errors: ErrorStages, unit: float, name: str, each: str) -> Html:
    shown = errors.held_out or errors.after
    if shown is None:
        return card(label, MISSING, "", "not determined")
    kind = "left out of the fit" if errors.held_out else "in the fit itself: no proof of accuracy"
    about = f"rms over {counted(shown.count, each)} {kind}"
    if errors.before is not None:
        about += f"; before: {significant(errors.before.rms / unit)} {name}"
    return card(label, significant(shown.rms / unit), name, about)


def _uncertainty_card(sensor: Sensor, group: ParameterGroup) -> Html:
    label = f"{sensor.name} {group.name.lower().removesuffix(' error')} uncertainty"
    if group.largest_uncertainty == 0.0:
        return card(label, "fixed", "", "not estimated by this method")
    value = f"± {significant(group.largest_uncertainty, 2)}"
    return card(label, value, group.unit, "largest standard uncertainty of the axes")


def _parameters(result: CalibrationResult, found: tuple[Sensor, ...], truth: Truth | None) -> Html:
    comparison = compare_with_truth(found)
    judged = []
    if comparison is not None and truth is not None:
        judged = [
            element(
                "p",
                "This sensor is simulated, so the truth is known: it lies inside the 95 % interval "
                f"of {comparison.inside} of the {comparison.compared} estimated parameters, and "
                f"the errors are {significant(comparison.rms, 2)} standard uncertainties (root "
                f"mean square; 1 is expected). {_really(result, truth)}",
            )
        ]
    matrices, code = [], []
    if result.has_accel:
        matrices.append(matrix_table("Accelerometer", result.accel, "m/s²"))
        code.append(matrix_code("accel", result.accel))
    if result.gyro is not None:
        matrices.append(matrix_table("Gyroscope", result.gyro, "rad/s"))
        code.append(matrix_code("gyro", result.gyro))
    frame = (
        "the sensor's own frame, in which the accelerometer's K is upper triangular"
        if result.frame == "sensor"
        else f"the {result.frame} frame, so K also turns the readings into it"
    )
    return section(
        "Parameters",
        *judged,
        element(
            "div",
            *(parameter_table(sensor) for sensor in found),
            class_="pair" if comparison is None else "pair wide",
        ),
        element(
            "p",
            "Scale error: how much too much an axis reads. Non-orthogonality and cross-axis x → y: "
            "angle by which axis x senses toward axis y, the gyroscope's relative to the axes of "
            "the accelerometer. Bias: reading at zero input. “Std. unc.” is the standard "
            "uncertainty; “fixed” values are set by convention or by the method, not estimated. "
            "1 mg is 0.001 of standard gravity.",
            class_="note",
        ),
        folded(
            "K and b, with standard uncertainties",
            element("p", "calibrated = K · raw − b, in " + frame + "."),
            *matrices,
            element("h3", "In full precision"),
            element("pre", "\n".join(code)),
        ),
    )


def _really(result: CalibrationResult, truth: Truth) -> str:
    """Say what the calibrated sensor errs by, which only a simulation can know."""
    reading, turn = true_errors(result, truth)
    parts = []
    if reading is not None:
        parts.append(
            f"its readings at rest err by {significant(reading.rms / MILLI_G, 2)} mg (root mean "
            f"square over all attitudes; at most {significant(reading.maximum / MILLI_G, 2)} mg)"
        )
    if turn is not None:
        parts.append(
            f"a 90° turn by {significant(turn.rms / DEG, 2)} deg (over all axes; at most "
            f"{significant(turn.maximum / DEG, 2)} deg)"
        )
    return f"As calibrated, {', '.join(parts)}." if parts else ""


def _figures(result: CalibrationResult, found: tuple[Sensor, ...], drawn: Figures) -> Html:
    with report_style():
        if result.poses:
            _draw_pose_figures(drawn, result)
        if result.moves and result.gyro is not None:
            drawn.add(
                "moves",
                figures.move_errors(result),
                "Direction error per move",
                "How far the gravity direction that the gyroscope predicts for the end of a move "
                "is from the one measured there. Logarithmic scale.",
            )
        for sensor in found:
            truth = any(p.truth is not None for p in sensor.parameters)
            drawn.add(
                f"intervals{sensor.name[0]}",
                figures.parameter_intervals(sensor),
                f"{sensor.name} parameters",
                "Estimates, and the half width of their 95 % intervals about them"
                + (", with the true values of the simulation." if truth else "."),
            )
        residuals = figures.vector_residuals(result)
        if residuals is not None:
            drawn.add(
                "vectors",
                residuals,
                "Residual vectors against the commanded angles",
                "This method takes the jig's commanded angles as exact; what the jig did not do "
                "stays here, by axis of the output frame.",
            )
    folds = []
    if result.poses:
        folds.append(folded(f"All {counted(len(result.poses), 'pose')}", pose_table(result)))
    if result.moves and result.gyro is not None:
        folds.append(folded(f"All {counted(len(result.moves), 'move')}", move_table(result)))
    return section("Evidence", element("div", *drawn.parts, class_="figures"), *folds)


def _draw_pose_figures(drawn: Figures, result: CalibrationResult) -> None:
    ball = figures.sphere(result)
    if ball is not None:
        drawn.add(
            "sphere",
            ball,
            "Poses on the sphere",
            "Where up was in the sensor in each still pose, by pose number, both halves seen "
            "from +z (equal-area projection, circles of elevation). Numbers that would cover "
            "each other are left out; those of the largest errors stay.",
        )
    if result.has_accel:
        drawn.add(
            "map",
            uncertainty_map(result),
            "How certain a calibrated reading is",
            "Standard uncertainty of a reading at rest with each direction up, from that of all "
            "parameters; the circles are the poses. Seen from +z in both halves (equal-area "
            "projection). Noise of the reading itself is not in it.",
        )
    drawn.add(
        "poses",
        figures.pose_errors(result),
        "Error of the gravity magnitude per pose",
        "Above before, below after calibration, on another scale. σ is one standard uncertainty: "
        "of the mean reading for poses in the fit, of the prediction for poses left out of it.",
    )
    drawn.add(
        "magnitude",
        figures.gravity_magnitude(result),
        "Magnitude of the specific force at rest",
        "What the accelerometer reads in each still pose, on one scale before and after.",
    )


def _session(session: SessionSummary | None) -> Html:
    if session is None:
        return Html("")
    protocol = session.protocol
    protocol += f": {session.protocol_title}" if session.protocol_title else ""
    stated = [
        ("Protocol", protocol),
        ("Jig", session.jig or MISSING),
        ("Stops", f"{session.finished} of {session.planned}"),
        ("Duration", duration(session.duration_s)),
        ("Recoveries from faults", str(session.recoveries)),
    ]
    packets = [("good", session.good), ("lost", session.lost), ("corrupt", session.corrupt)]
    known = [f"{count} {name}" for name, count in packets if count is not None]
    stated += [("Packets", ", ".join(known))] if known else []
    if session.reconnects is not None:
        stated.append(("Reconnects", str(session.reconnects)))
    if session.rate_hz is not None:
        stated.append(("Packet rate", f"{fixed(session.rate_hz, 2)} Hz"))
    for name, backlash_deg in session.backlash_deg:
        stated.append((f"Backlash, {name}", f"{fixed(backlash_deg, 2, sign=True)} deg"))
    notices = [element("p", "The session had nothing to say on the way.", class_="note")]
    if session.notices:
        notices = [
            element("h3", "Notices of the session"),
            element("ul", *(element("li", sentence) for sentence in session.notices)),
        ]
    return section("Session", facts(stated), *notices)


def _use(certificate: Certificate | None, file: str) -> Html:
    if certificate is None:
        saving = (
            "from imu_rig.calibration.certificate import certificate_of\n\n"
            f"certificate_of(result).save({file!r})"
        )
        return section(
            "Use",
            element("p", "calibrated = K · raw − b, with K and b as above. To keep them:"),
            element("pre", saving),
        )
    recording = "TRIAL" if certificate.recording is None else certificate.recording.file
    device = certificate.device.device()
    load = "from imu_rig.calibration.certificate import apply_certificate, load_certificate\n"
    apply = f"calibrated = apply_certificate(load_certificate({file!r}), block)"
    if certificate.recording is None or recording.endswith(SUFFIX):
        command = (
            f"imu-rig export {shlex.quote(recording)} --certificate {shlex.quote(file)} "
            "--output calibrated.csv"
        )
        ways = [
            element("p", "For a recording:"),
            element("pre", command),
            element("p", "For a block of samples in Python:"),
            element("pre", f"{load}\n{apply}"),
        ]
    else:
        ways = [
            element("p", "For a table in Python, with columns stated as they were here:"),
            element("pre", f"{load}{_reading(recording, device)}{apply}"),
        ]
    scale = f" by the nominal scale of the packet layout {device.layout}" if device.layout else ""
    if device.recorded_units:
        scale = f" from the units of the recording ({device.recorded_units})"
    return section(
        "Use the certificate",
        *ways,
        element(
            "p",
            "Elsewhere: calibrated = K · raw − b with the numbers under “K and b”, raw in m/s² and "
            f"rad/s{scale}.",
        ),
    )


def _reading(recording: str, device: DeviceInfo) -> str:
    """Python that reads a recording of another program."""
    units = {
        "accel_unit": device.accel_recorded_unit,
        "gyro_unit": device.gyro_recorded_unit,
        "mag_unit": device.mag_recorded_unit,
    }
    stated = ", ".join(f"{name}={unit!r}" for name, unit in units.items() if unit)
    return (
        "from imu_rig.importing.column_map import ColumnMap\n"
        "from imu_rig.importing.formats import read_imu\n\n"
        f"columns = ColumnMap({stated})\n"
        f"block = read_imu({recording!r}, columns)\n"
    )


def _provenance(result: CalibrationResult, certificate: Certificate | None) -> Html:
    device = result.device
    stated: list[tuple[str, str]] = [
        ("Sensor", device.name or MISSING),
        ("Serial number", device.serial or MISSING),
        ("Packet layout", device.layout or MISSING),
        ("Method", result.method),
        ("Gravity", gravity_sentence(result.gravity)),
        ("Recording", _recording(certificate)),
    ]
    if device.recorded_units:
        stated.append(("Units of the recording", device.recorded_units))
    if certificate is not None and certificate.recording is not None:
        digest = element("span", certificate.recording.sha256, class_="mono")
        stated.append(("SHA-256 of the recording", digest))
    stated.append(
        (
            "Data",
            f"{fixed(result.rate_hz, 2)} samples/s for {duration(result.duration_s)}",
        )
    )
    if result.temperature_c is not None:
        low, high = result.temperature_c
        stated.append(("Sensor temperature", f"{fixed(low, 1)} to {fixed(high, 1)} °C"))
    if certificate is not None:
        stated.append(("Date", f"{certificate.date.isoformat(sep=' ')}"))
    software = f"imu-rig {__version__}" if certificate is None else certificate.software
    stated.append(("Software", software))
    return section("Provenance", facts(stated))


def _recording(certificate: Certificate | None) -> str:
    if certificate is None or certificate.recording is None:
        return "not stated"
    return certificate.recording.file
