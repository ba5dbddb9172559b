"""The plot's own process says why there can be no window; in a program see the commands."""

import signal
from multiprocessing import Pipe

import pytest
from matplotlib import pyplot

from imu_rig.errors import InputError
from imu_rig.monitor.figure import StreamPlan
from imu_rig.monitor.quantities import Quantity
from imu_rig.monitor.rings import Ring
from imu_rig.monitor.window import require_screen, show

PLAN = StreamPlan("left", (Quantity("accel", "g", 1.0, 3),))


def test_no_screen_is_told_before_anything_is_opened(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "MPLBACKEND"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(InputError, match="--save FILE"):
        require_screen()
    monkeypatch.setenv("DISPLAY", ":0")
    require_screen()


def test_a_toolkit_that_shows_nothing_is_told():
    ours, theirs = Pipe()
    ring = Ring(100, PLAN.columns)
    before = signal.getsignal(signal.SIGINT)
    try:
        show(theirs, (PLAN,), [(ring.size, ring.columns, ring.numbers, ring.written)], 10.0)
        assert "toolkit" in ours.recv()
    finally:
        signal.signal(signal.SIGINT, before)
        pyplot.close("all")
        ours.close()
        theirs.close()
