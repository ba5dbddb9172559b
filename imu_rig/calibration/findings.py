"""Faults that the data themselves show, as values: what, where, how large, and a sentence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal[
    "mislabelled",
    "bumped",
    "slip",
    "saturated",
    "moved",
    "bad still",
    "remounted",
    "nonlinear",
    "g-sensitivity",
    "warm-up",
]


@dataclass(frozen=True)
class Finding:
    """One fault.

    Attributes
    ----------
    kind : str
        ``mislabelled``: commanded angles belong to another pose; ``bumped``: a single pose is off;
        ``slip``: a servo jumped and stayed; ``saturated``, ``moved``, ``bad still``: a still that
        cannot be used as it is; ``remounted``: the sensor sits otherwise than the protocol says;
        ``nonlinear``, ``g-sensitivity``, ``warm-up``: the sensor does what a linear, constant
        model does not describe.
    text : str
        A sentence for the user.
    poses : tuple of int
        Which poses, from 0; the first one concerned where it is all from there on.
    axis : str
        Servo (``pan``) or sensor axis (``x``) where one is at fault.
    size : float
        How large, in the unit of the sentence.
    """

    kind: Kind
    text: str
    poses: tuple[int, ...] = ()
    axis: str = ""
    size: float = 0.0
