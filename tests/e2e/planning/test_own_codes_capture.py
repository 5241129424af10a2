"""Own codes through the whole chain: a family's codes in a file give its photo, byte for byte."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pdcd
from pdcd.codes.make import make_codes
from pdcd.runs.verify import verify_run
from tests.bench_rig import GRID, config
from tests.e2e.api.test_connected import daemon
from tests.places import ROOT

pytestmark = pytest.mark.whole

COUNT = 16


def test_a_family_in_a_file_gives_the_same_probe(tmp_path: Path) -> None:
    made = make_codes("bernoulli", GRID, COUNT, dual="complement", seed=3)
    pair = tuple(side.reshape(COUNT, *GRID) for side in (made.primal, made.dual))
    np.savez(tmp_path / "own.npz", primal=pair[0], dual=pair[1])
    usual: Any = {"seed": 3, "parts": 1, "pilot": 0, "window": "whole", "progress": False}
    ways: list[Any] = [{"family": "bernoulli", "codes": COUNT},
                       {"codes_from": tmp_path / "own.npz"}, {"codes_from": pair}]  # fmt: skip
    folders = []
    for number, way in enumerate(ways):
        rig = config(tmp_path)
        there = daemon(rig, tmp_path / "s") if number else pdcd.local(rig)
        with there as bench:
            run = bench.capture("indirect", **usual, **way)
        folders.append(run.folder)
    family, *own = folders
    for folder in own:
        for file in [family / "probe.npz", *family.glob("linear/*")]:
            assert file.read_bytes() == (folder / file.relative_to(family)).read_bytes(), file.name
        assert verify_run(folder).whole
    told = json.loads((own[0] / "capture.json").read_text())["request"]["codes_from"]
    assert told["file"] == "own.npz"


@pytest.mark.parametrize(
    ("side", "verdict", "words"),
    [(0, "bad", "never lights 72 of 192"), (1, "doubtful", "never opens 72 of 192")],
)
def test_codes_that_never_show_a_third_of_the_cells_are_told(
    side: int, verdict: str, words: str, tmp_path: Path
) -> None:
    """All four parts miss the same: their spread knows nothing of it."""
    shown = np.random.default_rng(1).random((64, 12, 16)) < 0.5
    pair = np.stack([shown, np.logical_not(shown)])
    pair[side][:, :, :6] = False
    with pdcd.local({"scene": {"kind": "open-book", "grid": [12, 16]}}, folder=tmp_path) as bench:
        run = bench.capture("indirect", codes_from=(pair[0], pair[1]), parts=4, progress=False)
    assert run.verdict == verdict and words in run.quality.reasons[0]
    known = np.isfinite(run.sigma[..., 0])
    assert known[:, 6:].all() and known[:, :6].any() == (side == 0)
    assert run.truth is not None
    off = (run.image - run.truth)[known]
    covered = np.mean(np.abs(off) <= 1.96 * run.sigma[known])
    assert (covered > 0.9) == (side == 1)


def test_the_docs_make_codes_that_are_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both pieces of Python, on a smaller bench: a file to plan by, and the codes of a run."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pdcd").mkdir()
    (tmp_path / "pdcd" / "pdcd.toml").write_text("[scene]\ngrid = [6, 8]\n")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    text = (ROOT / "docs" / "python.md").read_text().partition("## Codes of your own")[2]
    first, second = (part.split("```")[0] for part in text.split("```python\n")[1:])
    exec(first.replace("48, 64", "6, 8"), {})
    with pdcd.local() as bench:
        assert bench.plan("indirect", codes_from=Path("own.npz")).codes == 64
    names: dict[str, Any] = {}
    exec(second, names)
    shown = [np.load(names[run].folder / "codes.npz") for run in ("run", "again")]
    for side in ("coded.primal", "coded.dual"):
        assert np.array_equal(shown[0][side], shown[1][side])
