"""imu-rig: calibrate inertial sensors on a servo jig and record trials that nothing can lose.

Conventions of the whole package: SI units inside (microtesla for the magnetic field), sample axis
first, scalar-first body-to-navigation quaternions, navigation frame with z up, accelerometers read
+g upward at rest, and a calibrated value is ``K @ raw - b``.

Examples
--------
>>> trial = imu_rig.open_trial("walk.imu-trial")  # doctest: +SKIP
>>> trial.imu("left shoe", calibrated=True).accel  # doctest: +SKIP
>>> track = imu_rig.smooth_foot(trial.imu("left shoe"), covariance=True)  # doctest: +SKIP
>>> imu_rig.gait_parameters(track).length  # doctest: +SKIP
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from imu_rig.gait.live import LiveFoot
    from imu_rig.gait.smoother import smooth_foot
    from imu_rig.gait.strides import gait_parameters
    from imu_rig.recording.reader import Trial, open_trial

__version__ = "0.1.0"

__all__ = ["LiveFoot", "Trial", "__version__", "gait_parameters", "open_trial", "smooth_foot"]

_HOMES = {
    "LiveFoot": "imu_rig.gait.live",
    "Trial": "imu_rig.recording.reader",
    "gait_parameters": "imu_rig.gait.strides",
    "open_trial": "imu_rig.recording.reader",
    "smooth_foot": "imu_rig.gait.smoother",
}


def __getattr__(name: str) -> Any:
    """Load what the package offers when it is asked for: arrays take a second to import."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
