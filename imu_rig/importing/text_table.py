"""Numbers out of a text table: where they begin, what parts them, and what is wrong with a line.

Reads in pieces of bounded size; only the wanted columns are kept.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from operator import methodcaller
from pathlib import Path

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.errors import InputError

PIECE_BYTES = 4_000_000
HEAD_BYTES = 65_536
MAXIMUM_ROWS = 10_000_000
COMMENTS = ("#", "%", "//")
_NUMBER_BEGINS = frozenset("0123456789-")
JUDGED_LINES = 30
FEWEST_COLUMNS = 3
_NUMERALS = {1: "one column", 2: "two columns", 3: "three columns"}


@dataclass(frozen=True)
class Form:
    """How a text table is written.

    Attributes
    ----------
    delimiter : str or None
        One character; None for any white space.
    decimal : str
        Decimal sign.
    first_line : int
        Number of the first line of data, from 0.
    columns : int
        Fields per line.
    names : tuple of str or None
        Names of the header, if there is one.
    preamble : tuple of str
        Lines before the header.
    """

    delimiter: str | None
    decimal: str
    first_line: int
    columns: int
    names: tuple[str, ...] | None
    preamble: tuple[str, ...]

    def split(self, line: str) -> list[str]:
        """Split a line into fields without their quotes."""
        fields = line.split(self.delimiter)
        return [field.strip().strip('"').strip() for field in fields]


def first_lines(path: Path) -> list[str]:
    """Return the lines that a text file begins with.

    Raises
    ------
    InputError
        A file that cannot be read, is empty, or is no text.
    """
    return _head(path, 0)


def detect_form(
    path: Path,
    *,
    delimiter: str | None = None,
    decimal: str | None = None,
    skip_rows: int = 0,
    fewest: int = FEWEST_COLUMNS,
) -> Form:
    """Find out how a table is written from its first lines.

    Parameters
    ----------
    path : Path
        The file.
    delimiter : str, optional
        One character or ``whitespace``; recognized where not given.
    decimal : str, optional
        ``.`` or ``,``.
    skip_rows : int
        Lines to pass over first.
    fewest : int
        Columns of numbers that make a table.

    Raises
    ------
    InputError
        A file that cannot be read, is empty, or is no text table.
    """
    lines = _head(path, skip_rows)
    rows = [(i, line) for i, line in enumerate(lines) if _is_content(line)]
    if not rows:
        raise InputError(f"{path} holds no lines of data")
    # The later half of a short file: a preamble may be as long as its data.
    tail = [line for _, line in rows[-min(JUDGED_LINES, (len(rows) + 1) // 2) :]]
    best = max(_candidates(delimiter, decimal), key=lambda c: _numbers_per_line(tail, c[0], c[1]))
    form = Form(best[0], best[1], 0, 0, None, ())
    if _numbers_per_line(tail, *best) < fewest:
        raise InputError(
            f"{path} holds no table of numbers with {_NUMERALS[fewest]} or more: {tail[-1][:60]!r}"
        )
    counts = Counter(len(form.split(line)) for line in tail)
    columns = counts.most_common(1)[0][0]
    typical = [form.split(line) for line in tail if len(form.split(line)) == columns]
    numeric = [
        j
        for j in range(columns)
        if sum(_is_number(f[j], form.decimal) for f in typical) * 2 >= len(typical)
    ]
    first = next(i for i, line in rows if _is_data(form, line, columns, numeric))
    above = [line for i, line in rows if i < first]
    names = None
    comments = [ln for ln in lines[:first] if ln.lstrip().startswith(COMMENTS)]
    for candidate in above[-1:] or [c.lstrip("#%/ \t") for c in comments[-1:]]:
        fields = form.split(candidate)
        if len(fields) == columns:
            names = tuple(fields)
            above = above[:-1]
    return Form(best[0], best[1], first + skip_rows, columns, names, tuple(above))


def read_numbers(
    path: Path, form: Form, wanted: Sequence[int], *, gaps: bool = False
) -> FloatArray:
    """Read the wanted columns, shape (n, len(wanted)).

    Parameters
    ----------
    path : Path
    form : Form
        As `detect_form` found it.
    wanted : sequence of int
        Columns, from 0.
    gaps : bool
        Whether nothing or NaN may stand in a wanted column; both read NaN.

    Raises
    ------
    InputError
        A line with text, infinity or (without ``gaps``) nothing or NaN in a wanted column, or
        with another number of columns; more than `MAXIMUM_ROWS` rows.
    """
    parts: list[FloatArray] = []
    rows = 0
    for first_line, lines in _pieces(path):
        kept = lines[max(0, form.first_line - first_line) :]
        content = [line for line in kept if line[:1] in _NUMBER_BEGINS or _is_content(line)]
        if not content:
            continue
        numbers = _parse(content, form, wanted)
        if numbers is None and gaps:
            numbers = _parse_with_gaps(content, form, wanted)
        if numbers is None:
            raise InputError(_what_is_wrong(path, form, wanted, lines, first_line, gaps=gaps))
        parts.append(numbers)
        rows += len(numbers)
        if rows > MAXIMUM_ROWS:
            raise InputError(
                f"{path} holds more than {MAXIMUM_ROWS // 1_000_000} million rows: cut it up"
            )
    if not parts:
        raise InputError(f"{path} holds no lines of data")
    return np.concatenate(parts)


def read_words(path: Path, form: Form, column: int) -> list[str]:
    """Read one column as text, one word per row of data."""
    words: list[str] = []
    for first_line, lines in _pieces(path):
        kept = lines[max(0, form.first_line - first_line) :]
        for line in kept:
            if line[:1] in _NUMBER_BEGINS or _is_content(line):
                fields = form.split(line)
                words.append(fields[column] if column < len(fields) else "")
        if len(words) > MAXIMUM_ROWS:
            raise InputError(
                f"{path} holds more than {MAXIMUM_ROWS // 1_000_000} million rows: cut it up"
            )
    return words


def line_of_row(path: Path, form: Form, row: int) -> int:
    """Return the line number, from 1, of a row of data."""
    passed = 0
    for first_line, lines in _pieces(path):
        for i, line in enumerate(lines):
            if first_line + i >= form.first_line and _is_content(line):
                if passed == row:
                    return first_line + i + 1
                passed += 1
    return 0


def _parse(lines: list[str], form: Form, wanted: Sequence[int]) -> FloatArray | None:
    """Parse lines, None where one of them is not as it should be."""
    if form.delimiter is None:
        even = set(map(len, map(str.split, lines))) == {form.columns}
    else:
        even = set(map(methodcaller("count", form.delimiter), lines)) == {form.columns - 1}
    # A quoted text may hold the delimiter; then the parser alone counts.
    if not even and not any('"' in line for line in lines):
        return None
    if form.decimal == ",":
        lines = [line.replace(",", ".") for line in lines]
    try:
        numbers = np.loadtxt(
            lines,
            delimiter=form.delimiter,
            usecols=list(wanted),
            ndmin=2,
            comments=None,
            quotechar='"',
        )
    except ValueError:
        return None
    return numbers if np.all(np.isfinite(numbers)) else None


def _parse_with_gaps(lines: list[str], form: Form, wanted: Sequence[int]) -> FloatArray | None:
    """Parse lines that lack numbers here and there, one by one."""
    numbers = np.full((len(lines), len(wanted)), np.nan)
    for i, line in enumerate(lines):
        fields = form.split(line)
        if len(fields) != form.columns:
            return None
        for place, j in enumerate(wanted):
            if fields[j]:
                try:
                    numbers[i, place] = float(fields[j].replace(form.decimal, "."))
                except ValueError:
                    return None
    return None if np.any(np.isinf(numbers)) else numbers


def _what_is_wrong(
    path: Path,
    form: Form,
    wanted: Sequence[int],
    lines: list[str],
    first_line: int,
    *,
    gaps: bool,
) -> str:
    for i, line in enumerate(lines):
        number = first_line + i
        if number < form.first_line or not _is_content(line):
            continue
        fields = form.split(line)
        if len(fields) != form.columns:
            return (
                f"{path}, line {number + 1}: {len(fields)} columns instead of {form.columns}; "
                "correct or delete the line"
            )
        for j in wanted:
            name = form.names[j] if form.names else str(j + 1)
            where = f"{path}, line {number + 1}, column {name}"
            text = fields[j]
            if gaps and (not text or text.lower() == "nan"):
                continue
            if not text:
                return f"{where} is empty; fill it in or delete the line"
            if not _is_number(text, form.decimal):
                return f"{where} holds {text[:30]!r}, which is no number"
            if not math.isfinite(float(text.replace(form.decimal, "."))):
                return f"{where} holds {text[:30]!r}; delete such lines"
    return f"{path} holds a number that cannot be read near line {first_line + len(lines)}"


def _head(path: Path, skip_rows: int) -> list[str]:
    for first_line, lines in _pieces(path, skip_to=skip_rows):
        usable = lines[max(0, skip_rows - first_line) :]
        total, head = 0, []
        for line in usable:
            total += len(line) + 1
            head.append(line)
            if total > HEAD_BYTES:
                break
        return head
    raise InputError(f"{path} is empty")


def _pieces(path: Path, *, skip_to: int = 0) -> Iterator[tuple[int, list[str]]]:
    """Yield whole lines in pieces, with the number of their first line from 0."""
    if not path.is_file():
        problem = "is not a file" if path.exists() else "does not exist"
        raise InputError(f"{path} {problem}")
    first_line = 0
    rest = b""
    try:
        with path.open("rb") as file:
            while True:
                data = file.read(PIECE_BYTES)
                whole, rest = _cut(path, rest + data, last=not data)
                lines = _text(path, whole, first_line)
                if lines and first_line + len(lines) > skip_to:
                    yield first_line, lines
                first_line += len(lines)
                if not data:
                    return
    except OSError as error:
        raise InputError(f"{path} could not be read: {error.strerror}") from error


def _cut(path: Path, data: bytes, *, last: bool) -> tuple[bytes, bytes]:
    if last:
        return data, b""
    end = max(data.rfind(b"\n"), data.rfind(b"\r", 0, len(data) - 1)) + 1
    if end == 0 and len(data) >= PIECE_BYTES:
        raise InputError(f"{path} is no text table: it has a line of {len(data) // 10**6} MB")
    return data[:end], data[end:]


def _text(path: Path, data: bytes, first_line: int) -> list[str]:
    if not data:
        return []
    if data.startswith(b"\x1f\x8b") and first_line == 0:
        raise InputError(f"{path} is compressed; decompress it first")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")) and first_line == 0:
        raise InputError(f"{path} is written in UTF-16; save it as UTF-8 text")
    if b"\x00" in data:
        raise InputError(f"{path} is no text table: it holds zero bytes (binary, or UTF-16)")
    try:
        text = data.decode("utf-8-sig" if first_line == 0 else "utf-8")
    except UnicodeDecodeError:
        # Old spreadsheets write the degree sign in this encoding; every byte is valid in it.
        text = data.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n").removesuffix("\n").split("\n")


def _is_content(line: str) -> bool:
    return bool(line) and not line.isspace() and not line.lstrip().startswith(COMMENTS)


def _is_number(text: str, decimal: str) -> bool:
    try:
        float(text.replace(decimal, "."))
    except ValueError:
        return False
    return "_" not in text


def _candidates(delimiter: str | None, decimal: str | None) -> list[tuple[str | None, str]]:
    delimiters: tuple[str | None, ...] = ("\t", ";", ",", None)
    if delimiter == "whitespace":
        delimiters = (None,)
    elif delimiter is not None:
        if len(delimiter) != 1 or delimiter.isalnum() or delimiter in "+-.\"'\n\r":
            raise InputError(f"{delimiter!r} cannot be a delimiter; give one sign or 'whitespace'")
        delimiters = (None if delimiter == " " else delimiter,)
    decimals = (decimal,) if decimal else (".", ",")
    return [(d, s) for s in decimals for d in delimiters if d != s]


def _numbers_per_line(lines: list[str], delimiter: str | None, decimal: str) -> float:
    form = Form(delimiter, decimal, 0, 0, None, ())
    counts = [sum(_is_number(f, decimal) for f in form.split(line)) for line in lines]
    return float(np.median(counts))


def _is_data(form: Form, line: str, columns: int, numeric: list[int]) -> bool:
    fields = form.split(line)
    if len(fields) != columns:
        return False
    return sum(_is_number(fields[j], form.decimal) for j in numeric) * 2 >= len(numeric)
