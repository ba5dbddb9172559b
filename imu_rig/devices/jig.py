"""The jig: three servos under one Maestro, commanded in degrees, within limits, without jerks.

A Maestro reports the pulse it sends, never where the servo is. What can be known of a jig's
health is whether its controller still does as told; that is checked here. Whether the servos
follow only the sensor can tell.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Iterable, Mapping
from typing import Literal

from firmware_protocols.maestro import MaestroErrors
from imu_rig.clock import NS_PER_S, Clock
from imu_rig.devices.jig_config import (
    AXES,
    DEFAULT_JIG_NAME,
    QUARTERS,
    AxisConfig,
    AxisName,
    JigConfig,
    load_jig,
)
from imu_rig.devices.maestro import MaestroClient
from imu_rig.errors import DeviceError, DeviceLost, LimitError, PortError

__all__ = [
    "AXES",
    "DEFAULT_JIG_NAME",
    "AxisConfig",
    "AxisName",
    "Jig",
    "JigConfig",
    "JigFault",
    "load_jig",
]

# Constants of time.
FOLLOW_S = 0.5  # without any progress after its predicted arrival: an axis is stuck
MACHINE_FOLLOW_S = 0.25  # of the machine's own time at least, for clocks that run faster

_log = logging.getLogger(__name__)


class JigFault(DeviceError):  # noqa: N818  (a state of the jig, as its siblings name theirs)
    """A controller that does not do as told any more.

    Attributes
    ----------
    kind : str
        "errors": it latched an error and released its servos; "reset": it started anew and has
        forgotten targets and limits; "stuck": an axis does not reach its target.
    axis : str or None
        The axis concerned, where it is one.
    """

    def __init__(
        self,
        message: str,
        kind: Literal["errors", "reset", "stuck"],
        axis: AxisName | None = None,
    ) -> None:
        super().__init__(message)
        self.kind = kind
        self.axis = axis


class Jig:
    """Moves the axes of one jig. Use it from one thread.

    Parameters
    ----------
    config : JigConfig
    maestro : MaestroClient
        Opened here if it is not; its limits are set from the configuration.
    clock : Clock

    Attributes
    ----------
    config : JigConfig
    start_errors : MaestroErrors
        What the controller had latched before `start`, which cleared it.
    """

    def __init__(self, config: JigConfig, maestro: MaestroClient, clock: Clock) -> None:
        self.config = config
        self.start_errors = MaestroErrors(0)
        self._maestro, self._clock = maestro, clock
        self._axes = config.axes
        self._targets: dict[AxisName, int] = {}  # commanded here [quarter-us]
        self._seen: dict[AxisName, int] = {}  # last pulse reported that was one
        self._due_ns: dict[AxisName, int] = {}  # when each axis should have arrived
        self._moved: dict[AxisName, tuple[int, int, float]] = {}  # pulse, since when on two clocks
        maestro.limits = {axis.channel: axis.limits_quarter_us for axis in self._axes.values()}

    def start(self) -> None:
        """Set the speed limits and see where the axes are. Moves nothing.

        Raises
        ------
        PortError, DeviceError
            If the controller cannot be opened or does not answer.
        """
        self._maestro.open()
        self.start_errors = self._maestro.errors()
        if self.start_errors:
            _log.warning("cleared from the Maestro: %s", self.start_errors.describe())
        self._apply_settings()
        self._positions()

    def command(self, angles: Mapping[str, float]) -> None:
        """Send axes on their way; returns at once.

        A released servo is first taken hold of where it was last seen, or at its park angle,
        which its controller does without any limit of speed; from there it moves as any other.

        Parameters
        ----------
        angles : mapping
            Axis name to angle [deg], some or all axes.

        Raises
        ------
        LimitError
            If any angle leaves its limits; then nothing was sent.
        DeviceError
            If the controller was reset, answers wrongly or is lost.
        """
        targets = self._checked(angles)
        before = self._positions()
        if any(before[axis] == 0 and axis in self._targets for axis in targets):
            self.check()
        self._take_hold(a for a in targets if before[a] == 0)
        self._move(targets, before)

    def reported(self, axes: Iterable[AxisName] = AXES) -> dict[str, float]:
        """Return the angle that each axis is commanded to just now [deg]; NaN where released.

        Under way that is the angle its ramp has reached.
        """
        return {
            axis: self._axes[axis].angle(pulse) if pulse else math.nan
            for axis, pulse in self._positions(axes).items()
        }

    def arrived(self) -> bool:
        """Return whether every axis commanded so far is reported at its target."""
        positions = self._positions()
        return all(positions[axis] == target for axis, target in self._targets.items())

    def check(self) -> None:
        """See whether the controller still does as told.

        Raises
        ------
        JigFault
            If it latched an error, was reset, or an axis is overdue at its target.
        DeviceError
            If it answers wrongly or is lost.
        """
        errors = self._maestro.errors()
        if errors:
            raise JigFault(
                f"The Maestro on {self._maestro.url} reports {errors.describe()} and has sent all "
                "servos to their home positions, by default released.",
                "errors",
            )
        positions = self._positions()
        for axis, target in self._targets.items():
            position = positions[axis]
            if position == 0:
                raise self._reset_fault(axis)
            if position != target and self._overdue(axis):
                raise self._stuck_fault(axis, position, target)

    def park(self) -> None:
        """Send the jig to its park pose; returns at once.

        Raises
        ------
        DeviceError
            If the controller takes no commands.
        """
        _log.info("parking the jig at %s", self.config.park())
        try:
            self.command(self.config.park())
        except JigFault:
            self.recover()
            self.command(self.config.park())

    def park_blind(self, axes: Iterable[AxisName] = AXES) -> None:
        """Send settings and park targets without asking anything; returns at once.

        The quickest way to park, and the only one when a controller obeys but does not answer. A
        controller that was reset would jump there: `park` takes hold of released servos first.

        Parameters
        ----------
        axes : iterable of str
            Those to park; the others stay as they are.

        Raises
        ------
        DeviceError
            If nothing can be sent.
        """
        park = self.config.park()
        targets = self._checked({axis: park[axis] for axis in axes})
        self._apply_settings()
        self._move(targets, {axis: self._seen.get(axis, t) for axis, t in targets.items()})

    def recover(self) -> None:
        """Bring a controller that was reset or unplugged back to where it was told to be.

        Its speed limits are set first. Each released servo is taken hold of at the pulse last
        reported, so that it does not jerk, and then sent to its last target at the usual speed.
        Does no harm to a controller that is well.

        Raises
        ------
        DeviceError
            If the controller is not back.
        """
        try:
            self._maestro.open()
        except PortError as error:
            raise DeviceLost(f"The Maestro is not back: {error}") from error
        errors = self._maestro.errors()
        if errors:
            _log.warning("cleared from the Maestro: %s", errors.describe())
        self._apply_settings()
        before = self._positions()
        released = [axis for axis in self._targets if before[axis] == 0]
        self._take_hold(released)
        self._move(dict(self._targets), before)
        after = self._positions()
        for axis in released:
            if after[axis] == 0:
                raise self._reset_fault(axis)

    def release(self) -> None:
        """Stop the pulses to all axes, so that the servos can be turned by hand."""
        self._maestro.set_targets({axis.channel: 0 for axis in self._axes.values()})
        self._targets.clear()
        self._due_ns.clear()

    def travel_time(self, start: Mapping[str, float], stop: Mapping[str, float]) -> float:
        """Predict how long a move takes [s]; see `JigConfig.travel_time`."""
        return self.config.travel_time(start, stop)

    # --- parts --------------------------------------------------------------------------------

    def _checked(self, angles: Mapping[str, float]) -> dict[AxisName, int]:
        """Turn angles into pulses [quarter-us], all of them checked."""
        unknown = [name for name in angles if name not in AXES]
        if unknown:
            raise LimitError(
                f"The jig has no axis {', '.join(map(str, unknown))}; its axes are pan, tilt and "
                "roll. Nothing was sent."
            )
        targets: dict[AxisName, int] = {}
        for name in AXES:
            if name not in angles:
                continue
            axis, angle = self._axes[name], float(angles[name])
            low, high = axis.limits_deg
            if not low <= angle <= high:
                raise LimitError(
                    f"{name} was to go to {angle:g} deg, outside its limits of {low:g} to "
                    f"{high:g} deg on jig '{self.config.name}'; nothing was sent."
                )
            targets[name] = axis.pulse(angle)
        return targets

    def _apply_settings(self) -> None:
        for axis in self._axes.values():
            self._maestro.set_speed(axis.channel, axis.speed_units)
            self._maestro.set_acceleration(axis.channel, axis.acceleration_units)

    def _positions(self, axes: Iterable[AxisName] = AXES) -> dict[AxisName, int]:
        """Ask for the pulse of axes [quarter-us]; 0 is none."""
        positions = {name: self._maestro.position(self._axes[name].channel) for name in axes}
        now = (self._clock.now_ns(), time.monotonic())
        for name, pulse in positions.items():
            low, high = self._axes[name].limits_quarter_us
            if low <= pulse <= high:
                self._seen[name] = pulse
            if name not in self._moved or self._moved[name][0] != pulse:
                self._moved[name] = (pulse, *now)
        return positions

    def _overdue(self, axis: AxisName) -> bool:
        """Whether an axis should have arrived and has made no progress since."""
        _, since_ns, machine_s = self._moved[axis]
        waited_ns = self._clock.now_ns() - max(self._due_ns[axis], since_ns)
        return waited_ns > FOLLOW_S * NS_PER_S and time.monotonic() - machine_s > MACHINE_FOLLOW_S

    def _take_hold(self, released: Iterable[AxisName]) -> None:
        """Send pulses to released servos where they were last seen, or else where they park."""
        park = self.config.park()
        holds = {}
        for name in released:
            axis = self._axes[name]
            holds[axis.channel] = self._seen.setdefault(name, axis.pulse(park[name]))
        if holds:
            self._maestro.set_targets(holds)

    def _move(self, targets: Mapping[AxisName, int], before: Mapping[AxisName, int]) -> None:
        """Send targets and reckon when each axis should have arrived."""
        if not targets:
            return
        self._maestro.set_targets({self._axes[a].channel: pulse for a, pulse in targets.items()})
        now = self._clock.now_ns()
        for name, pulse in targets.items():
            axis = self._axes[name]
            begin = before[name] or self._seen[name]
            seconds = axis.travel_time(axis.angle(begin), axis.angle(pulse))
            if self._targets.get(name, begin) != begin:
                # it was under way and may have to brake and turn round
                seconds += 2.0 * axis.braking_time
            self._due_ns[name] = now + int(seconds * NS_PER_S)
            self._targets[name] = pulse

    def _reset_fault(self, axis: AxisName) -> JigFault:
        return JigFault(
            f"The Maestro on {self._maestro.url} was reset (it sends no pulses to {axis}, which "
            "was commanded): look after its supply, which dips when servos start.",
            "reset",
            axis,
        )

    def _stuck_fault(self, axis: AxisName, position: int, target: int) -> JigFault:
        config = self._axes[axis]
        return JigFault(
            f"The Maestro does not bring {axis} to {config.angle(target):.1f} deg: it stays at "
            f"{config.angle(position):.1f} deg ({position / QUARTERS:g} us). Another program may "
            f"command it, or the limits of channel {config.channel} stop it (Maestro Control "
            "Center, Channel Settings).",
            "stuck",
            axis,
        )
