"""Hold the sensor of a check session, or of any session, against its certificate."""

from __future__ import annotations

from imu_rig.calibration.certificate import Certificate
from imu_rig.calibration.gravity import Gravity
from imu_rig.calibration.recheck import Recheck, recheck
from imu_rig.calibration.result import DeviceInfo
from imu_rig.calibration.verification import Limits
from imu_rig.errors import DataError
from imu_rig.recording.reader import Trial
from imu_rig.session.history import IMU_SOURCE, SessionRecord
from imu_rig.session.solve import holds, limits_of


def recheck_session(
    trial: Trial,
    session: SessionRecord,
    certificate: Certificate,
    *,
    limits: Limits | None = None,
    gravity: Gravity | None = None,
) -> Recheck:
    """Judge the held poses of a session, all of them, against a certificate.

    Raises
    ------
    DataError
        If the session holds no finished pose.
    """
    block = trial.imu_in_time(IMU_SOURCE)
    visits, windows = holds(session, block.t)
    held = [i for i, visit in enumerate(visits) if visit.kind != "rotation"]
    if not held:
        raise DataError(f"{trial.path} holds no finished pose; check the sensor anew.")
    return recheck(
        certificate,
        block,
        windows[held],
        tuple(f"{visits[i].index + 1}: {visits[i].name}" for i in held),
        limits=limits or limits_of(session.protocol.limits),
        gravity=gravity,
        mounting=tuple(visits[i].mounting for i in held),
    )


def device_of(session: SessionRecord) -> DeviceInfo:
    """Return the sensor that a session was run with."""
    return DeviceInfo(session.device, session.serial, session.layout.name)
