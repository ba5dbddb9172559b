"""Facts about a recording that options state: its parts, the angle of its turns, known rates."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imu_rig.errors import InputError

if TYPE_CHECKING:
    from imu_rig.blocks import ImuBlock
    from imu_rig.calibration.known import Known
    from imu_rig.importing.column_map import ColumnMap

Parts = Annotated[
    Path | None,
    typer.Option("--parts", help="ferraris: JSON list of parts by first and last sample."),
]
TurnAngle = Annotated[
    float | None,
    typer.Option("--turn-angle", help="ferraris: angle of every turn [deg], 360 by default."),
]
Rates = Annotated[
    Path | None,
    typer.Option("--rates", help="turntable: CSV or TOML of t0, t1, axis and rate_dps."),
]
TAKES_PARTS = ("auto", "multi-position", "static", "ferraris")
"""Methods that rest on still poses, which a column of parts names."""
LARGEST_TURN_DEG = 7200.0


@dataclass(frozen=True)
class KnownOptions:
    """What the options say."""

    parts: Path | None = None
    turn_angle: float | None = None
    rates: Path | None = None

    def check(self, method: str) -> None:
        """Refuse options that ``method`` does not look at, and angles that are none."""
        for name, value, of in (
            ("--parts", self.parts, "ferraris"),
            ("--turn-angle", self.turn_angle, "ferraris"),
            ("--rates", self.rates, "turntable"),
        ):
            if value is not None and method != of:
                raise InputError(f"{name} belongs to --method {of}, not to {method}.")
        if method == "turntable" and self.rates is None:
            raise InputError("--method turntable needs the known rates: give them with --rates.")
        if self.turn_angle is not None and not 60.0 < self.turn_angle < LARGEST_TURN_DEG:
            raise InputError(
                f"--turn-angle is {self.turn_angle:g}: give the degrees of one turn, more than 60."
            )

    def facts(self, block: ImuBlock) -> Known:
        """Read the files beside ``block``."""
        from imu_rig.calibration.known import FULL_TURN, Known
        from imu_rig.importing.parts import read_part_list
        from imu_rig.importing.rates import read_rates
        from imu_rig.units import DEG

        return Known(
            parts=() if self.parts is None else read_part_list(self.parts, block.t),
            turn_angle=FULL_TURN if self.turn_angle is None else self.turn_angle * DEG,
            rates=None if self.rates is None else read_rates(self.rates),
        )


def read_with_facts(
    file: Path, columns: ColumnMap, method: str, options: KnownOptions
) -> tuple[ImuBlock, Known]:
    """Read a table with the parts that a column of it names, or another program's recording.

    Parts are cut out and put together, so that rests found without them would run on from one
    into the next. Only the method for faces and turns insists on names that it knows.
    """
    from dataclasses import replace

    from imu_rig.importing.formats import is_table, read_imu
    from imu_rig.importing.parts import has_known_parts, has_parts, read_annotated

    named = has_parts if method == "ferraris" else has_known_parts
    may_name = options.parts is None and method in TAKES_PARTS and is_table(file, columns)
    if may_name and named(file, columns):
        block, parts = read_annotated(file, columns)
        return block, replace(options.facts(block), parts=parts)
    block = read_imu(file, columns)
    return block, options.facts(block)
