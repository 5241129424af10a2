"""`pdcd show` and `pdcd timing` on a real X server."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pdcd.bench.config import format_config
from pdcd.bench.tables import Config
from pdcd.capture.show import make_loop_frames, make_pattern_frames
from pdcd.cli.main import main
from pdcd.panels.patterns import read_pattern_levels
from tests import x11_rig
from tests.xserver import XServer

pytestmark = pytest.mark.whole


@pytest.fixture
def file(tmp_path: Path, x_quarter: XServer) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(format_config(x11_rig.config(tmp_path, x_quarter)), encoding="utf-8")
    return path


@pytest.mark.long
def test_timing_reports_every_refresh_and_draws_histograms(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = file.with_name("timing.png")
    words = ["timing", "--frames", "90", "--json", "--config", str(file), "--out", str(picture)]
    code = main(words)
    told = json.loads(capsys.readouterr().out)
    assert code == (5 if told["missed"] else 0)
    assert told["refreshes"] == 90 and told["source"] == "present-msc"
    assert told["refresh_hz"] == pytest.approx(60.0, rel=0.02)
    assert told["times"]["refresh to refresh"]["p50_ms"] == pytest.approx(1000 / 60, rel=0.1)
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("words", [["grid"], ["code", "--index", "3"], ["--loop"]])
def test_show_ends_by_itself_and_black(file: Path, x_quarter: XServer, words: list[str]) -> None:
    assert main(["show", *words, "--seconds", "0.3", "--config", str(file)]) == 0
    assert not x11_rig.root_pixels(x_quarter).any()


def test_the_alignment_grid_is_the_same_on_both_panels() -> None:
    frames = make_pattern_frames("grid", 0, (48, 64), Config())
    np.testing.assert_array_equal(frames.primal_patterns, frames.dual_patterns)
    assert read_pattern_levels(frames.primal_patterns, 0, 48 * 64).sum() == 6 * 64 + 8 * 48 - 6 * 8


def test_the_loop_shows_indirect_light_only_for_the_time_asked() -> None:
    frames = make_loop_frames((6, 8), Config(), 10.0)
    assert len(frames) / 60.0 == pytest.approx(10.0, rel=0.4)
    for index in range(len(frames.primal_patterns)):
        lit, seen = (
            read_pattern_levels(p, index, 48)
            for p in (frames.primal_patterns, frames.dual_patterns)
        )
        assert not (lit * seen).any()
