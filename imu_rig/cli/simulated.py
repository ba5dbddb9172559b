"""Simulated hardware for a session in the same process: ports, clock, truth and planned faults."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from imu_rig.clock import Clock, ScaledClock, SystemClock
from imu_rig.errors import InputError
from imu_rig.session.progress import Progress

if TYPE_CHECKING:
    from imu_rig.devices.jig import JigConfig
    from imu_rig.report.facts import Truth
    from imu_rig.session.run import SessionSetup
    from simulators.models import JigModel, ServoModel
    from simulators.rig import SimulatedRig

MAX_SPEED = 20.0
BURST_S = 0.005
"""Longest burst at life's speed: more often than so, times the speed, nobody looks at the ports."""
FAULT = re.compile(
    r"(?P<device>\w+):(?P<word>\w+)@(?P<pose>\d+)(:(?P<when>move|hold)(:(?P<s>[\d.]+))?)?"
)


class SimulatedSession:
    """A session pointed at a simulated rig that is being served, with hands to turn its sensor.

    Attributes
    ----------
    clock : Clock
    setup : SessionSetup
        With the rig's ports.
    rig : SimulatedRig
    """

    def __init__(self, clock: Clock, setup: SessionSetup, rig: SimulatedRig) -> None:
        self.clock, self.setup, self.rig = clock, setup, rig
        self._held_ns: dict[int, tuple[int, int]] = {}

    def observe(self, progress: Progress) -> None:
        """Remember when each pose was held: the calibration is of those times.

        Checks are kept out of it.
        """
        if progress.state == "holding" and progress.kind != "check":
            now = self.clock.now_ns()
            begin, _ = self._held_ns.get(progress.step, (now, now))
            self._held_ns[progress.step] = (begin, now)

    def ask(self, request: str, turn: tuple[float, float, float]) -> bool:
        """Turn the simulated sensor over."""
        del request
        self.rig.remount(turn)
        return True

    def mount_for(self, stopped: Path) -> None:
        """Let the sensor sit as the next stop of a stopped session asks."""
        from imu_rig.recording.reader import open_trial
        from imu_rig.session.history import read_session

        record = read_session(open_trial(stopped))
        mounting = record.protocol.mounting_of_steps[record.next_step]
        self.rig.remount(record.protocol.mounting_turns[mounting])

    def ready(self) -> bool:
        """At once."""
        return True

    def truth(self) -> Truth:
        """Return what the sensor was, its walking offsets averaged over the poses."""
        import numpy as np

        from imu_rig.calibration.model import Affine
        from imu_rig.report.facts import JigTruth, Truth
        from imu_rig.units import DEG
        from simulators.straight_line import line_over_gravity

        exact = np.zeros((12, 12))
        now = self.clock.now_ns()
        held = [self.rig.truth_between(*times) for times in self._held_ns.values() or [(now, now)]]
        true = replace(
            held[0],
            accel=replace(held[0].accel, b=np.mean([pose.accel.b for pose in held], axis=0)),
            gyro=replace(held[0].gyro, b=np.mean([pose.gyro.b for pose in held], axis=0)),
        )
        sensor, jig = self.rig.world.imu.sensor.model, true.jig
        line = line_over_gravity(
            true.accel, sensor.accel_quadratic, sensor.accel_cubic, true.gravity
        )
        return Truth(
            accel=Affine(line.K, line.b, exact),
            gyro=Affine(true.gyro.K, true.gyro.b, exact),
            accel_at_zero=Affine(true.accel.K, true.accel.b, exact),
            quadratic=sensor.accel_quadratic,
            cubic=sensor.accel_cubic,
            jig=JigTruth(jig.tilt_skew_deg * DEG, jig.roll_skew_deg * DEG),
        )


@contextmanager
def simulated_session(
    setup: SessionSetup, *, seed: int, speed: float, worn: str | None = None
) -> Iterator[SimulatedSession]:
    """Serve a simulated rig and point a session at it.

    Parameters
    ----------
    setup : SessionSetup
    seed : int
    speed : float
    worn : str, optional
        The sensor is that which a simulated walk of the same seed carries under this name.

    Raises
    ------
    InputError
        If the speed is not one that this machine's scheduler can hold, or if no simulated sensor
        speaks the session's protocol.
    """
    from simulators.rig import RigConfig, SimulatedRig

    if not 0 < speed <= MAX_SPEED:
        raise InputError(f"--speed must be above 0 and at most {MAX_SPEED:g}, not {speed:g}.")
    if seed < 0:
        raise InputError(f"--seed must not be negative, and is {seed}.")
    clock: Clock = SystemClock() if speed == 1 else ScaledClock(speed)
    transport: Literal["pty", "tcp"] = "tcp" if sys.platform == "win32" else "pty"
    try:
        config = RigConfig.speaking(setup.layout, seed, setup.stream)
    except ValueError as error:
        raise InputError(f"--simulate: {error}") from error
    if worn is not None:
        from simulators.walker.device import worn_sensor

        sensor = worn_sensor(worn, config.imu, seed)
        config = config.model_copy(update={"sensor": sensor})
    shortest, longest = config.firmware.burst_s
    bursts = {"burst_s": (shortest, max(longest, BURST_S * speed))}
    config = config.model_copy(
        update={
            "jig": _wired_as(config.jig, setup.jig),
            "firmware": config.firmware.model_copy(update=bursts),
        }
    )
    with SimulatedRig(config, clock=clock, transport=transport) as rig:
        simulated = replace(setup, imu_url=rig.imu_url, maestro_url=rig.maestro_url)
        yield SimulatedSession(clock, simulated, rig)


def _wired_as(simulated: JigModel, jig: JigConfig) -> JigModel:
    """Give a simulated jig, with its errors, the channels and pulses of a jig file."""
    axes: dict[str, ServoModel] = {
        name: getattr(simulated, name).model_copy(
            update={
                "channel": axis.channel,
                "angle_deg": axis.angle_deg,
                "pulse_us": axis.pulse_us,
            }
        )
        for name, axis in jig.axes.items()
    }
    return simulated.model_copy(update=axes)


def together(*observers: Callable[[Progress], None]) -> Callable[[Progress], None]:
    """Join observers of progress into one."""

    def observe(progress: Progress) -> None:
        for each in observers:
            each(progress)

    return observe


class FaultPlan:
    """Injects faults when a session reaches the stop they were planned for."""

    def __init__(self, specifications: Sequence[str], rig: SimulatedRig, *, steps: int) -> None:
        from simulators.faults import check_fault

        self._rig = rig
        self._waiting: list[tuple[int, str, str, str, float | None]] = []
        for text in specifications:
            match = FAULT.fullmatch(text)
            if match is None or not 1 <= int(match["pose"]) <= steps:
                raise InputError(
                    f"--fault {text}: write DEVICE:WORD@POSE[:move|hold[:SECONDS]] with a pose "
                    f"from 1 to {steps}, for example imu:unplug@5:move:2."
                )
            seconds = float(match["s"]) if match["s"] else None
            try:
                check_fault(match["device"], match["word"], seconds)
            except ValueError as error:
                raise InputError(f"--fault {text}: {error}") from error
            when = {"move": "moving", "hold": "holding"}[match["when"] or "move"]
            self._waiting.append(
                (int(match["pose"]), when, match["device"], match["word"], seconds)
            )

    def __call__(self, progress: Progress) -> None:
        """Look whether the moment of a fault has come."""
        for planned in list(self._waiting):
            pose, when, device, word, seconds = planned
            if progress.step == pose and progress.state == when:
                self._waiting.remove(planned)
                self._rig.fault(device, word, duration_s=seconds)
