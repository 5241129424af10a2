"""Is a calibration folder whole? Whatever was changed in it is noticed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pdcd.bench.calibration import CALIBRATION_DIGEST, RECORD, format_digest_line
from pdcd.runs.record import FileRecord
from pdcd.runs.verify_calibration import verify_calibration


def record(data: bytes) -> FileRecord:
    return FileRecord(hashlib.sha256(data).hexdigest(), len(data))


PHOTO = {
    "name": "dots", "raw": "raw/dots.dng", "iso": 100, "f_number": 8.0, "open_ns": 5, "close_ns": 9,
    "size_bytes": 3, "end_ns": [1, 1], "refreshes": 1, "missed": 0, "mask_delay": 0,
    "source": "mock", "verified": True,
}  # fmt: skip


def _as_it_is(told: dict[str, Any]) -> None:
    """Change nothing."""


def calibration(folder: Path, change: Callable[[dict[str, Any]], object] = _as_it_is) -> Path:
    """A calibration folder of one photo, and what is changed in its record before it is sealed."""
    place = folder / "cal"
    (place / "raw").mkdir(parents=True)
    (place / "preview").mkdir()
    files = {"raw/dots.dng": b"raw", "frames.csv": b"shot\n"}
    for name, data in files.items():
        (place / name).write_bytes(data)
    listed = {name: msgspec.to_builtins(record(data)) for name, data in files.items()}
    photo = PHOTO | {"sha256": listed["raw/dots.dng"]["sha256"]}
    step = {
        "name": "geometry", "made_utc": "2026", "seconds": 1.0, "verdict": "good", "figures": [],
        "advice": [], "photos": [photo], "settings": {},
    }  # fmt: skip
    identity = {
        "rig": "", "camera_model": "", "camera_serial": "", "frame_quads": None, "flip": None,
        "projector": "", "mask": "", "projector_hz": 60.0, "mask_hz": 60.0, "iso": 100,
        "f_number": None,
    }  # fmt: skip
    camera = {
        "model": "", "serial": "", "profile": "", "responsivity_e": [1.0, 1.0, 1.0], "isos": [100],
        "f_numbers": [], "frame_quads": None,
    }  # fmt: skip
    told: dict[str, Any] = {
        "schema": 1, "name": "cal", "version": "0", "started_utc": "", "finished_utc": "",
        "verdict": "good", "identity": identity, "belief": {}, "camera": camera, "profile": {},
        "measured": {}, "steps": [step], "before": None, "files": listed,
    }  # fmt: skip
    change(told)
    data = json.dumps(told).encode()
    (place / RECORD).write_bytes(data)
    (place / CALIBRATION_DIGEST).write_bytes(format_digest_line(data))
    return place


def test_a_calibration_folder_is_whole(tmp_path: Path) -> None:
    place = calibration(tmp_path)
    found = verify_calibration(place)
    assert found.findings == () and found.whole
    assert (found.job, found.schema, found.files, found.size_bytes) == ("cal", 1, 2, 8)
    digest = hashlib.sha256((place / RECORD).read_bytes()).hexdigest()
    assert found.manifest_sha256 == digest and found.folder == str(place)
    assert verify_calibration(place, manifest_sha256=digest.upper()).whole
    (other,) = verify_calibration(place, manifest_sha256="0" * 64).findings
    assert (other.path, other.what) == (RECORD, "manifest")


def _photo(told: dict[str, Any]) -> dict[str, Any]:
    photo: dict[str, Any] = told["steps"][0]["photos"][0]
    return photo


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t["files"].update({RECORD: t["files"]["frames.csv"]}), "it vouches for itself"),
        (
            lambda t: t["files"].update({CALIBRATION_DIGEST: t["files"]["frames.csv"]}),
            "it vouches for itself",
        ),
        (lambda t: t["files"].update({"../x": t["files"]["frames.csv"]}), "leads out"),
        (lambda t: t["files"].pop("frames.csv"), "does not list 'frames.csv'"),
        (lambda t: t["steps"].append(t["steps"][0]), "two photos of one name"),
        (lambda t: _photo(t).update(sha256="0" * 64), "name another RAW file"),
        (lambda t: _photo(t).update(raw="raw/x.dng"), "name another RAW file"),
        (lambda t: _photo(t).update(open_ns=9), "closed before it opened"),
        (lambda t: _photo(t).update(open_ns=10), "closed before it opened"),
        (lambda t: t.pop("steps"), "missing required field"),
        (lambda t: t.update(schema=2), "schema"),
    ],
)
def test_a_record_that_cannot_be_true_is_noticed(
    change: Callable[[dict[str, Any]], object], words: str, tmp_path: Path
) -> None:
    found = verify_calibration(calibration(tmp_path, change))
    assert not found.whole
    assert any(words in one.detail for one in found.findings if one.path == RECORD)


def test_a_photo_may_be_as_short_as_a_nanosecond(tmp_path: Path) -> None:
    assert verify_calibration(calibration(tmp_path, lambda t: _photo(t).update(open_ns=8))).whole
    bare = calibration(tmp_path / "bare", lambda t: t.update(steps=[]))
    assert verify_calibration(bare).whole


@pytest.mark.parametrize(
    ("spoil", "path", "what"),
    [
        (lambda p: (p / RECORD).unlink(), RECORD, "missing"),
        (lambda p: (p / CALIBRATION_DIGEST).unlink(), CALIBRATION_DIGEST, "missing"),
        (lambda p: (p / CALIBRATION_DIGEST).write_text("0" * 64), RECORD, "manifest"),
        (lambda p: (p / "raw/dots.dng").write_bytes(b"row"), "raw/dots.dng", "changed"),
        (lambda p: (p / "raw/dots.dng").unlink(), "raw/dots.dng", "missing"),
        (lambda p: (p / "report.html").write_text("x"), "report.html", "unknown"),
        (lambda p: (p / "linear").mkdir(), "linear", "unknown"),
    ],
)
def test_whatever_happens_to_its_files_is_noticed(
    spoil: Callable[[Path], object], path: str, what: str, tmp_path: Path
) -> None:
    place = calibration(tmp_path)
    spoil(place)
    (found,) = verify_calibration(place).findings
    assert (found.path, found.what) == (path, what)
