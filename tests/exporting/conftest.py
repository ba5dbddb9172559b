"""One trial of four devices for all formats."""

import pytest
from trials_to_export import write_trial

from imu_rig.recording import Trial


@pytest.fixture(scope="session")
def trial(tmp_path_factory: pytest.TempPathFactory) -> Trial:
    return write_trial(tmp_path_factory.mktemp("export") / "walk.imu-trial")
