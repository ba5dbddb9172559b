"""Between rows of packets, integer counts and values in the layout's units; and rows to bytes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from firmware_protocols.checksums import checksum_rows
from firmware_protocols.fields import Field, LayoutError
from firmware_protocols.layout import PacketLayout
from firmware_protocols.rows import RowLayout

FloatArray = npt.NDArray[np.float64]
AnyArray = npt.NDArray[Any]
BoolArray = npt.NDArray[np.bool_]
Rows = npt.NDArray[np.void]


def counts(layout: RowLayout, rows: Rows, name: str) -> AnyArray:
    """Return one field as the device counted it, on the device's own axes, without flags.

    Parameters
    ----------
    layout : RowLayout
    rows : shape (n,), structured
        Packets, of ``layout.dtype``.
    name : str
        Field name.

    Returns
    -------
    shape (n,) or (n, count), int64; float64 for f32 and f64; uint8 for pads
    """
    field = layout.field(name)
    raw = rows[name]
    if field.type == "pad":
        return raw
    if not field.is_integer:
        return _as_floats(raw)
    whole = _whole(layout, field, raw)
    return whole if field.low_bits is None else _low(whole, field)


def flag(layout: RowLayout, rows: Rows, name: str, bit: int) -> BoolArray:
    """Return whether a bit of an integer field is set, counted from the lowest; shape (n,).

    Of several numbers, whether it is set in any.
    """
    is_set: BoolArray = (_whole(layout, layout.field(name), rows[name]) >> bit & 1).astype(np.bool_)
    if is_set.ndim > 1:
        is_set = np.any(is_set, axis=1)
    return is_set


def values(layout: RowLayout, rows: Rows, name: str) -> FloatArray:
    """Return one field in its unit, on the axes that the layout maps it to.

    Returns
    -------
    shape (n,) or (n, count), float64
        ``(counts - zero) / counts_per_unit``, then turned by ``axes``; infinite where that is
        beyond a number, as by a layout that nobody measured with.
    """
    field = layout.field(name)
    if field.bits == 24 or field.low_bits is not None:
        scaled: FloatArray = counts(layout, rows, name).astype(np.float64)
    else:
        scaled = _as_floats(rows[name])
    with np.errstate(over="ignore"):
        if field.zero != 0.0:
            scaled -= field.zero
        scaled /= _scale(layout, field, rows, scaled.ndim)
    if field.axes is None:
        return scaled
    columns, signs = _axes(field.axes)
    turned: FloatArray = scaled[:, columns]
    turned *= signs
    return turned


def quantize(
    layout: RowLayout, name: str, of_values: npt.ArrayLike, *, selected: int | None = None
) -> AnyArray:
    """Return the counts that a device sends for values: the inverse of :func:`values`.

    Rounds to the nearest count and stays at the end of the type's range beyond it, as a
    saturated sensor does. Floating-point fields are not rounded.

    Parameters
    ----------
    layout : RowLayout
    name : str
        Field name.
    of_values : shape (n,) or (n, count)
        Values in the field's unit on the layout's axes; must be finite.
    selected : int, optional
        Count of the field that ``scale_by`` names, where there is one; otherwise the first.
    """
    field = layout.field(name)
    raw = np.asarray(of_values, dtype=np.float64)
    if field.axes is not None:
        columns, signs = _axes(field.axes)
        turned = np.empty_like(raw)
        turned[..., columns] = raw * signs
        raw = turned
    scale = field.counts_per_unit
    if field.scales:
        scale = dict(field.scales)[field.scales[0][0] if selected is None else selected]
    raw = raw * scale + field.zero
    if not field.is_integer:
        return raw
    lo, hi = field.limits
    return np.clip(np.rint(raw), lo, hi).astype(np.int64)


def encode(layout: PacketLayout, rows: Rows | Mapping[str, npt.ArrayLike]) -> bytes:
    """Return packets as bytes, with header and checksum filled in.

    Parameters
    ----------
    layout : PacketLayout
    rows : structured array of ``layout.dtype``, or mapping of field name to counts
        Of a mapping every field but pads must be there, with shape (n,) or (n, count), or without
        the n for all packets alike; flags, with shape (n,) or none, are 0 where they are not.

    Raises
    ------
    ValueError
        For a field that is missing, unknown, of the wrong shape or out of its type's range.
    """
    if isinstance(rows, Mapping):
        packed = _pack(layout, rows)
    else:
        if rows.dtype != layout.dtype:
            raise ValueError(f"layout {layout.name}: the rows are of another layout.")
        packed = np.array(rows, ndmin=1)
    packed["header"] = np.frombuffer(layout.header, dtype=np.uint8)
    if layout.checksum is not None:
        table = packed.view(np.uint8).reshape(len(packed), layout.length)
        covered = table[:, layout.checksum.start : layout.length - layout.checksum.size]
        packed["checksum"] = checksum_rows(layout.checksum.kind, covered)
    return packed.tobytes()


def _pack(layout: PacketLayout, columns: Mapping[str, npt.ArrayLike]) -> Rows:
    flags = {name: (field, bit) for field in layout.fields for name, bit in field.flags}
    for name in columns:
        if name not in flags:
            layout.field(name)
    arrays: dict[str, AnyArray] = {}
    number = 1
    for field in layout.fields:
        if field.name not in columns:
            if field.type == "pad":
                continue
            raise LayoutError(f"layout {layout.name}: the field {field.name!r} is not given.")
        array = np.asarray(columns[field.name])
        arrays[field.name] = array
        if array.ndim == (2 if _is_vector(field) else 1):
            number = len(array) if number == 1 else number
    rows = np.zeros(number, dtype=layout.dtype)
    for name, array in arrays.items():
        _store(layout, layout.field(name), array, rows)
    for name, (field, bit) in flags.items():
        if name in columns:
            _set_flag(layout, field, rows, np.asarray(columns[name]), bit)
    return rows


def _set_flag(layout: RowLayout, field: Field, rows: Rows, is_set: AnyArray, bit: int) -> None:
    """Set a bit in whole numbers, in all of several, in place."""
    numbers = rows[field.name]
    if field.bits == 24:
        place = 2 - bit // 8 if layout.order(field) == "big" else bit // 8
        numbers, bit = numbers[..., place], bit % 8
    unsigned = numbers.view(numbers.dtype.str.replace("i", "u"))
    which = np.broadcast_to(is_set.astype(np.bool_), numbers.shape[:1])
    unsigned[which] |= unsigned.dtype.type(1 << bit)


def _store(layout: PacketLayout, field: Field, array: AnyArray, rows: Rows) -> None:
    where = f"layout {layout.name}: field {field.name!r}"
    shape = (len(rows), field.count) if _is_vector(field) else (len(rows),)
    try:
        array = np.broadcast_to(array, shape)
    except ValueError:
        raise LayoutError(f"{where} has shape {array.shape}, not {shape}.") from None
    if field.is_integer or field.type == "pad":
        lo, hi = field.limits if field.is_integer else (0, 255)
        if array.dtype.kind not in "iub":
            raise LayoutError(f"{where} takes whole numbers (counts), not {array.dtype}.")
        if array.size and not (lo <= int(array.min()) and int(array.max()) <= hi):
            raise LayoutError(f"{where} takes counts of {lo} to {hi}.")
    if field.low_bits is not None:
        array = array.astype(np.int64) & ((1 << field.low_bits) - 1)
    if field.bits == 24:
        rows[field.name] = _to_24_bits(array.astype(np.int64), layout.order(field))
    elif field.low_bits is not None and field.type[0] == "i":
        code = rows.dtype[field.name].base.str
        rows[field.name] = array.astype(code.replace("i", "u")).view(code)
    else:
        rows[field.name] = array


def _is_vector(field: Field) -> bool:
    return field.count > 1 or field.type == "pad"


def _whole(layout: RowLayout, field: Field, raw: AnyArray) -> AnyArray:
    """Return an integer field with the flags above its number."""
    if field.bits == 24:
        return _from_24_bits(raw, layout.order(field), signed=field.type[0] == "i")
    return raw.astype(np.int64)


def _low(whole: AnyArray, field: Field) -> AnyArray:
    """Return the number in the low bits."""
    number = whole & ((1 << field.number_bits) - 1)
    if field.type[0] == "i":
        number -= (number & (1 << (field.number_bits - 1))) << 1
    return number


def _scale(layout: RowLayout, field: Field, rows: Rows, dimensions: int) -> FloatArray | float:
    """Return the counts per unit, of each row where another field selects it."""
    if field.scale_by is None:
        return field.counts_per_unit
    selected = counts(layout, rows, field.scale_by)
    scale = np.full(len(rows), np.nan)
    for count, of_count in field.scales:
        scale[selected == count] = of_count
    return scale[:, np.newaxis] if dimensions > 1 else scale


def _axes(axes: tuple[str, ...]) -> tuple[list[int], FloatArray]:
    columns = ["xyz".index(a[1]) for a in axes]
    return columns, np.array([-1.0 if a[0] == "-" else 1.0 for a in axes])


def _as_floats(raw: AnyArray) -> FloatArray:
    with np.errstate(invalid="ignore"):  # bytes may be those of a NaN that signals
        return raw.astype(np.float64)


def _from_24_bits(raw: AnyArray, byte_order: str, *, signed: bool) -> AnyArray:
    wide = raw.astype(np.int64)
    if byte_order == "little":
        wide = wide[..., ::-1]
    number = wide[..., 0] << 16 | wide[..., 1] << 8 | wide[..., 2]
    return number - ((number & 0x800000) << 1) if signed else number


def _to_24_bits(number: AnyArray, byte_order: str) -> AnyArray:
    split = np.stack([number >> 16, number >> 8, number], axis=-1) & 0xFF
    return split[..., ::-1] if byte_order == "little" else split
