"""Numbers as people read them: as many digits as the uncertainty supports, and never "nan"."""

from __future__ import annotations

import math

MISSING = "–"
MOST_DECIMALS = 9


def decimals_for(uncertainty: float) -> int:
    """Decimals that show two significant digits of ``uncertainty``."""
    if not math.isfinite(uncertainty) or uncertainty <= 0.0:
        return 4
    return _clamped(1 - math.floor(math.log10(uncertainty)))


def fixed(value: float, decimals: int, *, sign: bool = False) -> str:
    """Return ``value`` with a number of decimals, a real minus sign, a plus sign on request."""
    if not math.isfinite(value):
        return MISSING
    rounded = round(value, decimals) + 0.0
    text = f"{rounded:{'+' if sign else ''}.{decimals}f}"
    return text.replace("-", "−")


def significant(value: float, digits: int = 3) -> str:
    """Return ``value`` with a number of significant digits, never in powers of ten."""
    if not math.isfinite(value):
        return MISSING
    if value == 0.0:
        return "0"
    return fixed(value, _clamped(digits - 1 - math.floor(math.log10(abs(value)))))


def duration(seconds: float) -> str:
    """Return a duration as a person says it."""
    if not math.isfinite(seconds):
        return MISSING
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 120:
        return f"{minutes} min {rest} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min"


def counted(count: int, singular: str, plural: str = "") -> str:
    """``1 pose``, ``24 poses``."""
    return f"{count} {singular if count == 1 else plural or singular + 's'}"


def _clamped(decimals: int) -> int:
    return min(max(decimals, 0), MOST_DECIMALS)
