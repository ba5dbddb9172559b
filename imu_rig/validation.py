"""What is wrong with a file, from a pydantic error to one sentence a person can act on.

The file may come from anywhere, so nothing of it reaches a terminal as it is, or at any length.
"""

from __future__ import annotations

from typing import Any

from pydantic import AfterValidator, ValidationError

from imu_rig.foreign_text import LONGEST_PARAGRAPH, one_line

SHOWN = 3
SHOWN_LENGTH = 40
FIELD_LENGTH = 100
ONE_LINE = AfterValidator(lambda text: one_line(text, LONGEST_PARAGRAPH))
"""Makes a text field of a file one line of printable characters."""


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
    path = ".".join(name for name in names if not name.startswith("function-"))
    return one_line(path, FIELD_LENGTH)


def _clause(field: str, kind: str, message: str, given: Any, kind_of_file: str) -> str:
    if kind == "missing":
        return f"{field} is missing"
    if kind == "extra_forbidden":
        return f"{field} is not a field of {kind_of_file}; check its spelling"
    if kind == "value_error":
        said = one_line(message.removeprefix("Value error, "), LONGEST_PARAGRAPH)
        return f"{field}: {said}" if field else said
    shown = one_line(repr(given), SHOWN_LENGTH)
    said = one_line(message[:1].lower() + message[1:])
    return f"{field} is {shown}, but {said.replace('input should', 'it should')}"
