"""Whether a mock bench is computed by pixels; most are computed by cells: faster and as exact."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from typing import TYPE_CHECKING
from weakref import WeakValueDictionary

from pdcd.bench.placed import compute_mock_frame
from pdcd.bench.tables import Config
from pdcd.bench.truth import restore_typed_values
from pdcd.panels.lattice import Lattice
from pdcd.panels.placing import Placing
from pdcd.probing.fine import is_cut_by_windows
from pdcd.probing.panel import offset_cells
from pdcd.virtual.scene.scene import Scene

if TYPE_CHECKING:
    from pdcd.virtual.optics.bench import OpticalBench

_made: WeakValueDictionary[tuple[int, int], OpticalBench] = WeakValueDictionary()
"""Benches in use, by the identities of their configuration and scene, which they hold on to."""


def choose_optics(
    config: Config, scene: Scene, windows: Iterable[str] = ("whole",)
) -> OpticalBench | None:
    """The bench pixel by pixel; None where computing it by the scene's cells is exact.

    It is exact where no device has a truth or a place of its own, codes and scene have the same
    cells, edges of cells and windows are edges of pixels on both panels, and the camera either sees
    a cell as one quad or has nothing finer to see in it: no detail of the scene, no edge of a
    window. `windows` are those of the codes. Raises ConfigError for a truth or a map that cannot be
    used.
    """
    camera, grid = config.camera, config.code_grid(scene.grid)
    typed = restore_typed_values(config)
    devices = (c for each in (config, typed) for c in (each.projector, each.mask, each.camera))
    lattices = [Lattice(grid, w, offset_cells(typed.projector, typed.mask, grid)) for w in windows]
    cut = any(is_cut_by_windows(lattice) for lattice in lattices)
    if (
        config.bench.truth is None
        and camera.frame_quads is None
        and grid == scene.grid
        and not (camera.quads_per_cell > 1 and (cut or scene.textures is not None))
        and all(_end_with_pixels(typed, lattice) for lattice in lattices)
        and all(device.place == Placing() for device in devices)
        and config.projector.field_px is None
    ):
        return None
    return build_pixel_bench(config, scene)


def build_pixel_bench(config: Config, scene: Scene) -> OpticalBench:
    """The bench pixel by pixel, whether it is needed or not. Raises ConfigError as `choose_optics`.

    While a bench is in use, another call with the very same configuration and scene returns it:
    where the camera looks is then found once, for its photos and for their truth.
    """
    from pdcd.virtual.optics.bench import OpticalBench  # most captures need none

    key = id(config), id(scene)
    bench = _made.get(key)
    if bench is None:
        frame = compute_mock_frame(config, config.code_grid(scene.grid))
        bench = _made[key] = OpticalBench(config, scene, frame)
    return bench


def _end_with_pixels(config: Config, lattice: Lattice) -> bool:
    """Whether all edges of cells and windows are edges of pixels, on panels that fill the field. A
    pixel shows the cell that its centre falls in, so other edges are drawn beside their places."""
    opening = lattice.opening
    halves, ends = {0.0}, {0.0}
    if opening.shifted:
        halves = {0.0, 0.5}
        ends = {opening.guard, 1.0 - opening.guard, 0.5 * opening.side, 1.0 - 0.5 * opening.side}
    for panel, edges in ((config.projector, halves), (config.mask, ends)):
        for size, cells in zip(panel.size_px[::-1], lattice.grid, strict=True):
            if any((size * Fraction(edge)) % cells for edge in edges) or size % cells:
                return False
    return True
