"""Time: device counters unwrapped, device clocks mapped to the host's monotonic clock."""

from imu_rig.timing.clock_fit import ClockFit, alignment_sigma_s, fit_clock
from imu_rig.timing.counters import Unwrapper, unwrap
from imu_rig.timing.device_time import DeviceTime, Unwrapped
from imu_rig.timing.live_clock_fit import LiveClockFit

__all__ = [
    "ClockFit",
    "DeviceTime",
    "LiveClockFit",
    "Unwrapped",
    "Unwrapper",
    "alignment_sigma_s",
    "fit_clock",
    "unwrap",
]
