"""Taking values out of a description, which is plain data from a file and not trusted.

Every mistake is a :class:`LayoutError` that says where it is and which key is wrong.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from firmware_protocols.fields import LayoutError, quote

REQUIRED: Any = object()
"""The default of a key that has none."""

_KIND_NAMES = {str: "text", int: "a whole number", list: "a list", dict: "a table"}


def check_keys(where: str, entry: Mapping[str, Any], known: Collection[str]) -> None:
    """Refuse a key that nobody would read, which is a misspelt one most often."""
    for key in entry:
        if key not in known:
            raise LayoutError(
                f"{where}: the key {quote(key)} is not known (known: {', '.join(sorted(known))})."
            )


def every(where: str, entry: Mapping[str, Any], kinds: Mapping[str, type[Any]]) -> dict[str, Any]:
    """Return the values of all keys that are there; none may be unknown or of another kind.

    Parameters
    ----------
    where : str
        What the description is of, for the beginning of an error.
    entry : mapping
    kinds : mapping
        Of each key that may be there: str, int, list, dict, or float for any number.
    """
    check_keys(where, entry, kinds)
    return {
        key: number(where, entry, key) if kind is float else take(where, entry, key, kind)
        for key, kind in kinds.items()
        if key in entry
    }


def take(
    where: str, entry: Mapping[str, Any], key: str, kind: type[Any], default: Any = REQUIRED
) -> Any:
    """Return the value of a key, which must be of a kind: str, int, list or dict."""
    value = entry.get(key, default)
    if value is REQUIRED:
        raise LayoutError(f"{where}: the key {key!r} is missing.")
    if value is default:
        return value
    if not isinstance(value, kind) or isinstance(value, bool):
        raise LayoutError(f"{where}: {key} must be {_KIND_NAMES[kind]}.")
    return value


def number(where: str, entry: Mapping[str, Any], key: str, default: Any = REQUIRED) -> Any:
    """Return the value of a key as a float; what is not finite is up to the caller."""
    value = entry.get(key, default)
    if value is REQUIRED:
        raise LayoutError(f"{where}: the key {key!r} is missing.")
    if value is default:
        return value
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise LayoutError(f"{where}: {key} must be a number.")
    try:
        return float(value)
    except OverflowError:
        raise LayoutError(f"{where}: {key} is too large a number.") from None
