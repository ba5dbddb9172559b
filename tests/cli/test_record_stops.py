"""Recordings ended from outside: by key, by signal, by a closed window, by kill -9."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from program import PROGRAM
from terminal import PATIENCE_S, Terminal

from imu_rig.errors import InputError
from imu_rig.recording.reader import Trial, open_trial
from simulators.served_devices import ServedDevices

WAYS = ("key", "ctrl-c", "SIGTERM", "hang-up", "kill", "full disk")
ON_TERMINALS = ("key", "ctrl-c", "hang-up")
WITH_JIG = ("ctrl-c", "SIGTERM", "hang-up")
FULL_BYTES = 14_000
ALMOST_FULL = (
    "import os, resource, sys; "
    f"resource.setrlimit(resource.RLIMIT_FSIZE, ({FULL_BYTES}, {FULL_BYTES})); "
    "os.execv(sys.argv[1], sys.argv[1:])"
)
"""Lets files grow as far as on a disk that is almost full."""
CLEAN_S = 3.0


@dataclass
class Ending:
    """What was left of one recording."""

    code: int
    trial: Trial
    text: str = ""
    took_s: float = 0.0  # from the signal to the last byte of the file
    details: dict[str, object] = field(default_factory=dict)


def the_trial(folder: Path) -> Path | None:
    return next(folder.glob("recordings/*/*.imu-trial"), None)


def wait_until_live(folder: Path) -> Path:
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        path = the_trial(folder)
        if path is not None and path.stat().st_size > 2000:
            try:
                if any(event.name == "all_live" for event in open_trial(path).events):
                    return path
            except InputError:  # created just now
                pass
        time.sleep(0.05)
    pytest.fail(f"nothing live in {folder}")


def until(terminal: Terminal, modes: list[object]) -> list[object]:
    """Wait for a terminal to have modes, and return those it has."""
    deadline = time.monotonic() + PATIENCE_S
    while terminal.modes_now() != modes and time.monotonic() < deadline:
        terminal.read(0.01)
    return terminal.modes_now()


@contextlib.contextmanager
def full_pipe() -> Iterator[int]:
    """Yield the end to write to of a pipe that nobody reads."""
    read, write = os.pipe()
    try:
        os.set_blocking(write, False)
        with contextlib.suppress(BlockingIOError):
            while os.write(write, bytes(65536)):
                pass
        os.set_blocking(write, True)
        yield write
    finally:
        os.close(read)
        os.close(write)


@pytest.fixture(scope="module")
def endings(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Ending]]:
    """Six recordings at the same time, each ended in its own way.

    The reader of the one that gets a SIGTERM has stopped reading.
    """
    root = tmp_path_factory.mktemp("endings")
    found: dict[str, Ending] = {}
    with ServedDevices() as served, full_pipe() as unread:
        terminals, processes, urls = {}, {}, {}
        folders = {way: root / way for way in WAYS}
        try:
            for way, folder in folders.items():
                folder.mkdir()
                urls[way] = served.add(way, "mpu9150-28", seed=1)
                arguments = ["record", "--device", f"left shoe={urls[way]}"]
                if way in WITH_JIG:
                    arguments += ["--maestro", served.add_servos(f"jig of {way}")]
                if way == "ctrl-c":
                    arguments += ["--duration", "1h"]
                elif way == "SIGTERM":
                    arguments += ["--json"]
                if way in ON_TERMINALS:
                    terminals[way] = Terminal(*arguments, cwd=folder)
                else:
                    full = way == "full disk"
                    before = [sys.executable, "-ISc", ALMOST_FULL] if full else []
                    processes[way] = subprocess.Popen(
                        [*before, PROGRAM, *arguments],
                        cwd=folder,
                        stdin=subprocess.PIPE,
                        stdout=unread if way == "SIGTERM" else subprocess.PIPE,
                        stderr=subprocess.PIPE,
                        text=True,
                    )
            paths = {way: wait_until_live(folder) for way, folder in folders.items()}

            processes["second"] = subprocess.Popen(
                [PROGRAM, "record", "--device", urls["key"]],
                cwd=folders["key"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            key = terminals["key"]
            key.read_until("q: stop")
            during = key.modes_now()
            key.press("a")
            key.press("\x1b[A")  # arrow up: no marker A
            key.press("\x1a")  # Ctrl-Z: halts nothing
            key.press(" ")
            key.press("é")
            size = paths["key"].stat().st_size
            deadline = time.monotonic() + PATIENCE_S
            while paths["key"].stat().st_size < size + 5000 and time.monotonic() < deadline:
                key.read()
            halted = terminals["ctrl-c"]
            halted.process.send_signal(signal.SIGTSTP)
            at_halt = until(halted, halted.modes)
            halted.process.send_signal(signal.SIGCONT)
            again = until(halted, during)
            refused = processes["second"].communicate(timeout=PATIENCE_S)[1]
            second = processes.pop("second")
            key.press("q")
            asked_s = time.time()
            halted.press("\x03")
            time.sleep(0.05)  # as fast as an impatient person
            halted.press("\x03")
            terminals["hang-up"].hang_up()
            processes["SIGTERM"].send_signal(signal.SIGTERM)
            processes["kill"].kill()
            for way, terminal in terminals.items():
                code = terminal.wait()
                found[way] = Ending(code, open_trial(paths[way]), terminal.text)
            for way, process in processes.items():
                stdout, stderr = process.communicate(timeout=PATIENCE_S)
                found[way] = Ending(process.returncode, open_trial(paths[way]), f"{stdout}{stderr}")
            for way, path in paths.items():
                found[way].took_s = path.stat().st_mtime - asked_s
            found["key"].details = {
                "second": (second.returncode, refused),
                "during": during,
                "after": key.modes_now(),
                "before": key.modes,
                "halted": at_halt == key.modes and again == during,
            }
            yield found
        finally:
            for terminal in terminals.values():
                terminal.close()
            for process in processes.values():
                process.kill()
                process.communicate()


@pytest.mark.parametrize(
    ("way", "code", "reason"),
    [
        ("key", 0, "complete"),
        ("ctrl-c", 130, "interrupted"),  # before its planned end
        ("SIGTERM", 0, "complete"),
        ("hang-up", 0, "complete"),
        ("kill", -signal.SIGKILL, None),
        ("full disk", 5, None),  # not even an end record finds room
    ],
)
def test_however_it_ends_the_file_is_whole_and_says_so(endings, way, code, reason):
    ending = endings[way]
    assert "Traceback" not in ending.text
    assert (ending.code, ending.trial.ended) == (code, reason), ending.text
    if way in ("key", "ctrl-c"):  # somebody can read it
        assert "imu-rig info recordings/" in ending.text
    assert not ending.trial.damage.records_lost
    samples = ending.trial.samples("left shoe")
    assert len(samples.t) > 50
    assert (samples.counter[1:] - samples.counter[:-1] == 1).all()


@pytest.mark.parametrize("way", WITH_JIG)
def test_a_jig_is_parked_and_the_file_closed_at_once(endings, way):
    ending = endings[way]
    assert [event.name for event in ending.trial.events] == ["all_live", "parking"]
    assert ending.took_s < CLEAN_S


def test_a_disk_that_fills_up_is_told_with_what_to_do(endings):
    told = " ".join(endings["full disk"].text.split())
    assert "has reached the largest size" in told
    assert "record to another disk before you go on." in told
    assert endings["full disk"].trial.path.stat().st_size <= FULL_BYTES


def test_keys_are_markers_and_no_key_sequence_is_one(endings):
    labels = [marker.label for marker in endings["key"].trial.markers]
    assert labels == ["a", "marker 2", "é"]


def test_the_terminal_gives_keys_one_by_one_and_is_as_before_afterwards(endings):
    modes = endings["key"].details
    assert modes["during"] != modes["before"]
    assert modes["after"] == modes["before"]
    assert modes["halted"]
    assert endings["key"].text.rfind("\x1b[?25h") > endings["key"].text.rfind("\x1b[?25l")


def test_the_table_is_drawn_over_itself_and_the_figures_stay(endings):
    text = endings["key"].text
    assert "● RECORDING" in text
    assert "\x1b[2J" not in text
    assert "± " in text.rpartition("device")[2]  # how well its time is known
    assert text.rstrip().splitlines()[-2].lstrip().startswith("imu-rig info recordings/")


def test_a_second_recorder_on_the_port_is_refused_and_the_first_goes_on(endings):
    code, said = endings["key"].details["second"]
    assert code == 3, said
    assert "open in another program" in said
    assert "Traceback" not in said
    assert len(list(endings["key"].trial.path.parent.iterdir())) == 1
