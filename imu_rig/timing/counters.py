"""Counters of few bits that wrap, continued as 64-bit integers."""

import numpy as np
import numpy.typing as npt

from imu_rig.arrays import AnyArray, FloatArray, IntArray

MAX_BACKWARD = 32
"""Counts that a packet may stand behind its predecessor and still count as reordered, at most;
a quarter of the modulus where that is less. Larger steps back are steps forward with a loss."""


def differences(values: AnyArray, before: AnyArray | float) -> AnyArray:
    """Return the step to each value from the one before it, the first from ``before``.

    What ``np.diff(values, prepend=before)`` returns, several times as fast for short arrays.
    A device may send any number: the step from an infinity to itself is NaN.
    """
    steps = np.empty_like(values)
    if len(steps):
        with np.errstate(over="ignore", invalid="ignore"):
            steps[0] = values[0] - before
            np.subtract(values[1:], values[:-1], out=steps[1:])
    return steps


def backward_limit(modulus: int) -> int:
    """Return how far back a step may go to be read as reordering."""
    return min(MAX_BACKWARD, modulus // 4)


def wrapped_steps(values: AnyArray, previous: int, modulus: int, backward: int) -> IntArray:
    """Return the steps between counter values, each in ``[-backward, modulus - backward)``.

    Parameters
    ----------
    values : shape (n,)
        Raw counter values, each in ``[0, modulus)``.
    previous : int
        The raw value before the first.
    modulus : int
        Where the counter wraps, e.g. 256.
    backward : int
        Largest step back.

    Returns
    -------
    shape (n,)
    """
    steps: IntArray = differences(np.asarray(values).astype(np.int64), previous)
    steps += backward
    remainder(steps, modulus)
    steps -= backward
    return steps


def remainder(counts: IntArray, modulus: int) -> None:
    """Reduce counts to ``[0, modulus)`` in place; counters have powers of two, which is quick."""
    if modulus & (modulus - 1):
        counts %= modulus
    else:
        counts &= modulus - 1


def unwrap(values: npt.ArrayLike, modulus: int) -> IntArray:
    """Continue a wrapping counter; small steps back (reordered packets) stay steps back.

    Parameters
    ----------
    values : shape (n,)
        Raw counter values in order of arrival, each in ``[0, modulus)``.
    modulus : int
        Where the counter wraps.

    Returns
    -------
    shape (n,)
        The counter without wraps; the first value is unchanged.
    """
    return Unwrapper(modulus).feed(np.asarray(values))


class Unwrapper:
    """The same for values that come in pieces.

    Parameters
    ----------
    modulus : int
        Where the counter wraps, above 1.
    """

    def __init__(self, modulus: int) -> None:
        if modulus < 2:
            raise ValueError(f"a counter's modulus must be above 1, not {modulus}")
        self.modulus = modulus
        self._raw: int | None = None
        self._last: int | None = None

    @property
    def last(self) -> int | None:
        """The last unwrapped value; None before the first."""
        return self._last

    def feed(self, values: AnyArray, expected: FloatArray | None = None) -> IntArray:
        """Unwrap the next values.

        Parameters
        ----------
        values : shape (n,)
            Raw values, each in ``[0, modulus)``.
        expected : shape (n,), optional
            Steps that another clock expects to each value from the one before it (the first
            from the last value of the previous call): whole turns of the counter that went
            unseen are added where they bring the step closer. NaN expects nothing.

        Returns
        -------
        shape (n,)
        """
        if len(values) == 0:
            return np.empty(0, np.int64)
        raw = int(values[0]) if self._raw is None else self._raw
        steps = wrapped_steps(values, raw, self.modulus, backward_limit(self.modulus))
        if expected is not None:
            turns = np.rint((expected - steps) / self.modulus)
            steps = steps + self.modulus * np.fmax(turns, 0).astype(np.int64)
        if self._last is None:
            steps[0] = raw
        elif self._raw is None:
            steps[0] = 1
        unwrapped: IntArray = (self._last or 0) + np.cumsum(steps)
        self._raw, self._last = int(values[-1]), int(unwrapped[-1])
        return unwrapped

    def restart(self) -> None:
        """Take the next value, whatever it is, as the one after the last."""
        self._raw = None
