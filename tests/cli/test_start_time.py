"""What a command imports: drawing takes longer to import than a calibration takes to solve."""

import subprocess
import sys

import pytest


@pytest.mark.parametrize("module", ["imu_rig.cli.summary", "imu_rig.session.solve"])
def test_solving_and_telling_it_draw_nothing(module):
    program = (
        f"import sys, {module}\n"
        "import imu_rig.calibration.certificate, imu_rig.calibration.reach\n"
        "heavy = {name.split('.')[0] for name in sys.modules} & {'matplotlib', 'scipy'}\n"
        "sys.exit(', '.join(sorted(heavy)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
