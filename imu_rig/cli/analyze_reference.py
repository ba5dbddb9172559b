"""A foot's track beside what another instrument, or a tape measure, says of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from imu_rig.errors import InputError

if TYPE_CHECKING:
    from imu_rig.gait.strides import Strides
    from imu_rig.gait.trajectory import FootTrack
    from imu_rig.reference.footprints import Footprints, StrideComparison
    from imu_rig.reference.reference import Reference
    from imu_rig.report.foot_facts import Measured


@dataclass(frozen=True)
class ReferenceOptions:
    """What the options say about references; see `imu_rig.cli.analyze_options`."""

    file: Path | None = None
    marker: str | None = None
    search_s: float = 0.0
    mirrored: bool = False
    fit_lever: bool = False
    footprints: Path | None = None
    columns: str | None = None
    unit: str | None = None
    rate_hz: float | None = None

    def check(self, files: int) -> None:
        """Refuse what contradicts itself before anything is read."""
        if files > 1 and (self.file is not None or self.footprints is not None):
            raise InputError(
                "--reference and --footprints are of one recording: analyse them one by one."
            )
        about = {
            "--marker": self.marker,
            "--reference-columns": self.columns,
            "--reference-unit": self.unit,
            "--reference-rate": self.rate_hz,
        }
        if self.file is None:
            for option, value in about.items():
                if value is not None:
                    raise InputError(f"{option} needs --reference beside it.")
        if self.columns is not None and self.columns.count(",") != 2:
            raise InputError("--reference-columns names three columns, as X,Y,Z.")

    def read(self) -> Reference | None:
        """Return the reference of the file, if one was given."""
        if self.file is None:
            return None
        from imu_rig.importing.optical import read_reference

        columns = None
        if self.columns is not None:
            x, y, z = (_column(part.strip()) for part in self.columns.split(","))
            columns = (x, y, z)
        return read_reference(
            self.file, marker=self.marker, columns=columns, unit=self.unit, rate_hz=self.rate_hz
        )

    def read_footprints(self) -> Footprints | None:
        """Return the footprints of the file, if one was given."""
        if self.footprints is None:
            return None
        from imu_rig.importing.footprints import read_footprints

        return read_footprints(self.footprints)


def _column(text: str) -> str | int:
    return int(text) if text.isascii() and text.isdigit() else text


def beside_reference(
    track: FootTrack, strides: Strides, reference: Reference, options: ReferenceOptions
) -> Measured:
    """Compare a track with optical positions: yaw and shift are fitted, nothing else.

    Raises
    ------
    DataError
        If they do not overlap, or go nowhere.
    """
    from imu_rig.errors import DataError
    from imu_rig.reference.alignment import align
    from imu_rig.reference.optical_strides import compare_optical_strides
    from imu_rig.report.foot_facts import Measured
    from imu_rig.report.foot_figures import SeenPath
    from imu_rig.report.numbers import fixed
    from imu_rig.rotation import about_z
    from imu_rig.units import DEG

    trajectory = track.trajectory
    found = align(
        trajectory.t,
        trajectory.position,
        reference,
        mirrored=options.mirrored,
        search_offset_s=options.search_s,
    )
    x, y, z = found.rmse
    rows = [
        (
            "Horizontal",
            f"{fixed(found.rmse_horizontal, 3)} m RMSE, {fixed(found.largest_horizontal, 3)} m at "
            "most",
        ),
        ("Vertical", f"{fixed(found.rmse_vertical, 3)} m RMSE"),
        ("Its axes x, y, z", f"{fixed(x, 3)}, {fixed(y, 3)}, {fixed(z, 3)} m RMSE"),
        ("End", f"{fixed(found.closure, 3)} m off the way from begin to end"),
    ]
    figures = found.to_dict()
    try:
        compared = compare_optical_strides(strides, reference, time_offset=found.time_offset)
        rows.append(("Stride length", stride_words(compared)))
        figures["strides"] = compared.to_dict()
    except DataError:
        pass  # a marker that was lost at footfalls has positions to compare, but no strides
    if options.fit_lever:
        fitted = align(
            trajectory.t,
            trajectory.position,
            reference,
            mirrored=options.mirrored,
            search_offset_s=options.search_s,
            quaternion=trajectory.quaternion,
            fit_lever=True,
        )
        assert fitted.lever is not None
        lever = ", ".join(fixed(100.0 * v, 1) for v in fitted.lever)
        rows.append(
            (
                "With the marker's place fitted",
                f"{fixed(fitted.rmse_horizontal, 3)} m RMSE horizontally, marker at ({lever}) cm",
            )
        )
        figures["with_lever"] = fitted.to_dict()
    note = (
        f"Yaw ({fixed(found.yaw / DEG, 2)} deg) and shift of the track were fitted to "
        f"{len(found.t)} places of the reference, {fixed(100.0 * found.coverage, 0)} % of it."
    )
    if found.time_offset:
        note += f" Its clock was taken to be {fixed(found.time_offset, 3, sign=True)} s off."
    card = (
        "Reference",
        fixed(found.rmse_horizontal, 3),
        "m",
        "horizontal RMSE after the best yaw and shift",
    )
    seen = SeenPath(
        found.t + found.time_offset,
        (found.reference - found.translation) @ about_z(-found.yaw).T,
    )
    return Measured(
        tuple(rows),
        card,
        " ".join([note, *(f"{n.rstrip('.')}." for n in found.notes)]),
        seen,
        None,
        figures,
        found,
    )


def beside_footprints(strides: Strides, footprints: Footprints) -> Measured:
    """Compare strides with measured footprints.

    Raises
    ------
    DataError
        If there are fewer than two footprints.
    """
    import numpy as np

    from imu_rig.gait.stride_kinds import SHIFT
    from imu_rig.reference.footprints import compare_footprints
    from imu_rig.report.foot_facts import Measured
    from imu_rig.report.numbers import fixed

    found = compare_footprints(strides, footprints)
    rows = [
        ("Strides", f"{found.count} found, {found.true_count} true"),
        (
            "Distance",
            f"{fixed(found.distance, 2)} m, true {fixed(found.true_distance, 2)} m: "
            f"{fixed(found.distance_percent, 2, sign=True)} %",
        ),
    ]
    lengths = None
    if len(found.errors):
        rows.append(("Stride length", stride_words(found)))
        lengths = np.full(len(strides), np.nan)
        lengths[strides.kind != SHIFT] = found.true_length
    note = (
        "The first stride is compared with the first, and so on."
        if len(found.errors)
        else "The numbers of strides differ, so that single lengths cannot be compared."
    )
    card = (
        "Footprints",
        fixed(found.distance_percent, 2, sign=True),
        "%",
        f"of the distance; {found.count} of {found.true_count} strides",
    )
    return Measured(tuple(rows), card, note, None, lengths, found.to_dict())


def stride_words(found: StrideComparison) -> str:
    """Tell the errors of stride lengths."""
    from imu_rig.report.numbers import fixed

    return (
        f"{fixed(1000.0 * found.mae, 1)} mm mean absolute error over {len(found.errors)}, bias "
        f"{fixed(1000.0 * found.bias, 1, sign=True)} mm"
    )
