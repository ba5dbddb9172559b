"""HTML built from elements that escape their text, and its way to disk."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib import resources
from pathlib import Path

from imu_rig.files import write_whole

UNPRINTABLE = re.compile(
    r"[^\t\n\x20-\x7e\xa0-\ud7ff\ue000-\ufdcf\ufdf0-\ufffd\U00010000-\U0010fffd]"
    r"|[\u200e\u200f\u202a-\u202e\u2066-\u2069]"
)
"""What no document may hold, and the marks that turn the reading direction of text around."""


class Html(str):
    """Text that is markup already; every other text is escaped where an element takes it in."""

    __slots__ = ()


def text(value: str) -> Html:
    """Escape data; characters that cannot be shown, or mislead, become a visible mark."""
    visible = UNPRINTABLE.sub("\N{REPLACEMENT CHARACTER}", value)
    return Html(escape(visible, quote=True))


def element(tag: str, *content: str, **attributes: str) -> Html:
    """Return an element; attribute ``class_`` means ``class``."""
    stated = "".join(
        f' {name.rstrip("_").replace("_", "-")}="{text(value)}"'
        for name, value in attributes.items()
    )
    return Html(f"<{tag}{stated}>{joined(content)}</{tag}>")


def joined(parts: Iterable[str]) -> Html:
    """Join parts, escaping those that are not markup."""
    return Html("".join(part if isinstance(part, Html) else text(part) for part in parts))


def table(
    head: Sequence[str],
    body: Iterable[Sequence[str] | Html],
    *,
    class_: str = "",
    caption: str = "",
) -> Html:
    """Return a table that scrolls sideways where the page is too narrow.

    A row is its cells, the first of which is the row's header, or an entire row as markup; a
    column's head is a text or an entire cell as markup.
    """
    rows = [row if isinstance(row, Html) else _row(row) for row in body]
    cells = [cell if isinstance(cell, Html) else element("th", cell, scope="col") for cell in head]
    heading = element("tr", *cells)
    described = [element("caption", caption)] if caption else []
    inner = element("table", *described, element("thead", heading), element("tbody", *rows))
    return element("div", inner, class_=f"table {class_}".strip())


def header(about: str, title: str, subtitle: str) -> Html:
    """Return the head of a page; ``about`` says what the page is, beside the program's name."""
    return element(
        "header",
        element("p", f"imu-rig · {about}", class_="eyebrow"),
        element("h1", title),
        element("p", subtitle, class_="subtitle"),
    )


def card(label: str, value: str, unit: str, about: str) -> Html:
    """Return one figure that is seen first."""
    shown = [Html(" "), element("small", unit)] if unit else []
    return element(
        "div",
        element("div", label, class_="label"),
        element("div", value, *shown, class_="value"),
        element("div", about, class_="about"),
        class_="card",
    )


def facts(pairs: Iterable[tuple[str, str]]) -> Html:
    """Return a list of named values."""
    return element(
        "dl", *(element("div", element("dt", name), element("dd", value)) for name, value in pairs)
    )


def section(title: str, *content: str, class_: str = "") -> Html:
    """Return a titled section."""
    return element("section", element("h2", title), *content, class_=class_)


def folded(summary: str, *content: str) -> Html:
    """Return a block that opens on demand, without a script."""
    return element("details", element("summary", summary), *content)


def document(title: str, *content: str) -> Html:
    """Return a whole document; its style is inside, and it needs nothing else."""
    style = (resources.files("imu_rig.report") / "report.css").read_text(encoding="utf-8")
    head = (
        Html('<meta charset="utf-8">\n'),
        Html('<meta name="viewport" content="width=device-width, initial-scale=1">\n'),
        Html('<meta name="color-scheme" content="light dark">\n'),
        Html(
            '<meta http-equiv="Content-Security-Policy" '
            "content=\"default-src 'none'; style-src 'unsafe-inline'\">\n"
        ),
        element("title", title),
        Html(f"\n<style>\n{style}</style>\n"),
    )
    body = element("main", *content)
    return Html(
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n{joined(head)}</head>\n'
        f"<body>\n{body}\n</body>\n</html>\n"
    )


def write_report(path: Path | str, html: str, *, overwrite: bool = False) -> None:
    """Write a report whole or not at all; an existing file is kept unless ``overwrite``.

    Raises
    ------
    InputError
        The file exists, or its folder does not.
    StorageError
        The disk is full or fails.
    """
    write_whole(path, html.encode(), what="a report", overwrite=overwrite)


def _row(cells: Sequence[str]) -> Html:
    first, *rest = cells
    return element("tr", element("th", first, scope="row"), *(element("td", cell) for cell in rest))
