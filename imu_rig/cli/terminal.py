"""Text made to fit the terminal it goes to."""

from __future__ import annotations

import shutil
import sys
import textwrap


def fitted(sentence: str) -> str:
    """Break a sentence between words on a terminal; elsewhere it stays one line."""
    if not sys.stderr.isatty():
        return sentence
    width = shutil.get_terminal_size().columns
    return textwrap.fill(sentence, width, break_long_words=False, break_on_hyphens=False)
