"""The jig against a simulated one: moves, predicted times, and recovery from every fault."""

import math
import time
from contextlib import contextmanager

import pytest

from imu_rig.clock import ScaledClock
from imu_rig.devices.jig import Jig, JigFault, load_jig
from imu_rig.devices.maestro import MaestroClient
from imu_rig.errors import DeviceError, DeviceLost
from simulators.models import MaestroModel
from simulators.rig import RigConfig, SimulatedRig

PAPER = load_jig("paper-jig")
PATIENCE_S = 15.0
SPEED = 5.0
HOME = {"pan": 0.0, "tilt": 0.0, "roll": 0.0}


@contextmanager
def running(config=None):
    clock = ScaledClock(SPEED)
    with SimulatedRig(config or RigConfig.ideal(), clock=clock) as rig:
        maestro = MaestroClient(rig.maestro_url, clock)
        jig = Jig(PAPER, maestro, clock)
        try:
            jig.start()
            yield rig, jig, clock
        finally:
            maestro.close()


def wait_until(condition):
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)


def close_to(reported, expected):
    return all(abs(reported[a] - expected[a]) < 0.2 for a in expected)


def raised_by(call):
    """What a call raises sooner or later."""
    caught = []

    def tried():
        try:
            call()
        except DeviceError as error:
            caught.append(error)
        return caught

    wait_until(tried)
    return caught[0]


def test_a_released_jig_is_taken_hold_of_where_it_parks():
    with running() as (_, jig, _):
        assert all(math.isnan(angle) for angle in jig.reported().values())
        assert jig.arrived()
        jig.command({"pan": 40.0})
        assert abs(jig.reported()["pan"]) < 30  # it did not leap
        wait_until(jig.arrived)
        assert close_to(jig.reported(), {"pan": 40.0})
        assert math.isnan(jig.reported()["tilt"])
        jig.check()


def test_moves_take_the_predicted_time_and_end_where_the_servo_is():
    pose = {"pan": -60.0, "tilt": 50.0, "roll": 30.0}
    with running() as (rig, jig, _):
        jig.park()
        jig.command(pose)
        begin_s = rig.state().t_s
        wait_until(lambda: jig.check() or jig.arrived())
        seconds = rig.state().t_s - begin_s
        predicted = jig.travel_time(HOME, pose)
        assert predicted - 0.1 < seconds < predicted + 1.5
        assert close_to(jig.reported(), pose)
        wait_until(lambda: close_to(rig.state().angles_deg, pose))


def test_settings_are_the_files():
    with running() as (rig, _, _):
        channels = rig.world.maestro.channels
        for axis in PAPER.axes.values():
            assert channels[axis.channel].speed == axis.speed_units
            assert channels[axis.channel].acceleration == axis.acceleration_units


@pytest.mark.parametrize("fault", ["reset", "brownout"])
def test_a_reset_is_noticed_and_recovered_from_without_a_jerk(fault):
    with running() as (rig, jig, _):
        jig.park()
        wait_until(jig.arrived)
        jig.command({"roll": 150.0})
        wait_until(lambda: jig.reported()["roll"] > 40)
        rig.fault("maestro", fault)
        error = raised_by(jig.check)
        assert isinstance(error, JigFault | DeviceLost)
        wait_until(lambda: _recovers(jig))
        held = jig.reported()["roll"]
        assert 20 < held < 140, "it leapt to its target"
        channels = rig.world.maestro.channels
        assert channels[PAPER.roll.channel].speed == PAPER.roll.speed_units
        wait_until(jig.arrived)
        jig.check()
        assert close_to(jig.reported(), {"pan": 0.0, "tilt": 0.0, "roll": 150.0})


def _recovers(jig):
    try:
        jig.recover()
    except DeviceError:
        return False
    return True


def test_a_reset_is_told_from_an_error_and_commands_wait_for_recovery():
    with running() as (rig, jig, _):
        jig.park()
        wait_until(jig.arrived)
        rig.fault("maestro", "reset")
        error = raised_by(lambda: jig.command({"pan": 10.0}))
        assert isinstance(error, JigFault)
        assert error.kind == "reset"
        jig.park()  # recovers by itself
        wait_until(jig.arrived)
        assert close_to(jig.reported(), HOME)


def test_a_latched_error_is_named_and_recovered_from():
    config = RigConfig.ideal().model_copy(update={"maestro": MaestroModel(timeout_s=1.5)})
    with running(config) as (_, jig, clock):
        jig.park()
        wait_until(jig.arrived)
        clock.sleep(3.0)
        error = raised_by(jig.check)
        assert isinstance(error, JigFault)
        assert error.kind == "errors"
        assert "timeout" in str(error)
        jig.recover()
        wait_until(jig.arrived)
        jig.check()


def test_errors_from_before_are_cleared_and_kept_for_the_record():
    config = RigConfig.ideal().model_copy(update={"maestro": MaestroModel(crc=True)})
    clock = ScaledClock(SPEED)
    with SimulatedRig(config, clock=clock) as rig:
        wrong = MaestroClient(rig.maestro_url, clock, crc=False, timeout_s=0.05)
        wrong.open()
        wrong.set_target(0, 6000)
        wrong.set_target(0, 6000)
        wrong.close()
        right = MaestroClient(rig.maestro_url, clock, crc=True)
        jig = Jig(PAPER, right, clock)
        jig.start()
        assert jig.start_errors
        jig.check()
        right.close()


def test_channel_limits_of_the_controller_are_pointed_at():
    config = RigConfig.ideal().model_copy(
        update={"maestro": MaestroModel(min_us=992.0, max_us=2000.0)}
    )
    with running(config) as (_, jig, _):
        jig.park()
        wait_until(jig.arrived)
        jig.command({"tilt": -90.0})
        error = raised_by(jig.check)
        assert isinstance(error, JigFault)
        assert (error.kind, error.axis) == ("stuck", "tilt")
        assert "992 us" in str(error)
        assert "Channel Settings" in str(error)


@pytest.mark.parametrize("fault", ["stuck", "wrong"])
def test_positions_that_are_not_the_targets_are_a_fault(fault):
    with running() as (rig, jig, _):
        jig.park()
        wait_until(jig.arrived)
        rig.fault("maestro", fault)
        jig.command({"pan": 20.0})
        error = raised_by(jig.check)
        assert isinstance(error, JigFault)
        assert error.kind == "stuck"
        assert error.axis in ("pan", "tilt", "roll")
        rig.clear("maestro")
        jig.recover()
        wait_until(jig.arrived)
        jig.check()


def test_an_unplugged_controller_is_lost_and_recovered_under_its_name():
    with running() as (rig, jig, _):
        jig.park()
        jig.command({"pan": 20.0})
        rig.fault("maestro", "unplug")
        assert isinstance(raised_by(jig.check), DeviceLost)
        with pytest.raises(DeviceError):
            jig.park()
        with pytest.raises(DeviceLost, match="not back"):
            jig.recover()
        rig.clear("maestro")
        wait_until(lambda: _recovers(jig))
        wait_until(jig.arrived)
        assert close_to(jig.reported(), {"pan": 20.0})


def test_turning_round_under_way_is_no_fault():
    with running() as (_, jig, _):
        jig.park()
        wait_until(jig.arrived)
        jig.command({"pan": 90.0})
        wait_until(lambda: jig.reported()["pan"] > 20)
        jig.command({"pan": -20.0})
        while not jig.arrived():
            jig.check()
        assert close_to(jig.reported(), {"pan": -20.0})


def test_released_servos_have_no_angle_and_no_target():
    with running() as (_, jig, _):
        jig.park()
        jig.release()
        assert all(math.isnan(angle) for angle in jig.reported().values())
        assert jig.arrived()
        jig.check()
        jig.command({"pan": 5.0})
        wait_until(jig.arrived)
