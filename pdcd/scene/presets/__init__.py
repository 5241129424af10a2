"""Scenes that need no file: name -> builder of (grid, options)."""

from collections.abc import Callable, Mapping
from typing import Any

from pdcd.scene.presets.book import open_book
from pdcd.scene.presets.bottle import milky_bottle
from pdcd.scene.presets.disco import disco_ball
from pdcd.scene.presets.vase import mirror_and_vase
from pdcd.scene.presets.wax import wax_disk
from pdcd.scene.scene import Scene

__all__ = ["PRESETS"]

PRESETS: dict[str, Callable[[tuple[int, int], Mapping[str, Any]], Scene]] = {
    "open-book": open_book,
    "wax-disk": wax_disk,
    "disco-ball": disco_ball,
    "milky-bottle": milky_bottle,
    "mirror-and-vase": mirror_and_vase,
}
"""Each builder takes a grid (rows, cols), both at least 1, and the options of the [scene] table;
it raises ConfigError for options it does not know."""
