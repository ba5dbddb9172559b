"""The error tree. Every message is one sentence that names what is wrong and what to do.

::

    ImuRigError            exit code 1
    ├── InputError         2   a file, option or value that cannot be used
    │   ├── DataError      2   data that cannot determine what was asked of them
    │   └── NameTaken      2   a file that exists already and is never overwritten
    ├── PortError          3   a port that cannot be opened: forbidden, busy
    │   └── PortMissing    3   ... because it is not there, or its device does not answer
    ├── DeviceError        4   a device that answers wrongly
    │   ├── DeviceLost     4   a device that went silent or was unplugged
    │   └── LimitError     4   a command that would leave the limits of the jig file
    ├── StorageError       5   the disk is full or fails
    └── SessionStopped     6   a session ended before its last pose; what it measured is kept
        ├── AnotherSensor  6   ... because another sensor was to go on with it
        └── SessionInterrupted  130   ... because its user said so (Ctrl-C, SIGTERM, SIGHUP)

Three exit codes are no errors. 7: `imu-rig verify` found a sensor that is not what its certificate
says, or could not tell. 8: `imu-rig record` kept all it was sent, and that is not all there was.
9: `imu-rig doctor` found something that will not work as it is.
"""

from typing import ClassVar

NOT_VERIFIED_EXIT = 7
INCOMPLETE_EXIT = 8
NOT_READY_EXIT = 9


class ImuRigError(Exception):
    """Anything that imu-rig reports to its user in one sentence."""

    exit_code: ClassVar[int] = 1


class InputError(ImuRigError):
    """A file, option or value that cannot be used.

    Examples: a CSV without the named column, a jig file with a limit below its minimum.
    """

    exit_code = 2


class DataError(InputError):
    """Data that are well formed but cannot determine what was asked of them.

    Examples: too few poses, every pose upside up, an axis at its range limit.
    """


class NameTaken(InputError):  # noqa: N818  (the state is what its reader goes by)
    """A file that exists already and is never overwritten; another name will do."""


class PortError(ImuRigError):
    """A port that cannot be opened.

    Examples: no such device file, no permission, open in another program.
    """

    exit_code = 3


class PortMissing(PortError):  # noqa: N818  (as its sibling of devices)
    """A port that is not there now and may come: the device is not plugged in or switched off."""


class DeviceError(ImuRigError):
    """A device that answers, but not as it should.

    Examples: packets of another layout, a servo controller that latched an error.
    """

    exit_code = 4


class DeviceLost(DeviceError):  # noqa: N818  (the state is the name users meet)
    """A device that was there and is silent or unplugged now."""


class LimitError(DeviceError):
    """A command that would leave the limits of the jig file; it was not sent."""


class StorageError(ImuRigError):
    """The disk is full or fails; what was acknowledged before stays readable."""

    exit_code = 5


class SessionStopped(ImuRigError):  # noqa: N818
    """A session that ended before its last pose; the trial file keeps what was measured."""

    exit_code = 6


class AnotherSensor(SessionStopped):
    """A session that was to go on with a sensor that is not the one it began with."""


class SessionInterrupted(SessionStopped):
    """A session that its user stopped; everything is parked and closed before this is raised."""

    exit_code = 130


def reason_of(error: Exception) -> str:
    """Why something of the system or a library failed, without its number."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
