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
        grid=said.pop("grid", (3, 4)), cells=said.pop("cells", None),
        shots=said.pop("shots", (shot(),)), dark=said.pop("dark", None),
        borders=said.pop("borders", None),
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


SIDE = 2**12
"""Its square is the most cells."""
FILES: dict[str, FileRecord] = manifest().files
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
        ({"grid": (SIDE, SIDE)}, []),
        ({"grid": (SIDE, SIDE + 1)}, ["a grid of 4096 x 4097 cells"]),
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
        ({"shots": (shot(close_ns=1),)}, ["shot 'coded' closed before it opened"]),
        *(
            (
                {"files": {key: one for key, one in FILES.items() if key != name}},
                [f"it does not list {name!r}"],
            )
            for name in NEEDED
        ),
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
    assert len(check.found) == MAX_FINDINGS == 1000
    one = check.found[-1]
    assert (one.path, one.detail) == ("n" * MAX_WORDS, "d" * MAX_WORDS) and MAX_WORDS == 300


def record(data: bytes, size: int = -1) -> FileRecord:
    length = len(data) if size == -1 else size
    return FileRecord(hashlib.sha256(data).hexdigest(), length)


def looked(
    folder: Path, files: dict[str, FileRecord], names: Any = None
) -> tuple[FolderCheck, int]:
    """A look at files alone, and how often it gave a sign of life."""
    signs: list[int] = []
    check = FolderCheck(lambda: signs.append(1))
    check.read = manifest(files=files)
    with open_folder(folder) as descriptor:
        check.files(descriptor, names)
    return check, len(signs)


def test_files_are_held_against_size_and_digest(tmp_path: Path) -> None:
    for name in "abc":
        (tmp_path / name).write_bytes(b"12345")
    files = {
        "a": record(b"12345"), "b": record(b"12345", 6), "c": record(b"54321"), "e": record(b""),
    }  # fmt: skip
    check, signs = looked(tmp_path, files)
    assert [(one.path, one.what, one.detail) for one in check.found] == [
        ("b", "changed", "it has 5 bytes, not 6"),
        ("c", "changed", "it does not have the SHA-256 that the manifest names"),
        ("e", "missing", "the manifest lists it"),
    ]
    assert (check.sound, check.size_bytes, check.later) == (1, 5, [])
    assert signs == 5  # at the end of each of three files, and for each piece that was read


def test_of_names_given_only_those_are_looked_at(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"1")
    (tmp_path / "more").touch()
    files = {"a": record(b"1"), "b": record(b"2"), "../c": record(b"3")}
    check, _ = looked(tmp_path, files, ["a", "x", "../c"])
    assert [(one.path, one.what, one.detail) for one in check.found] == [
        ("x", "manifest", "the manifest does not list it")
    ]
    assert check.sound == 1


def test_what_is_there_and_not_listed_is_unknown(tmp_path: Path) -> None:
    for folder in ("raw", "linear", "preview", "deep/er", "deep/other", "preview.x"):
        (tmp_path / folder).mkdir(parents=True)
    for name in ("capture.json", "capture.json.sha256", "deep/er/a", "report.html", "b"):
        (tmp_path / name).write_bytes(b"1")
    check, _ = looked(tmp_path, {"deep/er/a": record(b"1")})
    assert [(one.path, one.what, one.detail) for one in check.found] == [
        ("b", "unknown", "a file that the manifest does not list"),
        ("deep/other", "unknown", "a folder that the manifest does not list"),
        ("preview.x", "unknown", "a folder that the manifest does not list"),
    ]
    assert check.later == ["report.html"]


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


@pytest.mark.parametrize(
    ("err", "what", "words"),
    [
        (DecodeError("it is a FIFO"), "changed", "it is a FIFO"),
        (OSError(40, "Too many levels"), "changed", "Too many levels"),
        (NotADirectoryError(20, "Not a directory"), "changed", "Not a directory"),
        (PermissionError(13, "Permission denied"), "unreadable", "Permission denied"),
        (OSError("bare"), "unreadable", "bare"),
        (ValueError("null byte"), "unreadable", "null byte"),
    ],
)
def test_what_cannot_be_opened_was_changed_or_cannot_be_read(
    err: Exception, what: str, words: str
) -> None:
    assert (module._what(err), module._words(err)) == (what, words)
