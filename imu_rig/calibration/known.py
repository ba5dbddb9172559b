"""What somebody knows about a recording: which part is which, and how it was turned."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.errors import InputError

FACES = ("x_p", "x_a", "y_p", "y_a", "z_p", "z_a")
"""Static parts of a Ferraris session: axis along (p) or against (a) the reaction to gravity."""
TURNS = ("x_rot", "y_rot", "z_rot")
FULL_TURN = 2.0 * np.pi


@dataclass(frozen=True)
class Part:
    """A named part of a recording, from ``t0`` to ``t1`` [s] on the time of the block."""

    name: str
    t0: float
    t1: float

    def __post_init__(self) -> None:
        if self.name not in (*FACES, *TURNS):
            raise InputError(
                f"there is no part {self.name!r}; parts are {', '.join((*FACES, *TURNS))}"
            )
        if not self.t1 > self.t0:
            raise InputError(f"the part {self.name} must end after it begins")


@dataclass(frozen=True, eq=False)
class RateTable:
    """Known rates of a turntable over ``n`` segments.

    Attributes
    ----------
    t0, t1 : shape (n,)
        Begin and end of each segment of constant rate [s].
    rate : shape (n, 3)
        True rate in sensor axes [rad/s].
    """

    t0: FloatArray
    t1: FloatArray
    rate: FloatArray

    def __post_init__(self) -> None:
        if self.rate.shape != (len(self.t0), 3) or len(self.t1) != len(self.t0):
            raise InputError("a table of rates needs begin, end and a rate of three axes per row")
        if not all(np.all(np.isfinite(x)) for x in (self.t0, self.t1, self.rate)):
            raise InputError("a table of rates holds a value that is not a number")
        late = np.flatnonzero(~(self.t1 > self.t0))
        if late.size:
            raise InputError(f"row {late[0] + 1} of the rates ends before it begins")

    def __len__(self) -> int:
        """Return the number of segments."""
        return len(self.t0)


@dataclass(frozen=True, eq=False)
class Known:
    """Facts beside the recording that some methods need.

    Attributes
    ----------
    parts : tuple of Part
        Faces and turns of a Ferraris session; found by themselves where empty.
    turn_angle : float
        Angle of every such turn [rad].
    rates : RateTable or None
        Known rates of a turntable.
    """

    parts: tuple[Part, ...] = ()
    turn_angle: float = field(default=FULL_TURN)
    rates: RateTable | None = None

    @property
    def spans(self) -> tuple[tuple[float, float], ...]:
        """Begin and end of everything that is known [s]."""
        spans = [(p.t0, p.t1) for p in self.parts]
        if self.rates is not None:
            spans += zip(self.rates.t0.tolist(), self.rates.t1.tolist(), strict=True)
        return tuple(spans)

    @property
    def face_parts(self) -> tuple[Part, ...]:
        """Return the static parts, in time order."""
        return tuple(sorted((p for p in self.parts if p.name in FACES), key=lambda p: p.t0))

    @property
    def turn_parts(self) -> tuple[Part, ...]:
        """Return the turns, in time order."""
        return tuple(sorted((p for p in self.parts if p.name in TURNS), key=lambda p: p.t0))


def windows_with(known: Known, found: FloatArray) -> FloatArray:
    """Join the static parts with the stills found outside all that is known, in time order.

    Parameters
    ----------
    known : Known
        Parts and segments of known rate.
    found : shape (m, 2)
        Begin and end of the stills that were found [s].

    Returns
    -------
    windows : shape (k, 2)
        Begin and end [s].
    """
    outside = np.ones(len(found), dtype=bool)
    for t0, t1 in known.spans:
        outside &= (found[:, 1] <= t0) | (found[:, 0] >= t1)
    faces = np.array([(p.t0, p.t1) for p in known.face_parts]).reshape(-1, 2)
    windows = np.concatenate((faces, found[outside]))
    return np.asarray(windows[np.argsort(windows[:, 0], kind="stable")])
