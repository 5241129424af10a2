"""The darkroom of a run: each RAW file and each line of the frame log is read once."""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import SceneConfig
from pdcd.cli.main import main
from pdcd.errors import DecodeError
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.row import read_matrix_row
from pdcd.runs.folder import read_manifest
from pdcd.sensor import raw
from pdcd.words import MethodName
from tests import bench_rig, tampered
from tests.taken import take

MIRROR = SceneConfig(kind="mirror-and-vase", grid=(12, 16))


def taken(folder: Path, **fields: Any) -> Path:
    """A finished run on the mock bench."""
    return take(bench_rig.config(folder, scene=MIRROR), **fields).folder


@pytest.mark.parametrize(
    ("fields", "again"),
    [
        ({"codes": 96, "pilot": 32, "white": False}, []),
        ({"codes": 64, "parts": 8, "until_error": 0.01}, ["look-again.dng"]),
        ({"codes": 8, "method": "multi-image"}, []),
    ],
)
def test_a_capture_reads_each_shot_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fields: dict[str, Any], again: list[str]
) -> None:
    read: Counter[str] = Counter()
    plain = raw.read_raw

    def counted(path: Path, **keywords: Any) -> Any:
        read[path.name] += 1
        return plain(path, **keywords)

    lines = 0
    real_reader = csv.reader

    def counting(source: Any) -> Any:
        nonlocal lines
        for line in real_reader(source):
            lines += 1
            yield line

    monkeypatch.setattr("pdcd.sensor.shelf.read_raw", counted)
    monkeypatch.setattr("pdcd.runs.frame_table.csv.reader", counting)
    folder = taken(tmp_path, **fields)
    shots = {Path(shot.raw).name for shot in read_manifest(folder).run.shots}
    once = shots | {"look-dark.dng"} | set(again)
    assert {name: read[name] for name in once} == dict.fromkeys(once, 1)
    assert lines == len((folder / "frames.csv").read_text().splitlines())


@pytest.mark.parametrize(("method", "codes"), [("coded", 16), ("multi-image", 8)])
def test_a_row_of_the_matrix_needs_no_raw_file(
    tmp_path: Path, method: MethodName, codes: int
) -> None:
    folder = taken(tmp_path, codes=codes, method=method)
    before = read_matrix_row(folder, (3, 4))
    for file in (folder / "raw").iterdir():
        file.unlink()
    np.testing.assert_array_equal(before.realised, read_matrix_row(folder, (3, 4)).realised)
    with pytest.raises(DecodeError, match="cannot read"):
        Darkroom(folder, read_manifest(folder).run).decoded()


def test_a_wanted_error_chooses_the_iso_and_leaves_the_bench_as_configured(tmp_path: Path) -> None:
    """The manifest keeps the configuration of the bench; the ISO stands with plan and shots."""
    folder = taken(tmp_path, error=0.02)
    manifest = read_manifest(folder)
    assert manifest.config["camera"]["iso"] is None
    chosen = manifest.plan["prediction"]["iso"]
    assert {shot.iso for shot in manifest.run.shots} == {chosen}


def test_decode_of_a_damaged_frame_log_is_one_clear_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = taken(tmp_path, codes=8)
    table = folder / "frames.csv"
    table.write_text("".join(table.read_text().splitlines(keepends=True)[:-3]))
    assert main(["decode", str(folder)]) == 5
    assert "frames.csv: it has" in capsys.readouterr().err
    tampered.relisted(folder)
    assert main(["decode", str(folder)]) == 5
    assert "refreshes of shot" in capsys.readouterr().err
