"""Whether a mock bench is one of pixels; most are one of cells, which is faster and as exact."""

from __future__ import annotations

from typing import TYPE_CHECKING
from weakref import WeakValueDictionary

from pdcd.bench.placed import frame_of
from pdcd.bench.tables import Config
from pdcd.panels.lattice import Lattice
from pdcd.panels.placing import Placing
from pdcd.probing.fine import cut_by_windows
from pdcd.probing.panel import offset_cells
from pdcd.virtual.scene.scene import Scene

if TYPE_CHECKING:
    from pdcd.virtual.optics.bench import OpticalBench

_made: WeakValueDictionary[tuple[int, int], OpticalBench] = WeakValueDictionary()
"""Benches in use, by the identities of their configuration and scene, which they hold on to."""


def windows_cut(config: Config, grid: tuple[int, int], window: str) -> bool:
    """Whether edges of the mask's windows fall within cells, as quarter windows and an offset mask
    make them do; `window` is that of the codes."""
    offset = offset_cells(config.projector, config.mask, grid)
    return cut_by_windows(Lattice(grid, window, offset))


def optics_of(config: Config, scene: Scene, *, cut: bool = False) -> OpticalBench | None:
    """The bench pixel by pixel; None where the scene's cells say all there is to see.

    They do where nothing has a truth or a place of its own, codes and scene have the same cells,
    and the camera either sees a cell as one quad or there is nothing finer to see in it: no detail
    of the scene, and no edge of a window (`cut`). Raises ConfigError for a truth or a map that
    cannot be used.

    As long as somebody holds a bench, who asks for one of the very same configuration and scene
    gets that: where the camera looks is found once for its photos and for their truth.
    """
    camera, grid = config.camera, config.code_grid(scene.grid)
    placed = any(p.place != Placing() for p in (config.projector, config.mask, camera))
    fine = camera.quads_per_cell > 1 and (cut or scene.textures is not None)
    apart = camera.frame_quads is not None or grid != scene.grid
    if config.bench.truth is None and not (placed or fine or apart):
        return None
    from pdcd.virtual.optics.bench import OpticalBench  # most captures need none

    key = id(config), id(scene)
    bench = _made.get(key)
    if bench is None:
        bench = _made[key] = OpticalBench(config, scene, frame_of(config, grid))
    return bench
