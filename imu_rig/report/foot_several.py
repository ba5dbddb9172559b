"""One page over several recordings of feet: what was found of each, and the tables of each axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from imu_rig import __version__
from imu_rig.reference.tables import AxisTable
from imu_rig.report.foot import told_with_sigma
from imu_rig.report.foot_facts import FootReport, Measured
from imu_rig.report.numbers import MISSING, counted, fixed
from imu_rig.report.page import Html, document, element, facts, header, section, table
from imu_rig.report.stride_table import shown_summary

TITLE = "Where feet went"


def several_report(
    reports: Sequence[FootReport], tables: Sequence[AxisTable], failed: Mapping[str, str]
) -> str:
    """Return a page over recordings as the text of one HTML file that needs nothing else.

    Parameters
    ----------
    reports : sequence of FootReport
        Of the recordings that could be analysed.
    tables : sequence of AxisTable
        Of those with a reference.
    failed : mapping of str to str
        Names of recordings and feet that could not be, and why.
    """
    rows = [
        [
            f"{report.recording}, {foot.name}",
            str(len(foot.strides)),
            told_with_sigma(foot.strides.distance, foot.strides.distance_sigma),
            fixed(shown_summary(foot.strides, "length")[1].mean, 3),
            fixed(shown_summary(foot.strides, "velocity")[1].mean, 2),
            _beside(foot.reference),
            str(len(foot.notes)),
        ]
        for report in reports
        for foot in report.feet
    ]
    head = ["recording", "strides", "distance [m]", "stride [m]", "velocity [m/s]"]
    head += ["reference [m]", "notes"]
    left_out = [element("li", f"{name}: {why}") for name, why in failed.items()]
    return document(
        TITLE,
        header("trajectories and strides", TITLE, counted(len(reports), "recording")),
        *(
            [
                element(
                    "div",
                    element("h2", f"{len(left_out)} left out"),
                    element("ul", *left_out),
                    class_="verdict care",
                )
            ]
            if left_out
            else []
        ),
        section(
            "Recordings",
            table(head, rows),
            element(
                "p",
                "Means are of steady walking and running; the reference's distance is that of the "
                "strides it saw. Notes are in the page of each recording.",
                class_="note",
            ),
        ),
        *([section("Beside the references", *map(_axis, tables))] if tables else []),
        section("Provenance", facts([("Software", f"imu-rig {__version__}")])),
    )


def _beside(measured: Measured | None) -> str:
    found = None if measured is None else (measured.figures or {}).get("strides")
    return MISSING if found is None else fixed(found["true_distance_m"], 2)


def _axis(axis: AxisTable) -> Html:
    rows = [
        [name, fixed(a, 2), fixed(b, 2), fixed(c, 2), fixed(d, 3)]
        for name, a, b, c, d in zip(
            axis.trials,
            axis.reference.tolist(),
            axis.estimate.tolist(),
            axis.error.tolist(),
            axis.path_rmse.tolist(),
            strict=True,
        )
    ]
    rows.append(["RMSE", "", "", fixed(axis.rmse, 2), fixed(axis.mean_path_rmse, 3)])
    head = ["recording", "reference [m]", "sensor [m]", "error [m]", "RMSE of the path [m]"]
    return table(head, rows, caption=f"From begin to end along {axis.axis}")
