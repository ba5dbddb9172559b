"""What is told of a foot while it walks."""

from __future__ import annotations

from dataclasses import dataclass

from imu_rig.arrays import FloatArray


@dataclass(frozen=True)
class LiveStride:
    """One stride, from one stance of the foot to its next.

    Attributes
    ----------
    begin_s, end_s : float
        The quietest moments of the two stances, time of the sensor [s].
    told_s : float
        When it was known [s].
    length : float
        Between the two on the plan [m].
    height : float
        By which the second is higher [m].
    turn : float
        Of the foot about the vertical, counterclockwise from above [rad].
    length_sigma : float
        Standard uncertainty of the length [m]: larger with gaps, readings that were cut off, and
        sensors that nobody calibrated.
    """

    begin_s: float
    end_s: float
    told_s: float
    length: float
    height: float
    turn: float
    length_sigma: float

    @property
    def duration(self) -> float:
        """From stance to stance [s]."""
        return self.end_s - self.begin_s


@dataclass(frozen=True, eq=False)
class LiveState:
    """The latest of a foot, by the forward filter.

    Attributes
    ----------
    t : float
        [s]
    quaternion : shape (4,)
        Sensor to navigation axes; the heading at the begin is arbitrary.
    velocity, position : shape (3,)
        [m/s, m]
    stands : bool
        Whether the foot stands.
    """

    t: float
    quaternion: FloatArray
    velocity: FloatArray
    position: FloatArray
    stands: bool
