"""Scenes read from a file that holds a whole transport matrix.

================  ================================================================================
`transport`       (N, M) or (N, M, 3): row = camera cell, column = projector cell, both row-major;
                  one matrix for all colours, or one each for R, G and B
`grid`            [rows, columns] of the camera's cells, N of them
`projector_grid`  [rows, columns] of the projector's, M of them; left out, it is `grid`
`texture`         (H, W, 3), positive: detail finer than cells (see `texture.py`); optional
================  ================================================================================

Codes have the camera's cells, so a scene is a matrix over these alone: see `over_camera_cells`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from pdcd.errors import ConfigError
from pdcd.files.arrays import ZIP_MAGIC, list_members, read_npz
from pdcd.files.opening import ArrayLimits, UnsoundFileError
from pdcd.files.reading import read_array_file
from pdcd.virtual.scene.effects import (
    COLOUR_NAMES,
    Array,
    DenseEffect,
    DirectEffect,
    Effect,
    SparseEffect,
)
from pdcd.virtual.scene.texture import compute_pixel_shares

_SPARSE_BELOW = 0.12
"""Share of non-zero entries below which single paths are cheaper to probe (measured, N = 768)."""

MOST_SCENE_ELEMENTS = 2**28
"""Most numbers in the transport of a scene that a configuration names: 16384 cells, 2 GiB."""
MOST_TEXTURE_ELEMENTS = 2**26
"""Most numbers in its texture: 22 million pixels, 512 MiB."""

_MOST_LIGHT = float(np.finfo(np.float32).max)
"""Most light that an entry may send, as pictures are kept in single precision."""

_Grid = tuple[int, int]


@dataclass(frozen=True, eq=False)
class _Stored:
    """What a file holds; see the module for shapes."""

    transport: Array
    grid: _Grid
    projector_grid: _Grid
    texture: Array | None = None

    def effects(self) -> tuple[Effect, ...]:
        """The transport over the camera's cells, as effects."""
        if self.projector_grid == self.grid:
            return split_into_effects(self.transport)
        return split_into_effects(over_camera_cells(self.transport, self.grid, self.projector_grid))


def load_matrix(path: Path) -> _Stored:
    """Return what an .npz file holds.

    Raises
    ------
    ConfigError
        If the file is missing, is not an .npz of plain numbers, lacks `transport` or `grid`, or
        if its arrays do not fit each other, are too large, or are not finite and non-negative.
    """
    limits = ArrayLimits(MOST_SCENE_ELEMENTS)
    try:
        data = read_array_file(path, ArrayLimits(MOST_SCENE_ELEMENTS + MOST_TEXTURE_ELEMENTS))
        stored = _read(data, limits)
        return _Stored(stored.transport, stored.grid, stored.projector_grid, _texture(data))
    except UnsoundFileError as err:
        raise ConfigError(f"scene file {path}: {err.message}", hint=err.hint) from err


def read_transport(data: bytes, limits: ArrayLimits) -> tuple[Array, _Grid]:
    """The transport (N, N) and the grid in the bytes of an .npz file, such as that of a prior.

    `limits` are those of the transport. Raises Unsound, also for other grids and for colours.
    """
    stored = _read(data, limits)
    if stored.projector_grid != stored.grid or stored.transport.ndim != 2:
        raise UnsoundFileError(
            f"`transport` has shape {stored.transport.shape}, over two grids or in colour",
            "give one matrix (N, N) over one grid",
        )
    return stored.transport, stored.grid


def over_camera_cells(transport: Array, grid: _Grid, projector_grid: _Grid) -> Array:
    """Return a transport (N, M) or (N, M, 3) as one over the camera's cells, (N, N) or (N, N, 3).

    A projector cell gets the mean of the light that falls on it, so light of a camera cell counts
    there by the share of it that the camera cell covers. Light that a projector cell sends to a
    camera cell it overlaps is direct: it is taken to come back where it fell, on the diagonal. The
    sums of rows are kept, so even light gives the same picture.
    """
    down, across = (compute_pixel_shares(projector_grid[axis], grid[axis]) for axis in (0, 1))
    covered = scipy.sparse.csr_array(scipy.sparse.kron(down, across))
    projector, camera = covered.nonzero()
    rest = transport.copy()
    rest[camera, projector] = 0.0
    square = np.empty((len(transport), len(transport), *transport.shape[2:]))
    # One matrix at a time; a grey transport is one.
    for one, out in zip(_matrices(rest), _matrices(square), strict=True):
        out[:] = one @ covered
    direct = np.zeros((len(transport), *transport.shape[2:]))
    np.add.at(direct, camera, transport[camera, projector])
    square[np.arange(len(square)), np.arange(len(square))] = direct
    return square


def split_into_effects(transport: Array) -> tuple[Effect, ...]:
    """Return a transport (N, N) or (N, N, 3) as its diagonal and the rest, for each colour; the
    rest in its cheaper form."""
    if transport.ndim == 2:
        return _effects(transport, "", np.ones(3))
    effects: list[Effect] = []
    for channel, colour in enumerate(COLOUR_NAMES):
        one = np.ascontiguousarray(transport[..., channel])
        effects += _effects(one, f" {colour}", np.eye(3)[channel])
    return tuple(effects)


def _effects(transport: Array, colour: str, tint: Array) -> tuple[Effect, ...]:
    diagonal = np.diagonal(transport).copy()
    rest = transport - np.diag(diagonal)
    effects: list[Effect] = [DirectEffect(f"direct{colour}", diagonal, tint=tint)]
    filled = np.count_nonzero(rest)
    if filled >= _SPARSE_BELOW * rest.size:
        effects.append(DenseEffect(f"indirect{colour}", rest, tint=tint))
    elif filled:
        effects.append(SparseEffect(f"indirect{colour}", scipy.sparse.csr_array(rest), tint=tint))
    return tuple(effects)


def _matrices(transport: Array) -> list[Array]:
    if transport.ndim == 2:
        return [transport]
    return [transport[..., channel] for channel in range(transport.shape[2])]


def _read(data: bytes, limits: ArrayLimits) -> _Stored:
    """Read all but the texture. Raises Unsound."""
    if not data.startswith(ZIP_MAGIC):
        raise UnsoundFileError("it is not an .npz file", "write it with numpy.savez")
    small = ArrayLimits(64, limits.alive)
    wanted = {"transport": limits, "grid": small}
    if "projector_grid" in list_members(data):
        wanted["projector_grid"] = small
    found = read_npz(data, wanted)
    grid, transport = _grid(found["grid"], "grid"), found["transport"]
    projector_grid = grid
    if "projector_grid" in found:
        projector_grid = _grid(found["projector_grid"], "projector_grid")
    _check_shape(transport, grid, projector_grid, limits)
    negative = transport < 0
    if negative.any():
        row, column = np.argwhere(negative)[0][:2]
        raise UnsoundFileError(
            f"`transport` has {np.count_nonzero(negative)} entries that are negative, "
            f"the first at row {row}, column {column}",
            "light transport is finite and non-negative",
        )
    most = float(transport.max())
    if most > _MOST_LIGHT:
        raise UnsoundFileError(
            f"`transport` has entries up to {most:.3g}, and {_MOST_LIGHT:g} is the most",
            "1 is all light of a cell that a white surface sends back: divide it by its scale",
        )
    return _Stored(transport, grid, projector_grid)


def _check_shape(transport: Array, grid: _Grid, projector_grid: _Grid, limits: ArrayLimits) -> None:
    """Raise Unsound for a transport that does not fit the grids, or has too many cells."""
    cells, lights = grid[0] * grid[1], projector_grid[0] * projector_grid[1]
    if transport.shape not in ((cells, lights), (cells, lights, 3)):
        raise UnsoundFileError(
            f"`transport` has shape {transport.shape}, but the grid {grid[0]} x {grid[1]} "
            f"needs ({cells}, {lights}) or ({cells}, {lights}, 3)",
            "one row for each camera cell and one column for each projector cell, row-major; "
            "`projector_grid` says the rows and columns of the latter where they are others",
        )
    colours = transport[0, 0].size
    if cells**2 * colours > limits.elements:  # before room is taken for it
        raise UnsoundFileError(
            f"`grid` has {cells} camera cells, and light between all of them {cells**2 * colours} "
            f"numbers; at most {limits.elements} are taken",
            "store fewer camera cells, or all colours in one",
        )


def _texture(data: bytes) -> Array | None:
    """Read the texture, where there is one. Raises Unsound."""
    if "texture" not in list_members(data):
        return None
    texture = read_npz(data, {"texture": ArrayLimits(MOST_TEXTURE_ELEMENTS)})["texture"]
    if texture.ndim != 3 or texture.shape[2] != 3:
        raise UnsoundFileError(
            f"`texture` has shape {texture.shape}", "give an image (rows, columns, 3), any size"
        )
    if texture.min() <= 0.0:
        count = np.count_nonzero(texture <= 0.0)
        raise UnsoundFileError(
            f"`texture` has {count} values that are not above 0",
            "add a little everywhere: cells are divided by its means over them",
        )
    return texture


def _grid(value: Array, name: str) -> _Grid:
    """Check the `grid` members."""
    if value.shape != (2,) or not np.all((value >= 1) & (value == np.rint(value))):
        raise UnsoundFileError(
            f"`{name}` is {value.tolist()!r}", "two positive whole numbers: rows, columns"
        )
    return int(value[0]), int(value[1])
