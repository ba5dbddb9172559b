"""USB devices found by serial number, wherever they are plugged in."""

from dataclasses import dataclass

import pytest

from imu_rig.devices import ports
from imu_rig.devices.ports import find_usb, open_port, usb_address
from imu_rig.errors import PortError, PortMissing


@dataclass
class Listed:
    """A port as pyserial lists it."""

    device: str
    vid: int | None
    pid: int | None
    serial_number: str | None
    description: str = "n/a"
    location: str | None = None


@pytest.fixture
def plugged(monkeypatch):
    listed = [
        Listed("/dev/ttyUSB0", 0x0403, 0x6001, "FT1"),
        Listed("/dev/ttyUSB1", 0x0403, 0x6001, "FT2"),
        Listed("COM7", 0x0403, 0x6015, "FT3A"),
        Listed("/dev/ttyACM0", 0x1FFB, 0x0089, "00042"),
        Listed("/dev/ttyACM1", 0x1FFB, 0x0089, "00042"),
        Listed("/dev/ttyS0", None, None, None),
    ]
    monkeypatch.setattr(ports.list_ports, "comports", lambda: listed)
    return listed


def test_a_serial_number_finds_the_port_of_the_moment(plugged):
    assert find_usb("usb:FT2") == "/dev/ttyUSB1"
    plugged[1].device = "/dev/ttyUSB7"
    assert find_usb("usb:0403:6001:FT2") == "/dev/ttyUSB7"
    assert find_usb("usb:0403:6015") == "COM7"
    assert find_usb("usb:FT3") == "COM7"  # Windows appends the channel's letter


def test_an_address_is_what_finds_the_port_again(plugged):
    for port in ("/dev/ttyUSB0", "/dev/ttyUSB1", "COM7"):
        assert find_usb(usb_address(port)) == port


@pytest.mark.parametrize("serial", ["1,layout=zzz", "a\x1b[2Jb", "two words", "x" * 65, "é"])
def test_a_serial_number_that_is_more_than_that_is_no_address(plugged, serial):
    plugged[0].serial_number = serial
    assert usb_address("/dev/ttyUSB0") is None


def test_descriptions_from_outside_are_short_and_plain(plugged):
    plugged[0].description = "cl\x1bear " + "very " * 1000 + "long"
    described = {port.url: port.description for port in ports.seen_ports()}["/dev/ttyUSB0"]
    assert described.isprintable()
    assert len(described) <= 60


@pytest.mark.parametrize("address", ["", " ", "usb:", "usb:0403:", "usb:0403:6001:"])
def test_an_address_without_a_device_is_none(plugged, address):
    with pytest.raises(PortError) as refused:
        open_port(address)
    assert not isinstance(refused.value, PortMissing)  # which would be waited for


def test_a_serial_number_noted_on_windows_is_found_elsewhere(plugged):
    assert find_usb("usb:0403:6001:FT1A") == "/dev/ttyUSB0"
    with pytest.raises(PortMissing):  # of other makers the letter may be part of the number
        find_usb("usb:00042A")


def test_of_a_maestro_it_is_the_command_port(plugged):
    plugged[3].location, plugged[4].location = "1-2:1.0", "1-2:1.2"
    assert find_usb("usb:00042") == "/dev/ttyACM0"
    assert find_usb("usb:1FFB:0089") == "/dev/ttyACM0"
    assert usb_address("/dev/ttyACM0") == "usb:1FFB:0089:00042"
    assert usb_address("/dev/ttyACM1") is None


def test_what_cannot_be_told_apart_has_no_address(plugged):
    assert usb_address("/dev/ttyACM0") is None  # two ports of one Maestro
    assert usb_address("/dev/ttyS0") is None
    assert usb_address("/dev/rfcomm0") is None


def test_addresses_that_find_nothing_or_too_much_are_explained(plugged):
    with pytest.raises(PortMissing, match=r"No device usb:FT9 is plugged in.*ports seen now"):
        open_port("usb:FT9")
    with pytest.raises(PortError, match=r"more than one port \(/dev/ttyACM0, /dev/ttyACM1\)"):
        find_usb("usb:00042")
    with pytest.raises(PortError, match="is no USB address"):
        find_usb("usb:zz:1:FT1")
