"""`imu-rig analyze`: walks of people from sensors on their feet."""

from __future__ import annotations

import typer

from imu_rig.cli.analyze_foot import foot
from imu_rig.cli.analyze_gait import gait

app = typer.Typer(
    help="Analyse walks: trajectories of feet, strides and distances.", no_args_is_help=True
)
app.command("foot")(foot)
app.command("gait")(gait)


@app.callback()
def analyze() -> None:
    """Analyse walks: trajectories of feet, strides and distances."""
