"""What a report is told beside the calibration: the session, and the truth of a simulation."""

from __future__ import annotations

from dataclasses import dataclass

from imu_rig.calibration.model import Affine


@dataclass(frozen=True)
class SessionSummary:
    """How the jig session went that a calibration was solved from.

    Attributes
    ----------
    protocol, protocol_title : str
        Name and title of the jig protocol.
    jig : str
        Name of the jig.
    planned, finished : int
        Stops of the protocol, and those that were reached and held.
    duration_s : float
        From the first to the last record of the session.
    recoveries : int
        How often a device was lost and came back.
    notices : tuple of str
        What the session had to say on the way, one sentence each.
    good, lost, corrupt, reconnects : int or None
        Packets decoded, missing by their counter, and damaged; how often the port came back.
    rate_hz : float or None
        Measured packet rate.
    backlash_deg : tuple of (str, float)
        Where a pose was approached from both sides: its name and the difference.
    """

    protocol: str
    jig: str
    planned: int
    finished: int
    duration_s: float
    protocol_title: str = ""
    recoveries: int = 0
    notices: tuple[str, ...] = ()
    good: int | None = None
    lost: int | None = None
    corrupt: int | None = None
    reconnects: int | None = None
    rate_hz: float | None = None
    backlash_deg: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class JigTruth:
    """What a simulated jig really is.

    Only what a choice of frame has no part in, and backlash does not look like.

    Attributes
    ----------
    tilt_skew, roll_skew : float
        [rad].
    """

    tilt_skew: float
    roll_skew: float


@dataclass(frozen=True, eq=False)
class Truth:
    """What a simulated sensor really is: the calibrations that would be exact.

    Attributes
    ----------
    accel : Affine
        Accelerometer, m/s^2: the best line over +-1 g.
    gyro : Affine or None
        Gyroscope, rad/s, in the output frame of ``accel``.
    accel_at_zero : Affine or None
        The accelerometer's slope at zero input; the same as ``accel`` for a linear one.
    quadratic, cubic : (float, float, float) or None
        Share of 1 g by which an axis errs at 1 g.
    jig : JigTruth or None
        What the simulated jig really is.
    """

    accel: Affine
    gyro: Affine | None = None
    accel_at_zero: Affine | None = None
    quadratic: tuple[float, float, float] | None = None
    cubic: tuple[float, float, float] | None = None
    jig: JigTruth | None = None
