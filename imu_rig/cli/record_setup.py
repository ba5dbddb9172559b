"""What the options of `imu-rig record` say, made one setup with that of a file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from imu_rig.errors import InputError
from imu_rig.foreign_text import one_line
from imu_rig.recorder.setup import DeviceSetup, TrialSetup, load_setup

_UNITS_S = {"s": 1.0, "min": 60.0, "h": 3600.0}
_LONG_UNITS = {"": "s", "sec": "s", "second": "s", "m": "min", "minute": "min", "hour": "h"}
_PART = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*([a-z]*)\s*")
DEVICE_FORM = (
    "write --device NAME=PORT, or PORT alone, then what differs from the usual: "
    '"left shoe=/dev/ttyUSB0,layout=baro-16,baud=230400,certificate=left.json,optional", or '
    "optional=STREAM for one of several on its port"
)
ONE_NAME = "imu"


@dataclass(frozen=True)
class Options:
    """Options of the command, as they were typed; None or empty where they were not.

    ``doing`` is what the command does with devices, for sentences.
    """

    setup: Path | None = None
    devices: Sequence[str] = ()
    layout: str | None = None
    certificate: Path | None = None
    maestro: str | None = None
    jig: str | None = None
    maestro_device: int | None = None
    maestro_crc: bool = False
    duration: str | None = None
    subject: str | None = None
    session: str | None = None
    trial: str | None = None
    note: str | None = None
    doing: str = "record"


def setup_from(options: Options, more: Sequence[DeviceSetup] = ()) -> TrialSetup:
    """Make one setup of options and file; options replace and add.

    ``more`` are devices that neither names.

    Raises
    ------
    InputError
        In one sentence that names the option or the file and its field.
    """
    base = TrialSetup() if options.setup is None else load_setup(options.setup)
    devices = {device.name: device for device in (*base.devices, *more)}
    named: set[str] = set()
    for text in options.devices:
        device = device_from(text, devices)
        if device.name in named:
            raise InputError(
                f"--device names {one_line(device.name, 60)!r} twice: each device needs a name of "
                "its own."
            )
        named.add(device.name)
        if options.layout is not None and "layout" not in device.model_fields_set:
            device = device.model_copy(update={"layout": options.layout})
        devices[device.name] = device
    if options.certificate is not None:
        if len(devices) != 1:
            raise InputError(
                f"--certificate is for one device and there are {len(devices)}: state each one's "
                'in --device "NAME=PORT,certificate=FILE".'
            )
        devices = {
            name: d.model_copy(update={"certificate": options.certificate})
            for name, d in devices.items()
        }
    if not devices:
        raise InputError(
            f"Nothing to {options.doing}: name a device with --device PORT, devices in a file with "
            "--setup FILE, or try it without hardware by --simulate 2."
        )
    words = {
        name: value
        for name in ("subject", "session", "trial", "note")
        if (value := getattr(options, name)) is not None
    }
    values: dict[str, Any] = {
        **base.model_dump(include=set(TrialSetup.model_fields) - {"devices", "jig"}),
        **words,
        "devices": tuple(devices.values()),
        "jig": _jig(options, base),
    }
    if options.duration is not None:
        values["duration_s"] = duration_s(options.duration)
    return TrialSetup.of(values, "Options" if options.setup is None else str(options.setup))


def _jig(options: Options, base: TrialSetup) -> Any:
    stated: dict[str, Any] = {
        "maestro": options.maestro,
        "file": options.jig,
        "device": options.maestro_device,
        "crc": options.maestro_crc or None,
    }
    stated = {name: value for name, value in stated.items() if value is not None}
    if base.jig is not None:
        return {**base.jig.model_dump(), **stated}
    if stated and options.maestro is None:
        raise InputError("--jig is recorded by its servo controller: name its port with --maestro.")
    return stated or None


def device_from(text: str, known: Any = ()) -> DeviceSetup:
    """Return one device as ``--device`` tells it; one without a name gets one that is free.

    Raises
    ------
    InputError
        If it cannot be understood.
    """
    head, *settings = (part.strip() for part in text.split(","))
    name, equals, port = head.partition("=")
    if not equals or name.startswith(("/", ".")) or "://" in name:  # a port, or its address
        name, port = _free_name(known), head
    values: dict[str, Any] = {"name": name.strip(), "port": port.strip()}
    for setting in settings:
        key, equals, value = (part.strip() for part in setting.partition("="))
        if key == "optional" and not equals:
            values["required"] = False
        elif key == "optional" and value:
            values["optional_streams"] = (*values.get("optional_streams", ()), value)
        elif key.startswith("certificate.") and value:
            stream = key.removeprefix("certificate.")
            values["certificates"] = {**values.get("certificates", {}), stream: value}
        elif key in ("layout", "baud", "certificate") and value:
            values[key] = value
        else:
            raise InputError(
                f"--device {one_line(text)!r}: {one_line(setting, 60)!r} is not understood; "
                f"{DEVICE_FORM}."
            )
    if not values["port"] or not values["name"]:
        raise InputError(
            f"--device {one_line(text)!r} has no {'port' if values['name'] else 'name'}; "
            f"{DEVICE_FORM}."
        )
    checked = TrialSetup.of({"devices": (values,)}, f"--device {one_line(text)!r}")
    return checked.devices[0]


def _free_name(known: Any) -> str:
    number = 1
    while (name := ONE_NAME if number == 1 else f"{ONE_NAME}{number}") in known:
        number += 1
    return name


def duration_s(text: str) -> float:
    """Return the seconds of ``60``, ``90 s``, ``2min``, ``1h 30min`` or ``2:30``.

    Raises
    ------
    InputError
        If it is none of these.
    """
    words = text.strip().lower()
    if re.fullmatch(r"\d{1,4}(:[0-5]\d){1,2}", words):
        seconds = 0.0
        for part in words.split(":"):
            seconds = 60 * seconds + int(part)
    else:
        parts = _PART.findall(words)
        if not parts or _PART.sub("", words) or (len(parts) > 1 and not all(u for _, u in parts)):
            raise _no_duration(text)
        seconds = 0.0
        for number, unit in parts:
            known = _LONG_UNITS.get(unit.removesuffix("s") if len(unit) > 1 else unit, unit)
            if known not in _UNITS_S:
                raise _no_duration(text)
            seconds += float(number) * _UNITS_S[known]
    if not 0 < seconds <= 30 * 86_400:
        raise InputError(
            f"--duration {one_line(text, 40)!r} is not between 0 s and 30 days; leave it out to "
            "record until you stop it."
        )
    return seconds


def _no_duration(text: str) -> InputError:
    return InputError(
        f"--duration {one_line(text, 40)!r} is no duration: write seconds, or 2min, 1h30min, 2:30."
    )
