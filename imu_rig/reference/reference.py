"""What another instrument measured of the same motion."""

from __future__ import annotations

from dataclasses import dataclass

from imu_rig.arrays import BoolArray, FloatArray


@dataclass(frozen=True)
class Reference:
    """What another instrument measured meanwhile, on the time of the recording.

    Attributes
    ----------
    t : shape (n,)
        Time [s].
    position : shape (n, 3) or None
        Position [m], right-handed, z up; NaN where it was lost.
    orientation : shape (n, 4) or None
        Scalar-first quaternion, sensor to reference frame; NaN where it was lost.
    moving : shape (n,) or None
        Which samples the makers of the recording count when they compare.
    frame : str
        What is known of the frame.
    """

    t: FloatArray
    position: FloatArray | None = None
    orientation: FloatArray | None = None
    moving: BoolArray | None = None
    frame: str = ""

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.t)
