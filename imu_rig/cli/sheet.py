"""A printed answer of labels and sentences, as wide as the terminal, with commands left whole."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imu_rig.foreign_text import printable

if TYPE_CHECKING:
    from rich.console import Console

WIDEST = 100  # lines that are longer read badly
MARKS = {"ok": "green", "warn": "yellow", "bad": "bold red"}


class Sheet:
    """Prints to stdout; colours on a terminal only, and nothing that a text could smuggle in.

    Parameters
    ----------
    indent : int
        Columns of the labels.
    """

    def __init__(self, indent: int) -> None:
        from rich.console import Console

        self._console: Console = Console(highlight=False, markup=False, emoji=False)
        self._indent = indent
        self.width = min(self._console.width, WIDEST)

    def head(self, text: str, more: str = "") -> None:
        """Print a line that begins a paragraph."""
        self._line([(printable(text), "bold"), (printable(more), "")])

    def entry(self, label: str, text: str, style: str = "", label_style: str = "dim") -> None:
        """Print a label and a sentence, broken between words."""
        self.parts([(label, label_style)], text, style)

    def parts(self, labels: list[tuple[str, str]], text: str, style: str = "") -> None:
        """Print several labels that share the columns, and a sentence beside them."""
        import textwrap

        room = max(20, self.width - self._indent)
        clean = " ".join(printable(text).split())
        lines = textwrap.wrap(clean, room, break_on_hyphens=False, break_long_words=False) or [""]
        used = sum(len(label) for label, _ in labels)
        first = [*labels, (" " * max(1, self._indent - used), ""), (lines[0], style)]
        self._line(first)
        for line in lines[1:]:
            self._line([(" " * self._indent, ""), (line, style)])

    def command(self, text: str, label: str = "") -> None:
        """Print a command, whole, however long."""
        room = " " * max(1, self._indent - len(label))
        self._line([(label, "dim"), (room, ""), (printable(text), "cyan")])

    def remark(self, text: str) -> None:
        """Print a sentence that is true of everything above, as wide as the rest."""
        import textwrap

        for line in textwrap.wrap(printable(text), self.width, break_on_hyphens=False):
            self._line([(line, "dim")])

    def blank(self) -> None:
        """Print an empty line."""
        self._line([])

    def row(self, pieces: list[tuple[str, str]]) -> None:
        """Print pieces of one line with their styles, as they are."""
        self._line(pieces)

    def _line(self, pieces: list[tuple[str, str]]) -> None:
        from rich.text import Text

        self._console.print(Text.assemble(*pieces), soft_wrap=True)
