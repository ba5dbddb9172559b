"""Options that `imu-rig analyze foot` and `imu-rig analyze gait` share."""

from __future__ import annotations

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
