"""The record of a calibration folder: read back as written, and refused where it is not."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pdcd.bench.calibration import (
    CALIBRATION_DIGEST,
    RECORD,
    PhotoRecord,
    format_digest_line,
    read_calibration,
)
from pdcd.errors import ConfigError
from tests.unit.bench._calibrations import entry, record, written


def test_a_record_comes_back_with_its_digest(tmp_path: Path) -> None:
    told = record(measured={"mask.skew_s": entry(0.5)})
    folder = written(tmp_path / "cal", told)
    data = (folder / RECORD).read_bytes()
    assert read_calibration(folder) == (told, hashlib.sha256(data).hexdigest())
    assert data.startswith(b'{\n "schema": 1,\n') and data.endswith(b"}\n")
    assert format_digest_line(b"abc", "x").decode() == f"{hashlib.sha256(b'abc').hexdigest()}  x\n"


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda folder: (folder / RECORD).unlink(), "No such file"),
        (lambda folder: (folder / CALIBRATION_DIGEST).unlink(), "No such file"),
        (lambda folder: (folder / RECORD).write_bytes(b"{"), "cannot be used"),
        (lambda folder: (folder / RECORD).write_bytes(b"\xff"), "cannot be used"),
        (
            lambda folder: (folder / CALIBRATION_DIGEST).write_bytes(format_digest_line(b"x")),
            "another digest",
        ),
    ],
)
def test_a_damaged_folder_is_refused(tmp_path: Path, spoil: Any, says: str) -> None:
    folder = written(tmp_path / "cal", record())
    spoil(folder)
    with pytest.raises(ConfigError, match=says) as caught:
        read_calibration(folder)
    assert str(folder) in caught.value.message and caught.value.hint


def test_a_record_of_another_schema_is_refused(tmp_path: Path) -> None:
    for schema in (0, 2):
        folder = written(tmp_path / str(schema), record(schema=schema))
        with pytest.raises(ConfigError, match="cannot be used"):
            read_calibration(folder)


PHOTO: dict[str, Any] = {
    "name": "dots", "raw": "raw/dots.dng", "sha256": "0" * 64, "size_bytes": 0, "iso": 1,
    "f_number": 8.0, "open_ns": 2**62, "close_ns": -(2**62), "end_ns": [0, 0],
    "refreshes": 2**62, "missed": 0, "mask_delay": 0, "source": "mock", "verified": True,
}  # fmt: skip


@pytest.mark.parametrize(
    "wrong",
    [
        {"size_bytes": -1}, {"iso": 0}, {"open_ns": 2**62 + 1}, {"close_ns": -(2**62) - 1},
        {"refreshes": 2**62 + 1}, {"missed": -1}, {"sha256": "0" * 63}, {"sha256": "G" * 64},
        {"name": ""}, {"name": ".x"}, {"name": "a/b"}, {"name": "x" * 101},
    ],
)  # fmt: skip
def test_numbers_and_names_of_a_photo_have_bounds(wrong: dict[str, Any]) -> None:
    assert msgspec.convert({**PHOTO, "name": "x" * 100}, PhotoRecord).refreshes == 2**62
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(PHOTO | wrong, PhotoRecord)
