"""A finished export."""

from __future__ import annotations

from dataclasses import dataclass, field

from imu_rig.calibration.exports.loss import Loss


@dataclass(frozen=True)
class Exported:
    """Text of a file and what its user must know.

    Attributes
    ----------
    text : str
        Content of the file.
    loss : Loss
        What the target cannot hold; nothing by default.
    notes : tuple of str
        One sentence each.
    """

    text: str
    loss: Loss = field(default_factory=Loss)
    notes: tuple[str, ...] = ()
