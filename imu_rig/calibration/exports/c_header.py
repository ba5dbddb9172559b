"""A C99 header that needs nothing else: the numbers, and a function that applies them."""

from __future__ import annotations

import re

from imu_rig.calibration.exports.exported import Exported
from imu_rig.calibration.exports.options import ExportOptions
from imu_rig.calibration.exports.source import KINDS, UNITS, Source
from imu_rig.calibration.model import Affine

APPLY = """\
static inline void {name}_{sensor}(const {real} raw[3], {real} calibrated[3])
{{
    const {real} x = raw[0], y = raw[1], z = raw[2];
    int i;
    for (i = 0; i < 3; ++i) {{
        calibrated[i] = {name}_{sensor}_K[i][0] * x + {name}_{sensor}_K[i][1] * y
            + {name}_{sensor}_K[i][2] * z - {name}_{sensor}_b[i];
    }}
}}"""


def c_header(source: Source, options: ExportOptions) -> Exported:
    """Write a header whose names begin with ``options.name``."""
    name = options.name
    real, guard = f"{name}_real", f"{name.upper()}_H"
    lines = ["/*", *(f" * {_comment(line)}" for line in source.about), " *"]
    lines += [
        " * calibrated = K raw - b; an in-place call is allowed.",
        f" * Numbers are float; define {name.upper()}_REAL as double for more digits.",
        " */",
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        f"#ifndef {name.upper()}_REAL",
        f"#define {name.upper()}_REAL float",
        "#endif",
        f"typedef {name.upper()}_REAL {real};",
    ]
    for sensor, model in source.sensors.items():
        lines += ["", *_arrays(name, sensor, real, model), ""]
        lines.append(APPLY.format(name=name, sensor=sensor, real=real))
    lines += ["", f"#endif /* {guard} */"]
    return Exported("\n".join(lines) + "\n")


def _arrays(name: str, sensor: str, real: str, model: Affine) -> list[str]:
    def row(values: list[float], cast: bool = True) -> str:
        return ", ".join(f"({real}){value!r}" if cast else f"{value:.2g}" for value in values)

    K, b = (model.K + 0.0).tolist(), (model.b + 0.0).tolist()
    K_u, b_u = model.K_uncertainty.tolist(), model.b_uncertainty.tolist()
    lines = [f"/* {KINDS[sensor]}: raw and calibrated readings and b in {UNITS[sensor]}. */"]
    lines.append(f"static const {real} {name}_{sensor}_K[3][3] = {{")
    lines += [
        f"    {{{row(values)}}}, /* standard uncertainties {row(u, cast=False)} */"
        for values, u in zip(K, K_u, strict=True)
    ]
    lines.append("};")
    lines.append(f"/* standard uncertainties {row(b_u, cast=False)} {UNITS[sensor]} */")
    lines.append(f"static const {real} {name}_{sensor}_b[3] = {{{row(b)}}};")
    return lines


def _comment(line: str) -> str:
    """Keep a text of unknown origin from ending the comment, or beginning another.

    Two question marks begin a trigraph, which compilers warn of even here.
    """
    return re.sub(r"\?(?=\?)", "? ", line).replace("*/", "* /").replace("/*", "/ *")
