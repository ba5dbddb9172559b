"""Checks in a report: their part of a calibration report, and the page of a later check."""

from __future__ import annotations

from datetime import datetime

import numpy as np
from matplotlib.figure import Figure

from imu_rig import __version__
from imu_rig.calibration.certificate import Certificate
from imu_rig.calibration.recheck import UNITS, Recheck
from imu_rig.calibration.verification import CheckRow, Verification
from imu_rig.report.numbers import MISSING, counted, fixed, significant
from imu_rig.report.page import Html, card, document, element, facts, header, section, table
from imu_rig.report.svg import (
    AFTER,
    BEFORE,
    INK,
    LEFT_OUT,
    Figures,
    new_figure,
    panel,
    report_style,
)
from imu_rig.units import DEG, MILLI_G

KINDS = (
    ("pose", "Check poses: magnitude of gravity", MILLI_G, "mg"),
    ("move", "Check moves: direction of gravity", DEG, "deg"),
)
LIMIT_INK = "#b3261e"


def verification_section(verification: Verification) -> Html:
    """Return the part of a calibration report that tells how its own checks ended."""
    return section(
        "Verification",
        element("p", f"{verification.headline} {_limits(verification)}"),
        *_tables(verification),
        element(
            "p",
            "These poses, and the moves to and from them, were kept out of the fit. The predicted "
            "σ comes from the uncertainty of the parameters and the noise of the check.",
            class_="note",
        ),
        element("div", *_drawn(verification, later=False), class_="figures"),
    )


def verification_card(verification: Verification | None) -> Html:
    """Return a card that tells whether the checks passed, or that there were none."""
    label = "Verification"
    if verification is None:
        return card(label, "none", "", "no poses were measured for checking alone")
    counted_rows = [row for row in verification.rows if row.state != "void"]
    inside = sum(row.state == "passed" for row in counted_rows)
    about = f"{inside} of {counted(len(counted_rows), 'check')} within limits"
    return card(label, verification.state, "", f"{about}, on poses measured for checking alone")


def figure_count(verification: Verification | None) -> int:
    """How many figures `verification_section` holds."""
    rows = () if verification is None else verification.rows
    return len({row.kind for row in rows if row.error is not None})


def verification_page(
    certificate: Certificate,
    recheck: Recheck,
    *,
    certificate_file: str,
    recording: str,
    date: datetime,
) -> str:
    """Return the report of a sensor held against its certificate, as one HTML file.

    Parameters
    ----------
    certificate : Certificate
        What the sensor was.
    recheck : Recheck
        How it does now.
    certificate_file, recording : str
        Names of the files compared.
    date : datetime
        When the check was judged.
    """
    verification, device = recheck.verification, certificate.device
    named = [device.name or "unnamed sensor"]
    named += [f"serial {device.serial}"] if device.serial else []
    named += [f"{date:%Y-%m-%d %H:%M %Z}"]
    points = (*verification.reasons, *recheck.notes)
    attention = [element("ul", *(element("li", point) for point in points))] if points else []
    return document(
        f"Check of {device.name}" if device.name else "Check of a sensor",
        header("a sensor and its certificate", "Check against certificate", " · ".join(named)),
        element(
            "div",
            element("h2", verification.headline),
            *attention,
            element("p", f"{_limits(verification)} {_what(certificate)}"),
            class_="verdict" if verification.passed else "verdict care",
        ),
        element("div", *_cards(verification), class_="cards"),
        _drift(recheck),
        section(
            "Checks",
            *_tables(verification),
            element(
                "p",
                "The predicted σ allows for what sensors of this class drift from day to day.",
                class_="note",
            ),
            element("div", *_drawn(verification, later=True), class_="figures"),
        ),
        section(
            "Provenance",
            facts(
                [
                    ("Certificate", certificate_file),
                    ("Calibrated", f"{certificate.date.isoformat(sep=' ')}"),
                    ("Method", certificate.method),
                    ("Recording of the check", recording),
                    ("Software", f"imu-rig {__version__}"),
                ]
            ),
        ),
    )


def check_figure(rows: list[CheckRow], unit: float, name: str, *, later: bool) -> Figure:
    """Errors of the checks that count, with their limits.

    With each error stands its predicted σ or, in a ``later`` check, its noise: the prediction
    allows for another day then and is wider than the limits.
    """
    figure = new_figure(300.0)
    axes = panel(figure, 66.0, 46.0, 442.0, 222.0)
    x = np.arange(1, len(rows) + 1, dtype=float)
    error = np.array([np.nan if r.error is None else r.error for r in rows]) / unit
    spread = [r.noise if later else r.sigma for r in rows]
    sigma = np.array([np.nan if s is None else s for s in spread]) / unit
    allowed = np.array([r.allowed for r in rows]) / unit
    failed = np.array([r.state == "failed" for r in rows])
    signed = bool(np.any(error < 0))
    edge = float(np.nanmax(np.abs(np.concatenate((error, allowed)))))
    for sign in (1.0, -1.0) if signed else (1.0,):
        axes.hlines(
            sign * allowed, x - 0.4, x + 0.4, color=LIMIT_INK, linewidth=1.4,
            label="limit and noise of the check" if sign > 0 else "_again",
        )  # fmt: skip
    bar = "noise" if later else "predicted σ"
    low = np.maximum(error - sigma, 0.0 if not signed else -np.inf)
    axes.vlines(x, low, error + sigma, color=AFTER, linewidth=1.1, label=f"± {bar}")
    axes.plot(x[~failed], error[~failed], "o", color=AFTER, markersize=6, label="error")
    if failed.any():
        axes.plot(x[failed], error[failed], "D", color=LEFT_OUT, markersize=7, label="beyond")
    void = np.isnan(error)
    if void.any():
        axes.plot(x[void], 0.0 * x[void], "x", color=BEFORE, markersize=7, label="does not count")
    if signed:
        axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set_ylim(-1.25 * edge if signed else 0.0, 1.25 * edge)
    axes.set_xlim(0.3, len(rows) + 0.7)
    axes.set_xticks(x if len(rows) <= 15 else x[:: len(rows) // 10])
    axes.set_xlabel("check")
    axes.set_ylabel(f"error [{name}]")
    axes.legend(
        loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.2,
        handletextpad=0.4, columnspacing=1.2, fontsize=11.5,
    )  # fmt: skip
    return figure


def _drawn(verification: Verification, *, later: bool) -> list[Html]:
    drawn = Figures()
    with report_style():
        for kind, title, unit, name in KINDS:
            rows = [row for row in verification.rows if row.kind == kind]
            if any(row.error is not None for row in rows):
                drawn.add(
                    f"check{kind}",
                    check_figure(rows, unit, name, later=later),
                    title,
                    "Error of every check, numbered as in the table, with "
                    + ("the noise of the check" if later else "its predicted uncertainty")
                    + " (one standard deviation) and the largest error that passes.",
                )
    return drawn.parts


def _tables(verification: Verification) -> list[Html]:
    tables = []
    for kind, title, unit, name in KINDS:
        rows = [row for row in verification.rows if row.kind == kind]
        if rows:
            head = [
                "No.", element("th", kind.capitalize(), class_="text", scope="col"),
                f"Error [{name}]", f"σ predicted [{name}]", f"Allowed [{name}]",
                "Error in σ", "Allowed", "",
            ]  # fmt: skip
            body = [_row(i, row, unit) for i, row in enumerate(rows, start=1)]
            tables.append(table(head, body, caption=title))
    return tables


def _row(number: int, row: CheckRow, unit: float) -> Html:
    if row.error is None or row.sigma is None or row.sigmas is None:
        cells = [MISSING] * 5
    else:
        cells = [
            fixed(row.error / unit, 3, sign=row.kind == "pose"),
            fixed(row.sigma / unit, 3),
            fixed(row.allowed / unit, 2),
            fixed(row.sigmas, 1),
            fixed(row.sigma_limit, 1),
        ]
    outside = {"class_": "outside"} if row.state == "failed" else {}
    verdict = {"passed": "passed", "failed": "beyond", "void": f"void: {row.void}"}[row.state]
    return element(
        "tr",
        element("th", str(number), scope="row"),
        element("td", row.name, class_="text"),
        *(element("td", cell) for cell in cells),
        element("td", verdict, **outside),
    )


def _cards(verification: Verification) -> list[Html]:
    cards = []
    for kind, title, unit, name in KINDS:
        found = [r for r in verification.rows if r.kind == kind and r.error is not None]
        label = f"Largest error, {title.split(': ')[1]}"
        if not found:
            continue
        worst = max(abs(row.error or 0.0) for row in found) / unit
        limit = found[0].limit / unit
        about = (
            f"of {counted(len(found), f'check {kind}')}; limit {significant(limit, 2)} {name} "
            "beyond noise"
        )
        cards.append(card(label, significant(worst), name, about))
    return cards


def _drift(recheck: Recheck) -> Html:
    if not recheck.drift:
        return Html("")
    rows = []
    for row in recheck.drift:
        unit, name = UNITS[row.sensor, row.quantity]
        known = row.determined
        values = [
            fixed(row.certified / unit, 3, sign=True),
            fixed(row.change / unit, 3, sign=True) if known else MISSING,
            fixed(row.sigma / unit, 3) if known else MISSING,
            fixed(row.sigmas, 1) if known else MISSING,
            fixed(row.day_to_day / unit, 2),
        ]
        said = "no change shown"
        if not known:
            said = "not determined"
        elif row.drifted:
            said = "drifted, as usual" if row.usual else "drifted"
        outside = {"class_": "outside"} if row.drifted and not row.usual else {}
        rows.append(
            element(
                "tr",
                element("th", f"{row.name} [{name}]", scope="row"),
                *(element("td", value) for value in values),
                element("td", said, **outside),
            )
        )
    head = ["Parameter", "Certificate", "Change", "σ if unchanged", "Change in σ", "Usual σ", ""]
    return section(
        "What drifted",
        table(head, rows),
        element(
            "p",
            "A change is judged by the scatter it would have if nothing had drifted: the "
            "uncertainty of the certificate and the noise of the check. The usual σ is what "
            "sensors of this class change from one day to another.",
            class_="note",
        ),
    )


def _limits(verification: Verification) -> str:
    limits = verification.limits
    return (
        f"Allowed are {limits.accel / MILLI_G:g} mg in a pose and {limits.turn / DEG:g} degrees "
        f"after a move, both beyond the noise of the check itself, and {limits.sigma:g} predicted "
        "standard deviations."
    )


def _what(certificate: Certificate) -> str:
    return f"The certificate is of {certificate.date:%Y-%m-%d}, made by {certificate.method}."
