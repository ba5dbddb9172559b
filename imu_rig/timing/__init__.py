"""Time: device counters unwrapped, device clocks mapped to the host's monotonic clock."""

from imu_rig.timing.clock_fit import ClockFit, LiveClockFit, fit_clock
from imu_rig.timing.counters import Unwrapper, unwrap
from imu_rig.timing.device_time import DeviceTime, Unwrapped

__all__ = [
    "ClockFit",
    "DeviceTime",
    "LiveClockFit",
    "Unwrapped",
    "Unwrapper",
    "fit_clock",
    "unwrap",
]
