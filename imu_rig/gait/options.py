"""What the default smoother of a foot assumes of feet and sensors, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from imu_rig.units import DEG, STANDARD_GRAVITY

Level = Literal["auto", "always", "never"]


@dataclass(frozen=True)
class StanceOptions:
    """When a foot stands.

    Attributes
    ----------
    window_s : float
        Over which motion is averaged [s]. A running foot rests for 60 to 80 ms: a longer window
        would mix in the strike. In simulated walks and runs all from 0.03 to 0.055 s serve equally,
        0.07 s makes errors of strides a tenth larger and 0.1 s a fifth; the longest of these, as a
        turning point of the swing may be taken for rest in a short one. No even number of usual
        sample periods, so that jittery stamps keep the ends of the window.
    lever : float
        Height of the sensor above the ground about which a foot rolls [m]: it makes a velocity of
        an angular rate. On the instep of a shoe 0.06 to 0.12 m.
    settling_s : float
        Makes a velocity of an acceleration [s]: that of a foot being lowered or lifted lasts some
        hundredths of a second; it also weighs accelerometer against gyroscope about equally in the
        middle of a stance.
    quiet_s, level_s : float
        The quietest moment is looked for this far to either side [s], and the level of motion taken
        over that far. Below 0.6 s there are moments of swings with no stance so near: footfalls are
        made up in simulated slow gait at 0.45 s. Half as much again bears slower swings.
    quiet_share : float
        Of the level of motion: no stance between strides is taken to be quieter [1]. It keeps the
        stand before a run from hiding the footfalls beside it, as it does in simulated walks with
        nothing of the kind. From 3 percent on the gentle begin of a slide counts as rest, from 20
        percent on swings of slow gait and stairs.
    lowest, highest : float
        Bounds of the threshold [m/s]. Below 0.01 lies what a foot that stands with its owner's
        weight on it does by itself, and the noise of any sensor. Above 0.15 a heel is rising: the
        foot turns about its ball, faster than at 1.5 rad/s. In simulated walks at 0.5 to 1.3 m/s
        the speed of a foot is a multiple of its motion from 0.04 to 0.15 on, as swings begin there,
        in runs from 0.25 on. Errors of strides are the same with any bound from 0.1 to 0.3.
    stand_s, gentle_s : float
        Of a stand longer than the first [s], which no stance of a stride is, the second [s] is left
        out at both ends: people set out so gently that it shows only after a while.
    sprint_level, sprint_stride_s, sprint_window_s : float
        Where the level of motion, over so many seconds to either side as such a stride takes,
        exceeds the first [m/s], as from runs at 4 m/s on, motion is averaged over the last only
        [s]: a sprinter's foot rests for some 20 ms.
    sprint_ratio, sprint_highest, sprint_share : float
        The quietest moment of each stride counts even above `highest`, up to this multiple of it,
        as long as it is below so many m/s and below that share of the level around: of a sprinter
        who is on the ground for 100 ms nothing else would be left.
    trust : float
        Standard uncertainty of "the velocity is zero" as a multiple of the motion [1]: against
        optical positions a foot's speed is about its motion statistic; the half more covers those
        parts of its motion that are not seen.
    floor : float
        The least such uncertainty [m/s]: what a flat foot in a shoe on a carpet creeps.
    """

    window_s: float = 0.055
    lever: float = 0.1
    settling_s: float = 0.0175
    quiet_s: float = 0.9
    level_s: float = 1.0
    quiet_share: float = 0.02
    lowest: float = 0.01
    highest: float = 0.15
    stand_s: float = 1.5
    gentle_s: float = 0.15
    sprint_level: float = 1.0
    sprint_stride_s: float = 0.4
    sprint_window_s: float = 0.022
    sprint_ratio: float = 1.3
    sprint_highest: float = 1.0
    sprint_share: float = 0.5
    trust: float = 1.5
    floor: float = 0.005


@dataclass(frozen=True)
class FootOptions:
    """Settings of `imu_rig.gait.smoother.smooth_foot`; the defaults serve slow gait to sprints.

    Attributes
    ----------
    gravity : float
        Local gravity [m/s^2]. Between equator and pole it differs by 0.5 %; an error of 0.2 % is
        taken up by the accelerometer's bias.
    level : "auto", "always" or "never"
        Whether all footfalls are at one height: where the height changes from stride to stride
        say so, everywhere, or nowhere. A ramp below 5 % can look level.
    stance : StanceOptions
    correlated_s : float
        Errors of "the velocity is zero" last so long [s], the time in which a foot rolls on; the
        measurement's weight follows time, not the number of samples.
    measured_every_s : float
        Zero velocity is measured once in this time [s] and the surer for it: well below
        `correlated_s`, so that nothing is lost, and above a sample's time, which saves work.
    gate : float
        Innovations beyond so many sigma are given more noise, so that they count as if they were
        at that bound: 3, as errors of motion have heavier tails than a normal distribution.
    gate_cap : float
        The noise grows at most by that factor, so that a filter that is wrong finds back.
    gyro_noise, gyro_motion : float
        Noise density [rad/s/sqrt(Hz)], and what is added per angular rate [1/sqrt(Hz)]: in a swing
        errors of scale, alignment and bandwidth (half a percent over 0.3 s) outweigh the noise.
    accel_noise, accel_motion : float
        The same for specific force [m/s^2/sqrt(Hz)], and per acceleration [1/sqrt(Hz)].
    accel_bias_walk : float
        By which the accelerometer's bias wanders [m/s^2/sqrt(s)]; its size is in `SensorGrade`.
    pivot_m, pivot_sigma_m : float
        Height of the sensor above the point about which a standing foot rolls, along the vertical
        [m], and its standard uncertainty along every axis: an instep, between toe and ankle.
    tilt_sigma : float
        Standard uncertainty of the first attitude [rad]: of an accelerometer on a foot in the
        quietest moment of a stance.
    speed_sigma : float
        Standard uncertainty of the first velocity along each axis [m/s]; recordings may begin in
        a swing.
    flat_m : float
        Scatter of a sensor's height over one and the same floor between footfalls [m], as a foot
        never comes down quite the same way.
    step_m, slope : float
        A height change from footfall to footfall is a real one above the first [m], and above the
        second times the way along the ground: stairs begin at 0.15 m a step, ramps at 5 %, and
        heights of footfalls come out within 0.02 m, or 3 % of long strides with a poor sensor.
    floor_walk_m : float
        By which the floor under the next footfall may differ on level ground [m].
    """

    gravity: float = STANDARD_GRAVITY
    level: Level = "auto"
    stance: StanceOptions = StanceOptions()
    correlated_s: float = 0.05
    measured_every_s: float = 0.02
    gate: float = 3.0
    gate_cap: float = 10.0
    gyro_noise: float = 0.03 * DEG
    gyro_motion: float = 0.003
    accel_noise: float = 0.02
    accel_motion: float = 0.015
    accel_bias_walk: float = 1e-4
    pivot_m: float = 0.08
    pivot_sigma_m: float = 0.03
    tilt_sigma: float = 2.0 * DEG
    speed_sigma: float = 2.0
    flat_m: float = 0.01
    step_m: float = 0.07
    slope: float = 0.05
    floor_walk_m: float = 0.003
