"""What `imu-rig record --json` writes, while it records and at the end."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from imu_rig.recorder.engine import RecordingOutcome
    from imu_rig.recorder.status import DeviceStatus, RecorderStatus


def json_line(kind: str, values: dict[str, Any]) -> str:
    """Return a line of ``--json``; numbers that JSON cannot have are null."""
    return json.dumps({kind: _finite(values)}, allow_nan=False)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def status_json(status: RecorderStatus) -> dict[str, Any]:
    """Return a status as plain JSON values."""
    return {
        **dataclasses.asdict(status),
        "path": str(status.path),
        "devices": [device_json(device) for device in status.devices],
    }


def result_json(
    outcome: RecordingOutcome, shortfalls: Sequence[str], exit_code: int
) -> dict[str, Any]:
    """Return how a recording ended as plain JSON values."""
    return {
        **dataclasses.asdict(outcome),
        "path": str(outcome.path),
        "devices": [device_json(device) for device in outcome.devices],
        "complete": not shortfalls and outcome.reason == "complete",
        "shortfalls": list(shortfalls),
        "exit_code": exit_code,
    }


def device_json(device: DeviceStatus) -> dict[str, Any]:
    """Return how a device does as plain JSON values."""
    return {
        **dataclasses.asdict(device),
        "loss": device.loss,
        "supply": {name: [value, unit] for name, value, unit in device.supply},
        "streams": [device_json(stream) for stream in device.streams],
    }
