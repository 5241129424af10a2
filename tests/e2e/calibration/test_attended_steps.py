"""A step in which a person has a part: a ring to turn."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdcd.bench.tables import Config, SceneConfig
from pdcd.calibration.registration.focus_step import watch_focus
from tests.e2e.calibration.hands import Hands
from tests.e2e.calibration.steps_rig import make_config


def bench(folder: Path, blur_quads: float) -> Config:
    truth = f"[mask]\ncontrast = 450.0\n[camera]\nblur_quads = {blur_quads}\n"
    scene = SceneConfig(kind="card", grid=(12, 16))
    return make_config(
        folder / f"blurred by {blur_quads}", truth, projector_px=(128, 96), mask_px=(160, 120),
        quads=(288, 216), scene=scene,
    )  # fmt: skip


def test_focus_tells_a_number_until_nobody_turns(tmp_path: Path) -> None:
    one = Hands(bench(tmp_path, 2.0), tmp_path, full=80, f_number=22.0)
    one.benches = [bench(tmp_path, 2.0 - 0.5 * n) for n in (1, 2, 3)]
    outcome = one.run("focus", watch_focus(one.session))
    seen = [float(text.split("now ")[1].split(",")[0]) for text in one.asked]
    assert seen[0] < seen[1] - 0.05 < seen[2] - 0.1
    assert len(one.asked) < 10
    for told, (now, best) in zip(seen, one.numbers, strict=True):
        assert now is not None and best is not None
        assert now == pytest.approx(told, abs=6e-4) and best >= now
    assert {figure.name for figure in outcome.figures} == {"focus.mask", "focus.projector"}
