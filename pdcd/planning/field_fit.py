"""Where the field lies in the projector's picture, and cells of it that have no pixels."""

from __future__ import annotations

from collections.abc import Iterator

from pdcd.bench.placed import panels_of
from pdcd.bench.tables import Config
from pdcd.errors import ConfigError
from pdcd.panels.atoms import cells_shown, check_cells

OBLONG = 1.1
"""Sides of a cell, one over the other, from which on it is said to be oblong."""


def field_reasons(config: Config, grid: tuple[int, int]) -> Iterator[str]:
    """Where the field lies in the projector's picture; nothing where nobody measured it."""
    if config.projector.field_px is None:
        return
    (left, top, wide, high), (width, height) = config.projector.field_px, config.projector.size_px
    across, down = wide / grid[1], high / grid[0]
    oblong = ", oblong" if max(across, down) > OBLONG * min(across, down) else ""
    yield (
        f"field of {wide} x {high} of the projector's {width} x {height} pixels, from ({left}, "
        f"{top}) on, which projector, mask and camera share; cells of {across:.4g} x {down:.4g} "
        f"pixels{oblong}"
    )


def blind_reasons(config: Config, grid: tuple[int, int]) -> Iterator[str]:
    """Cells that have no pixel on a panel, of each panel with such cells."""
    panels = panels_of(config)
    for view in (panels.projector, panels.mask):
        blind = 1.0 - float(cells_shown(view, grid).mean())
        if blind > 0.0:
            yield (
                f"{100.0 * blind:.2g} % of the cells have no pixel on the {view.role}: nothing is "
                "known there (infinite sigma)"
            )


def refuse_blind(config: Config, grid: tuple[int, int]) -> None:
    """Raise ConfigError for cells that the panels cannot show, or none of which has pixels on both:
    before any light, and not when a display is to show them."""
    panels = panels_of(config)
    for view in (panels.projector, panels.mask):
        check_cells(view, grid)
    if not (cells_shown(panels.projector, grid) & cells_shown(panels.mask, grid)).any():
        raise ConfigError(
            f"none of {grid[0]} x {grid[1]} cells has pixels on both panels",
            device="mask",
            hint="mend [projector.place] and [mask.place], or calibrate the geometry",
        )
