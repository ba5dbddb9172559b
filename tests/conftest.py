"""What every test gets: a guard against leaks and the folder of real recordings."""

import gc
import os
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

# as in the program: threads cost more than they save on small matrices; numpy reads it at import
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import matplotlib as mpl
import pytest
from hypothesis import settings
from xdist.remote import Producer
from xdist.scheduler import LoadScopeScheduling

mpl.use("agg")
settings.register_profile("untimed", deadline=None)  # a busy machine fails no test
settings.load_profile("untimed")

ROOT = Path(__file__).resolve().parent.parent
AGAINST_THE_CLOCK = tuple(
    f"tests/{folder}/" for folder in ("cli", "devices", "end_to_end", "recorder", "simulators")
)
KEEPING_THEIR_OWN_TIME = tuple(
    f"tests/simulators/test_{name}"
    for name in (
        "adis16405_",
        "imu_kinds",
        "jig_kinematics",
        "maestro_channel",
        "mma7260",
        "mpu9150_model",
        "ms5803_chip",
        "quick_session",
        "sample_means",
        "servo_motion",
        "two_imu",
        "waist_unit",
        "walk_devices",
        "walk_motion",
        "walk_truth",
        "world_physics",
    )
)
"""Files in those folders that open no ports: they may run beside anything."""
LEAK_PATIENCE_S = 2.0  # a thread told to stop may still be on its last lines
WORKERS = 2  # sessions in simulated time mostly wait; more would get in each other's way


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let whoever has the time run what the ordinary suite samples."""
    parser.addoption(
        "--exhaustive",
        action="store_true",
        help="every combination of faults and states, where the suite takes turns",
    )


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Share the whole suite between processes; a part of it runs in this one."""
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    return WORKERS if whole and (os.cpu_count() or 1) >= WORKERS else 0


class _InWholeFiles(LoadScopeScheduling):
    """Keep together every file, and all that runs against the clock.

    Simulated hardware keeps up with its clock as long as it has a core to itself; two such tests
    at a time, of which some start a dozen programs, would take it from each other.
    """

    def _split_scope(self, nodeid: str) -> str:
        path = nodeid.split("::")[0]
        if path.startswith(KEEPING_THEIR_OWN_TIME) or not path.startswith(AGAINST_THE_CLOCK):
            return path
        return "against the clock"


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> LoadScopeScheduling:
    """Deal tests out to the processes."""
    return _InWholeFiles(config, log)


@pytest.fixture(scope="session")
def imu_rig_data() -> Path:
    """Folder of the real recordings; tests that need it are skipped where it is absent."""
    folder = Path(os.environ.get("IMU_RIG_DATA", ROOT.parent / "shared" / "data"))
    if not (folder / "calibration").is_dir():
        pytest.skip(f"no real recordings in {folder} (set IMU_RIG_DATA to their folder)")
    return folder


@pytest.fixture(scope="session", autouse=True)
def private_temporary_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Send temporary files to a folder of this run, so that a forgotten one is seen."""
    folder = tmp_path_factory.mktemp("temporary")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", str(folder))
        patch.setattr(tempfile, "tempdir", None)
        yield folder


@pytest.fixture(autouse=True)
def nothing_left_behind(private_temporary_folder: Path) -> Iterator[None]:
    """Fail a test that leaves a thread, a child process, an open port or a temporary file."""
    before = _belongings(private_temporary_folder)
    yield
    deadline = time.monotonic() + LEAK_PATIENCE_S
    while left := _belongings(private_temporary_folder) - before:
        if time.monotonic() > deadline:
            pytest.fail(f"left behind: {', '.join(sorted(left))}", pytrace=False)
        gc.collect()
        time.sleep(0.02)


def _belongings(folder: Path) -> set[str]:
    threads = {f"thread {t.name} {t.ident}" for t in threading.enumerate() if t.is_alive()}
    files = {f"temporary file {p.name}" for p in folder.iterdir()}
    return threads | files | _open_ports()


def _open_ports() -> set[str]:
    """Open sockets, pipes and terminals of this process (empty where there is no /proc)."""
    ports = set()
    try:
        descriptors = list(Path("/proc/self/fd").iterdir())
    except OSError:
        return ports
    for descriptor in descriptors:
        try:
            target = str(descriptor.readlink())
        except OSError:  # closed meanwhile
            continue
        if target.startswith(("socket:", "pipe:", "/dev/pt", "/dev/tty")):
            ports.add(f"descriptor {descriptor.name} of {target}")
    return ports
