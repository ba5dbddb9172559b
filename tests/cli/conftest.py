"""Running the installed program as its users do."""

import io
import json
import subprocess
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import pytest
from program import PROGRAM

from imu_rig.cli.main import run as main

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def imu_rig() -> Run:
    """Run `imu-rig` with arguments; `code` is the exit code that is expected."""

    def run(
        *arguments: object, code: int = 0, cwd: Path | None = None
    ) -> subprocess.CompletedProcess[str]:
        done = subprocess.run(
            [PROGRAM, *map(str, arguments)],
            cwd=cwd,
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
        )
        assert done.returncode == code, done.stdout + done.stderr
        assert "Traceback" not in done.stderr
        return done

    return run


@pytest.fixture(scope="session")
def inside() -> Run:
    """Run `imu-rig` in the same way inside this process, which saves its start."""

    def run(
        *arguments: object, code: int = 0, cwd: Path | None = None
    ) -> subprocess.CompletedProcess[str]:
        stdout, stderr, returned = io.StringIO(), io.StringIO(), 0
        with (
            pytest.MonkeyPatch.context() as patch,
            redirect_stdout(stdout),
            redirect_stderr(stderr),
        ):
            patch.setattr(sys, "argv", [str(PROGRAM), *map(str, arguments)])
            if cwd is not None:
                patch.chdir(cwd)
            try:
                main()
            except SystemExit as leaving:
                returned = int(leaving.code or 0)
        done = subprocess.CompletedProcess(sys.argv, returned, stdout.getvalue(), stderr.getvalue())
        assert returned == code, done.stdout + done.stderr
        return done

    return run


@pytest.fixture(scope="session")
def finished(imu_rig: Run, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The JSON of one whole demo session, with the paths of its files."""
    folder = tmp_path_factory.mktemp("demo") / "out"
    done = imu_rig("demo", "--json", "--quiet", "--output", folder)
    return json.loads(done.stdout)
