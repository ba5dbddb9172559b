"""What `imu-rig monitor --json` writes, each second and at the end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from imu_rig.cli.record_json import device_json, json_line
from imu_rig.monitor.status import MonitorStatus


def status_line(status: MonitorStatus) -> str:
    """Return a line with how the devices do now."""
    return json_line("status", _values(status))


def result_line(status: MonitorStatus, save: Path | None, exit_code: int) -> str:
    """Return the last line."""
    picture = None if save is None else str(save)
    return json_line("result", {**_values(status), "picture": picture, "exit_code": exit_code})


def _values(status: MonitorStatus) -> dict[str, Any]:
    return {
        "elapsed_s": status.elapsed_s,
        "planned_s": status.planned_s,
        "devices": [device_json(device) for device in status.devices],
        "readings": {
            name: {
                quantity.name: {
                    "value": list(numbers) if quantity.count > 1 else numbers[0],
                    "unit": quantity.unit,
                }
                for quantity, numbers in readings
            }
            for name, readings in status.readings.items()
        },
    }
