"""The methods that find a foot's trajectory, behind one function."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from imu_rig.errors import DataError, InputError

if TYPE_CHECKING:
    from imu_rig.blocks import ImuBlock
    from imu_rig.calibration.certificate import Certificate
    from imu_rig.gait.options import FootOptions
    from imu_rig.gait.trajectory import FootTrack
    from imu_rig.gait.two_filter import StepSmoothing

METHODS = ("default", "paper")
LEVELS = ("auto", "always", "never")
ADAPTIVE = "adaptive"
PAPERS_DETECTOR = "paper"
LONGEST_S = 6.0
"""No foot is off the ground for longer in a stride [s]; the slowest walkers take 3 s for all of it,
and over 6 s even a good sensor's place is lost by metres."""


@dataclass(frozen=True)
class Way:
    """How a trajectory is found.

    Attributes
    ----------
    method : str
        ``"default"``: our smoother. ``"paper"``: a forward and a backward filter, step by step.
    detector : str or None
        Of zero velocity, by name; None: the method's own.
    level : str
        See `imu_rig.gait.options.FootOptions`.
    gravity : float
        [m/s^2]
    """

    method: str = "default"
    detector: str | None = None
    level: str = "auto"
    gravity: float = 9.80665

    def check(self) -> None:
        """Refuse names that are none, before anything is read.

        Raises
        ------
        InputError
        """
        from imu_rig.gait.detectors import DETECTORS

        if self.method not in METHODS:
            raise InputError(f"--method is one of {', '.join(METHODS)}, not {self.method!r}.")
        if self.level not in LEVELS:
            raise InputError(f"--level is one of {', '.join(LEVELS)}, not {self.level!r}.")
        if self.detector is not None and self.detector not in (ADAPTIVE, *DETECTORS):
            names = ", ".join((ADAPTIVE, *DETECTORS))
            raise InputError(f"--detector is one of {names}, not {self.detector!r}.")

    @property
    def name(self) -> str:
        """The detector's name: the one given, or the method's own."""
        return self.detector or (PAPERS_DETECTOR if self.method == "paper" else ADAPTIVE)

    @property
    def motion_unit(self) -> str:
        """The unit of what the detector compares; empty where it is a number of its own."""
        return "m/s" if self.name == ADAPTIVE else ""

    @property
    def options(self) -> FootOptions:
        """The options of our smoother."""
        from imu_rig.gait.options import FootOptions

        level: Literal["auto", "always", "never"] = "auto"
        if self.level == "always":
            level = "always"
        elif self.level == "never":
            level = "never"
        return FootOptions(gravity=self.gravity, level=level)

    @property
    def words(self) -> str:
        """The method and its detector, for people."""
        if self.method == "paper":
            return f"forward and backward filter, step by step; detector {self.name}"
        return f"smoother over the whole recording; detector {self.name}"


@dataclass(frozen=True, eq=False)
class Found:
    """A track, the samples that it is of, and what the paper's two filters say where asked."""

    track: FootTrack
    block: ImuBlock
    steps: StepSmoothing | None = None


def find_track(block: ImuBlock, way: Way, certificate: Certificate | None = None) -> Found:
    """Find the track of a foot.

    Raises
    ------
    DataError
        If the recording cannot be one of a foot that walks.
    """
    name = way.name
    if name == ADAPTIVE:
        return _followed(block, way, certificate)
    try:
        found = _followed(block, way, certificate)
    except DataError as error:
        raise DataError(
            f"{str(error).rstrip('.')}; or detector {name}, whose threshold is fixed, finds other "
            f"stances than this foot's: try --detector {ADAPTIVE}"
        ) from error
    _require_stances(found.track, name)
    return found


def _followed(block: ImuBlock, way: Way, certificate: Certificate | None) -> Found:
    from imu_rig.calibration.foot_grade import grade_of
    from imu_rig.gait.smoother import smooth_foot

    if way.method == "paper":
        return _by_two_filters(block, way)
    own = way.name == ADAPTIVE
    track = smooth_foot(
        block,
        way.options,
        grade=grade_of(certificate),
        covariance=True,
        detector=None if own else way.name,
    )
    return Found(track, block)


def _require_stances(track: FootTrack, name: str) -> None:
    """Refuse a track that nothing held for longer than any stride lasts."""
    import numpy as np

    t = track.trajectory.t
    stands = t[track.zero_velocity.still]
    longest = np.diff(stands)
    worst = int(np.argmax(longest)) if len(longest) else 0
    if len(longest) and longest[worst] <= LONGEST_S:
        return
    told = (
        f"for {longest[worst]:.1f} s from {stands[worst] - t[0]:.1f} s on"
        if len(longest)
        else "at all"
    )
    raise DataError(
        f"detector {name} finds no stance {told}, as its threshold is fixed: nobody could tell "
        f"where the foot went; take --detector {ADAPTIVE}"
    )


def without_bias(block: ImuBlock) -> tuple[ImuBlock, tuple[float, float, float]]:
    """Take off the gyroscope's bias that the stills of a recording show [rad/s]."""
    from imu_rig.gait.stills import find_stills, rough_gyro_bias

    bias = rough_gyro_bias(find_stills(block.t, block.accel, block.gyro))
    x, y, z = bias.tolist()
    return replace(block, gyro=block.gyro - bias), (x, y, z)


def _by_two_filters(block: ImuBlock, way: Way) -> Found:
    import numpy as np

    from imu_rig.gait.adaptive import detect_stance
    from imu_rig.gait.detectors import detector_named
    from imu_rig.gait.fitness import check_recording, check_track
    from imu_rig.gait.footfalls import find_footfalls
    from imu_rig.gait.mounting import find_foot_axes, first_heading
    from imu_rig.gait.trajectory import FootTrack
    from imu_rig.gait.two_filter import TwoFilterOptions, smooth_steps
    from imu_rig.gait.zero_velocity import ZeroVelocity

    raw, told = block, check_recording(block, gravity=way.gravity)
    block, bias = without_bias(raw)
    name = way.name
    zero = (
        detect_stance(block.t, block.accel, block.gyro, way.options.stance, way.gravity)
        if name == ADAPTIVE
        else detector_named(name).detect(block)
    )
    options = TwoFilterOptions(
        gravity=way.gravity, height_sigma=None if way.level == "never" else 0.01
    )
    steps = smooth_steps(block, zero, options)
    rows = slice(int(steps.boundaries[0]), int(steps.boundaries[-1]) + 1)
    inside = ZeroVelocity(
        zero.still[rows], zero.sigma[rows], zero.statistic[rows], zero.threshold[rows]
    )
    trajectory = steps.smoothed.trajectory
    falls = find_footfalls(inside, trajectory.t)
    heading = first_heading(trajectory, falls, find_foot_axes(trajectory, falls))
    steps = steps.turned(-heading)
    turned = steps.smoothed.trajectory
    notes = [
        "The published two-filter method was used: it estimates no sensor errors, and its "
        "covariance knows of white noise only, so no uncertainty is given.",
        *told,
    ]
    if rows.start > 0 or rows.stop < len(block):
        notes.append(
            f"It begins and ends with a standing foot: {rows.start} samples before and "
            f"{len(block) - rows.stop} after are left out."
        )
    track = FootTrack(
        turned.moved(-turned.position[0]),
        inside,
        falls,
        gyro_bias=np.array(bias),
        accel_bias=np.zeros(3),
        pivot=np.zeros(3),
        notes=tuple(notes),
    )
    doubts = check_track(track, raw[rows], gravity=way.gravity)
    return Found(replace(track, notes=(*notes, *doubts)), block[rows], steps)
