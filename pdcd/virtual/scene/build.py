"""From the [scene] table of the configuration to a scene."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pdcd.bench.tables import DEFAULT_GRID, SceneConfig
from pdcd.errors import ConfigError
from pdcd.virtual.scene.effects import DirectEffect
from pdcd.virtual.scene.matrix import load_matrix
from pdcd.virtual.scene.presets import find_builder, list_presets
from pdcd.virtual.scene.scene import Scene


def build_scene(config: SceneConfig) -> Scene:
    """Build the scene that `config` describes.

    Raises
    ------
    ConfigError
        If the kind is unknown, an option is unknown or wrong, a matrix file is missing or
        unsound, or its grid is not the one that the configuration asks for.
    """
    if config.kind == "matrix":
        scene = _matrix_scene(config)
    elif make := make_card if config.kind == CARD else find_builder(config.kind):
        if config.path is not None:
            raise ConfigError(
                f"[scene] path: the kind {config.kind!r} reads no file",
                hint='remove `path`, or set kind = "matrix"',
            )
        scene = make(config.grid or DEFAULT_GRID, config.options)
    else:
        raise ConfigError(
            f"[scene] kind: unknown kind {config.kind!r}",
            hint=f"one of {', '.join(sorted([*list_presets(), CARD, 'matrix']))}",
        )
    if config.ambient == 0.0:
        return scene
    return scene.under(np.full((scene.cells, 3), config.ambient))


def _matrix_scene(config: SceneConfig) -> Scene:
    if config.options:
        raise ConfigError(
            f"[scene] options: the kind 'matrix' has none, got {', '.join(config.options)}",
            hint="remove the options",
        )
    if config.path is None:
        raise ConfigError(
            "[scene] path: the kind 'matrix' needs a file",
            hint="set `path` to an .npz with `transport` and `grid`",
        )
    path = Path(config.path)
    stored = load_matrix(path)
    grid = stored.grid
    if config.grid is not None and tuple(config.grid) != grid:
        raise ConfigError(
            f"[scene] grid: {config.grid[0]} x {config.grid[1]} is asked for, "
            f"but {path} holds {grid[0]} x {grid[1]}",
            hint="remove `grid`; the file's own is used",
        )
    return Scene(path.stem, grid, stored.effects(), texture=stored.texture)


CARD = "card"
"""Its name in `[scene] kind`."""
ALBEDO = 0.9
"""Reflectance of white paper."""


def make_card(grid: tuple[int, int], options: Mapping[str, Any]) -> Scene:
    """A card that fills the field. Options: `albedo`, its reflectance, 0 to 1.

    Raises ConfigError for other options, or an albedo that is not a number from 0 to 1.
    """
    unknown = sorted(set(options) - {"albedo"})
    albedo = options.get("albedo", ALBEDO)
    number = isinstance(albedo, int | float) and not isinstance(albedo, bool)
    if unknown or not number or not 0.0 < albedo <= 1.0:
        raise ConfigError(
            f"[scene] options of 'card': {', '.join(unknown) or f'albedo = {albedo!r}'}",
            hint="`albedo` alone, above 0 and at most 1",
        )
    cells = grid[0] * grid[1]
    return Scene("card", grid, (DirectEffect("card", np.full(cells, float(albedo))),))
