"""The calibration report: complete, self-contained, honest, and safe with hostile names."""

import re
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime
from html.parser import HTMLParser

import matplotlib as mpl
import numpy as np
import pytest

from imu_rig.calibration.certificate import certificate_of
from imu_rig.calibration.result import ErrorStages
from imu_rig.report.calibration import SessionSummary, calibration_report
from imu_rig.report.parameters import sensors
from imu_rig.units import DEG, MILLI_G

DIGEST = "0123456789abcdef" * 4
HOSTILE = (
    "</title></style><script>alert(1)</script>\"'><img src=http://evil/x onerror=f()>$x_1$\u202e"
)
VOID = {"meta", "br", "img", "input", "link"}

SESSION = SessionSummary(
    protocol="full",
    protocol_title="24 poses",
    jig="paper-jig",
    planned=24,
    finished=24,
    duration_s=131.0,
    recoveries=1,
    notices=("It came back; the session goes on with the pose it was at.",),
    good=8160,
    lost=2,
    corrupt=1,
    reconnects=1,
    rate_hz=100.02,
    backlash_deg=(("tilt at pose 24", 0.62),),
)


class Page(HTMLParser):
    """Elements, texts and references of a page; fails on tags that do not match."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.html = html
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.figures: list[list[str]] = []
        self._open: list[str] = []
        self._texts: list[tuple[str, str]] = []
        self.feed(html)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag == "figure":
            self.figures.append([])
        if tag not in VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        within = self._open[-1] if self._open else ""
        self._texts.append((within, data))
        if within == "text":
            self.figures[-1].append(data)

    @property
    def names(self) -> set[str]:
        return {tag for tag, _ in self.tags}

    @property
    def text(self) -> str:
        return "\n".join(data for within, data in self._texts if within != "style")

    def texts(self, tag: str) -> list[str]:
        return [data for within, data in self._texts if within == tag]

    def attribute(self, name: str) -> list[str]:
        return [attributes[name] for _, attributes in self.tags if name in attributes]


def certified(result):
    return certificate_of(
        result,
        date=datetime(2025, 3, 4, 10, 20, tzinfo=UTC),
        recording=("session.imu-trial", DIGEST),
    )


@pytest.fixture(scope="module")
def standard(make_result, truth):
    """One result with its report, for the tests that only read."""
    result = make_result()
    html = calibration_report(result, certificate=certified(result), session=SESSION, truth=truth)
    return result, Page(html)


def test_it_needs_nothing_from_outside(standard):
    _, page = standard
    assert "http:" not in page.html
    assert "https:" not in page.html
    assert "@import" not in page.html
    assert not page.names & {"script", "link", "img", "image", "iframe", "object", "embed", "base"}
    assert page.attribute("src") == []
    assert all(reference.startswith("#") for reference in page.attribute("href"))
    assert all(name.startswith("#") for name in re.findall(r"url\((.)", page.html))
    assert not [name for _, attributes in page.tags for name in attributes if name[:2] == "on"]


def test_identifiers_are_unique_and_every_reference_finds_one(standard):
    _, page = standard
    identifiers = page.attribute("id")
    assert len(identifiers) == len(set(identifiers))
    wanted = {reference[1:] for reference in page.attribute("href")}
    wanted |= set(re.findall(r"url\(#([^)]+)\)", page.html))
    assert wanted
    assert wanted <= set(identifiers)


def test_the_verdict_states_what_how_and_how_good(standard):
    result, page = standard
    held_out = np.array([pose.left_out for pose in result.poses])
    rms = np.sqrt(np.mean(held_out**2)) / MILLI_G
    assert "Accelerometer and gyroscope calibrated; nothing needs attention" in page.text
    assert f"the magnitude of gravity errs by {rms:.3f} mg" in page.text
    moves = np.array([move.held_out_rad for move in result.moves]) / DEG
    assert f"errs by {np.sqrt(np.mean(moves**2)):.3f} deg" in page.text
    assert "24 still poses and 23 moves" in page.text
    assert "multi-position" in page.text
    assert "WGS-84 at 47.37 deg, 410 m" in page.text


def test_every_parameter_is_there_with_its_uncertainty_and_the_truth(standard, truth):
    result, page = standard
    cells = page.texts("td")
    for sensor in sensors(result, truth):
        for group in sensor.groups:
            assert f"{group.name} [{group.unit}]" in page.text
            for parameter in group.parameters:
                decimals = max(0, 1 - int(np.floor(np.log10(parameter.uncertainty))))
                for value in (parameter.value, parameter.truth):
                    assert f"{value:+.{decimals}f}".replace("-", "−") in cells
                assert f"{parameter.uncertainty:.{decimals}f}" in cells


def test_the_matrices_can_be_copied_in_full_precision(standard):
    result, page = standard
    code = next(block for block in page.texts("pre") if "accel_K" in block)
    values: dict[str, object] = {}
    for name, value in re.findall(r"(\w+) = (\[[^=]*\])(?=\n|$)", code):
        values[name] = [float(v) for v in re.findall(r"-?[\d.]+(?:e-?\d+)?", value)]
    np.testing.assert_array_equal(values["accel_K"], result.accel.K.ravel())
    np.testing.assert_array_equal(values["accel_b"], result.accel.b)
    np.testing.assert_array_equal(values["gyro_K"], result.gyro.K.ravel())
    np.testing.assert_array_equal(values["gyro_b"], result.gyro.b)


def test_session_provenance_and_use_are_stated(standard):
    _, page = standard
    for fact in (
        "foot-left",
        "A-0417",
        "mpu9150-28",
        DIGEST,
        "session.imu-trial",
        "2025-03-04 10:20",
        "imu-rig 0.",
        "paper-jig",
        "24 of 24",
        "2 min 11 s",
        "8160 good, 2 lost, 1 corrupt",
        "100.02 Hz",
        "27.1 to 28.4 °C",
        "Backlash, tilt at pose 24",
        SESSION.notices[0],
        "imu-rig export session.imu-trial --certificate certificate.json",
        "apply_certificate(load_certificate('certificate.json'), block)",
    ):
        assert fact in page.text


def test_every_figure_labels_its_axes_with_units_and_says_what_it_shows(standard):
    _, page = standard
    captions = [text for text in page.texts("b") if text.startswith("Figure")]
    assert [caption.split(".")[0] for caption in captions] == [f"Figure {i}" for i in range(1, 8)]
    units = [
        {"[mg]"},
        {"[mg]"},
        {"[mg]"},
        {"[m/s²]", "[s]"},
        {"[deg]"},
        {"[%]", "[mrad]", "[mg]"},
        {"[%]", "[mrad]", "[deg/s]"},
    ]
    for texts, wanted in zip(page.figures, units, strict=True):
        assert wanted <= set(re.findall(r"\[[^\]]+\]", " ".join(texts)))
    assert all(attributes.get("aria-label") for tag, attributes in page.tags if tag == "svg")


def test_the_sphere_numbers_every_pose_where_there_is_room(standard):
    result, page = standard
    assert {str(i + 1) for i in range(len(result.poses))} <= set(page.figures[0])


def test_it_is_the_same_for_the_same_input_and_leaves_matplotlib_alone(make_result):
    result = make_result(5)
    first = calibration_report(result, certificate=certified(result))
    changed = {"font.size": 31.0, "axes.facecolor": "black", "svg.hashsalt": "other"}
    with mpl.rc_context(changed):
        second = calibration_report(result, certificate=certified(result))
        assert {name: mpl.rcParams[name] for name in changed} == changed
    assert second == first


@pytest.mark.parametrize("poses", [3, 200])
def test_few_and_many_poses(make_result, poses):
    result = make_result(poses)
    page = Page(calibration_report(result))
    assert f"All {poses} poses" in page.text
    numbered = [text for text in page.figures[0] if re.fullmatch(r"[1-9]\d*", text)]
    assert len(numbered) == (3 if poses == 3 else 6)
    assert len(page.html) < 1_000_000


def test_poses_at_one_place_share_a_label(make_result):
    up = np.tile([0.0, 0.6, 0.8], (6, 1))
    page = Page(calibration_report(make_result(6, directions=up, gyro=False)))
    assert "1, 2, 3 +3" in page.figures[0]


def test_an_accelerometer_alone(make_result, truth):
    page = Page(calibration_report(make_result(12, gyro=False), truth=truth))
    assert "Accelerometer calibrated; nothing needs attention" in page.text
    assert "Gyroscope" not in page.text
    assert len(page.figures) == 5


def test_warnings_stand_before_every_figure(make_result):
    warnings = ("Pose 7 moved while it was held; it was left out.", "Sensor warmed up by 9 °C.")
    session = replace(SESSION, finished=11)
    page = Page(calibration_report(make_result(6, warnings=warnings), session=session))
    assert "with 3 points to heed" in page.text
    for point in (*warnings, "The session ended after 11 of 24 stops"):
        assert page.text.index(point) < page.text.index("Gravity magnitude error")


def test_without_held_out_data_it_claims_no_accuracy(make_result):
    page = Page(calibration_report(make_result(8, held_out=False)))
    assert "No pose was kept out of the fit" in page.text
    assert "No move was kept out of the fit" in page.text
    assert "no proof of accuracy" in page.text
    assert "left out of the fit" not in [text for figure in page.figures for text in figure]


def test_missing_and_impossible_numbers_are_never_shown(make_result):
    nan, inf = float("nan"), float("inf")
    result = make_result(5)
    poses = (
        replace(result.poses[0], after=nan, sigma=inf, direction=np.full(3, nan)),
        replace(result.poses[1], before=inf, left_out=nan, left_out_sigma=0.0),
        *result.poses[2:],
    )
    moves = (
        replace(result.moves[0], after_rad=nan, held_out_rad=inf, sigma_rad=None),
        replace(result.moves[1], before_rad=0.0, after_rad=0.0, angle_rad=nan),
        *result.moves[2:],
    )
    odd = replace(result, poses=poses, moves=moves, rate_hz=nan, temperature_c=(nan, 3.0))
    session = replace(SESSION, duration_s=nan, rate_hz=nan, backlash_deg=(("pan", nan),))
    page = Page(calibration_report(odd, session=session))
    assert re.findall(r"\b(?:nan|inf)\b", page.html, flags=re.IGNORECASE) == []
    assert "None" not in page.text


def test_nothing_at_rest_is_no_crash(make_result):
    bare = replace(
        make_result(4, gyro=False), poses=(), moves=(), accel_errors=ErrorStages(), warnings=()
    )
    page = Page(calibration_report(bare))
    assert "No error of the magnitude of gravity could be stated." in page.text


def test_residual_vectors_of_methods_that_trust_the_jig(make_result):
    page = Page(calibration_report(make_result(6, method="paper", vector_errors=True)))
    assert "Residual vectors against the commanded angles" in page.text
    assert {"residual [mg]", "residual [deg]"} <= set(page.figures[-1])


def test_hostile_names_stay_text(make_result):
    result = make_result(4, name=HOSTILE, warnings=(HOSTILE,), method=HOSTILE)
    result = replace(
        result,
        device=replace(result.device, serial=HOSTILE, layout=HOSTILE),
        poses=tuple(replace(pose, name=HOSTILE) for pose in result.poses),
        moves=tuple(replace(move, start=HOSTILE, stop=HOSTILE) for move in result.moves),
        frame=HOSTILE,
    )
    certificate = certificate_of(result, recording=("x", DIGEST))
    recording = certificate.recording.model_copy(update={"file": HOSTILE})
    certificate = certificate.model_copy(update={"recording": recording, "software": HOSTILE})
    session = replace(
        SESSION,
        protocol=HOSTILE,
        protocol_title=HOSTILE,
        jig=HOSTILE,
        notices=(HOSTILE,),
        backlash_deg=((HOSTILE, 1.0),),
    )
    html = calibration_report(
        result,
        certificate=certificate,
        session=session,
        title=HOSTILE,
        certificate_file=HOSTILE,
    )
    page = Page(html)
    assert not page.names & {"script", "img"}
    assert page.html.count("<style>") == 1
    assert "onerror" not in {name for _, attributes in page.tags for name in attributes}
    assert HOSTILE[:-1] + "\N{REPLACEMENT CHARACTER}" in page.text
    assert "\u202e" not in page.html
    assert not [text for figure in page.figures for text in figure if "evil" in text]


def test_it_draws_without_pyplot_and_without_a_display():
    code = (
        "import sys, imu_rig.report.calibration; "
        "sys.exit(any(m in sys.modules for m in ('matplotlib.pyplot', 'tkinter')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=30).returncode == 0
