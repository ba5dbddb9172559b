"""Servos: where they stop, how they get there, and what they ignore."""

import math

import numpy as np
import pytest

from imu_rig.units import DEG
from simulators.models import ServoModel
from simulators.servo import STEP_S, Servo

QUIET = {
    "channel": 0,
    "angle_deg": (-90.0, 90.0),
    "pulse_us": (1000.0, 2000.0),
    "sine_deg": 0.0,
    "repeatability_deg": 0.0,
    "dead_band_us": 0.0,
    "backlash_deg": 0.0,
    "ring_hz": 0.0,
}


def servo(**changes) -> Servo:
    return Servo(ServoModel(**(QUIET | changes)), np.random.default_rng(3))


class Bench:
    """Drives one servo with a pulse every 20 ms and keeps what its axis did."""

    def __init__(self, tested: Servo) -> None:
        self.servo = tested
        self.steps = 0
        self.rows: list[tuple[float, float, float]] = []

    def run(self, pulse_us: float, seconds: float) -> np.ndarray:
        start = len(self.rows)
        for _ in range(round(seconds / STEP_S)):
            if self.steps % 20 == 0:
                self.servo.hear(pulse_us, self.steps * STEP_S)
            self.rows.append(self.servo.step())
            self.steps += 1
        return np.array(self.rows[start:])

    def stop(self, pulse_us: float) -> float:
        """Angle [deg] where the axis comes to rest."""
        self.run(pulse_us, 3.0)
        assert self.servo.resting
        return self.servo.angle / DEG


def test_gain_zero_and_once_per_turn_error_make_the_angle():
    bench = Bench(servo(gain_error=0.02, zero_deg=-1.5, sine_deg=0.3, sine_phase_deg=30.0))
    for pulse, commanded in ((1000.0, -90.0), (1500.0, 0.0), (1750.0, 45.0)):
        expected = 1.02 * commanded - 1.5 + 0.3 * math.sin((commanded + 30.0) * DEG)
        assert bench.stop(pulse) == pytest.approx(expected, abs=1e-4)


def test_the_motor_turns_no_faster_and_pulls_no_harder_than_it_can():
    bench = Bench(servo(speed_dps=130.0, acceleration_dps2=6000.0))
    rate, acceleration = bench.run(2000.0, 3.0)[:, 1:].T / DEG
    assert rate.max() == pytest.approx(130.0)
    assert rate.min() > -1e-3  # critically damped: it does not come back
    assert np.abs(acceleration).max() == pytest.approx(6000.0)


def test_the_path_has_no_jumps_and_its_columns_integrate_to_one_another():
    bench = Bench(servo(speed_dps=130.0, ring_hz=9.0))
    rows = bench.run(2000.0, 3.0)
    angle, rate, acceleration = rows.T
    assert angle[-1] / DEG == pytest.approx(90.0, abs=1e-4)
    assert np.cumsum(rate) * STEP_S == pytest.approx(angle - angle[0], abs=2e-3)
    # Where friction catches the axis, the last 1e-6 rad/s are gone within one step.
    assert np.diff(rate) / STEP_S == pytest.approx(
        0.5 * (acceleration[1:] + acceleration[:-1]), abs=1.1e-3
    )


def test_the_axis_moves_no_sooner_than_the_next_pulse():
    bench = Bench(servo())
    bench.run(1500.0, 0.5)
    bench.run(1500.0, 0.001)  # the pulse of this period has just gone by
    rows = bench.run(1800.0, 0.019)
    assert not rows[:, 1:].any()
    assert bench.run(1800.0, 0.02)[:, 1].any()


def test_a_change_within_the_dead_band_moves_nothing():
    bench = Bench(servo(dead_band_us=8.0, repeatability_deg=0.5))
    before = bench.stop(1600.0)
    assert bench.stop(1596.0) == before
    assert bench.stop(1592.5) == before
    assert bench.stop(1600.0) == before
    assert bench.stop(1560.0) != before


@pytest.mark.parametrize(
    ("errors", "difference_deg"),
    [
        ({"dead_band_us": 8.0}, 8.0 * 0.18),
        ({"backlash_deg": 1.0}, 1.0),
        ({"dead_band_us": 8.0, "backlash_deg": 1.0}, 8.0 * 0.18 + 1.0),
    ],
)
def test_a_pose_approached_from_the_other_side_is_off_by_dead_band_and_play(errors, difference_deg):
    bench = Bench(servo(**errors))
    bench.stop(1200.0)
    from_below = bench.stop(1500.0)
    bench.stop(1800.0)
    from_above = bench.stop(1500.0)
    assert from_above - from_below == pytest.approx(difference_deg, abs=1e-3)
    bench.stop(1100.0)
    assert bench.stop(1500.0) == pytest.approx(from_below, abs=1e-3)


def test_stops_scatter_as_the_repeatability_says():
    bench = Bench(servo(repeatability_deg=0.5, speed_dps=300.0))
    stops = []
    for _ in range(150):
        bench.run(1450.0, 0.4)
        bench.run(1500.0, 0.6)
        stops.append(bench.servo.angle / DEG)
    assert np.std(stops) == pytest.approx(0.5, rel=0.2)
    assert abs(np.mean(stops)) < 0.15


def test_without_pulses_it_stays_where_it_is_and_comes_back_with_them():
    bench = Bench(servo(speed_dps=100.0))
    bench.stop(1500.0)
    bench.run(2000.0, 0.5)
    rows = bench.run(0.0, 2.0)
    stopped = bench.servo.angle / DEG
    assert bench.servo.limp
    assert bench.servo.resting
    assert 20.0 < stopped < 60.0
    assert rows[0, 1] > 0
    assert (rows[:, 1] > -1e-4).all()  # friction stops it, nothing pulls it back
    assert bench.stop(0.0) == stopped
    assert bench.stop(2000.0) == pytest.approx(90.0, abs=1e-4)


def test_the_structure_rings_after_a_stop_and_dies_out_in_its_decay_time():
    bench = Bench(servo(ring_hz=9.0, ring_tau_s=0.1))
    bench.stop(1500.0)
    acceleration = np.abs(bench.run(1600.0, 1.5)[:, 2])
    moving_s = 0.3
    early = acceleration[int((moving_s + 0.1) / STEP_S) : int((moving_s + 0.2) / STEP_S)].max()
    late = acceleration[int((moving_s + 0.5) / STEP_S) : int((moving_s + 0.6) / STEP_S)].max()
    assert early > 0.02
    assert late / early == pytest.approx(math.exp(-4.0), rel=0.5)
    assert bench.stop(1600.0) == pytest.approx(18.0, abs=1e-4)


def test_a_stuck_servo_stays_and_a_wrong_one_goes_15_degrees_off():
    bench = Bench(servo())
    start = bench.stop(1500.0)
    bench.servo.faults.start("stuck", 0.0, None)
    assert bench.stop(1700.0) == start
    bench.servo.faults.clear()
    bench.servo.faults.start("wrong", 0.0, None)
    assert bench.stop(1700.0) == pytest.approx(36.0 + 15.0, abs=1e-4)


def test_a_slow_servo_has_a_quarter_of_its_speed():
    bench = Bench(servo(speed_dps=120.0))
    bench.servo.faults.start("slow", 0.0, None)
    rows = bench.run(2000.0, 2.0)
    assert np.abs(rows[:, 1]).max() / DEG == pytest.approx(30.0, rel=1e-6)
