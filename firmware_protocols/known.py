"""Every protocol that is known by name or kind, and the ones that a lab describes itself.

A description is a TOML file, or the same as plain data in a trial file. Without a key "kind" it is
that of packets of one fixed length.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

from firmware_protocols.fields import LayoutError, quote
from firmware_protocols.layout import PacketLayout, builtin_names, read_description
from firmware_protocols.protocol import DeviceProtocol

KINDS = {
    "interleaved": "firmware_protocols.interleaved:from_dict",
    "xsens-mti": "firmware_protocols.xsens:from_dict",
    "mavlink": "firmware_protocols.mavlink:from_dict",
}
"""Where the reader of each kind of description is, imported when it is needed."""


def load_protocol(path_or_name: str | Path) -> DeviceProtocol:
    """Load what a device speaks from a TOML file, or the built-in one of that name.

    Raises
    ------
    LayoutError
        For a file that is missing, too large or not a usable description.
    """
    data, source = read_description(path_or_name)
    return protocol_from_dict(data, source=source)


def protocol_from_dict(data: Mapping[str, Any], *, source: str = "packet layout") -> DeviceProtocol:
    """Build a protocol from plain data, checking every key and type.

    Parameters
    ----------
    data : mapping
        As `DeviceProtocol.to_dict` gives it or a TOML file holds it.
    source : str
        Where the data come from; every error begins with it.

    Raises
    ------
    LayoutError
        For anything that is not a usable description.
    """
    if "kind" not in data:
        return PacketLayout.from_dict(data, source=source)
    kind = data["kind"]
    if not isinstance(kind, str) or kind not in KINDS:
        raise LayoutError(
            f"{source}: the kind {quote(kind)} is not known (known: {', '.join(KINDS)}; leave it "
            "out for packets of one fixed length)."
        )
    module, name = KINDS[kind].split(":")
    read: Callable[[Mapping[str, Any]], DeviceProtocol] = getattr(import_module(module), name)
    try:
        return read(data)
    except LayoutError as error:
        raise LayoutError(f"{source}: {error}") from None


@lru_cache(maxsize=1)
def builtin_protocols() -> Mapping[str, DeviceProtocol]:
    """Return every built-in protocol by its name."""
    return {name: load_protocol(name) for name in builtin_names()}
