"""Files of a folder that may be forged: names, lists, contents, and never more than is allowed."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import pytest

from pdcd.errors import DecodeError, PdcdError
from pdcd.files import inside, reading
from pdcd.files.inside import (
    find_name_fault,
    list_folder,
    open_folder,
    open_inner_file,
    read_inner_file,
)
from pdcd.files.reading import hash_open_file
from pdcd.files.system import path_of
from pdcd.protocol import events
from pdcd.runs import manifest, provenance


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("raw/coded.dng", None),
        ("raw/..dng", None),
        ("raw/...", None),
        ("a b~ é", None),
        ("x" * 255, None),
        ("/".join("a" * 16), None),
        ("x" * 256, "too long"),
        ("raw/" + "é" * 128, "too long"),  # 256 bytes, whatever the letters
        ("/".join("a" * 17), "too long"),
        ("/etc/passwd", "absolute"),
        ("..\\secret", "elsewhere on other systems"),
        ("C:evil", "elsewhere on other systems"),
        ("../x", "leads out"),
        ("raw/../x", "leads out"),
        ("raw/..", "leads out"),
        ("", "empty"),
        ("raw//x", "empty"),
        ("raw/", "empty"),
        ("raw/./x", "empty"),
        (".", "empty"),
        ("a\x1fb", "control"),
        ("a\x7fb", "control"),
        ("a\ud800", "no text"),
    ],
)
def test_a_name_leads_to_a_file_inside_or_its_fault_is_told(name: str, fault: str | None) -> None:
    found = find_name_fault(name)
    assert found is None if fault is None else fault in str(found)


def test_all_that_lies_in_a_folder_is_listed_by_its_kind(tmp_path: Path) -> None:
    (tmp_path / "raw" / "deep").mkdir(parents=True)
    (tmp_path / "raw" / "deep" / "a").write_text("x")
    (tmp_path / "link").symlink_to(tmp_path / "raw")
    os.mkfifo(tmp_path / "pipe")
    fds = len(list(Path("/proc/self/fd").iterdir()))
    with open_folder(tmp_path) as folder:
        assert list_folder(folder) == {
            "raw": "folder", "raw/deep": "folder", "raw/deep/a": "file", "link": "symbolic link",
            "pipe": "FIFO",
        }  # fmt: skip
    assert len(list(Path("/proc/self/fd").iterdir())) == fds


def test_no_more_is_listed_than_is_allowed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place = tmp_path
    for _ in range(4):
        place /= "d"
        place.mkdir()
    monkeypatch.setattr(inside, "MAX_NAME_PARTS", 3)
    with open_folder(tmp_path) as folder:
        assert [*list_folder(folder)] == ["d", "d/d", "d/d/d"]
        monkeypatch.setattr(inside, "MAX_ENTRIES", 3)
        assert len(list_folder(folder)) == 3
        monkeypatch.setattr(inside, "MAX_ENTRIES", 2)
        with pytest.raises(DecodeError, match="more than 2 files"):
            list_folder(folder)


def test_contents_are_read_up_to_a_length(tmp_path: Path) -> None:
    (tmp_path / "raw").mkdir()
    (tmp_path / "raw" / "a").write_bytes(b"12345")
    (tmp_path / "raw" / "way").symlink_to(tmp_path / "raw")
    (tmp_path / "link").symlink_to(tmp_path / "raw" / "a")
    os.mkfifo(tmp_path / "pipe")
    fds = len(list(Path("/proc/self/fd").iterdir()))
    with open_folder(tmp_path) as folder:
        assert path_of(folder).samefile(tmp_path)
        assert read_inner_file(folder, "raw/a", 5) == b"12345"
        with pytest.raises(DecodeError, match="5 bytes, more than the 4 allowed"):
            read_inner_file(folder, "raw/a", 4)
        for name, words in (("pipe", "a FIFO, no file"), ("raw", "a folder"), ("link", "link")):
            with pytest.raises(DecodeError, match=words):
                read_inner_file(folder, name, 5)
        for gone in ("none", "none/a", "raw/way/a", "raw/a/b"):
            with pytest.raises(OSError, match=r"No such|Not a directory|symbolic"):
                read_inner_file(folder, gone, 5)
    assert len(list(Path("/proc/self/fd").iterdir())) == fds


def test_a_digest_is_of_what_follows_and_gives_signs_of_life(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading, "HASH_CHUNK_BYTES", 4)
    (tmp_path / "a").write_bytes(b"0123456789")
    signs: list[int] = []
    with open_folder(tmp_path) as folder, open_inner_file(folder, "a") as descriptor:
        os.lseek(descriptor, 1, os.SEEK_SET)
        found = hash_open_file(descriptor, lambda: signs.append(1))
    assert found == (hashlib.sha256(b"123456789").hexdigest(), 9) and len(signs) == 3


def test_a_manifest_that_could_not_be_read_again_is_not_written(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told: Any = {"job": "one"}
    data = manifest.encode_manifest(told)
    assert b'"job": "one"' in data
    monkeypatch.setattr(manifest, "MAX_MANIFEST_BYTES", len(data))
    assert manifest.encode_manifest(told) == data
    monkeypatch.setattr(manifest, "MAX_MANIFEST_BYTES", len(data) - 1)
    with pytest.raises(PdcdError, match=f"would have {len(data)} bytes"):
        manifest.encode_manifest(told)


@pytest.mark.parametrize("schema", [2, "1", 1.0, True])
def test_another_schema_is_refused_by_its_name(schema: object) -> None:
    data = json.dumps({"schema": schema}).encode()
    with pytest.raises(DecodeError, match=f"has schema {schema!r}; .* reads schema 1") as told:
        manifest.parse_manifest(data)
    assert told.value.hint is not None and "versions" in told.value.hint


def test_the_commit_is_that_of_the_checkout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(provenance, "__file__", str(tmp_path / "pdcd" / "runs" / "provenance.py"))
    assert provenance.find_git_commit() is None
    (tmp_path / ".git" / "refs").mkdir(parents=True)
    (tmp_path / ".git" / "HEAD").write_text("1234\n")
    assert provenance.find_git_commit() == "1234"
    (tmp_path / ".git" / "HEAD").write_text("ref: refs/main\n")
    assert provenance.find_git_commit() is None
    (tmp_path / ".git" / "refs" / "main").write_text("5678\n")
    assert provenance.find_git_commit() == "5678"


def test_a_log_has_the_time_of_the_event_else_of_now() -> None:
    event = events.Progress(shot="a", frame=0, frames=1, missed=0, t_mono_ns=7)
    line = events.to_log_entry(event, 99)
    assert (line["t_mono_ns"], line["event"], line["shot"]) == (7, "progress", "a")
    assert "job" not in line and "seq" not in line and "type" not in line
    bare = events.Progress(job="one", shot="a", frame=0, frames=1, missed=0)
    assert (events.to_log_entry(bare, 99)["t_mono_ns"], events.to_log_entry(bare, 99)["job"]) == (
        99,
        "one",
    )


def test_the_schema_of_before_schemas_were_counted_anew_is_refused_by_its_name() -> None:
    data = json.dumps({"schema": 1, "run": {"goal": "indirect"}}).encode()
    with pytest.raises(DecodeError, match=r"has schema 1 of before .*; .* reads schema 1"):
        manifest.parse_manifest(data)
