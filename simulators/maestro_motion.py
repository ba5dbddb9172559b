"""One channel of a Maestro: from targets to pulse widths, tick by tick, in whole numbers.

The board updates its channels every 10 ms. Positions here are in eighths of a quarter
microsecond, so that an acceleration of 1 (0.25 us per 10 ms per 80 ms) is 1 per tick and tick.
"""

from __future__ import annotations

import math

TICK_S = 0.01
"""Time between two updates of the positions [s]."""

EIGHTHS = 8


class Channel:
    """Position, target and limits of one servo channel.

    Attributes
    ----------
    speed : int
        Limit in quarter microseconds per tick; 0 is none.
    acceleration : int
        Limit in eighths per tick and tick; 0 is none.
    """

    __slots__ = ("_position", "_target", "_velocity", "acceleration", "on", "speed")

    def __init__(self) -> None:
        self.speed = 0
        self.acceleration = 0
        self.on = False
        self._position = 0
        self._target = 0
        self._velocity = 0

    @property
    def position(self) -> int:
        """Pulse width sent now [quarter-us]; 0 for none."""
        return (self._position + EIGHTHS // 2) // EIGHTHS if self.on else 0

    @property
    def moving(self) -> bool:
        """Whether a limit keeps the position from its target, or it has too much speed there."""
        return self.on and (self._position != self._target or self._velocity != 0)

    def release(self) -> None:
        """Stop the pulses; the board no longer knows where the servo is."""
        self.on = False
        self._velocity = 0

    def aim(self, target: int) -> None:
        """Take a new target [quarter-us]; the first one after a release is reached at once."""
        self._target = target * EIGHTHS
        if not self.on or (self.speed == 0 and self.acceleration == 0):
            self.on = True
            self._position = self._target
            self._velocity = 0

    def tick(self) -> None:
        """Move for 10 ms."""
        if not self.moving:
            return
        distance = self._target - self._position
        limit = self.speed * EIGHTHS
        acceleration = self.acceleration
        if acceleration == 0:
            step = min(abs(distance), limit) if limit else abs(distance)
            self._position += step if distance > 0 else -step
            self._velocity = 0
            return
        sign = 1 if (distance or self._velocity) > 0 else -1
        distance = abs(distance)
        before = self._velocity * sign
        velocity = before + acceleration
        if limit:
            velocity = min(velocity, limit)
        if velocity > 0:
            velocity = min(velocity, fastest_stop(distance, acceleration))
        # A target set too close to stop at is passed and come back to.
        velocity = max(velocity, before - acceleration)
        self._position += velocity * sign
        landed = velocity == distance <= acceleration
        self._velocity = 0 if landed else velocity * sign


def fastest_stop(distance: int, acceleration: int) -> int:
    """Return the greatest v with ``v + (v - a) + (v - 2a) + ... <= distance``, terms above 0.

    With k terms of braking after v the sum is ``(k + 1) v - a k (k + 1) / 2``, for
    ``k a < v <= (k + 1) a``; k is the greatest with ``a k (k + 1) / 2 <= distance``.
    """
    k = (math.isqrt(8 * (distance // acceleration) + 1) - 1) // 2
    return (distance + acceleration * k * (k + 1) // 2) // (k + 1)
