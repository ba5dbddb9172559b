"""A foot's track beside what another instrument, or a tape measure, says of it."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from imu_rig.errors import InputError

if TYPE_CHECKING:
    from imu_rig.arrays import FloatArray
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
    time_unit: str | None = None
    z_down: bool = False
    y_up: bool = False

    def check(self, files: int) -> None:
        """Refuse what contradicts itself before anything is read."""
        if files > 1 and (self.file is not None or self.footprints is not None):
            raise InputError(
                "--reference and --footprints are of one recording: analyse them one by one."
            )
        if self.file is None:
            for option, value in self._of_a_table.items():
                if value is not None:
                    raise InputError(f"{option} needs --reference beside it.")
        if self.columns is not None and self.columns.count(",") != 2:
            raise InputError("--reference-columns names three columns, as X,Y,Z.")

    @property
    def _of_a_table(self) -> dict[str, object]:
        """Options about a file that does not state everything; None where not given."""
        return {
            "--marker": self.marker,
            "--reference-columns": self.columns,
            "--reference-unit": self.unit,
            "--reference-rate": self.rate_hz,
            "--reference-time-unit": self.time_unit,
            "--reference-y-up": self.y_up or None,
        }

    def require_reference(self) -> None:
        """Refuse options about a reference where there is none, of a file or in the recording."""
        about = {
            "--mirrored": self.mirrored,
            "--reference-z-down": self.z_down,
            "--search-offset": self.search_s,
            "--fit-lever": self.fit_lever,
        }
        for option, value in about.items():
            if value:
                raise InputError(
                    f"{option} is about a reference, and there is none: give --reference."
                )

    def read(self) -> Reference | None:
        """Return the reference of the file, if one was given."""
        if self.file is None:
            return None
        from imu_rig.importing.matlab_file import is_matlab_file
        from imu_rig.importing.optical import read_reference

        given = [option for option, value in self._of_a_table.items() if value is not None]
        if given and self.file.is_file() and is_matlab_file(self.file):
            raise InputError(f"{self.file} states all about itself: leave {given[0]} out.")
        columns = None
        if self.columns is not None:
            x, y, z = (_column(part.strip()) for part in self.columns.split(","))
            columns = (x, y, z)
        return read_reference(
            self.file,
            marker=self.marker,
            columns=columns,
            unit=self.unit,
            time_unit=self.time_unit,
            rate_hz=self.rate_hz,
            y_up=self.y_up or None,
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
    from imu_rig.cli.analyze_agreement import (
        about_signs,
        aligned,
        distance_words,
        horizontal_words,
        misplaced,
    )
    from imu_rig.errors import DataError
    from imu_rig.reference.alignment import align
    from imu_rig.reference.optical_strides import compare_optical_strides
    from imu_rig.report.foot_facts import Measured
    from imu_rig.report.foot_figures import SeenPath
    from imu_rig.report.numbers import fixed
    from imu_rig.rotation import about_z
    from imu_rig.units import DEG

    trajectory = track.trajectory
    found = aligned(track, reference, options)
    x, y, z = found.rmse
    rows: list[tuple[str, str]] = []
    doubts: list[str] = []
    figures = found.to_dict()
    compared, contradictions = None, tuple[str, ...]()
    try:
        compared = compare_optical_strides(strides, reference, time_offset=found.time_offset)
    except DataError as error:
        # A marker that was lost at footfalls has positions to compare, but no strides.
        doubts.append(f"No stride could be compared: {error}")
    else:
        told, contradictions = distance_words(compared, strides, "the reference has")
        rows.append(("Distance", told))
        rows.append(("Stride length", stride_words(compared)))
        doubts += contradictions
        figures["strides"] = compared.to_dict()
    rows += [
        ("Horizontal", horizontal_words(found)),
        ("Vertical", f"{fixed(found.rmse_vertical, 3)} m RMSE"),
        ("Axes of the reference", f"x {fixed(x, 3)}, y {fixed(y, 3)}, z {fixed(z, 3)} m RMSE"),
        ("End", f"{fixed(found.closure, 3)} m apart, if both begin at one place"),
    ]
    elsewhere = misplaced(track, reference, options, found, compared)
    if elsewhere is not None:
        doubts = [elsewhere]
    elif options.fit_lever or contradictions:
        fitted = align(
            trajectory.t,
            trajectory.position,
            reference,
            mirrored=options.mirrored,
            z_down=options.z_down,
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
        moved = _at_the_marker(track, strides, fitted.lever)
        with contextlib.suppress(DataError):  # told above
            there = compare_optical_strides(moved, reference, time_offset=fitted.time_offset)
            told, others = distance_words(there, strides, "the reference has")
            rows.append(("Distance of that place", told))
            figures["with_lever"]["strides"] = there.to_dict()
            if contradictions and not others:
                doubts.append(f"A marker at ({lever}) cm from the sensor would explain it: {told}")
    doubts += about_signs(found.hands)
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
        tuple(doubts),
    )


def _at_the_marker(track: FootTrack, strides: Strides, lever: FloatArray) -> Strides:
    """Return strides with the lengths [m] of a place beside the sensor, by ``lever`` (3,)."""
    import numpy as np

    from imu_rig.rotation import rotate

    path, rows = track.trajectory, track.footfalls.quietest
    places = path.position[rows] + rotate(path.quaternion[rows], lever)
    way = np.diff(places[:, :2], axis=0)
    return replace(strides, length=np.hypot(way[:, 0], way[:, 1]))


def beside_footprints(strides: Strides, footprints: Footprints) -> Measured:
    """Compare strides with measured footprints.

    Raises
    ------
    DataError
        If there are fewer than two footprints.
    """
    import numpy as np

    from imu_rig.cli.analyze_agreement import ANOTHER_WALK, distance_words
    from imu_rig.gait.stride_kinds import SHIFT
    from imu_rig.reference.footprints import compare_footprints
    from imu_rig.report.foot_facts import Measured
    from imu_rig.report.numbers import fixed

    found = compare_footprints(strides, footprints)
    told, contradictions = distance_words(found, strides, "the footprints have")
    doubts = list(contradictions)
    if abs(found.distance_percent) > 100.0 * ANOTHER_WALK:
        doubts = [f"Do the footprints belong to this recording? {told}"]
    rows = [
        ("Strides", f"{found.count} found, {found.true_count} true"),
        ("Distance", told),
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
    return Measured(tuple(rows), card, note, None, lengths, found.to_dict(), doubts=tuple(doubts))


def stride_words(found: StrideComparison) -> str:
    """Tell the errors of stride lengths."""
    from imu_rig.report.numbers import fixed

    return (
        f"{fixed(1000.0 * found.mae, 1)} mm mean absolute error over {len(found.errors)}, bias "
        f"{fixed(1000.0 * found.bias, 1, sign=True)} mm"
    )
