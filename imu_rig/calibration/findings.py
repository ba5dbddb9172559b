"""Faults that the data themselves show, as values: what, where, how large, and a sentence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

Kind = Literal[
    "saturated",
    "mislabelled",
    "remounted",
    "nonlinear",
    "warm-up",
    "g-sensitivity",
    "bad still",
    "moved",
    "slip",
    "bumped",
]
"""In order of importance: what spoils the sensor's figures before what spoils the jig's frame."""


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


def by_importance(findings: Sequence[Finding], warnings: Sequence[str]) -> tuple[str, ...]:
    """Sentences of findings and warnings, each once: the findings first, by importance.

    Warnings repeat the findings' sentences for readers that know warnings only.
    """
    rank = {kind: place for place, kind in enumerate(get_args(Kind))}
    texts = [f.text for f in sorted(findings, key=lambda f: rank[f.kind])]
    return tuple(dict.fromkeys((*texts, *warnings)))
