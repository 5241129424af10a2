"""Black exposures that a capture adds by itself: what calls for them, what they bring and cost."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, Config, PanelConfig, SceneConfig, ScheduleConfig
from tests import bench_rig, taken
from tests.taken import Taken

pytestmark = pytest.mark.whole

GRID = (6, 8)
MASK = PanelConfig(size_px=(1600, 1200), contrast=300.0)
PROJECTOR = PanelConfig(size_px=(1024, 768), contrast=50.0)


def bench(folder: Path, *, ambient: float = 0.0, noise: str = "none", **tables: Any) -> Config:
    return bench_rig.config(
        folder,
        grid=GRID,
        scene=bench_rig.matrix_scene(folder, GRID, ambient=ambient),
        camera=CameraConfig(noise=noise),  # type: ignore[arg-type]
        **tables,
    )


def take(config: Config, **fields: Any) -> Taken:
    out = tempfile.mkdtemp(dir=Path(str(config.server.state_dir)).parent)
    return taken.take(config, **{"codes": 48, "out": out, **fields})


def raws(made: Taken) -> list[str]:
    return [name for name in made.result.files if name.startswith("raw/") and "meter" not in name]


def test_ambient_light_is_found_and_taken_off(tmp_path: Path) -> None:
    plain = take(bench(tmp_path, ambient=0.3), black_level="none")
    made = take(bench(tmp_path, ambient=0.3))
    manifest = made.manifest
    assert plain.error > 0.5 and made.error < 0.02
    assert plain.manifest.run.leaks_unseen == "declined" and plain.quality.verdict != "good"
    assert any("no dark photo was taken" in text for text in plain.quality.reasons)
    assert not any("no dark photo" in text for text in made.quality.reasons)
    assert manifest.run.how.black_level == manifest.plan["black_level"] == "ambient"
    leaks = manifest.plan["leaks"]
    assert leaks["both"] == pytest.approx(plain.error, rel=0.05)
    assert leaks["raw"] == ["raw/look-dark.dng", "raw/look-ambient.dng"]
    assert any("decided after a look at dark photos" in text for text in manifest.plan["reasons"])
    assert any("black exposures were added (black level ambient)" in t for t in made.warnings)
    assert made.decodes_the_same()


@pytest.mark.parametrize(
    ("tables", "level"),
    [({"mask": MASK}, "mask"), ({"projector": PROJECTOR}, "ambient"),
     ({"mask": MASK, "projector": PROJECTOR}, "both")],
)  # fmt: skip
def test_leaking_panels_are_found(tables: dict[str, Any], level: str, tmp_path: Path) -> None:
    made = take(bench(tmp_path, **tables))
    assert made.manifest.run.how.black_level == level
    if level == "both":
        plain = take(bench(tmp_path, **tables), black_level="none")
        left, before = (
            bench_rig.cells_error(each.folder, taken_out=False) for each in (made, plain)
        )
        assert left < 0.2 * before


def test_a_quiet_bench_pays_one_dark_photo_and_keeps_every_bit(tmp_path: Path) -> None:
    config = bench(tmp_path, noise="full")
    plain, made = take(config, black_level="none"), take(config)
    manifest, before = made.manifest, plain.manifest
    assert set(raws(made)) == {*raws(plain), "raw/look-dark.dng"}
    assert manifest.run.how == before.run.how
    assert manifest.plan["leaks"]["both"] < 0.01
    assert not any("black" in text for text in made.warnings)
    for name in (name for name in plain.result.files if name.startswith("linear/")):
        assert manifest.files[name].sha256 == before.files[name].sha256
    assert [m.peak for m in manifest.meter if "look" in m.raw] == [None]


def test_what_cannot_be_added_is_said(tmp_path: Path) -> None:
    made = take(bench(tmp_path, ambient=0.3), method="multi-image", codes=16)
    manifest = made.manifest
    assert manifest.run.how.black_level == "none"
    assert any("black exposures are not added" in text for text in made.warnings)
    assert manifest.run.leak == manifest.plan["leaks"]["both"] > 0.3
    assert made.quality.verdict == "bad"
    assert any("were not subtracted" in text for text in made.quality.reasons)


def test_exact_photos_taken_before_a_pilot_ended_have_black_exposures(tmp_path: Path) -> None:
    """An illumination without codes is shown for as long as codes take, of which there are more
    once the pilot has ended."""
    light = np.round(np.random.default_rng(0).random(GRID), 3).tolist()
    asked = {"codes": 128, "pilot": 32, "illumination": light}
    made = take(bench(tmp_path, ambient=0.05), **asked)
    run = made.manifest.run
    assert run.how.pilot == 4 and run.how.black_level == "ambient" and run.leak == 0.0
    assert made.error < 0.02


def test_parts_get_their_black_exposures_as_they_go(tmp_path: Path) -> None:
    config = bench(tmp_path, ambient=0.3)
    made = take(config, codes=192, parts=8, until_error=0.1)
    names = [shot.name for shot in made.manifest.run.shots]
    assert made.manifest.run.how.black_level == "ambient"
    assert names[:4] == ["white", "coded-1", "white-black-primal", "coded-1-black-primal"]
    assert made.error < 0.1


@pytest.mark.whole
def test_black_exposures_last_as_long_as_what_they_belong_to(tmp_path: Path) -> None:
    """A look for mirrors that finds none changes the plan after the white photo was taken."""
    scene = SceneConfig(kind="open-book", grid=(24, 32), ambient=0.3)
    config = bench_rig.config(tmp_path, scene=scene, schedule=ScheduleConfig())
    made = take(config, goal="direct", codes=None)
    run = made.manifest.run
    assert run.how.black_level == "ambient" and run.how.pilot > 0
    lasts = {shot.name: shot.close_ns - shot.open_ns for shot in run.shots}
    blacks = [name for name in lasts if "-black" in name]
    assert "white-black-primal" in blacks
    for name in blacks:
        lit = lasts[name.partition("-black")[0]]
        assert lasts[name] == pytest.approx(lit, abs=1e6)
    assert made.error < 0.02


def test_a_wanted_error_is_the_limit(tmp_path: Path) -> None:
    """The same leak is borne where nobody asked for a small error."""
    mask = PanelConfig(size_px=(1600, 1200), contrast=20000.0)
    fields = {"codes": 32, "parts": 4, "white": False}
    strict = take(bench(tmp_path, mask=mask), **fields).manifest
    loose = take(bench(tmp_path, mask=mask), until_error=0.2, **fields).manifest
    assert strict.plan["leaks"]["limit"] == 0.01
    assert loose.plan["leaks"]["limit"] == 0.2
    assert loose.run.how.black_level == "none"
