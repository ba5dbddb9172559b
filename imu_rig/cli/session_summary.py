"""A session in a trial file as the few figures that its report shows."""

from __future__ import annotations

import numpy as np

from imu_rig.recording.reader import Trial
from imu_rig.report.facts import SessionSummary
from imu_rig.session.history import IMU_SOURCE, read_session


def session_summary(trial: Trial) -> SessionSummary:
    """Summarize the session in ``trial``.

    Raises
    ------
    InputError
        If the trial holds no session that makes sense.
    """
    session = read_session(trial)
    t, stats = trial.imu(IMU_SOURCE).t, trial.stream_statistics(IMU_SOURCE)
    return SessionSummary(
        protocol=session.protocol.name,
        protocol_title=session.protocol.title,
        jig=session.jig.name,
        planned=len(session.protocol.steps),
        finished=len(session.finished),
        duration_s=trial.duration_s,
        recoveries=session.recoveries,
        notices=session.notices,
        good=stats.good,
        lost=stats.lost,
        corrupt=stats.corrupt,
        rate_hz=float(1.0 / np.median(np.diff(t))) if len(t) > 2 else None,
    )
