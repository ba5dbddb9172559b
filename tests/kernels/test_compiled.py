"""Compiled functions are kept, and made anew when any file of their room changes."""

import importlib.util
import sys

import pytest

from imu_rig.kernels import compiled

PART = """
from imu_rig.kernels.compiled import inlined

@inlined
def more(x):
    return x + {}
"""
WHOLE = """
from imu_rig.kernels.compiled import compiled
from room_part import more

@compiled
def whole(x):
    return 2.0 * more(x)
"""


@pytest.fixture
def room(tmp_path, monkeypatch):
    """Return a function that loads the room's compiled function as a new process would."""
    folder = tmp_path / "room"
    folder.mkdir()
    (folder / "room_whole.py").write_text(WHOLE)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    monkeypatch.setattr("numba.config.CACHE_DIR", "")
    monkeypatch.setattr(compiled._State, "unkept", 0)

    def load(added=1.0):
        (folder / "room_part.py").write_text(PART.format(added))
        compiled.room_digest.cache_clear()
        modules = {}
        for name in ("room_part", "room_whole"):
            spec = importlib.util.spec_from_file_location(name, folder / f"{name}.py")
            modules[name] = importlib.util.module_from_spec(spec)
            monkeypatch.setitem(sys.modules, name, modules[name])
            monkeypatch.setattr(sys, "dont_write_bytecode", True)
            spec.loader.exec_module(modules[name])
        return modules["room_whole"].whole

    load.folder = folder
    return load


def hits(function):
    return sum(function.stats.cache_hits.values())


def test_what_is_compiled_is_kept_until_a_file_beside_changes(room):
    first = room()
    assert first(1.0) == 4.0
    assert hits(first) == 0
    again = room()
    assert again(1.0) == 4.0
    assert hits(again) == 1
    changed = room(added=5.0)
    assert changed(1.0) == 12.0
    assert hits(changed) == 0
    assert not compiled.compiling()


@pytest.mark.skipif(sys.platform != "linux", reason="user caches are elsewhere")
def test_where_the_package_cannot_be_written_the_users_cache_is_used(room):
    (room.folder / "__pycache__").write_text("no folder")
    assert room()(1.0) == 4.0
    again = room()
    assert again(1.0) == 4.0
    assert hits(again) == 1
    assert str(again._cache.cache_path).startswith(str(room.folder.parent / "caches"))


@pytest.mark.skipif(sys.platform != "linux", reason="user caches are elsewhere")
def test_where_nothing_can_be_written_all_works(room):
    (room.folder / "__pycache__").write_text("no folder")
    (room.folder.parent / "caches").write_text("no folder")
    assert room()(1.0) == 4.0
    assert not compiled.kept()


def test_a_kept_file_that_is_broken_is_made_anew(room):
    assert room()(1.0) == 4.0
    for file in (room.folder / "__pycache__").glob("*.nb?"):
        file.write_bytes(file.read_bytes()[:40])
    assert room()(1.0) == 4.0
