"""Small files: bounds, and all or nothing."""

from pathlib import Path

import pytest

from imu_rig.errors import InputError, StorageError
from imu_rig.files import parse_toml, read_small, whole_file, write_whole


def write_half(target: Path) -> None:
    with whole_file(target, what="a table") as file:
        file.write(b"half")
        raise KeyboardInterrupt


def test_a_file_appears_only_when_it_is_whole(tmp_path: Path) -> None:
    target = tmp_path / "table.csv"
    with pytest.raises(KeyboardInterrupt):
        write_half(target)
    assert list(tmp_path.iterdir()) == []
    write_whole(target, b"whole", what="a table")
    assert target.read_bytes() == b"whole"
    with pytest.raises(InputError, match="never overwritten"):
        write_whole(target, b"other", what="a table")
    write_whole(target, b"other", what="a table", overwrite=True)
    assert target.read_bytes() == b"other"
    assert [path.name for path in tmp_path.iterdir()] == ["table.csv"]


def test_a_link_is_replaced_not_followed(tmp_path: Path) -> None:
    elsewhere, link = tmp_path / "elsewhere", tmp_path / "link"
    elsewhere.write_text("mine")
    link.symlink_to(elsewhere)
    write_whole(link, b"new", what="a table", overwrite=True)
    assert elsewhere.read_text() == "mine"
    assert link.read_text() == "new"


@pytest.mark.parametrize("name", ["x" * 300, "none/x", "nul\0"])
def test_impossible_names_are_one_sentence(tmp_path: Path, name: str) -> None:
    with pytest.raises((InputError, StorageError)):
        write_whole(tmp_path / name, b"", what="a table")


def test_reading_is_bounded(tmp_path: Path) -> None:
    path = tmp_path / "small"
    path.write_bytes(b"12345")
    assert read_small(path, 5, what="a note") == b"12345"
    with pytest.raises(InputError, match="too large for a note"):
        read_small(path, 4, what="a note")
    with pytest.raises(InputError, match="no ordinary file"):
        read_small(tmp_path, 4, what="a note")


@pytest.mark.parametrize(
    "data",
    [b"a = ", b"\xff = 1", b"a." * 100 + b"a = 1", b"a = " + b"[" * 9000, b"a = " + b"9" * 9999],
)
def test_bad_toml_is_named(data: bytes) -> None:
    with pytest.raises(InputError, match=r"mine\.toml"):
        parse_toml(data, "mine.toml")
