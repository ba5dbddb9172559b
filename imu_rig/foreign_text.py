"""Text from files that nobody vouches for, made fit for terminals and comments."""

from __future__ import annotations

import textwrap

LONGEST = 200
LONGEST_PARAGRAPH = 1000


def one_line(text: str, longest: int = LONGEST) -> str:
    """Return one line of printable characters: no line ends, escapes or changes of direction."""
    printable = "".join(c if c.isprintable() else " " for c in text[: 2 * longest])
    line = " ".join(printable.split())
    return line if len(line) <= longest else f"{line[: longest - 3]}..."


def wrapped(text: str, width: int) -> list[str]:
    """Break such a text, of a sentence or a few, into lines between words."""
    return textwrap.wrap(one_line(text, LONGEST_PARAGRAPH), width, break_on_hyphens=False)
