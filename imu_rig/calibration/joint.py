"""Calibration on a jig that is not trusted: sensor and jig solved together.

Gravity's magnitude and the gyroscope's turns determine the sensor; the commanded angles, with
their own errors estimated beside it, determine how the sensor sits on the jig.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imu_rig.arrays import BoolArray, FloatArray
from imu_rig.calibration.direction import (
    angles_off,
    angles_turned,
    errors_before,
    gravity_directions,
)
from imu_rig.calibration.findings import Finding
from imu_rig.calibration.gyro_bias import track_bias
from imu_rig.calibration.joint_data import joint_data
from imu_rig.calibration.joint_faults import check_labels, remounted, repair
from imu_rig.calibration.joint_fit import JointFit, fit_joint, start, unit
from imu_rig.calibration.joint_model import G_SENSITIVITY, attitudes, offsets
from imu_rig.calibration.joint_result import (
    gain_at_zero,
    gyro_model,
    jig_estimate,
    leave_poses_out,
    line_over_one_g,
    straightness,
    without_move,
)
from imu_rig.calibration.joint_tests import (
    drift_findings,
    g_sensitivity_finding,
    g_sensitivity_shows,
    nonlinearity_findings,
    with_g_sensitivity,
)
from imu_rig.calibration.magnitude import UNKNOWNS, MagnitudeFit
from imu_rig.calibration.model import Affine, physical_figures
from imu_rig.calibration.moves import Moves, moves_between
from imu_rig.calibration.multi_position import (
    refuse_wrong_gyro,
    solve_accelerometer,
    strange_scale,
    unseen_turns,
)
from imu_rig.calibration.session import AccelOutcome, CommandedPoses, GyroOutcome, Outcome, Session
from imu_rig.errors import DataError
from imu_rig.units import DEG, MILLI_G

ALIKE = 4.0
"""Scale errors that three axes share and no data sheet allows [%]."""
SET_ASIDE = 1e3
"""Factor on the noise of a still that the others contradict."""


def joint(session: Session) -> Outcome:
    """Solve a jig session for sensor and jig.

    Raises
    ------
    DataError
        No commanded angles, too few poses, or a gyroscope whose unit, rate or axes contradict
        gravity.
    """
    stills = session.stills
    if session.commanded is None:
        raise DataError(
            "method joint needs a jig's commanded angles; take multi-position for a sensor that "
            "was turned by hand"
        )
    if len(stills) < UNKNOWNS:
        raise DataError(
            f"{len(stills)} still poses cannot determine the nine parameters of an accelerometer; "
            "run the session with a longer protocol, such as full"
        )
    radial, warnings = solve_accelerometer(session)
    track = track_bias((stills.t0 + stills.t1) / 2, stills.gyro_mean, stills.gyro_sem)
    moves = moves_between(session.block, stills, track.at_stills, session.gyro_bad)
    commanded = session.commanded
    mounted = commanded.mountings
    if session.has_gyro and not np.any(mounted[moves.first] == mounted[moves.last]):
        warnings.append("The gyroscope was not calibrated: no move between two poses is usable.")
        session = replace(session, has_gyro=False)
    if session.has_gyro:
        refuse_wrong_gyro(moves.with_gravity(radial.affine.apply), track.at_stills)
    solved = _solve(session, commanded, moves, radial)
    return _outcome(session, solved, warnings)


@dataclass(frozen=True, eq=False)
class _Solved:
    """The final fit, the stills (m,) it rests on, what was found, the session as corrected."""

    fit: JointFit
    usable: BoolArray
    findings: tuple[Finding, ...]
    session: Session


def _solve(
    session: Session, commanded: CommandedPoses, moves: Moves, radial: MagnitudeFit
) -> _Solved:
    names = session.names
    findings = [_bad_still(session, radial, i) for i in np.flatnonzero(~radial.used).tolist()]
    data = joint_data(session, commanded, moves, radial.affine)
    data = replace(data, accel_sigma=data.accel_sigma * np.where(radial.used, 1.0, SET_ASIDE))
    begin = start(data, radial.affine)
    elsewhere = remounted(begin)
    if elsewhere:
        # Where the sensor really sits is what small angles count from.
        data = replace(data, mountings=data.mountings @ begin.mounting)
        begin = start(data, radial.affine)
    labels = check_labels(data, radial.affine, begin, names)
    findings += labels.findings
    usable = labels.usable
    findings += elsewhere
    names = tuple(name for name, keep in zip(names, usable, strict=True) if keep)
    data = replace(data, angles=labels.angles).only(usable)
    mended = repair(data, start(data, radial.affine), names)
    place = np.flatnonzero(usable)
    findings += [replace(f, poses=tuple(int(place[i]) for i in f.poses)) for f in mended.findings]
    prior = mended.prior
    fit = fit_joint(mended.data, prior, mended.state)
    if g_sensitivity_shows(fit):
        prior = with_g_sensitivity(prior)
        fit = fit_joint(mended.data, prior, fit.state)
        fit, session, G = _without_g_sensitivity(session, usable, fit, radial.affine)
        findings.append(g_sensitivity_finding(G))
    findings += drift_findings(fit)
    findings += nonlinearity_findings(fit)
    return _Solved(fit, usable, tuple(findings), session)


def _without_g_sensitivity(
    session: Session, usable: BoolArray, fit: JointFit, accel: Affine
) -> tuple[JointFit, Session, FloatArray]:
    """Take the estimated g-sensitivity off every sample and fit what is left of it.

    The fit itself knows the force at both ends of a move only, not on the way.
    """
    G = fit.state.common[G_SENSITIVITY].reshape(3, 3)
    block, stills = session.block, session.stills
    feigned = G.T / session.gravity.value
    block = replace(block, gyro=block.gyro - accel.apply(block.accel) @ feigned)
    stills = replace(stills, gyro_mean=stills.gyro_mean - accel.apply(stills.accel_mean) @ feigned)
    session = replace(session, block=block, stills=stills)
    kept = stills.only(usable)
    moves = moves_between(block, kept, kept.gyro_mean, session.gyro_bad)
    same = np.isin(moves.first, fit.data.moves.first)
    data = replace(fit.data, gyro=kept.gyro_mean, moves=moves.only(same))
    common = fit.state.common.copy()
    common[G_SENSITIVITY] = 0.0
    fit = fit_joint(data, fit.prior, replace(fit.state, common=common))
    return fit, session, G + fit.state.common[G_SENSITIVITY].reshape(3, 3)


def _bad_still(session: Session, radial: MagnitudeFit, i: int) -> Finding:
    times = abs(radial.left_out[i] / radial.left_out_sigma[i])
    text = (
        f"The pose {session.names[i].removeprefix('pose ')} was set aside: its gravity is off by "
        f"{radial.left_out[i] / MILLI_G:.2f} mg, {times:.0f} times what noise and "
        "parameters explain."
    )
    return Finding("bad still", text, (i,), size=float(radial.left_out[i] / MILLI_G))


def _outcome(session: Session, solved: _Solved, warnings: list[str]) -> Outcome:
    fit, m = solved.fit, len(session.stills)
    line = line_over_one_g(fit)
    left_out = leave_poses_out(fit, line)
    error, error_sigma = np.full(m, np.nan), np.full(m, np.nan)
    error[solved.usable], error_sigma[solved.usable] = left_out.error, left_out.sigma
    up = unit(line.apply(session.stills.accel_mean))
    sigma = np.sqrt(np.einsum("mi,mij,mj->m", up, session.stills.accel_cov, up))
    sigma[solved.usable] = fit.data.accel_sigma * fit.scales["accel"]
    where = np.full((m, 3, 3), np.nan)
    where[solved.usable] = attitudes(fit.data, fit.state).A
    said = [f.text for f in solved.findings]
    warnings = [*said, *(w for w in warnings if w not in said)]
    if not fit.converged:
        warnings.append("The fit of sensor and jig did not settle; do not rely on its figures.")
    gyro: GyroOutcome | None = None
    if session.has_gyro:
        gyro, more = _gyro(solved, line)
        warnings += more
    elif not np.any(np.ptp(session.block.gyro, axis=0) > 0):
        warnings.append("No gyroscope shows anything, so only the accelerometer was calibrated.")
    return Outcome(
        frame="sensor",
        accel=AccelOutcome(line, sigma, error, error_sigma),
        gyro=gyro,
        warnings=tuple(warnings),
        accel_at_zero=gain_at_zero(fit),
        straightness=straightness(fit),
        jig=replace(
            jig_estimate(fit), deviation=_deviations(session, solved), commanded=session.order
        ),
        findings=solved.findings,
        attitudes=where,
    )


def _deviations(session: Session, solved: _Solved) -> FloatArray:
    """Return by how much servos missed what they were told, slips with it (m, 3) [rad].

    Stills that were left out are not numbers. A label put right is no deviation of a servo.
    """
    deviation = np.full((len(session.stills), 3), np.nan)
    deviation[solved.usable] = solved.fit.state.deviation
    if session.commanded is not None:
        commanded = session.commanded.angles_deg[solved.usable] * DEG
        deviation[solved.usable] += solved.fit.data.angles - commanded
    relabelled = [i for f in solved.findings if f.kind == "mislabelled" for i in f.poses]
    place = np.cumsum(solved.usable) - 1
    for i in relabelled:
        deviation[i] = solved.fit.state.deviation[place[i]]
    return deviation


def _gyro(solved: _Solved, accel: Affine) -> tuple[GyroOutcome | None, list[str]]:
    """Gyroscope with errors of gravity's direction over the moves, and sentences about it.

    Each error is also that of a fit which never saw the move.
    """
    fit, session = solved.fit, solved.session
    affine = gyro_model(fit)
    undetermined = unseen_turns(affine)
    if undetermined:
        return None, [undetermined]
    place = np.flatnonzero(solved.usable)
    stills = session.stills.only(solved.usable)
    moves = fit.data.moves
    track = track_bias((stills.t0 + stills.t1) / 2, stills.gyro_mean, stills.gyro_sem)
    where = gravity_directions(stills, moves, accel, track)
    unseen = [fit.turned.moved_to(fit.data, without_move(fit, j))[j] for j in range(len(moves))]
    outcome = GyroOutcome(
        affine=affine,
        first=place[moves.first],
        last=place[moves.last],
        angle=angles_turned(moves, fit.state.K, offsets(fit.data, fit.state)),
        before=errors_before(moves, stills, track),
        after=angles_off(fit.turned.moved_to(fit.data, fit.state), where),
        held_out=angles_off(np.array(unseen).reshape(-1, 4), where),
        sigma=np.sqrt(where.variance) * fit.scales["move"],
    )
    figures = physical_figures(affine, accel)
    suspects = "its unit, range setting or the sample rate"
    warnings = strange_scale(figures, "gyroscope", suspects)
    alike = figures.scale_percent
    if not warnings and np.all(np.abs(alike) > ALIKE) and np.ptp(alike) < ALIKE:
        warnings.append(
            f"All axes of the gyroscope are {np.mean(alike):+.1f} % off alike, as if the sample "
            f"rate or the clock was: check {suspects}."
        )
    return outcome, warnings
