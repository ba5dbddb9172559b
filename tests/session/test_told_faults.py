"""What a device says is wrong with it reaches the person and the trial file, once."""

from types import SimpleNamespace

import pytest

from imu_rig.blocks import ImuBlock
from imu_rig.clock import SteppedClock
from imu_rig.devices.stream_device import StreamHealth
from imu_rig.session.watch import Watch
from imu_rig.stopping import StopRequest


@pytest.fixture
def session(tmp_path):
    """A watch over a sensor whose health a test sets, what it said, and what it wrote down."""
    path = tmp_path / "session.imu-trial"
    path.touch()
    said, events = [], []
    imu = SimpleNamespace(
        name="shoe",
        health=StreamHealth(good=10, rate_hz=100.0),
        port_health=StreamHealth(),
        layout=SimpleNamespace(rate_hz=100.0),
        poll=ImuBlock.empty,
    )
    trial = SimpleNamespace(
        path=path, error=None, event=lambda name, **fields: events.append((name, fields))
    )
    watch = Watch(
        SimpleNamespace(check=lambda: None),
        imu,
        trial,
        SteppedClock(),
        StopRequest(),
        lambda progress: None,
        said.append,
        steps=1,
    )
    return SimpleNamespace(watch=watch, imu=imu, said=said, events=events)


def test_every_fault_is_named_once_however_long_it_lasts(session):
    session.watch.look()
    assert session.said == []
    session.imu.port_health = StreamHealth(faults=("self-test failed", "sensor over-range"))
    for _ in range(3):
        session.watch.look()
    assert session.said == ["shoe says: self-test failed.", "shoe says: sensor over-range."]
    assert [fields["text"] for name, fields in session.events if name == "notice"] == session.said


def test_a_fault_of_another_stream_of_the_port_is_named_too(session):
    """As of the barometer beside the accelerometer on the jig."""
    session.imu.port_health = StreamHealth(faults=("barometer PROM does not check (CRC-4)",))
    session.watch.look()
    assert session.said == ["shoe says: barometer PROM does not check (CRC-4)."]


def test_a_layout_file_s_words_cannot_move_the_cursor(session):
    session.imu.port_health = StreamHealth(faults=("over\x1b[2Jrange\n",))
    session.watch.look()
    assert session.said == ["shoe says: over [2Jrange."]
