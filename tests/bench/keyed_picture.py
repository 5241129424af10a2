"""The picture of docs/goals.md: ``python -m tests.bench.keyed_picture docs/plots/keyed.png``.

A red box at six depths, each photographed twice with the same codes: white, and with the direct
light of one plane blocked (Fig. 11 of the paper). Below, the brightness of the box's front over its
disparity, out of the same photos, beside the curve that geometry demands. Prints the figures.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.tables import Config, RigConfig, SceneConfig, ServerConfig
from pdcd.virtual.scene.build import build_scene
from pdcd.virtual.scene.effects import Array
from pdcd.virtual.scene.scene import Scene
from pdcd.words import WindowName
from tests import world
from tests.bench import plots
from tests.taken import started, take_with

GRID = (48, 64)
SHOWN = (-2.0, -1.0, -0.5, 0.0, 0.75, 2.0)
"""Disparities of the box in the pictures, in cells."""
CURVE = (*np.arange(-1.5, 1.6, 0.125),)
"""And in the plot below."""
CODES = 128

Image = NDArray[np.float64]


def taken(folder: Path, disparity: float, window: WindowName) -> tuple[Image, Image, Scene]:
    """The keyed and the white picture of a box at that disparity, (rows, cols, 3) each."""
    scene = SceneConfig(kind="off-axis-box", grid=GRID, options={"disparity": float(disparity)})
    config = Config(
        rig=RigConfig(arrangement="off-axis"),
        scene=scene,
        server=ServerConfig(state_dir=str(folder / "state")),
    )
    job = f"box{disparity:+.3f}{window}"
    with started(config) as engine:
        made = take_with(engine, job, goal="keyed", codes=CODES, window=window, out=str(folder))
    keyed, white = (made.picture(name).astype(np.float64) for name in ("keyed", "white"))
    return keyed, white, build_scene(scene)


def front(scene: Scene, disparity: float) -> tuple[NDArray[np.bool_], Array]:
    """Cells that see the box's front and are lit, with those around them, and the true direct
    light of all cells, (rows, cols, 3)."""
    moved = scene.displacement
    assert moved is not None
    on = np.isclose(moved[:, 1], disparity, atol=1e-6).reshape(GRID)
    inside = on.copy()
    for axis in (0, 1):
        inside &= np.roll(on, 1, axis) & np.roll(on, -1, axis)
    light = np.ones((1, scene.cells))
    direct = sum(e.apply(light)[0][:, None] * e.tint for e in scene.effects[:3])
    return inside, np.asarray(direct).reshape(*GRID, 3)


def brightness(folder: Path, disparity: float, window: WindowName) -> float:
    """Direct light that is left of the front, over what there is of it."""
    keyed, _, scene = taken(folder, disparity, window)
    inside, direct = front(scene, disparity)
    indirect = scene.white().reshape(*GRID, 3) - direct
    return float((keyed - indirect)[inside].sum() / direct[inside].sum())


def draw(folder: Path, path: Path) -> None:
    """Take all photos and write the picture."""
    figure, axes = plots.panels(6, 3, scale=0.4)
    for column, disparity in enumerate(SHOWN):
        keyed, white, _ = taken(folder, disparity, "quarter")
        top = float(np.percentile(white, 99.5))
        for row, image in ((0, white), (1, keyed)):
            axis = axes[6 * row + column]
            axis.imshow(np.clip(image / top, 0.0, 1.0) ** (1 / 2.2))
            axis.set_xticks([])
            axis.set_yticks([])
        axes[column].set_title(f"{disparity:+g} cells", fontsize=11)
    axes[0].set_ylabel("white", fontsize=11)
    axes[6].set_ylabel("keyed at 0", fontsize=11)
    grid = axes[0].get_gridspec()
    for axis in axes[12:]:
        axis.remove()
    wide = figure.add_subplot(grid[2, :])
    for number, window in enumerate(("whole", "quarter")):
        seen = [brightness(folder, d, window) for d in CURVE]  # type: ignore[arg-type]
        fine = np.linspace(CURVE[0], CURVE[-1], 400)
        far = np.abs(fine)
        true = np.minimum(1.0, far) if number == 0 else np.clip((far - 0.25) / 0.5, 0.0, 1.0)
        colour = plots.colour(number)
        wide.plot(fine, true, color=colour, lw=1.0, label=f"{window} cells, by geometry")
        wide.plot(
            CURVE, seen, plots.marker(number), color=colour, ms=4.5, label=f"{window} cells, photos"
        )
        for d, value in zip(CURVE, seen, strict=True):
            sys.stdout.write(f"{window:8s} {d:+.3f} {value:.4f}\n")
    wide.set_xlabel("disparity of the box's front, in cells", fontsize=11)
    wide.set_ylabel("direct light left", fontsize=11)
    wide.tick_params(labelsize=10)
    wide.grid(alpha=0.3)
    plots.legend(wide)
    plots.save(figure, path, colours=256)


if __name__ == "__main__":
    world.enter()
    with tempfile.TemporaryDirectory() as name:
        draw(Path(name), Path(sys.argv[1]))
