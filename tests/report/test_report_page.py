"""HTML pieces escape what they take in, and a report reaches the disk whole or not at all."""

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imu_rig.errors import InputError, StorageError
from imu_rig.report.page import Html, element, joined, table, text, write_report


@given(st.text())
def test_escaped_text_holds_no_markup(value):
    escaped = text(value)
    assert not set(escaped) & set("<>\"'")
    assert "&" not in escaped.replace("&amp;", "").replace("&lt;", "").replace("&gt;", "").replace(
        "&quot;", ""
    ).replace("&#x27;", "")
    escaped.encode()


def test_elements_escape_texts_and_attributes_but_not_elements():
    inner = element("b", "1 < 2")
    outer = element("p", inner, " & ", title='"><i>')
    assert outer == '<p title="&quot;&gt;&lt;i&gt;"><b>1 &lt; 2</b> &amp; </p>'


def test_markup_that_became_plain_text_is_escaped_again():
    plain = f"{element('b', 'x')}"
    assert not isinstance(plain, Html)
    assert joined([plain]) == "&lt;b&gt;x&lt;/b&gt;"


def test_misleading_and_unprintable_characters_become_visible():
    assert text("gpj.\u202egnp") == "gpj.\ufffdgnp"
    assert text("a\x00b\x1bc\ud800") == "a\ufffdb\ufffdc\ufffd"


def test_table_rows_begin_with_a_header():
    shown = table(["name", "value"], [["<b>", "1"]])
    assert '<th scope="row">&lt;b&gt;</th><td>1</td>' in shown


def test_a_report_is_written_and_never_overwritten_unasked(tmp_path):
    path = tmp_path / "report.html"
    write_report(path, "first ±")
    with pytest.raises(InputError, match="exists"):
        write_report(path, "second")
    assert path.read_text(encoding="utf-8") == "first ±"
    write_report(path, "second", overwrite=True)
    assert path.read_text(encoding="utf-8") == "second"
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def test_a_place_that_cannot_hold_a_report_is_named(tmp_path):
    with pytest.raises(InputError, match="nowhere is not a folder"):
        write_report(tmp_path / "nowhere" / "report.html", "x")
    with pytest.raises(InputError, match="is a folder"):
        write_report(tmp_path, "x", overwrite=True)


def test_a_full_disk_keeps_the_old_report_and_leaves_nothing(tmp_path, monkeypatch):
    path = tmp_path / "report.html"
    write_report(path, "old")

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match="No space left"):
        write_report(path, "new", overwrite=True)
    assert path.read_text(encoding="utf-8") == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def test_a_symbolic_link_is_replaced_not_followed(tmp_path):
    target = tmp_path / "precious"
    target.write_text("keep", encoding="utf-8")
    link = tmp_path / "report.html"
    link.symlink_to(target)
    with pytest.raises(InputError, match="exists"):
        write_report(link, "x")
    write_report(Path(link), "x", overwrite=True)
    assert target.read_text(encoding="utf-8") == "keep"
    assert not link.is_symlink()
