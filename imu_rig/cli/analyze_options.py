"""Options that `imu-rig analyze foot` and `imu-rig analyze gait` share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Level = Annotated[
    str,
    typer.Option(
        "--level",
        help="Whether all footfalls are at one height: auto (where heights say so), always, never "
        "(a ramp below 5 %).",
    ),
]
Detector = Annotated[
    str | None,
    typer.Option(
        "--detector",
        help="Of zero velocity: adaptive (default), paper, shoe, are, variance, magnitude, "
        "threshold.",
    ),
]
NoFiles = Annotated[
    bool, typer.Option("--no-files", help="Print the figures only; write no folder.")
]
Sensors = Annotated[
    list[str] | None,
    typer.Option(
        "--sensor", help="Which sensor; twice for two feet. By default those called after feet."
    ),
]
Certificates = Annotated[
    list[str] | None,
    typer.Option(
        "--certificate",
        metavar="[SENSOR=]FILE",
        help="Certificate to calibrate with; by default the one kept in the trial, if any.",
    ),
]
Raw = Annotated[bool, typer.Option("--raw", help="Do not calibrate, whatever the trial holds.")]
AnyDevice = Annotated[
    bool, typer.Option("--any-device", help="Apply the certificate of another sensor.")
]
ReferenceFile = Annotated[
    Path | None,
    typer.Option(
        "--reference",
        help="Positions of the foot by optics: CSV, C3D, or pyshoe .mat. A recording that holds "
        "them itself needs none.",
    ),
]
Marker = Annotated[
    str | None, typer.Option("--marker", help="Which marker of the reference sits on the foot.")
]
ReferenceColumns = Annotated[
    str | None,
    typer.Option(
        "--reference-columns", help="Its columns of x, y and z by name or number, as X,Y,Z."
    ),
]
ReferenceUnit = Annotated[
    str | None, typer.Option("--reference-unit", help="Unit of its positions: m, cm or mm.")
]
ReferenceRate = Annotated[
    float | None,
    typer.Option("--reference-rate", help="Its samples per second, where it has no times."),
]
ReferenceTimeUnit = Annotated[
    str | None, typer.Option("--reference-time-unit", help="Unit of its times, as s or ms.")
]
ReferenceZDown = Annotated[
    bool, typer.Option("--reference-z-down", help="Its z axis points down, its y to the right.")
]
ReferenceYUp = Annotated[
    bool, typer.Option("--reference-y-up", help="Its y axis points up, as in computer graphics.")
]
ClockSearch = Annotated[
    float,
    typer.Option(
        "--search-offset",
        min=0.0,
        max=600.0,
        help="The reference's clock may differ by up to so many seconds; 0: it is the same.",
    ),
]
Mirrored = Annotated[
    bool, typer.Option("--mirrored", help="The reference is left-handed: turn the sign of its y.")
]
FitLever = Annotated[
    bool,
    typer.Option(
        "--fit-lever", help="Say also what is left if the marker's place on the foot is fitted."
    ),
]
FootprintsFile = Annotated[
    Path | None,
    typer.Option(
        "--footprints", help="Measured footprints of the foot: CSV with x and y [m], or .mat."
    ),
]
