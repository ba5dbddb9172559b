"""The doctor on machines that do not exist: made-up trees of /dev, /etc, /proc and /sys."""

import stat
from collections import namedtuple
from functools import partial
from pathlib import Path

import pytest

from imu_rig.devices.doctor import disk, machine, maestro
from imu_rig.devices.doctor.bluetooth import check_bluetooth
from imu_rig.devices.doctor.disk import DiskSpeed, check_disk, check_kind, check_room, judge_speed
from imu_rig.devices.doctor.examine import examine
from imu_rig.devices.doctor.machine import (
    check_clock,
    check_packages,
    check_python,
    check_simulated_ports,
    check_windows_ports,
)
from imu_rig.devices.doctor.maestro import check_maestro
from imu_rig.devices.doctor.serial_ports import check_grabbers, check_latency, check_permissions
from imu_rig.devices.doctor.system import Owner, System
from imu_rig.devices.maestro import MaestroClient
from imu_rig.devices.ports import SeenPort
from simulators.models import MaestroModel
from simulators.served_devices import ServedDevices

DIALOUT, OTHERS = 20, 1000
TTY = stat.S_IFCHR | 0o660


class Machine:
    """A tree of files below a folder, and a user who looks at it."""

    def __init__(self, root: Path):
        self.root = root
        self.write("etc/group", "root:x:0:\ndialout:x:20:alice\ntty:x:5:\nusers:x:1000:\n")

    def write(self, path: str, text: str = "") -> Path:
        file = self.root / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        return file

    def link(self, path: str, to: str) -> None:
        (self.root / path).parent.mkdir(parents=True, exist_ok=True)
        (self.root / path).symlink_to(to)

    def system(self, *, user="bob", groups=(OTHERS,), owner=None, may_use=False, uid=1000, **more):
        return System(
            root=self.root,
            platform=more.pop("platform", "linux"),
            user=user,
            uid=uid,
            groups=frozenset(groups),
            owner=lambda path: owner or Owner(0, DIALOUT, TTY),
            may_use=lambda path: may_use,
            **more,
        )


@pytest.fixture
def made_up(tmp_path):
    return Machine(tmp_path)


# --- permissions ----------------------------------------------------------------------------------


def test_a_user_outside_the_group_is_told_the_command(made_up):
    made_up.write("dev/ttyUSB0")
    (check,) = check_permissions(made_up.system())
    assert check.state == "bad"
    assert "/dev/ttyUSB0" in check.found
    assert "group dialout" in check.found
    assert "out and in" in check.advice
    assert check.commands == ("sudo usermod -aG dialout bob",)


def test_a_user_who_joined_after_logging_in_needs_no_command(made_up):
    made_up.write("dev/ttyACM0")
    (check,) = check_permissions(made_up.system(user="alice"))
    assert check.state == "bad"
    assert "after logging in" in check.found
    assert not check.commands


@pytest.mark.parametrize(
    ("owner", "groups", "uid", "by"),
    [
        (Owner(0, DIALOUT, TTY), {OTHERS, DIALOUT}, 1000, "group dialout"),
        (Owner(0, DIALOUT, TTY), {OTHERS}, 1000, "access list"),
        (Owner(1000, DIALOUT, TTY), {OTHERS}, 1000, "belongs to bob"),
        (Owner(0, 0, stat.S_IFCHR | 0o666), {OTHERS}, 1000, "anybody"),
        (Owner(0, 0, TTY), {0}, 0, "root"),
    ],
)
def test_what_allows_a_port_is_named(made_up, owner, groups, uid, by):
    made_up.write("dev/ttyUSB0")
    system = made_up.system(owner=owner, groups=groups, uid=uid, may_use=True)
    (check,) = check_permissions(system)
    assert check.state == "ok"
    assert by in check.found


@pytest.mark.parametrize("owner", [Owner(0, 0, TTY), Owner(0, DIALOUT, stat.S_IFCHR | 0o600)])
def test_a_port_of_root_alone_needs_a_udev_rule(made_up, owner):
    made_up.write("dev/ttyACM3")
    (check,) = check_permissions(made_up.system(owner=owner))
    assert check.state == "bad"
    assert 'KERNEL=="ttyACM*"' in check.commands[0]
    assert "udevadm" in check.commands[1]


def test_the_group_of_other_systems_is_found_by_the_file(made_up):
    made_up.write("etc/group", "uucp:x:14:\n")
    made_up.write("dev/ttyUSB0")
    (check,) = check_permissions(made_up.system(owner=Owner(0, 14, TTY)))
    assert check.commands == ("sudo usermod -aG uucp bob",)


def test_without_ports_the_group_is_checked_all_the_same(made_up):
    (check,) = check_permissions(made_up.system())
    assert (check.state, check.commands) == ("warn", ("sudo usermod -aG dialout bob",))
    (check,) = check_permissions(made_up.system(user="alice"))
    assert check.state == "warn"
    assert "Log out" in check.advice
    (check,) = check_permissions(made_up.system(groups={DIALOUT}))
    assert check.state == "ok"


def test_a_tree_without_anything_breaks_no_check(tmp_path):
    system = System(root=tmp_path / "nothing", platform="linux", user="bob", uid=1)
    for check in (check_permissions, check_bluetooth):
        (found,) = check(system)
        assert found.state == "ok"
    assert check_grabbers(system) == check_latency(system) == []
    assert check_kind(system, tmp_path) == []


# --- who takes ports ------------------------------------------------------------------------------


def test_programs_that_take_ports_are_named(made_up):
    made_up.write("proc/10/comm", "ModemManager\n")
    made_up.write("proc/11/comm", "brltty\n")
    made_up.write("proc/self/comm", "doctor\n")
    modem, braille = check_grabbers(made_up.system())
    assert (modem.about, modem.state) == ("ModemManager", "warn")
    assert "ID_MM_DEVICE_IGNORE" in modem.commands[0]
    assert (braille.about, braille.state) == ("brltty", "warn")


def test_a_braille_rule_matters_only_with_an_adapter_that_it_takes(made_up):
    made_up.write("usr/lib/udev/rules.d/85-brltty.rules")
    assert check_grabbers(made_up.system()) == []
    made_up.write("sys/bus/usb/devices/1-2/idVendor", "1a86\n")
    made_up.write("sys/bus/usb/devices/1-2/idProduct", "7523\n")
    (check,) = check_grabbers(made_up.system())
    assert "1a86:7523" in check.found


def test_who_has_a_port_open_is_named_without_its_control_characters(made_up):
    made_up.write("dev/ttyUSB0")
    made_up.write("proc/77/comm", "mini\x1b[31mcom\n")
    made_up.link("proc/77/fd/5", "/dev/ttyUSB0")
    made_up.link("proc/77/fd/1", "/dev/null")
    (check,) = check_grabbers(made_up.system())
    assert "process 77" in check.found
    assert "\x1b" not in check.found


# --- latency, Bluetooth ---------------------------------------------------------------------------


def test_a_lazy_adapter_is_told_how_to_hurry(made_up):
    timer = "sys/bus/usb-serial/devices/ttyUSB{}/latency_timer"
    made_up.write(timer.format(0), "16\n")
    made_up.write(timer.format(1), "1\n")
    made_up.write("sys/bus/usb-serial/devices/ttyUSB2/other")
    made_up.write(timer.format(3), "soon\n")
    lazy, quick = check_latency(made_up.system())
    assert lazy.state == "warn"
    assert "16 ms" in lazy.found
    assert lazy.commands[0] == f"echo 1 | sudo tee /{timer.format(0)}"
    assert 'ATTR{latency_timer}="1"' in lazy.commands[1]
    assert quick.state == "ok"


def test_bluetooth_says_what_is_bound_and_how_to_bind(made_up):
    system = made_up.system(which=lambda name: f"/usr/bin/{name}")
    assert "no Bluetooth adapter" in check_bluetooth(system)[0].found
    made_up.write("sys/class/bluetooth/hci0/x")
    (check,) = check_bluetooth(system)
    assert check.state == "ok"
    assert any("rfcomm bind" in command for command in check.commands)
    (check,) = check_bluetooth(made_up.system(which=lambda name: None))
    assert check.state == "warn"
    made_up.write("dev/rfcomm0")
    made_up.write("sys/class/tty/rfcomm0/address", "00:1a:7d:da:71:13\n")
    (check,) = check_bluetooth(system)
    assert "/dev/rfcomm0 is bound to 00:1A:7D:DA:71:13" in check.found


# --- disk -----------------------------------------------------------------------------------------


def test_the_disk_is_written_to_and_left_as_it_was(tmp_path, made_up, monkeypatch):
    monkeypatch.setattr(disk, "WRITTEN_BYTES", 1 << 17)
    before = set(tmp_path.iterdir())
    checks = check_disk(made_up.system(), tmp_path / "not" / "made" / "yet")
    assert checks[0].about == "disk"
    assert "MB/s" in checks[0].found
    assert set(tmp_path.iterdir()) == before


def test_a_folder_that_takes_no_file_is_bad(tmp_path, made_up, monkeypatch):
    def refuse(folder):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(disk, "measure_disk", refuse)
    (check,) = check_disk(made_up.system(), tmp_path)
    assert check.state == "bad"
    assert "Permission denied" in check.found


@pytest.mark.parametrize(
    ("speed", "state"),
    [
        (DiskSpeed(100e6, 0.002, 0.01), "ok"),
        (DiskSpeed(1e6, 0.002, 0.01), "warn"),
        (DiskSpeed(100e6, 0.002, 0.6), "warn"),
        (DiskSpeed(100e6, 0.5, 3.0), "warn"),
    ],
)
def test_slow_disks_are_told(speed, state):
    check = judge_speed(speed, "/somewhere")
    assert check.state == state
    assert bool(check.advice) == (state != "ok")


@pytest.mark.parametrize(("free", "state"), [(50 << 20, "bad"), (500 << 20, "warn"), (1e11, "ok")])
def test_a_full_disk_is_told(tmp_path, monkeypatch, free, state):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(disk.shutil, "disk_usage", lambda path: usage(1e12, 0, free))
    assert check_room(tmp_path, "here")[0].state == state


@pytest.mark.parametrize(
    ("kind", "word"),
    [("nfs4", "another machine"), ("fuse.sshfs", "another machine"), ("tmpfs", "in memory")],
)
def test_other_kinds_of_disk_are_told(made_up, kind, word):
    mounts = f"/dev/sda1 / ext4 rw 0 0\nserver:/x /data/lab\\040one {kind} rw 0 0\nbroken\n"
    made_up.write("proc/mounts", mounts)
    system = made_up.system()
    assert check_kind(system, Path("/data")) == []
    (check,) = check_kind(system, Path("/data/lab one/trials"))
    assert check.state == "warn"
    assert word in check.found


# --- machine --------------------------------------------------------------------------------------


def test_packages_are_named_with_what_is_missing():
    (fine,) = check_packages(["numpy>=1.26", "rich>=13", "ruff>=99; extra == 'test'"])
    assert fine.state == "ok"
    old, *_ = check_packages(["numpy>=999.1", "no-such-package>=1"])
    assert old.state == "bad"
    assert "older than 999.1" in old.found
    assert "no-such-package is missing" in old.found
    _, extra = check_packages(["numpy", "no-such-package>=17; extra == 'parquet'"])
    assert extra.state == "ok"
    assert "imu-rig[parquet]" in extra.commands[0]


def test_an_old_python_is_bad():
    assert check_python((3, 10, 2))[0].state == "bad"
    assert check_python()[0].state == "ok"


def test_clocks_and_sleep_are_told(made_up, monkeypatch):
    monkeypatch.setattr(machine, "slept_s", lambda: 600.0)
    coarse, slept = check_clock(made_up.system(), 0.0156)
    assert coarse.state == "warn"
    assert "15.6 ms" in coarse.found
    assert "10 min" in slept.found
    made_up.write("run/systemd/timesync/other")
    assert check_clock(made_up.system(), 1e-9)[-1].about == "wall clock"
    made_up.write("run/systemd/timesync/synchronized")
    assert check_clock(made_up.system(), 1e-9)[-1].about == "sleep"


def test_a_system_without_terminals_is_told(made_up, monkeypatch):
    assert check_simulated_ports(made_up.system())[0].state == "ok"
    assert "--tcp" in check_simulated_ports(made_up.system(platform="win32"))[0].found

    def refuse():
        raise OSError(2, "No such file")

    monkeypatch.setattr(machine.os, "openpty", refuse)
    assert check_simulated_ports(made_up.system())[0].state == "warn"


def test_windows_is_told_where_the_latency_is(made_up):
    port = SeenPort("COM7", "USB Serial Port", 0x0403, 0x6001, "FT3A")
    assert check_windows_ports(made_up.system(), [port]) == []
    ports, latency = check_windows_ports(made_up.system(platform="win32"), [port])
    assert "COM7" in ports.found
    assert "LatencyTimer" in latency.advice


# --- the Maestro ----------------------------------------------------------------------------------


def test_a_maestro_is_asked_only_when_told_to(monkeypatch):
    seen = [
        SeenPort("/dev/ttyACM0", "Maestro", 0x1FFB, 0x0089, "42"),
        SeenPort("/dev/ttyACM1", "Maestro", 0x1FFB, 0x0089, "42"),
        SeenPort("/dev/ttyUSB0", "FTDI", 0x0403, 0x6001, "F"),
    ]
    (check,) = check_maestro(None, seen)
    assert check.commands == ("imu-rig doctor --maestro /dev/ttyACM0",)
    assert check.found.startswith("/dev/ttyACM0 and /dev/ttyACM1 belong to a Maestro;")
    (alone,) = check_maestro(None, seen[1:])
    assert alone.found == "/dev/ttyACM1 belongs to a Maestro."
    assert check_maestro(None, seen[2:]) == []


def test_a_maestro_that_listens_is_well_and_a_mute_one_is_explained(monkeypatch):
    quick = partial(MaestroClient, timeout_s=0.1)
    monkeypatch.setattr(maestro, "MaestroClient", quick)
    with ServedDevices() as served:
        (well,) = check_maestro(served.add_servos("jig", MaestroModel()), [])
        mute = served.add("mute", "mpu9150-28")
        served.silence("mute")
        (silent,) = check_maestro(mute, [])
    assert well.state == "ok"
    assert silent.state == "bad"
    assert "USB Dual Port" in silent.found + silent.advice


def test_a_port_that_is_not_there_is_bad(tmp_path):
    (check,) = check_maestro(str(tmp_path / "none"), [])
    assert check.state == "bad"
    assert "There is no port" in check.found


def test_everything_is_looked_at_in_one_go(tmp_path, made_up, monkeypatch):
    monkeypatch.setattr(disk, "WRITTEN_BYTES", 1 << 16)
    made_up.write("dev/ttyUSB0")
    told = []
    checks = examine(tmp_path, None, made_up.system(), told.append)
    assert {"Python", "ttyUSB0", "Bluetooth", "disk", "room", "clock"} <= {c.about for c in checks}
    assert len(told) >= 4
    for check in checks:
        assert check.found.endswith(".")
        assert check.state == "ok" or check.advice
