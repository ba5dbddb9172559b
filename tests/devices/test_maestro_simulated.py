"""The servo controller's driver against a simulated board, with every fault it can have."""

import contextlib
import os
import threading
import time
import tty
from contextlib import contextmanager

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_protocols.maestro import CommandParser, MaestroErrors, SetTarget, encode
from imu_rig.clock import ScaledClock, SystemClock
from imu_rig.devices.jig import AXES, Jig, load_jig
from imu_rig.devices.maestro import MaestroClient
from imu_rig.errors import DeviceError, DeviceLost, LimitError, PortError
from simulators.models import MaestroModel
from simulators.rig import RigConfig, SimulatedRig

PAPER = load_jig("paper-jig")
PATIENCE_S = 15.0


@contextmanager
def running(config=None, *, speed=4.0, transport="pty", **options):
    clock = SystemClock() if speed == 1 else ScaledClock(speed)
    config = config or RigConfig.ideal()
    with SimulatedRig(config, clock=clock, transport=transport) as rig:
        maestro = MaestroClient(rig.maestro_url, clock, **options)
        maestro.open()
        try:
            yield rig, maestro
        finally:
            maestro.close()


def board(**settings):
    return RigConfig.ideal().model_copy(update={"maestro": MaestroModel(**settings)})


def wait_until(condition):
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)


@pytest.mark.parametrize("transport", ["pty", "tcp"])
@pytest.mark.parametrize(
    ("settings", "options"),
    [
        ({}, {}),
        ({"crc": True}, {"crc": True}),
        ({"device": 5, "crc": True}, {"device": 5, "crc": True}),
    ],
)
def test_the_dialogue_in_every_form_of_the_protocol(settings, options, transport):
    wire = []
    with running(
        board(**settings), transport=transport, tap=lambda *seen: wire.append(seen), **options
    ) as (_, maestro):
        assert maestro.errors() == MaestroErrors(0)
        assert maestro.position(2) == 0
        maestro.set_target(2, 6000)
        assert maestro.position(2) == 6000
        maestro.set_speed(2, 4)
        maestro.set_acceleration(2, 10)
        maestro.set_target(2, 6400)
        wait_until(lambda: maestro.position(2) == 6400)
        wait_until(lambda: not maestro.moving())
        maestro.set_target(2, 0)
        assert maestro.position(2) == 0
        maestro.set_targets({0: 5900, 1: 6100})
        maestro.go_home()
        assert maestro.position(0) == 0
        assert maestro.errors() == MaestroErrors(0)
    out = b"".join(data for _, direction, data in wire if direction == "out")
    events = CommandParser(**settings).feed(out)
    assert not [e for e in events if isinstance(e, MaestroErrors)]
    assert SetTarget(2, 6400) in events
    assert sum(len(data) for _, direction, data in wire if direction == "in") > 10
    stamps = [t for t, _, _ in wire]
    assert stamps == sorted(stamps)


def test_errors_are_named_in_words():
    with running(crc=True) as (_, maestro):  # a board that expects no CRC byte
        maestro.errors()
        assert maestro.errors() == MaestroErrors.SERIAL_PROTOCOL
    with running() as (rig, maestro):
        maestro.errors()
        other = os.open(rig.maestro_url, os.O_RDWR | os.O_NOCTTY)
        os.write(other, b"\x05")
        os.close(other)
        wait_until(lambda: maestro.errors() == MaestroErrors.SERIAL_PROTOCOL)
        assert maestro.errors() == MaestroErrors(0)


def test_the_factory_mode_is_recognized_and_the_way_out_is_told():
    config = RigConfig.ideal().model_copy(update={"maestro_mode": "uart-detect"})
    with (
        running(config, timeout_s=0.1) as (_, maestro),
        pytest.raises(DeviceError, match=r"Control Center.*USB Dual Port.*TTL port"),
    ):
        maestro.errors()


def test_silence_after_answers_is_a_lost_device_and_it_comes_back():
    with running(timeout_s=0.2) as (rig, maestro):
        maestro.errors()
        rig.fault("maestro", "off")
        with pytest.raises(DeviceLost, match="does not answer any more"):
            maestro.position(0)
        rig.clear("maestro")
        assert maestro.position(0) == 0


def test_unplugging_is_noticed_and_the_same_name_opens_again():
    with running() as (rig, maestro):
        maestro.set_target(0, 6000)
        assert maestro.position(0) == 6000
        rig.fault("maestro", "unplug")
        with pytest.raises(DeviceLost):
            maestro.position(0)
        assert not maestro.is_open
        with pytest.raises(DeviceLost, match="not open"):
            maestro.set_target(0, 6000)
        with pytest.raises(PortError):
            maestro.open()
        rig.clear("maestro")
        wait_until(lambda: _opens(maestro))
        assert maestro.position(0) == 6000


def _opens(maestro):
    try:
        maestro.open()
    except PortError:
        return False
    return True


def test_slow_replies_are_waited_for():
    with running() as (rig, maestro):
        maestro.set_target(1, 6000)
        rig.fault("maestro", "slow")
        assert maestro.position(1) == 6000
        assert maestro.errors() == MaestroErrors(0)


def test_replies_later_than_the_patience_never_answer_a_later_question():
    with running(speed=1, timeout_s=0.25) as (rig, maestro):
        maestro.set_targets({0: 5000, 1: 6000, 2: 7000})
        assert maestro.position(0) == 5000
        rig.fault("maestro", "slow")  # 0.3 s late
        answers = {}
        for channel in (0, 1, 2):
            try:
                answers.setdefault(channel, set()).add(maestro.position(channel))
            except DeviceError:
                continue
        rig.clear("maestro")
        for channel in (2, 1, 0):
            answers.setdefault(channel, set()).add(maestro.position(channel))
        assert answers == {0: {5000}, 1: {6000}, 2: {7000}}


def test_a_port_that_never_falls_silent_is_no_maestro():
    with SimulatedRig(RigConfig.ideal(), clock=ScaledClock(20.0)) as rig:
        maestro = MaestroClient(rig.imu_url, SystemClock(), timeout_s=0.3)
        maestro.open()
        with pytest.raises(DeviceError, match=r"nonsense.*command port"):
            maestro.errors()
        maestro.close()


def test_garbage_in_place_of_replies_is_an_error_of_the_device():
    with running() as (rig, maestro):
        maestro.errors()
        rig.fault("maestro", "garbage")
        with pytest.raises(DeviceError, match="nonsense"):
            _ask_often(maestro)
        rig.clear("maestro")
        assert maestro.errors() == MaestroErrors(0)


def _ask_often(maestro):
    for _ in range(50):
        maestro.errors()


def test_threads_may_ask_at_once():
    with running() as (_, maestro):
        maestro.set_targets({0: 5000, 1: 6000})
        wrong = []

        def ask(channel, expected):
            for _ in range(30):
                if maestro.position(channel) != expected:
                    wrong.append(channel)

        threads = [threading.Thread(target=ask, args=a) for a in ((0, 5000), (1, 6000))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(PATIENCE_S)
        assert not wrong


# --- limits -------------------------------------------------------------------------------


class Ear:
    """A board that only listens, behind a pseudo-terminal, and answers position 6000 or 0."""

    def __init__(self):
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.url = os.ttyname(self._slave)
        self._parser = CommandParser()
        self.heard = []
        self._stopping = False
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _listen(self):
        while not self._stopping:
            try:
                data = os.read(self.master, 4096)
            except OSError:
                return
            for event in self._parser.feed(data):
                self.heard.append(event)
                if type(event).__name__ in ("GetPosition", "GetErrors"):
                    known = type(event).__name__ == "GetPosition"
                    os.write(self.master, (6000 if known else 0).to_bytes(2, "little"))

    def close(self):
        self._stopping = True
        os.write(self._slave, encode(SetTarget(0, 0)))  # wakes the thread
        self._thread.join(PATIENCE_S)
        os.close(self.master)
        os.close(self._slave)


@pytest.fixture(scope="module")
def ear():
    made = Ear()
    yield made
    made.close()


ANGLES = st.one_of(
    st.floats(-400, 400), st.floats(allow_nan=True), st.sampled_from([96.0, 96.1, -180.0, 180.01])
)
COMMANDS = st.one_of(
    st.tuples(st.just("jig"), st.dictionaries(st.sampled_from([*AXES, "yaw"]), ANGLES, max_size=4)),
    st.tuples(st.just("raw"), st.dictionaries(st.integers(0, 5), st.integers(-5, 20_000))),
    st.tuples(st.sampled_from(["park", "recover", "release"]), st.none()),
)


@settings(max_examples=20, deadline=None)
@given(plan=st.lists(COMMANDS, max_size=8))
def test_no_target_outside_the_limits_ever_reaches_the_wire(ear, plan):
    ear.heard.clear()
    maestro = MaestroClient(ear.url, SystemClock())
    maestro.open()
    try:
        jig = Jig(PAPER, maestro, SystemClock())
        jig.start()
        for verb, what in plan:
            with contextlib.suppress(LimitError):
                if verb == "jig":
                    jig.command(what)
                elif verb == "raw":
                    maestro.set_targets(what)
                else:
                    getattr(jig, verb)()
        maestro.errors()  # an answer: everything before it has been heard
    finally:
        maestro.close()
    limits = {a.channel: a.limits_quarter_us for a in PAPER.axes.values()}
    for event in ear.heard:
        assert not isinstance(event, MaestroErrors)
        if isinstance(event, SetTarget) and event.target != 0:
            low, high = limits[event.channel]
            assert low <= event.target <= high


def test_nothing_of_a_command_is_sent_if_one_part_leaves_the_limits(ear):
    maestro = MaestroClient(ear.url, SystemClock())
    maestro.open()
    try:
        jig = Jig(PAPER, maestro, SystemClock())
        jig.start()
        ear.heard.clear()
        with pytest.raises(LimitError, match=r"tilt was to go to 97 deg.*-96 to 96 deg"):
            jig.command({"pan": 10.0, "tilt": 97.0})
        with pytest.raises(LimitError, match="no axis yaw"):
            jig.command({"pan": 10.0, "yaw": 0.0})
        with pytest.raises(LimitError, match=r"Channel 1 was to go to 25 us"):
            maestro.set_targets({0: 6000, 1: 100})
        with pytest.raises(LimitError, match=r"Channel 7 .* not part of the jig"):
            maestro.set_target(7, 6000)
        maestro.errors()
        assert not [e for e in ear.heard if isinstance(e, SetTarget)]
    finally:
        maestro.close()


def test_without_a_jig_a_maestros_own_range_holds(ear):
    maestro = MaestroClient(ear.url, SystemClock())
    maestro.open()
    try:
        for target in (255, 16_321, -1):
            with pytest.raises(LimitError, match="64 to 4080 us"):
                maestro.set_target(0, target)
    finally:
        maestro.close()
