"""Times, sizes and losses as people read them on a terminal."""

from __future__ import annotations

import math


def clock(seconds: float, decimals: int = 0) -> str:
    """``1:05`` or ``1:02:05``; never more than has gone."""
    scale: int = 10**decimals
    whole, part = divmod(int(max(0.0, seconds) * scale + 1e-6), scale)
    hours, minutes = whole // 3600, whole // 60 % 60
    text = (f"{hours}:{minutes:02d}" if hours else f"{minutes}") + f":{whole % 60:02d}"
    return f"{text}.{part:0{decimals}d}" if decimals else text


def size(count: int) -> str:
    """Return a number of bytes, ``4.2 MB``."""
    value = float(count)
    for unit in ("B", "kB", "MB", "GB"):
        if value < 999.5:
            return f"{value:.{0 if unit == 'B' else 1}f} {unit}"
        value /= 1000
    return f"{value:.1f} TB"


def lasting(seconds: float) -> str:
    """Return how long something lasts, roughly."""
    for longest, one, unit in ((120, 1, "s"), (7200, 60, "min"), (172_800, 3600, "h")):
        if seconds < longest:
            return f"{seconds / one:.0f} {unit}"
    days = seconds / 86_400
    return f"{days:.0f} days" if days < 1000 else "years"


def uncertainty(seconds: float | None) -> str:
    """Return how well times are known to two digits, ``± 0.40 ms``."""
    if seconds is None or not math.isfinite(seconds):
        return "–"
    longest = ((1e-4, 1e6, "µs"), (0.1, 1e3, "ms"), (math.inf, 1.0, "s"))
    scale, unit = next((scale, unit) for limit, scale, unit in longest if seconds < limit)
    value = scale * seconds
    decimals = min(2, max(0, 1 - math.floor(math.log10(value)))) if value > 0 else 0
    return f"± {value:.{decimals}f} {unit}"


def counted(count: int, thing: str) -> str:
    """Return how many there are of something: ``1 sample``, ``2 samples``."""
    return f"{count} {thing}{'s'[: count != 1]}"


def supply(value: float, unit: str) -> str:
    """Return what a battery or supply has, one unit for one thing: ``4.15 V``, ``98 %``."""
    if unit == "mV":
        value, unit = value / 1000.0, "V"
    if not math.isfinite(value):
        return "–"
    decimals = 0 if unit == "%" or abs(value) >= 100 else 2
    return f"{value:.{decimals}f} {unit}".strip()


def losses(lost: int, share: float) -> str:
    """Return how many packets were lost and how many of a hundred that is."""
    if not lost:
        return "0"
    return f"{lost} ({100 * share:.2f} %)" if share >= 5e-5 else f"{lost} (<0.01 %)"
