"""Text from files that nobody vouches for, made fit for terminals and comments."""

from __future__ import annotations

import textwrap

LONGEST = 200
LONGEST_PARAGRAPH = 1000


def printable(text: str) -> str:
    """Put blanks for what is not printable: line ends, escapes, changes of direction."""
    return "".join(c if c.isprintable() else " " for c in text)


def one_line(text: str, longest: int = LONGEST) -> str:
    """Return one line of printable characters, not too long, with single blanks."""
    line = " ".join(printable(text[: 2 * longest]).split())
    return line if len(line) <= longest else f"{line[: longest - 3]}..."


def wrapped(text: str, width: int) -> list[str]:
    """Break such a text, of a sentence or a few, into lines between words."""
    return textwrap.wrap(one_line(text, LONGEST_PARAGRAPH), width, break_on_hyphens=False)
