"""Whatever reads a file that somebody else named: a pipe, a device, or one without end."""

from __future__ import annotations

import hashlib
import os
import socket
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from pdcd.bench.calibration import (
    CALIBRATION_ARRAYS,
    CALIBRATION_DIGEST,
    MAPS,
    PROFILE,
    RECORD,
    read_calibration,
)
from pdcd.bench.choosing import hash_truth_file, read_candidate
from pdcd.bench.grey import read_lut
from pdcd.bench.reading import read_toml
from pdcd.bench.tables import BenchConfig, Config
from pdcd.capture import again
from pdcd.capture.worker.calibrating import read_arrays
from pdcd.errors import ConfigError, DecodeError, PdcdError
from pdcd.figures.record import read_record
from pdcd.files.reading import MAX_PICTURE_BYTES, hash_file, read_file, refuse_unsound
from pdcd.panels.map_file import load_maps
from pdcd.pictures.written.picture_files import read_tiff
from pdcd.runs.folder import read_manifest
from pdcd.runs.frame_table import FRAMES_FILE, FrameTable, read_frame_columns
from pdcd.runs.ledger import LEDGER_FILE, read_ledger
from pdcd.runs.manifest import MANIFEST
from pdcd.runs.patterns import CODES_FILE, read_patterns, read_stored_arrays
from pdcd.sensor.profile import load_profile
from pdcd.sensor.raw import read_raw, read_raw_head
from pdcd.virtual.scene.matrix import load_matrix

pytestmark = pytest.mark.timeout(60)  # a pipe that is opened to be read blocks for good
SPARSE_BYTES = 60 * 2**30


def bound(path: Path) -> None:
    folder = os.open(path.parent, os.O_RDONLY)
    with socket.socket(socket.AF_UNIX) as made:  # of a name that is short enough
        made.bind(f"/proc/self/fd/{folder}/{path.name}")
    os.close(folder)


def sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(SPARSE_BYTES)


ODD: dict[str, Callable[[Path], object]] = {
    "FIFO": os.mkfifo,
    "socket": bound,
    "folder": Path.mkdir,
    "device": lambda p: p.symlink_to("/dev/zero"),
    "terminal": lambda p: p.symlink_to("/dev/ptmx"),
    "loop": lambda p: p.symlink_to(p.name),
    "sparse": sparse,
    "empty": Path.touch,
}


def read_open_ledger(folder: Path) -> object:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        return read_ledger(descriptor)
    finally:
        os.close(descriptor)


def hash_named(path: Path) -> str:
    with refuse_unsound(path):
        return hash_file(path, MAX_PICTURE_BYTES)


def read_some(path: Path) -> bytes:
    with refuse_unsound(path):
        return read_file(path, 100)


READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "RAW": ("a.dng", read_raw),
    "head of a RAW": ("a.dng", read_raw_head),
    "TIFF": ("a.tif", read_tiff),
    "arrays": ("a.npz", read_stored_arrays),
    "codes": (CODES_FILE, lambda p: read_patterns(p.parent)),
    "frames": (FRAMES_FILE, read_frame_columns),
    "frames as they come": (
        FRAMES_FILE,
        lambda p: FrameTable(p.parent).log_of(
            "a", 1, end_ns=(0, 0), source="x", verified=True, mask_delay=0
        ),
    ),
    "manifest": (MANIFEST, lambda p: read_manifest(p.parent)),
    "ledger": (LEDGER_FILE, lambda p: read_open_ledger(p.parent)),
    "profile": (PROFILE, load_profile),
    "maps": (MAPS, load_maps),
    "arrays of a calibration": (CALIBRATION_ARRAYS, read_arrays),
    "matrix": ("a.npz", load_matrix),
    "lights": ("a.txt", read_lut),
    "truth": ("a.toml", lambda p: read_toml(p, "the truth", "")["x"]),
    "digest": ("a", hash_named),
    "file": ("a", read_some),
}
NOTHING = {
    ("lights", "empty"),
    ("digest", "empty"),
    ("file", "empty"),
    ("arrays of a calibration", "loop"),
}
"""Files of which an empty one is whole, or that there need not be."""


@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize("reader", READERS)
def test_no_reader_waits_or_reads_without_end(tmp_path: Path, reader: str, odd: str) -> None:
    name, read = READERS[reader]
    ODD[odd](tmp_path / name)
    fds = len(os.listdir("/proc/self/fd"))  # noqa: PTH208
    if (reader, odd) in NOTHING:
        read(tmp_path / name)
    else:
        with pytest.raises((PdcdError, KeyError)) as caught:
            read(tmp_path / name)
        assert isinstance(caught.value, PdcdError) or odd == "empty"
    assert len(os.listdir("/proc/self/fd")) == fds  # noqa: PTH208


@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize("name", [RECORD, CALIBRATION_DIGEST])
def test_a_calibration_of_odd_files_is_passed_over_and_the_daemon_starts(
    tmp_path: Path, name: str, odd: str
) -> None:
    folder = tmp_path / "20260101T000000Z-00ff"
    folder.mkdir()
    for other in {RECORD, CALIBRATION_DIGEST} - {name}:
        (folder / other).write_bytes(b"{}")
    ODD[odd](folder / name)
    with pytest.raises(ConfigError, match="cannot be used"):
        read_calibration(folder)
    found = read_candidate(folder, Config())
    assert found is None or (found.record is None and found.why)
    config = msgspec.structs.replace(Config(), bench=BenchConfig(truth=str(folder / name)))
    if odd != "empty":
        assert hash_truth_file(config) == ""
    assert read_record(folder, "1", "x") is None


@pytest.mark.parametrize("odd", ODD)
def test_the_calibration_before_is_looked_for_past_odd_ones(tmp_path: Path, odd: str) -> None:
    folder, data = tmp_path / "b", b"it"
    for name in ("a", "b", "c"):
        (tmp_path / name).mkdir()
    ODD[odd](tmp_path / "a" / RECORD)
    (tmp_path / "c" / RECORD).write_bytes(data)
    record: Any = SimpleNamespace(before=hashlib.sha256(data).hexdigest(), measured={})
    assert again._before(record, folder) == tmp_path / "c"
    record.before = "0" * 64
    assert again._before(record, folder) == folder


def test_a_configuration_may_come_by_a_pipe(tmp_path: Path) -> None:
    read_end, write_end = os.pipe()
    os.write(write_end, b"x = 1")
    os.close(write_end)
    try:
        told: dict[str, Any] = read_toml(
            Path(f"/dev/fd/{read_end}"), "the configuration", "", may_be_pipe=True
        )
    finally:
        os.close(read_end)
    assert told == {"x": 1}


def test_a_directory_of_an_archive_is_not_believed(tmp_path: Path) -> None:
    """A zip file may say that its directory takes any size; zipfile takes the memory for it."""
    end = b"PK\x05\x06" + bytes(4) + b"\1\0\1\0" + b"\0\0\0\x70" + bytes(4) + b"\0\0"
    with (tmp_path / "a.npz").open("wb") as file:
        file.truncate(2**31)
        file.seek(0, os.SEEK_END)
        file.write(end)
    with pytest.raises(DecodeError, match="too many files"):
        read_stored_arrays(tmp_path / "a.npz")
