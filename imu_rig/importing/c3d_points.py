"""Markers out of C3D files: names, rate, unit and places, and nothing else of them.

The format is that of c3d.org: blocks of 512 bytes, a header, parameters in groups, then frames of
points and analog samples, as 16-bit integers with a scale or as 32-bit floats, little or big
endian. A reader of its own, because files come from outside: every length is checked before
anything is read, only the wanted marker is taken from the disk, and nothing has to be installed.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from imu_rig.arrays import FloatArray
from imu_rig.errors import InputError, reason_of
from imu_rig.foreign_text import one_line

BLOCK = 512
KEY = 0x50
"""Second byte of every C3D file."""
INTEL, DEC, MIPS = 84, 85, 86
MAXIMUM_BYTES = 4_000_000_000
MOST_PARAMETER_BLOCKS = 255
MOST_POINTS = 10_000
RATES_HZ = (0.1, 100_000.0)
TEXT, BYTE, INTEGER, REAL = -1, 1, 2, 4
MOST_SHOWN = 12
"""Names of markers in a message."""


@dataclass(frozen=True)
class C3dPoints:
    """What a C3D file says of its markers.

    Attributes
    ----------
    path : Path
    labels : tuple of str
        Names of the markers in order.
    unit : str
        As the file states it, such as "mm"; empty where it does not.
    up : str
        Axis that points up on its screen: "+Z", "+Y"; empty where it does not say.
    rate_hz : float
    first_frame : int
        Number of the first frame, from 1.
    frames : int
    data_offset, frame_bytes : int
    scale : float
        Of integers to the unit; negative for floats.
    endian : str
        "<" or ">".
    """

    path: Path
    labels: tuple[str, ...]
    unit: str
    up: str
    rate_hz: float
    first_frame: int
    frames: int
    data_offset: int
    frame_bytes: int
    scale: float
    endian: str

    @property
    def times(self) -> FloatArray:
        """Time of each frame [s], counted from frame 1 of the capture."""
        return (np.arange(self.frames) + self.first_frame - 1) / self.rate_hz


def is_c3d(path: Path) -> bool:
    """Whether a file begins like a C3D file."""
    try:
        with path.open("rb") as file:
            head = file.read(2)
    except OSError as error:
        raise InputError(f"{path} could not be read: {reason_of(error)}") from error
    return len(head) == 2 and head[1] == KEY and head[0] > 0


def open_c3d(path: Path) -> C3dPoints:
    """Read header and parameters of a file.

    Raises
    ------
    InputError
        A damaged file, a huge one, one of a DEC computer, or one without markers.
    """
    try:
        size = path.stat().st_size
        if size > MAXIMUM_BYTES:
            raise InputError(f"{path} has more than {MAXIMUM_BYTES // 10**9} GB: cut it up")
        with path.open("rb") as file:
            head = file.read(BLOCK)
            if len(head) < BLOCK or head[1] != KEY or not head[0]:
                raise _damaged(path, "its header is none")
            begin = (head[0] - 1) * BLOCK
            file.seek(begin)
            start = file.read(4)
            blocks = start[2] if len(start) == 4 else 0
            if not 1 <= blocks <= MOST_PARAMETER_BLOCKS or begin + blocks * BLOCK > size:
                raise _damaged(path, "its parameters are cut off")
            section = file.read(blocks * BLOCK - 4)
    except OSError as error:
        raise InputError(f"{path} could not be read: {reason_of(error)}") from error
    if start[3] == DEC:
        raise InputError(f"{path} was written for DEC computers, which is not read; save it anew")
    endian = ">" if start[3] == MIPS else "<"
    parameters = _parameters(path, section, endian)
    return _described(path, size, head, parameters, endian)


def read_marker(file: C3dPoints, index: int) -> FloatArray:
    """Read the places of one marker, shape (frames, 3), in the file's unit; NaN where lost.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    kind = f"{file.endian}f4" if file.scale < 0 else f"{file.endian}i2"
    width = np.dtype(kind).itemsize
    layout = np.dtype(
        {
            "names": ["point"],
            "formats": [(kind, (4,))],
            "offsets": [4 * width * index],
            "itemsize": file.frame_bytes,
        }
    )
    try:
        rows = np.memmap(
            file.path, dtype=layout, mode="r", offset=file.data_offset, shape=(file.frames,)
        )
        with np.errstate(invalid="ignore"):  # NaN that signals is NaN
            points = np.array(rows["point"], dtype=float)
    except (OSError, ValueError) as error:
        raise InputError(f"{file.path} could not be read: {reason_of(error)}") from error
    places = points[:, :3] * (1.0 if file.scale < 0 else file.scale)
    places[~(points[:, 3] >= 0.0) | ~np.all(np.isfinite(places), axis=1)] = np.nan
    return places


def find_marker(file: C3dPoints, name: str | None) -> int:
    """Return which marker is meant; the only one where no name is given.

    Raises
    ------
    InputError
        Naming the markers that there are.
    """
    if name is None and len(file.labels) == 1:
        return 0
    shown = ", ".join(one_line(label) or "(no name)" for label in file.labels[:MOST_SHOWN])
    if len(file.labels) > MOST_SHOWN:
        shown += f" and {len(file.labels) - MOST_SHOWN} more"
    if name is None:
        raise InputError(f"{file.path} has {len(file.labels)} markers: say which of {shown}")
    for same in (str.__eq__, lambda a, b: a.lower() == b.lower(), _same_end):
        found = [i for i, label in enumerate(file.labels) if same(label, name)]
        if len(found) == 1:
            return found[0]
    raise InputError(f"{file.path} has no marker {name!r}; it has {shown}")


def _same_end(label: str, name: str) -> bool:
    """Whether a label such as ``subject:heel`` ends with the name of a marker."""
    return label.rpartition(":")[2].lower() == name.lower()


def _described(
    path: Path, size: int, head: bytes, parameters: dict[tuple[str, str], Any], endian: str
) -> C3dPoints:
    points, analog, first, last = struct.unpack_from(f"{endian}4H", head, 2)
    scale, data_block = struct.unpack_from(f"{endian}fH", head, 12)
    (rate,) = struct.unpack_from(f"{endian}f", head, 20)
    rate = _number(parameters.get(("POINT", "RATE")), rate)
    scale = _number(parameters.get(("POINT", "SCALE")), scale)
    if not 1 <= points <= MOST_POINTS:
        raise InputError(f"{path} holds no markers: export the trajectories of markers to C3D")
    if not RATES_HZ[0] <= rate <= RATES_HZ[1] or not math.isfinite(scale) or scale == 0.0:
        raise _damaged(path, f"its rate is {rate:g} Hz and its scale {scale:g}")
    width = 4 if scale < 0 else 2
    frame_bytes = width * (4 * points + analog)
    data_block = int(_number(parameters.get(("POINT", "DATA_START")), data_block))
    offset = (data_block - 1) * BLOCK
    frames = _frame_count(parameters, first, last)
    if data_block < 2 or frames < 1 or offset + frames * frame_bytes > size:
        raise _damaged(path, f"it should hold {frames} frames and is too short for them")
    labels = _labels(parameters, points)
    return C3dPoints(
        path=path,
        labels=labels,
        unit=_text(parameters.get(("POINT", "UNITS"))),
        up=_text(parameters.get(("POINT", "Y_SCREEN"))).upper(),
        rate_hz=rate,
        first_frame=_first_frame(parameters, first),
        frames=frames,
        data_offset=offset,
        frame_bytes=frame_bytes,
        scale=scale,
        endian=endian,
    )


def _frame_count(parameters: dict[tuple[str, str], Any], first: int, last: int) -> int:
    """Return the number of frames; the header's 16 bits overflow in long files."""
    stated = _number(parameters.get(("POINT", "LONG_FRAMES")), 0.0)
    if stated >= 1:
        return int(stated)
    begin = _two_words(parameters.get(("TRIAL", "ACTUAL_START_FIELD")))
    end = _two_words(parameters.get(("TRIAL", "ACTUAL_END_FIELD")))
    if begin and end and end >= begin:
        return end - begin + 1
    stated = _number(parameters.get(("POINT", "FRAMES")), 0.0)
    counted = last - first + 1
    return int(stated) % 65536 if last == 65535 and stated else counted


def _first_frame(parameters: dict[tuple[str, str], Any], first: int) -> int:
    begin = _two_words(parameters.get(("TRIAL", "ACTUAL_START_FIELD")))
    return max(1, begin or first)


def _two_words(value: Any) -> int:
    """Return a number that is kept as its low and its high 16 bits; 0 where there is none."""
    if not isinstance(value, list) or len(value) != 2:
        return 0
    low, high = (int(word) & 0xFFFF for word in value)
    return low + (high << 16)


def _labels(parameters: dict[tuple[str, str], Any], points: int) -> tuple[str, ...]:
    """Return a name for every marker; lists of more than 255 go on in LABELS2, LABELS3 ..."""
    names: list[str] = []
    for number in range(1, MOST_POINTS // 255 + 2):
        more = parameters.get(("POINT", "LABELS" if number == 1 else f"LABELS{number}"))
        if not isinstance(more, list):
            break
        names += [str(name) for name in more]
    names = names[:points]
    return (*names, *(f"#{i + 1}" for i in range(len(names), points)))


def _parameters(path: Path, section: bytes, endian: str) -> dict[tuple[str, str], Any]:
    """Return the values of all parameters by group and name, in capitals."""
    groups: dict[int, str] = {}
    found: list[tuple[int, str, Any]] = []
    at = 0
    while at + 4 <= len(section):
        length, number = abs(struct.unpack_from("b", section, at)[0]), _signed(section[at + 1])
        if length == 0:
            break
        name_end = at + 2 + length
        if name_end + 2 > len(section):
            raise _damaged(path, "a parameter is cut off")
        name = section[at + 2 : name_end].decode("latin-1").strip().upper()
        step = struct.unpack_from(f"{endian}H", section, name_end)[0]
        if number < 0:
            groups[-number] = name
        else:
            found.append((number, name, _value(section, name_end + 2, endian)))
        if step == 0:
            break
        at = name_end + step
    return {(groups.get(number, ""), name): value for number, name, value in found}


def _value(section: bytes, at: int, endian: str) -> Any:
    """Return a parameter's text, list of texts, or list of numbers; None where it does not fit."""
    if at + 2 > len(section):
        return None
    kind, dimensions = _signed(section[at]), section[at + 1]
    shape = list(section[at + 2 : at + 2 + dimensions])
    count = math.prod(shape) if shape else 1
    width = {TEXT: 1, BYTE: 1, INTEGER: 2, REAL: 4}.get(kind)
    begin = at + 2 + dimensions
    if width is None or len(shape) < dimensions or begin + count * width > len(section):
        return None
    data = section[begin : begin + count * width]
    if kind == TEXT:
        text = data.decode("latin-1")
        if len(shape) < 2:
            return text.strip("\x00 ")
        wide = max(shape[0], 1)
        return [text[i : i + wide].strip("\x00 ") for i in range(0, len(text), wide)]
    form = {BYTE: "B", INTEGER: "h", REAL: "f"}[kind]
    return list(struct.unpack(f"{endian}{count}{form}", data))


def _signed(byte: int) -> int:
    return byte - 256 if byte > 127 else byte


def _number(value: Any, otherwise: float) -> float:
    usable = isinstance(value, list) and len(value) == 1 and not isinstance(value[0], str)
    return float(value[0]) if usable else float(otherwise)


def _text(value: Any) -> str:
    if isinstance(value, list):
        return str(value[0]) if value else ""
    return value if isinstance(value, str) else ""


def _damaged(path: Path, why: str) -> InputError:
    return InputError(f"{path} is damaged, or no C3D file: {why}; export it anew")
