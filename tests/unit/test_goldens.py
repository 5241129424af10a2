"""Goldens are compared byte by byte: what differs is told, and only what was listed is let pass."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.goldens.case import Bench
from tests.goldens.comparing import Difference, compare, differences
from tests.goldens.keep import keep_run
from tests.goldens.masks import Masks
from tests.goldens.renamed import LISTED, Name, Renamed, read_renamed

RECORD = {"how": {"bars": True, "codes": 64}, "seconds": 0.1, "message": "a sentence", "list": [1]}
IMAGE = np.linspace(-1.0, 1.0, 12, dtype=np.float32).reshape(3, 4)


def keep(folder: Path, record: dict[str, Any], image: Any = IMAGE, **files: bytes) -> Path:
    """A folder with the goldens of one case."""
    out = folder / "room" / "case"
    out.mkdir(parents=True)
    bench = Bench(folder, out, Masks({}))
    bench.keep_json("run/capture", record)
    bench.keep_arrays("run/probe", {"image": image})
    bench.keep_text("run/frames.csv", "shot,row\nwhite,0\n")
    bench.keep_sum("run/preview.png", files.get("preview", b"picture"))
    for name, data in {"run/white.tif": b"II*\0light", **files}.items():
        if "." in name:
            bench.keep_bytes(name, data)
    bench.end()
    return folder


@pytest.fixture
def before(tmp_path: Path) -> Path:
    return keep(tmp_path / "before", RECORD)


def found(before: Path, after: Path, renamed: Renamed | None = None) -> list[Difference]:
    return list(differences(before, after, Renamed() if renamed is None else renamed))


def changed(field: str, value: Any) -> dict[str, Any]:
    record: dict[str, Any] = json.loads(json.dumps(RECORD))
    part = record
    *way, last = field.split(".")
    for step in way:
        part = part[step]
    part[last] = value
    return record


def test_equal_goldens_do_not_differ(
    before: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    after = keep(tmp_path / "after", RECORD)
    assert compare(before, after, renamed=Renamed())
    assert "no differences in 1 cases" in capsys.readouterr().out


def test_no_goldens_at_all_are_not_equal(tmp_path: Path) -> None:
    assert not compare(tmp_path, tmp_path, renamed=Renamed())


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("how.codes", 65),
        ("how.codes", 64.0),
        ("how.bars", 1),
        ("seconds", np.nextafter(0.1, 1.0).item()),
        ("seconds", None),
        ("list", []),
        ("list", [1, 2]),
        ("how.more", 1),
    ],
)
def test_a_field_that_differs_at_all_is_told(
    field: str, value: Any, before: Path, tmp_path: Path
) -> None:
    told = found(before, keep(tmp_path / "after", changed(field, value)))
    assert told and {one.file for one in told} == {"run/capture.json"}
    assert all(one.field.startswith(field) for one in told)


@pytest.mark.parametrize(
    "change",
    [
        lambda image: np.nextafter(image, 2.0),
        lambda image: image.astype(np.float64),
        lambda image: image.reshape(4, 3),
        lambda image: np.where(image == image[0, 0], np.nan, image),
        lambda image: image * np.float32(-1.0) * np.float32(-1.0) - np.float32(0.0),
    ],
    ids=["last bit", "type", "shape", "nan", "none"],
)
def test_an_array_that_differs_in_a_byte_is_told(
    change: Callable[[Any], Any], before: Path, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    told = found(before, keep(tmp_path / "after", RECORD, change(IMAGE)))
    same = request.node.callspec.id == "none"
    assert [(one.file, one.field) for one in told] == ([] if same else [("run/probe.npz", "image")])


def test_zeros_of_other_signs_differ(tmp_path: Path) -> None:
    before = keep(tmp_path / "before", RECORD, np.zeros(3))
    (told,) = found(before, keep(tmp_path / "after", RECORD, -np.zeros(3)))
    assert "-0.0" in told.how


@pytest.mark.parametrize(
    ("name", "data", "field"),
    [
        ("run/white.tif", b"II*\0liGht", ""),
        ("run/frames.csv", b"shot,row\nwhite,1\n", "line 2"),
        ("run/frames.csv", b"shot,row\r\nwhite,0\r\n", ""),
        ("run/new.tif", b"", ""),
        ("preview", b"another", ""),
    ],
)
def test_a_byte_of_a_file_is_told(
    name: str, data: bytes, field: str, before: Path, tmp_path: Path
) -> None:
    (told,) = found(before, keep(tmp_path / "after", RECORD, **{name: data}))
    assert told.file == (name if "." in name else "run/preview.png") and told.field == field


def test_files_and_cases_that_are_missing_are_told(before: Path, tmp_path: Path) -> None:
    after = keep(tmp_path / "after", RECORD)
    (after / "room" / "case" / "run" / "white.tif").unlink()
    assert [(one.file, one.how) for one in found(before, after)] == [
        ("run/white.tif", "is missing")
    ]
    (tmp_path / "none").mkdir()
    assert [one.how for one in found(before, tmp_path / "none")] == ["is missing"]
    assert [one.how for one in found(tmp_path / "none", before)] == ["is new"]


def test_sentences_differ_where_they_count(before: Path, tmp_path: Path) -> None:
    after = keep(tmp_path / "after", changed("message", "another sentence"))
    assert not compare(before, after, renamed=Renamed())
    assert compare(before, after, words=False, renamed=Renamed())


LIST = """
[[field]]
old = "capture.json:how.bars"
new = "how.noise"
reason = "a clearer name"
[[field]]
old = "*.codes"
reason = "gone"
[[new]]
name = "capture.json:more"
reason = "wanted"
"""


def test_only_what_is_listed_is_let_pass(before: Path, tmp_path: Path) -> None:
    path = tmp_path / "renamed.toml"
    path.write_text(LIST)
    renamed = read_renamed(path)
    record = {**RECORD, "how": {"noise": True}, "more": {"of": 1}}
    assert not found(before, keep(tmp_path / "after", record), renamed)
    record["how"] = {"noise": False}
    (told,) = found(before, keep(tmp_path / "other", record), renamed)
    assert told.field == "how.bars"


def test_a_file_that_is_gone_or_renamed_on_purpose(before: Path, tmp_path: Path) -> None:
    after = keep(tmp_path / "after", RECORD, **{"run/light.tif": b"II*\0light"})
    (after / "room" / "case" / "run" / "white.tif").unlink()
    moved = Renamed(fields=[(Name.read("white.tif:"), Name.read("light.tif:"))])
    assert found(before, after) and not found(before, after, moved)
    gone = Renamed(fields=[(Name.read("white.tif:"), None)], new=[Name.read("light.tif:")])
    assert not found(before, after, gone)
    assert not found(before, after, Renamed(cases=["room/*"]))


def test_an_entry_without_a_reason_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "renamed.toml"
    path.write_text('[[new]]\nname = "more"\n')
    with pytest.raises(ValueError, match="reason"):
        read_renamed(path)
    read_renamed(LISTED)


def test_times_jobs_and_digests_of_what_holds_them_are_covered(tmp_path: Path) -> None:
    """Two runs of one photo that differ in nothing else are equal."""
    folders = []
    for number, second in enumerate(("01", "59")):
        run = tmp_path / f"run-{number}"
        (run / "raw").mkdir(parents=True)
        photo = b"II*\0 2026:01:01 00:00:" + second.encode() + b" light"
        (run / "raw" / "white.dng").write_bytes(photo)
        record = {
            "job": f"20260101T0000{second}Z-00ff",
            "folder": f"{run}/20260101T0000{second}Z-00ff",
            "started_utc": f"2026-01-01T00:00:{second}Z",
            "owner": {"pid": number},
            "files": {"raw/white.dng": {"sha256": hashlib.sha256(photo).hexdigest()}},
            "codes": 64,
        }
        (run / "capture.json").write_text(json.dumps(record))
        out = tmp_path / f"out-{number}" / "case"
        out.mkdir(parents=True)
        bench = Bench(tmp_path, out, Masks({run: "<run>"}))
        keep_run(bench, run)
        bench.end()
        folders.append(out.parent)
    assert not found(folders[0], folders[1])
    assert "64" in (folders[0] / "case" / "run" / "capture.json").read_text()
