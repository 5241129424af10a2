"""A step in which a person has a part: a ring to turn."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdcd.bench.tables import (
    BenchConfig,
    CameraConfig,
    Config,
    PanelConfig,
    SceneConfig,
    ServerConfig,
)
from pdcd.calibration.registration.focus_step import watch_focus
from tests.e2e.calibration.hands import Hands


def bench(
    folder: Path, name: str, *, right_px: float = 0.0, blur_quads: float = 0.6, albedo: float = 0.9
) -> Config:
    truth = folder / f"{name}.toml"
    truth.write_text(
        f"""
        [mask]
        contrast = 450.0
        [mask.place]
        offset_px = [{right_px}, 0.0]
        [camera]
        blur_quads = {blur_quads}
        """
    )
    return Config(
        projector=PanelConfig(size_px=(128, 96)),
        mask=PanelConfig(size_px=(160, 120)),
        camera=CameraConfig(profile="450d", frame_quads=(288, 216), seed=5),
        scene=SceneConfig(kind="card", grid=(12, 16), options={"albedo": albedo}),
        bench=BenchConfig(truth=str(truth)),
        server=ServerConfig(state_dir=str(folder / "state")),
    )


def test_focus_tells_a_number_until_nobody_turns(tmp_path: Path) -> None:
    one = Hands(bench(tmp_path, "soft", blur_quads=2.0), tmp_path, full=80, f_number=22.0)
    one.benches = [bench(tmp_path, f"turn{n}", blur_quads=2.0 - 0.5 * n) for n in (1, 2, 3)]
    outcome = one.run("focus", watch_focus(one.session))
    seen = [float(text.split("now ")[1].split(",")[0]) for text in one.asked]
    assert seen[0] < seen[1] - 0.05 < seen[2] - 0.1
    assert len(one.asked) < 10
    for told, (now, best) in zip(seen, one.numbers, strict=True):
        assert now is not None and best is not None
        assert now == pytest.approx(told, abs=6e-4) and best >= now
    assert {figure.name for figure in outcome.figures} == {"focus.mask", "focus.projector"}
