"""What is to be recorded: devices, jig and trial, from a small TOML file or from options."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from firmware_protocols.known import load_protocol
from firmware_protocols.layout import DEFAULT_LAYOUT_NAME, LayoutError
from firmware_protocols.protocol import DeviceProtocol
from imu_rig.devices.ports import DEFAULT_BAUD
from imu_rig.errors import InputError
from imu_rig.files import parse_toml, read_small
from imu_rig.validation import ONE_LINE, sentence

MAX_SETUP_BYTES = 1 << 16
MAX_DEVICES = 64
JIG_SOURCE = "jig"

_PRINTABLE = re.compile(r"[^\x00-\x1f\x7f]+")

Text = Annotated[str, Field(max_length=200), ONE_LINE]
Name = Annotated[str, Field(min_length=1, max_length=60), ONE_LINE]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class DeviceSetup(_Model):
    """One device to record.

    Attributes
    ----------
    name : str
        What people call it: "left shoe". Unique in the trial.
    port : str
        A path, ``COM5``, ``socket://host:port``, or ``usb:SERIAL`` / ``usb:VID:PID:SERIAL``.
    layout : str
        What it speaks: name of a built-in packet layout or protocol, or a file.
    baud : int
    required : bool
        Whether the trial is worth nothing without it.
    optional_streams : tuple of str
        Those of several streams on its port that may stay away.
    certificate : Path or None
        Of its calibration; kept in the trial beside the raw bytes.
    certificates : dict of str to Path
        The same for several inertial sensors on its port, by stream.
    """

    name: Name
    port: Annotated[str, Field(min_length=1, max_length=400)]
    layout: str = DEFAULT_LAYOUT_NAME
    baud: Annotated[int, Field(ge=50, le=20_000_000)] = DEFAULT_BAUD
    required: bool = True
    optional_streams: Annotated[tuple[Name, ...], Field(max_length=64)] = ()
    certificate: Path | None = None
    certificates: Annotated[dict[str, Path], Field(max_length=64)] = {}

    @field_validator("name")
    @classmethod
    def _not_the_jig(cls, name: str) -> str:
        if name == JIG_SOURCE:
            raise ValueError(f"the name {JIG_SOURCE!r} is kept for the jig; choose another")
        return name

    @field_validator("port")
    @classmethod
    def _printable(cls, port: str) -> str:
        if not _PRINTABLE.fullmatch(port):
            raise ValueError("a port has no control characters in its name")
        return port

    def protocol(self) -> DeviceProtocol:
        """Load what it speaks.

        Raises
        ------
        InputError
            If there is none of that name, or the file cannot be used; if a stream is called
            optional that it does not have.
        """
        try:
            protocol = load_protocol(self.layout)
        except LayoutError as error:
            raise InputError(f"Device {self.name!r}: {error}") from error
        names = ", ".join(name for name in protocol.streams if name)
        has = f"its streams are {names}" if names else "it sends one stream, which has no name"
        for stream in self.optional_streams:
            if stream not in protocol.streams:
                raise InputError(f"Device {self.name!r}: no stream {stream!r} is optional; {has}.")
        inertial = protocol.inertial_streams
        for stream in self.certificates:
            if stream not in inertial:
                raise InputError(
                    f"Device {self.name!r}: no stream {stream!r} has a certificate; {has}."
                )
        if self.certificate is not None and len(inertial) > 1:
            raise InputError(
                f"Device {self.name!r} has several sensors: say of which stream the certificate "
                f"is, as in certificate.{inertial[0]}=FILE."
            )
        return protocol


class JigSetup(_Model):
    """A jig whose servo controller is recorded and which is parked at the end.

    Attributes
    ----------
    maestro : str
        Command port of the controller.
    file : str
        Jig description.
    device : int or None
        Pololu device number, where controllers share a line.
    crc : bool
    """

    maestro: Annotated[str, Field(min_length=1, max_length=400)]
    file: str = "paper-jig"
    device: int | None = None
    crc: bool = False


class TrialSetup(_Model):
    """Everything a recording needs to know before it opens a port.

    Attributes
    ----------
    subject, session, trial, note : str
        Who, when and what, in the lab's own words; kept in the file.
    duration_s : float or None
        Planned duration; None goes on until stopped.
    devices : tuple of DeviceSetup
    jig : JigSetup or None
    """

    subject: Text = ""
    session: Text = ""
    trial: Text = ""
    note: Annotated[str, Field(max_length=2000), ONE_LINE] = ""
    duration_s: Annotated[float, Field(gt=0, le=30 * 86_400, allow_inf_nan=False)] | None = None
    devices: Annotated[tuple[DeviceSetup, ...], Field(max_length=MAX_DEVICES)] = ()
    jig: JigSetup | None = None

    @model_validator(mode="after")
    def _consistent(self) -> TrialSetup:
        names = [device.name for device in self.devices]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two devices have the name {name!r}; rename one of them")
            owner = name.rpartition("/")[0]
            if owner in names:
                raise ValueError(
                    f"the name {name!r} reads like a stream of {owner!r}; rename one of the two"
                )
        ports = [device.port for device in self.devices]
        if self.jig is not None:
            ports.append(self.jig.maestro)
        for port in ports:
            if ports.count(port) > 1:
                raise ValueError(f"the port {port} is there twice; one port is one device")
        return self

    @classmethod
    def of(cls, values: dict[str, Any], source: str) -> TrialSetup:
        """Check plain data.

        Raises
        ------
        InputError
            One sentence that begins with ``source`` and names the field.
        """
        try:
            return cls.model_validate(values)
        except ValidationError as error:
            raise InputError(f"{source}: {sentence(error, 'a recording setup')}.") from error


def load_setup(path: Path) -> TrialSetup:
    """Read a setup file; layouts, certificates and jig files are looked for beside it.

    Raises
    ------
    InputError
        If it cannot be read or used.
    """
    values = parse_toml(read_small(path, MAX_SETUP_BYTES, what="a recording setup"), str(path))
    setup = TrialSetup.of(values, str(path))
    folder = path.parent

    def beside(name: str) -> str:
        return str(folder / name) if name.endswith(".toml") and "://" not in name else name

    devices = tuple(
        device.model_copy(
            update={
                "layout": beside(device.layout),
                "certificate": device.certificate and folder / device.certificate,
                "certificates": {
                    stream: folder / file for stream, file in device.certificates.items()
                },
            }
        )
        for device in setup.devices
    )
    jig = setup.jig and setup.jig.model_copy(update={"file": beside(setup.jig.file)})
    return setup.model_copy(update={"devices": devices, "jig": jig})
