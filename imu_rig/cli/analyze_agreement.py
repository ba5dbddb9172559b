"""Whether a track and what another instrument says of it agree, or are of one walk at all."""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from imu_rig.cli.analyze_reference import ReferenceOptions
    from imu_rig.gait.strides import Strides
    from imu_rig.gait.trajectory import FootTrack
    from imu_rig.reference.alignment import Alignment
    from imu_rig.reference.footprints import StrideComparison
    from imu_rig.reference.handedness import Handedness
    from imu_rig.reference.reference import Reference

CONTRADICTS = "The distance is contradicted"
OUTSIDE_SIGMA, OUTSIDE_SHARE = 3.0, 0.03
"""A distance that is farther off than this contradicts the reference [sigma], [1]: what a sound
sensor with an honest uncertainty does once in 400 recordings, and what no sound one does at all."""
ANOTHER_WALK, ANOTHER_CLOCK = 0.2, 0.05
"""Where the best turn and shift leave more than this share of the reference's own spread, or the
distances differ by more, the two are hardly of one walk, or of one clock [1]."""
SLIP = 3.0
"""A foot's errors change over seconds: where 1 % of the places is farther off than all others by
this factor, the reference slipped."""
SEARCHED_S, MUCH_BETTER = 30.0, 0.3
"""So far another clock is looked for [s], which must leave no more than this share."""


def distance_words(
    found: StrideComparison, strides: Strides, other: str
) -> tuple[str, tuple[str, ...]]:
    """Tell a distance beside that of another instrument between the same moments.

    Parameters
    ----------
    found : StrideComparison
    strides : Strides
        All of them. What errs alike in all strides errs as much in part of them, so that the
        uncertainty of the distance of a part is taken to be in proportion.
    other : str
        Who says otherwise.

    Returns
    -------
    text : str
    doubts : tuple of str
        A sentence, where the two contradict each other.
    """
    from imu_rig.report.foot import told_with_sigma
    from imu_rig.report.numbers import fixed

    whole, part = strides.distance, float("nan")
    if whole > 0.0:
        part = strides.distance_sigma * found.distance / whole
    error = found.distance - found.true_distance
    share = error / found.true_distance if found.true_distance > 0.0 else float("inf")
    pull = error / part if part > 0.0 else float("nan")
    told = f"{fixed(100.0 * share, 2, sign=True)} %"
    if math.isfinite(pull):
        told += f", {fixed(pull, 1, sign=True)} of its standard uncertainties"
    text = (
        f"{told_with_sigma(found.distance, part)} m where {other} {fixed(found.true_distance, 2)} "
        f"m: {told}"
    )
    if abs(share) <= OUTSIDE_SHARE and not abs(pull) > OUTSIDE_SIGMA:
        return text, ()
    return text, (f"{CONTRADICTS}: {text}",)


def aligned(track: FootTrack, reference: Reference, options: ReferenceOptions) -> Alignment:
    """Lay a track on a reference, by yaw and shift.

    Raises
    ------
    DataError
        As `imu_rig.reference.alignment.align`.
    """
    from imu_rig.errors import DataError
    from imu_rig.reference.alignment import align

    path = track.trajectory
    try:
        return align(
            path.t,
            path.position,
            reference,
            mirrored=options.mirrored,
            z_down=options.z_down,
            search_offset_s=options.search_s,
        )
    except DataError as error:
        if "time offset" not in str(error) or options.search_s:
            raise
        raise DataError(f"{str(error).rstrip('.')} with --search-offset SECONDS") from error


def horizontal_words(found: Alignment) -> str:
    """Tell the errors on the plan; a few places far beyond all others are the reference's own."""
    import numpy as np

    from imu_rig.report.numbers import fixed

    size = np.linalg.norm(found.errors[:, :2], axis=1)
    most, nearly = float(size.max()), float(np.percentile(size, 99.0))
    text = f"{fixed(found.rmse_horizontal, 3)} m RMSE, {fixed(most, 3)} m at most"
    if most <= SLIP * nearly:
        return text
    when = found.t[int(np.argmax(size))] + found.time_offset
    return (
        f"{text} at {fixed(float(when), 1)} s, where the optics seem to slip: {fixed(nearly, 3)} m "
        "in 99 % of the places"
    )


def misplaced(
    track: FootTrack,
    reference: Reference,
    options: ReferenceOptions,
    found: Alignment,
    compared: StrideComparison | None,
) -> str | None:
    """Say where track and reference are hardly of one walk, or of one clock; None where they are.

    Parameters
    ----------
    track, reference, options
        As of `imu_rig.cli.analyze_reference.beside_reference`.
    found : Alignment
        Of the two.
    compared : StrideComparison or None
        Strides of both, where there are some.
    """
    import numpy as np

    from imu_rig.errors import DataError
    from imu_rig.report.numbers import fixed

    if found.hands.suspect:
        return None  # told as that
    spread = found.reference - found.reference.mean(axis=0)
    left = found.rmse_horizontal / float(np.sqrt(np.mean(np.sum(spread[:, :2] ** 2, axis=1))))
    far = compared is not None and abs(compared.distance_percent) > 100.0 * ANOTHER_WALK
    if left <= ANOTHER_CLOCK and not far:
        return None
    apart = f"after the best turn and shift they are {fixed(found.rmse_horizontal, 2)} m apart"
    if not options.search_s:
        with contextlib.suppress(DataError):
            later = aligned(track, reference, replace(options, search_s=SEARCHED_S))
            if later.rmse_horizontal < MUCH_BETTER * found.rmse_horizontal:
                return (
                    f"The reference seems to be on another clock: {apart}, and "
                    f"{fixed(later.rmse_horizontal, 2)} m if its times are "
                    f"{fixed(later.time_offset, 2, sign=True)} s off "
                    f"(--search-offset {SEARCHED_S:.0f})"
                )
    if left <= ANOTHER_WALK and not far:
        return None
    return f"Does the reference belong to this recording? {apart[:1].upper()}{apart[1:]}"


def about_signs(hands: Handedness) -> list[str]:
    """Return what signs the reference seems to have, with the options that turn them."""
    if hands.sentence is None:
        return []
    options = {
        (True, True): "--reference-z-down",
        (True, False): "--mirrored",
        (False, True): "--mirrored --reference-z-down",
    }[hands.suspect, hands.z_suspect]
    return [f"{hands.sentence.rstrip('.')} ({options})"]
