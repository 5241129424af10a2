"""`pdcd row`: one row of the realised probing matrix as picture and figures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pdcd.bench.tables import RigConfig
from pdcd.cli.main import main
from pdcd.pictures.row import read_matrix_row
from tests import bench_rig
from tests.captions import caption_height
from tests.taken import take

ROWS, COLS = bench_rig.GRID


def finished(folder: Path, config: Any = None, **fields: Any) -> Path:
    return take(config or bench_rig.config(folder), **fields).folder


@pytest.fixture(scope="module")
def coded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of eight codes by chance."""
    return finished(tmp_path_factory.mktemp("coded"), codes=8, family="bernoulli")


def meetings(folder: Path, name: str) -> Any:
    """How often each pair of cells meets, from the stored bits: the matrix without any defect."""
    with np.load(folder / "codes.npz") as stored:
        lit, opened = (
            np.unpackbits(stored[f"{name}.{side}"], axis=1, count=ROWS * COLS).astype(float)
            for side in ("primal", "dual")
        )
    return opened.T @ lit


def test_row_is_that_of_the_stored_codes(coded: Path) -> None:
    found = read_matrix_row(coded, (1, 2))
    pi = meetings(coded, "coded")
    off = ~np.eye(ROWS * COLS, dtype=bool)
    np.testing.assert_allclose(found.realised.ravel(), pi[6] / pi[off].mean(), rtol=1e-9)
    want = np.ones(ROWS * COLS)
    want[6] = 0.0
    np.testing.assert_array_equal(found.wanted.ravel(), want)
    assert found.photo == "coded"


def test_missed_refreshes_show_in_the_row(tmp_path: Path) -> None:
    """A late refresh stretches one code: the row is no longer that of the stored codes."""
    config = bench_rig.with_defects(tmp_path, rig=RigConfig(on_miss="flag"))
    folder = finished(tmp_path, config, goal="indirect", codes=8, normalise="scalar")
    found = read_matrix_row(folder, (1, 1)).realised.ravel()
    ideal = meetings(folder, "coded")[5]
    assert np.abs(found - ideal / ideal.mean()).max() > 0.05
    assert found[5] > 0.0  # direct light leaks in


def test_command_writes_the_picture_and_prints_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = finished(tmp_path, goal="diagonal", codes=16)
    out = tmp_path / "row.png"
    capsys.readouterr()
    line = ["row", str(folder), "--cell", "1", "2", "--out", str(out)]
    assert main([*line, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["photo"] == "matched" and told["file"] == str(out)
    assert told["wanted"] == {"min": 0.0, "mean": pytest.approx(1 / 12), "max": 1.0}
    assert told["realised"]["max"] == pytest.approx(1.0, rel=1e-6)
    assert abs(told["realised"]["min"]) < 1e-6  # 16 Hadamard codes are exact for 12 cells
    picture = cv2.imread(str(out))
    assert picture is not None
    height = caption_height(picture.shape[1])
    assert len(np.unique(picture[-height:])) > 10  # its strip has letters and greys
    picture = picture[:-height]
    side = picture.shape[0] // ROWS
    assert picture.shape[1] == side * (2 * COLS + 1)
    cells = picture[side // 2 :: side, side // 2 :: side, 0]
    assert cells[1, 2] == 255 and cells[0, 0] == 0
    assert cells[1, COLS + 1 + 2] == 255
    assert main(line[:-2]) == 0
    assert "realised" in capsys.readouterr().out
    assert (folder / "row-matched-1-2.png").read_bytes() == out.read_bytes()


def test_negative_weights_are_darker_than_none(tmp_path: Path) -> None:
    folder = finished(tmp_path, goal="descattered", codes=16, shift=(0, -1))
    picture = read_matrix_row(folder, (1, 2)).picture((1, 2))
    picture = picture[: -caption_height(picture.shape[1])]
    side = picture.shape[0] // ROWS
    cells = picture[side // 2 :: side, side // 2 :: side, 0].astype(int)
    assert cells[1, 2] == 255 and cells[1, 1] == 0 and cells[0, 0] == 128


@pytest.mark.parametrize(
    ("more", "code", "words"),
    [
        (["--cell", "3", "0"], 2, "no cell 3 0"),
        (["--cell", "0", "-1"], 2, "no cell 0 -1"),
        (["--cell", "0", "0", "--photo", "blue"], 2, "known: white, coded"),
        (["--cell", "0", "0", "--out", "missing/row.png"], 5, "missing/row.png: cannot write"),
    ],
)
def test_faults_are_told(
    more: list[str],
    code: int,
    words: str,
    coded: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["row", str(coded), *more]) == code
    assert words in capsys.readouterr().err
