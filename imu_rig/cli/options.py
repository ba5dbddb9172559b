"""Options that several commands share, described once."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imu_rig.errors import InputError

if TYPE_CHECKING:
    from imu_rig.calibration.gravity import Gravity

Json = Annotated[
    bool, typer.Option("--json", help="Print one JSON object to stdout; talk stays on stderr.")
]
Gravity_ = Annotated[
    float | None,
    typer.Option("--gravity", help="Local gravity [m/s^2], where it is known."),
]
Latitude = Annotated[
    float | None,
    typer.Option("--latitude", help="Latitude [deg], to compute local gravity from."),
]
Height = Annotated[
    float | None, typer.Option("--height", help="Height above sea level [m], with --latitude.")
]
Method = Annotated[
    str,
    typer.Option(
        "--method",
        help="auto: joint on a jig (gravity and jig, each for what it knows), multi-position "
        "(gravity alone) by hand. Others: paper or paper-diagonal (trust the jig), static, "
        "ferraris, turntable, magnetometer (nothing else).",
    ),
]


def named(text: str) -> Path:
    """Take a path; an empty one, as of a variable that is not set, would be the current folder.

    Raises
    ------
    InputError
        If it is empty.
    """
    if not text:
        raise InputError("An empty name is no folder: give --output one, or leave it out.")
    return Path(text)


Output = Annotated[
    Path | None,
    typer.Option(
        "--output", "-o", parser=named, metavar="PATH", help="Folder for certificate and report."
    ),
]
MapFile = Annotated[
    Path | None, typer.Option("--map", help="TOML file that names columns and units.")
]
Columns = Annotated[
    str | None,
    typer.Option("--columns", help='Names of all columns, as in "t ax ay az gx gy gz".'),
]
Rate = Annotated[
    float | None, typer.Option("--rate", help="Samples per second, where there is no time column.")
]
AccelColumns = Annotated[
    str | None,
    typer.Option("--accel", help="Accelerometer columns by name or number, as X,Y,Z."),
]
GyroColumns = Annotated[str | None, typer.Option("--gyro", help="Gyroscope columns, likewise.")]
MagColumns = Annotated[
    str | None,
    typer.Option(
        "--mag",
        help="Magnetometer columns for the accelerometer's x, y, z; a minus turns a sign, as in "
        "my,mx,-mz for the MPU-9150's raw axes.",
    ),
]
FieldUt = Annotated[
    float | None,
    typer.Option("--field", help="Magnitude of the magnetic field there [uT], if known."),
]
TimeColumn = Annotated[str | None, typer.Option("--time", help="Time column by name or number.")]
AccelUnit = Annotated[
    str | None,
    typer.Option("--accel-unit", help='m/s2, g, mg or counts as in "16384 LSB/g".'),
]
GyroUnit = Annotated[
    str | None,
    typer.Option("--gyro-unit", help='rad/s, deg/s or counts as in "131 LSB/(deg/s)".'),
]
MagUnit = Annotated[str | None, typer.Option("--mag-unit", help="uT, gauss, mG or nT.")]
TimeUnit = Annotated[str | None, typer.Option("--time-unit", help="s, ms, us, ns or samples.")]
SensorName = Annotated[str, typer.Option("--name", help="Name of the sensor, for the certificate.")]
Serial = Annotated[str, typer.Option("--serial", help="Serial number, for the certificate.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress on stderr.")]

DEFAULT_METHOD = "auto"


def gravity_from(gravity: float | None, latitude: float | None, height: float | None) -> Gravity:
    """Gravity as the options say it; standard gravity, and said so, where they say nothing.

    Raises
    ------
    InputError
        If the options contradict each other or name no place on Earth.
    """
    from imu_rig.calibration.gravity import Gravity
    from imu_rig.errors import InputError

    if gravity is not None and latitude is not None:
        raise InputError("Give either --gravity or --latitude, not both.")
    if height is not None and latitude is None:
        raise InputError("--height needs --latitude beside it.")
    if gravity is not None:
        return Gravity.given(gravity)
    if latitude is not None:
        return Gravity.at(latitude, height or 0.0)
    return Gravity()
