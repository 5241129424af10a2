"""Small mock benches whose truth their belief does not know, calibrated step by step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pdcd.bench.tables import (
    BenchConfig,
    CalibrationConfig,
    CameraConfig,
    Config,
    PanelConfig,
    SceneConfig,
    ServerConfig,
)
from pdcd.panels.map import Map
from pdcd.panels.placing import Placing
from tests.taken import Calibrated, calibrate_once

QUADS = (256, 192)
PROJECTOR_PX, MASK_PX = (256, 192), (400, 300)


def make_config(
    folder: Path,
    truth: str = "",
    *,
    projector_px: tuple[int, int] = PROJECTOR_PX,
    mask_px: tuple[int, int] = MASK_PX,
    quads: tuple[int, int] = QUADS,
    placed: bool = False,
    camera: Mapping[str, Any] = MappingProxyType({}),
    **tables: Any,
) -> Config:
    """A mock bench before a card with that truth. placed : whether maps are believed that fill the
    field. camera : more of its table."""
    folder.mkdir(exist_ok=True)
    (folder / "truth.toml").write_text(truth)

    def place(size: tuple[int, int]) -> Placing:
        return Placing(map=Map.filling(size)) if placed else Placing()

    said: dict[str, Any] = {"seed": 5, "frame_quads": quads, "place": place(quads), **camera}
    given: dict[str, Any] = {
        "projector": PanelConfig(size_px=projector_px, place=place(projector_px)),
        "mask": PanelConfig(size_px=mask_px, place=place(mask_px)),
        "camera": CameraConfig(profile="450d", **said),
        "scene": SceneConfig(kind="card"),
        "bench": BenchConfig(truth=str(folder / "truth.toml")),
        "server": ServerConfig(state_dir=str(folder / "state")),
    }
    return Config(**{**given, **tables})


@dataclass
class SmallBench:
    """truth : text of the truth's file. scene : kind of the scene. placed : whether belief has maps
    of all devices, as if the geometry had been measured; the truth then agrees. quads : width and
    height of the photos. use : the calibration that is gone by; the latest is none of a bench whose
    truth is another one by now. tables : in the place of those of `make_config`."""

    folder: Path
    truth: str = ""
    scene: str = "card"
    placed: bool = False
    quads: tuple[int, int] = QUADS
    use: str = "latest"
    tables: dict[str, Any] = field(default_factory=dict)

    @property
    def config(self) -> Config:
        scene = SceneConfig(kind=self.scene)
        tables = {"scene": scene, "calibration": CalibrationConfig(use=self.use), **self.tables}
        return make_config(self.folder, self.truth, quads=self.quads, placed=self.placed, **tables)

    def calibrate(self, *steps: Any, **request: Any) -> Calibrated:
        """These steps, by an engine of their own."""
        return calibrate_once(self.config, *steps, **request)
