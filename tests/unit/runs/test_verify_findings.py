"""What a look at a run finds wrong, one fault at a time: what `tests.tampered` does not reach."""

from __future__ import annotations

import hashlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pdcd.errors import DecodeError
from pdcd.files.inside import open_folder
from pdcd.protocol.result import Quality
from pdcd.runs import verify as module
from pdcd.runs.record import FileRecord
from pdcd.runs.verify import MAX_FINDINGS, MAX_WORDS, FolderCheck, read_whole_manifest

SHA, OTHER = "a" * 64, "b" * 64
NEEDED = ("codes.npz", "frames.csv", "probe.npz", "log.jsonl")


def shot(**said: Any) -> Any:
    told = {"name": "coded", "raw": "raw/coded.dng", "sha256": SHA, "open_ns": 1, "close_ns": 2}
    return SimpleNamespace(**{**told, **said})


def manifest(**said: Any) -> Any:
    """A manifest in which all fits, but for what is said."""
    run = SimpleNamespace(
        grid=(3, 4), cells=None, shots=said.pop("shots", (shot(),)),
        dark=said.pop("dark", None), borders=said.pop("borders", None),
    )  # fmt: skip
    names = (*NEEDED, "raw/coded.dng")
    told = {
        "schema": 1, "job": "job", "state": "done", "missing": (), "meter": (), "run": run,
        "summary": {"quality": Quality(verdict="good")},
        "files": {name: FileRecord(SHA, 1) for name in names}, "unkept": {},
    }  # fmt: skip
    return SimpleNamespace(**{**told, **said})


def understood(
    monkeypatch: pytest.MonkeyPatch, told: Any, *, vouched: bool = True
) -> list[tuple[str, str, str]]:
    """All that is found in a manifest by itself."""
    monkeypatch.setattr(module, "parse_manifest", lambda _: told)
    check = FolderCheck()
    check.understand(b"", vouched=vouched)
    return [(one.path, one.what, one.detail) for one in check.found]


DARK = "its dark photo and the list of files name another RAW file"
UNKEPT = "{!r} was not kept and is listed, or is no RAW file"
OUT = "file 'raw/../a': its name leads out of the folder"
BORDERS = "its photo of borders and the list of files name another RAW file"


def borders(lit: str, dark: str) -> SimpleNamespace:
    """The photos of the light along borders, by their digests."""
    raw = "raw/coded.dng"
    return SimpleNamespace(raw=raw, sha256=lit, dark=SimpleNamespace(raw=raw, sha256=dark))


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({}, []),
        ({"missing": ("b",)}, ["its state is 'done', and 1 shots are missing"]),
        ({"state": "partial"}, ["its state is 'partial', and 0 shots are missing"]),
        ({"meter": (SimpleNamespace(raw="raw/m.dng"),)}, ["it does not list 'raw/m.dng'"]),
        ({"dark": SimpleNamespace(raw="raw/coded.dng", sha256=SHA)}, []),
        ({"dark": SimpleNamespace(raw="raw/coded.dng", sha256=OTHER)}, [DARK]),
        ({"dark": SimpleNamespace(raw="/etc/passwd", sha256=SHA)}, [DARK]),
        ({"borders": borders(SHA, SHA)}, []),
        ({"borders": borders(OTHER, SHA)}, [BORDERS]),
        ({"borders": borders(SHA, OTHER)}, [BORDERS.replace("photo", "dark photo", 1)]),
        ({"shots": (shot(raw="raw/b.dng"),), "unkept": {"raw/b.dng": FileRecord(SHA, 1)}}, []),
        ({"unkept": {"raw/coded.dng": FileRecord(SHA, 1)}}, [UNKEPT.format("raw/coded.dng")]),
        ({"unkept": {"linear/a.tif": FileRecord(SHA, 1)}}, [UNKEPT.format("linear/a.tif")]),
        ({"unkept": {"raw/../a": FileRecord(SHA, 1)}}, [OUT]),
        ({"shots": (shot(), shot(name="b"))}, []),
    ],
)  # fmt: skip
def test_what_cannot_be_true_is_told(
    said: dict[str, Any], words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = understood(monkeypatch, manifest(**said))
    told = [detail for path, what, detail in found if what == "manifest"]
    assert told == words
    assert all(path == "capture.json" for path, what, _ in found if what == "manifest")
    assert [what for _, what, _ in found if what != "manifest"] == (
        ["partial"] if said.get("state") == "partial" else []
    )


def test_shots_that_are_missing_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    told = manifest(state="partial", missing=("black", "a\nb"))
    assert understood(monkeypatch, told) == [
        (".", "partial", "not all shots are there, missing: black, a\\nb")
    ]


def test_only_so_many_findings_of_so_many_letters_are_told() -> None:
    check = FolderCheck()
    for _ in range(MAX_FINDINGS + 5):
        check.find("n" * 301, "unknown", "d" * 301)
    assert len(check.found) == MAX_FINDINGS
    one = check.found[-1]
    assert (one.path, one.detail) == ("n" * MAX_WORDS, "d" * MAX_WORDS)


def record(data: bytes) -> FileRecord:
    return FileRecord(hashlib.sha256(data).hexdigest(), len(data))


def test_of_names_given_only_those_are_looked_at(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"1")
    (tmp_path / "more").touch()
    files = {"a": record(b"1"), "b": record(b"2"), "../c": record(b"3")}
    signs: list[int] = []
    check = FolderCheck(lambda: signs.append(1))
    check.read = manifest(files=files)
    with open_folder(tmp_path) as descriptor:
        check.files(descriptor, ["a", "x", "../c"])
    assert [(one.path, one.what, one.detail) for one in check.found] == [
        ("x", "manifest", "the manifest does not list it")
    ]
    assert (check.sound, len(signs)) == (1, 2)  # a sign of life for each piece, and for each file


def test_who_needs_a_whole_run_hears_of_the_first_fault_and_of_how_many_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(DecodeError) as one:
        read_whole_manifest(tmp_path)
    assert one.value.message.endswith("is no finished run: it has no capture.json")
    (tmp_path / "capture.json").write_bytes(b"{}")
    monkeypatch.setattr(module, "parse_manifest", lambda _: manifest(state="new"))
    with pytest.raises(DecodeError) as two:
        read_whole_manifest(tmp_path, ["log.jsonl", "x"])
    assert two.value.message.endswith(
        "capture.json.sha256: nothing vouches for the manifest, and 3 more"
    )
