"""Names of devices made fit for files, topics and variables, no two alike."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Sequence

from imu_rig.calibration.exports.matlab import KEYWORDS

LONGEST = 40
_NOT_IN_FILES = re.compile(r"[^\w-]+")
_NOT_IN_VARIABLES = re.compile(r"[^A-Za-z0-9_]+")


def file_names(names: Sequence[str], *, taken: Collection[str] = ()) -> dict[str, str]:
    """Return a part of a file name or topic for each name: letters, digits, ``_`` and ``-``.

    Letters of every script stay. Names that would differ in case only are told apart by number,
    for not every file system does.
    """
    return _apart(
        {n: _NOT_IN_FILES.sub("_", unicodedata.normalize("NFC", n)) for n in names}, taken
    )


def variable_names(names: Sequence[str], *, taken: Collection[str] = ()) -> dict[str, str]:
    """Return a MATLAB variable for each name: ASCII, a letter first, no keyword."""
    found = {}
    for name in names:
        plain = unicodedata.normalize("NFKD", name)
        word = _NOT_IN_VARIABLES.sub("_", "".join(c for c in plain if not unicodedata.combining(c)))
        word = word.strip("_")
        if word and not word[0].isalpha():
            word = f"device_{word}"
        found[name] = f"{word}_" if word in KEYWORDS else word
    return _apart(found, taken, keep_end=True)


def _apart(
    wanted: dict[str, str], taken: Collection[str], *, keep_end: bool = False
) -> dict[str, str]:
    used = {word.casefold() for word in taken}
    found = {}
    for name, text in wanted.items():
        word = (text.lstrip("_") if keep_end else text.strip("_"))[:LONGEST] or "device"
        chosen, number = word, 1
        while chosen.casefold() in used:
            number += 1
            chosen = f"{word}_{number}"
        used.add(chosen.casefold())
        found[name] = chosen
    return found
