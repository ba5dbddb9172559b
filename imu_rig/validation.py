"""What is wrong with a file, from a pydantic error to one sentence a person can act on."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError

SHOWN = 3
SHOWN_LENGTH = 40


def sentence(error: ValidationError, kind_of_file: str) -> str:
    """Put what is wrong into one sentence without its final stop.

    Parameters
    ----------
    error : ValidationError
    kind_of_file : str
        For example "a jig file"; named where a field is not one of it.
    """
    problems = error.errors(include_url=False, include_context=False)
    places = [p["loc"] for p in problems]
    # a list that fails only because an item does says nothing more
    problems = [p for p in problems if not any(p["loc"] == q[: len(p["loc"])] != q for q in places)]
    parts = [
        _clause(_field(p["loc"]), p["type"], p["msg"], p["input"], kind_of_file)
        for p in problems[:SHOWN]
    ]
    if len(problems) > SHOWN:
        parts.append(f"and {len(problems) - SHOWN} more")
    return "; ".join(parts)


def _field(place: tuple[int | str, ...]) -> str:
    """Write the place of a field; items of a list are counted from 1."""
    names = [str(step + 1) if isinstance(step, int) else step for step in place]
    return ".".join(name for name in names if not name.startswith("function-"))


def _clause(field: str, kind: str, message: str, given: Any, kind_of_file: str) -> str:
    if kind == "missing":
        return f"{field} is missing"
    if kind == "extra_forbidden":
        return f"{field} is not a field of {kind_of_file}; check its spelling"
    if kind == "value_error":
        said = message.removeprefix("Value error, ")
        return f"{field}: {said}" if field else said
    shown = repr(given)
    shown = shown if len(shown) <= SHOWN_LENGTH else f"{shown[: SHOWN_LENGTH - 3]}..."
    said = message[:1].lower() + message[1:]
    return f"{field} is {shown}, but {said.replace('input should', 'it should')}"
