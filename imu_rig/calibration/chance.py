"""How probable a sum of squares is by chance alone."""

from __future__ import annotations

import math


def chi_square_tail(square: float, dof: int) -> float:
    """Probability that chi-square with ``dof`` degrees of freedom exceeds ``square``.

    The finite sums for whole degrees of freedom (Abramowitz and Stegun 26.4.4 and 26.4.5). scipy
    has the same, but importing it takes longer than a whole calibration.
    """
    half = 0.5 * max(square, 0.0)
    total = math.erfc(math.sqrt(half)) if dof % 2 else math.exp(-half)
    term = math.exp(-half) * (2.0 * math.sqrt(half / math.pi) if dof % 2 else half)
    k = 1.5 if dof % 2 else 2.0
    for _ in range((dof - 1) // 2):
        total += term
        term *= half / k
        k += 1.0
    return min(1.0, total)
