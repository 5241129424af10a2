"""Scenes read from a file that holds a whole transport matrix."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import scipy.sparse

from pdcd.errors import ConfigError
from pdcd.inputs.limits import Limits, Unsound
from pdcd.inputs.npy import ZIP_MAGIC, read_npz
from pdcd.inputs.opening import contents, open_own
from pdcd.scene.effects import Array, Dense, Direct, Effect, Sparse

SPARSE_BELOW = 0.12
"""Share of non-zero entries below which single paths are cheaper to probe (measured, N = 768)."""


MOST_SCENE_ELEMENTS = 2**28
"""Numbers in the transport of a scene that a configuration names: 16384 cells, 2 GiB here."""


def load_matrix(path: Path) -> tuple[Array, tuple[int, int]]:
    """Return the transport (N, N) float64 and the grid (rows, cols) of an .npz file.

    Raises
    ------
    ConfigError
        If the file is missing, is not an .npz of plain numbers, lacks `transport` or `grid`, or
        if they do not fit each other or are not finite and non-negative.
    """
    limits = Limits(MOST_SCENE_ELEMENTS)
    try:
        descriptor = open_own(path)
        try:
            data = contents(descriptor, limits)
        finally:
            os.close(descriptor)
        return read_transport(data, limits)
    except Unsound as err:
        raise ConfigError(f"scene file {path}: {err.message}", hint=err.hint) from err


def read_transport(data: bytes, limits: Limits) -> tuple[Array, tuple[int, int]]:
    """The same of the bytes of an .npz file; `limits` are those of the transport.

    Raises Unsound.
    """
    if not data.startswith(ZIP_MAGIC):
        raise Unsound("it is not an .npz file", "write it with numpy.savez")
    members = read_npz(data, {"transport": limits, "grid": Limits(64, limits.alive)})
    grid, transport = _grid(members["grid"]), members["transport"]
    cells = grid[0] * grid[1]
    if transport.shape != (cells, cells):
        raise Unsound(
            f"`transport` has shape {transport.shape}, but the grid {grid[0]} x {grid[1]} "
            f"needs ({cells}, {cells})",
            "one row for each camera cell and one column for each projector cell, row-major",
        )
    negative = transport < 0
    if negative.any():
        row, column = np.argwhere(negative)[0]
        raise Unsound(
            f"`transport` has {np.count_nonzero(negative)} entries that are negative, "
            f"the first at row {row}, column {column}",
            "light transport is finite and non-negative",
        )
    return transport, grid


def matrix_effects(transport: Array) -> tuple[Effect, ...]:
    """Return a transport (N, N) as its diagonal and the rest, in the cheaper form of the rest."""
    diagonal = np.diagonal(transport).copy()
    rest = transport - np.diag(diagonal)
    effects: list[Effect] = [Direct("direct", diagonal)]
    filled = np.count_nonzero(rest)
    if filled >= SPARSE_BELOW * rest.size:
        effects.append(Dense("indirect", rest))
    elif filled:
        effects.append(Sparse("indirect", scipy.sparse.csr_array(rest)))
    return tuple(effects)


def _grid(value: Array) -> tuple[int, int]:
    """Check the `grid` member."""
    if value.shape != (2,) or not np.all((value >= 1) & (value == np.rint(value))):
        raise Unsound(f"`grid` is {value.tolist()!r}", "two positive whole numbers: rows, columns")
    return int(value[0]), int(value[1])
