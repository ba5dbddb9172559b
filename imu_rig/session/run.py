"""A whole session: open the devices and the trial file, run the engine, close everything."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from firmware_protocols.protocol import DeviceProtocol
from imu_rig.clock import Clock
from imu_rig.devices.imu import ImuDevice
from imu_rig.devices.jig import Jig, JigConfig
from imu_rig.devices.maestro import MaestroClient
from imu_rig.errors import ImuRigError, InputError, SessionInterrupted
from imu_rig.recording.reader import open_trial
from imu_rig.recording.writer import TrialWriter
from imu_rig.session.engine import SessionEngine
from imu_rig.session.history import IMU_SOURCE, MAESTRO_SOURCE, read_session, session_config
from imu_rig.session.plan import SessionPlan, plan_session
from imu_rig.session.progress import Hands, Progress, SessionOutcome, ignore
from imu_rig.session.protocol import JigProtocol
from imu_rig.stopping import StopRequest


@dataclass(frozen=True)
class SessionSetup:
    """Everything a session needs to know before it touches hardware.

    ``layout`` is what the sensor sends, ``protocol`` where it is taken; ``maestro_device`` is the
    controller's Pololu device number where several share a line, ``crc`` whether it expects a
    check byte behind every command. ``stream`` is the sensor on the jig where one port has several.
    """

    imu_url: str
    maestro_url: str
    layout: DeviceProtocol
    jig: JigConfig
    protocol: JigProtocol
    device: str = "imu"
    serial: str = ""
    note: str = ""
    baud: int = 115200
    maestro_device: int | None = None
    crc: bool = False
    stream: str | None = None

    def plan(self) -> SessionPlan:
        """Dry-run the protocol on the jig."""
        return plan_session(self.protocol, self.jig)


def resumed_setup(path: Path, setup: SessionSetup) -> SessionSetup:
    """Return the setup with which the stopped session in ``path`` goes on.

    Protocol, jig and layout are those it began with, because its finished poses were
    measured by them; only the ports are taken from ``setup``.

    Raises
    ------
    InputError
        If the file holds no session or a finished one.
    """
    record = read_session(open_trial(path))
    if record.next_step == len(record.protocol.steps):
        raise InputError(f"The session in {path} is complete; solve it with: imu-rig solve {path}")
    return SessionSetup(
        imu_url=setup.imu_url,
        maestro_url=setup.maestro_url,
        layout=record.layout,
        jig=record.jig,
        protocol=record.protocol,
        device=record.device,
        serial=record.serial,
        note=setup.note,
        baud=setup.baud,
        maestro_device=setup.maestro_device,
        crc=setup.crc,
        stream=record.stream,
    )


def run_session(
    setup: SessionSetup,
    path: Path,
    clock: Clock,
    *,
    resume: bool = False,
    stop: StopRequest | None = None,
    hands: Hands | None = None,
    observe: Callable[[Progress], None] = ignore,
    notify: Callable[[str], None] = lambda sentence: None,
) -> SessionOutcome:
    """Run a session into the trial file ``path`` (new, or a stopped one with ``resume``).

    Raises
    ------
    ImuRigError
        Whatever ended the session; the trial file is closed and keeps what was measured, and the
        jig is parked where its controller answers. No file is left where no device could be
        opened.
    """
    plan = setup.plan()
    begun = read_session(open_trial(path)) if resume else None
    finished_before = begun.visits[-1] if begun is not None and begun.visits else None
    with ExitStack() as stack:
        if resume:
            trial = TrialWriter.append(path, clock=clock)
        else:
            trial = TrialWriter.create(
                path,
                session_config(setup.protocol, setup.jig, setup.device, setup.serial, setup.note),
                clock=clock,
            )
        reason = "failed"
        engine: SessionEngine | None = None
        stack.callback(lambda: _close(trial, reason, keep=resume or engine is not None))
        try:
            described = {"layout": setup.layout.to_dict(), "url": setup.imu_url}
            if setup.stream is not None:
                described["stream"] = setup.stream
            imu_source = trial.add_source(IMU_SOURCE, "imu", described)
            maestro_source = trial.add_source(MAESTRO_SOURCE, "servo", {"url": setup.maestro_url})
            # the controller first: its errors concern safety
            maestro = MaestroClient(
                setup.maestro_url,
                clock,
                device=setup.maestro_device,
                crc=setup.crc,
                tap=lambda t_ns, direction, data: (
                    trial.bytes_out(maestro_source, t_ns, data)
                    if direction == "out"
                    else trial.bytes_in(maestro_source, t_ns, data)
                ),
            )
            maestro.open()
            stack.callback(maestro.close)
            jig = Jig(setup.jig, maestro, clock)
            imu = ImuDevice(
                setup.device,
                setup.imu_url,
                setup.layout,
                clock,
                tap=lambda t_ns, data: trial.bytes_in(imu_source, t_ns, data),
                sent=lambda t_ns, data: trial.bytes_out(imu_source, t_ns, data),
                stream=setup.stream,
                baud=setup.baud,
            )
            imu.start()
            stack.callback(imu.stop)
            jig.start()
            engine = SessionEngine(
                plan,
                jig,
                imu,
                trial,
                clock,
                observe=observe,
                notify=notify,
                stop=stop,
                first_step=0 if begun is None else begun.next_step,
                before=finished_before,
                hands=hands,
            )
            outcome = engine.run()
            reason = "complete"
        except SessionInterrupted:
            reason = "interrupted"
            raise
        except ImuRigError as error:
            reason = f"stopped: {error}"
            raise
    return outcome


def _close(trial: TrialWriter, reason: str, *, keep: bool) -> None:
    """Close the trial file; one in which nothing was begun is removed, as if never asked for."""
    trial.close(reason)
    if not keep:
        trial.path.unlink(missing_ok=True)
