"""Files as other programs write them, from the facts of their formats, with numbers made here."""

import numpy as np
from scipy.io import savemat

G = 9.80665
XSENS_NAMES = [
    *("PacketCounter", "SampleTimeFine", "Year"),
    *("Acc_X", "Acc_Y", "Acc_Z", "Gyr_X", "Gyr_Y", "Gyr_Z", "Mag_X", "Mag_Y", "Mag_Z"),
]
INERTIAL = (
    "Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s),"
    "Accelerometer X (g),Accelerometer Y (g),Accelerometer Z (g)"
)


def motion(n=200, seed=1):
    """Accelerometer [m/s2] and gyroscope [rad/s] of a tilted sensor near rest, (n, 3) each."""
    rng = np.random.default_rng(seed)
    accel = np.array([3.0, -4.0, 8.4]) + 0.05 * rng.standard_normal((n, 3))
    return accel, 0.02 * rng.standard_normal((n, 3))


def xsens_rows(n=200, first=100, ticks=100, seed=1):
    """Cells of an export at 100 Hz (10 kHz clock), as lists of text."""
    accel, gyro = motion(n, seed)
    mag = 0.5 + 1e-3 * np.random.default_rng(seed).standard_normal((n, 3))
    rows = []
    for i in range(n):
        numbers = [*accel[i], *gyro[i], *mag[i]]
        count, clock = (first + i) % 65536, (500_000 + ticks * i) % 2**32
        rows.append([f"{count:05d}", str(clock), "", *(f"{v:.6f}" for v in numbers)])
    return rows


def write_xsens(path, rows, names=XSENS_NAMES, rate="100.0Hz", device=None, delimiter="\t"):
    head = ["// Start Time: Unknown", "// Filter Profile: human (46.1)"]
    if rate is not None:
        head.append(f"// Update Rate: {rate}")
    if device is not None:
        head += ["// Device information: ", f"//  DeviceId: {device}"]
    lines = [*head, delimiter.join(names), *(delimiter.join(row) for row in rows)]
    path.write_text("\r\n".join(lines) + "\r\n")
    return path


def write_inertial(path, stamps, seed=1, header="Timestamp (us)"):
    accel, gyro = motion(len(stamps), seed)
    values = np.hstack((np.degrees(gyro), accel / G))
    lines = [f"{header},{INERTIAL}"]
    for stamp, row in zip(stamps, values, strict=True):
        lines.append(f"{stamp}," + ",".join(f"{v:.6f}" for v in row))
    path.write_text("\n".join(lines) + "\n")
    return np.loadtxt(lines[1:], delimiter=",")[:, 1:]


def write_table(path, header, stamps, values):
    lines = [header]
    for stamp, row in zip(stamps, values, strict=True):
        lines.append(f"{stamp}," + ",".join(f"{v:.6f}" for v in np.atleast_1d(row)))
    path.write_text("\n".join(lines) + "\n")


def broad_content(n=300, rate=2000 / 7, seed=1):
    accel, gyro = motion(n, seed)
    rng = np.random.default_rng(seed)
    orientation = rng.standard_normal((n, 4))
    orientation /= np.linalg.norm(orientation, axis=1, keepdims=True)
    orientation[10:20] = np.nan
    position = rng.standard_normal((n, 3))
    position[10:20] = np.nan
    return {
        "imu_acc": accel,
        "imu_gyr": gyro,
        "imu_mag": 40.0 + rng.standard_normal((n, 3)),
        "sampling_rate": rate,
        "opt_quat": orientation,
        "opt_pos": position,
        "movement": (np.arange(n) > n // 2)[:, None],
        "info": "made by a test",
    }


def pyshoe_content(n=300, seed=1):
    accel, gyro = motion(n, seed)
    rng = np.random.default_rng(seed)
    ts = 0.0052 + np.cumsum(0.005 + 0.0005 * rng.uniform(-1, 1, n))
    return {
        "imu": np.hstack((accel * [1, 1, -1], gyro)),
        "ts": ts[None, :],
        "gt": np.cumsum(rng.standard_normal((n, 3)), axis=0),
        "zv_shoe_opt": np.zeros((1, n), np.int64),
    }


def write_mat(path, content, **options):
    savemat(path, content, **options)
    return path
