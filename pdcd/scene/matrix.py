"""Scenes read from a file that holds a whole transport matrix."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from pdcd.errors import ConfigError
from pdcd.scene.effects import Array, Dense, Direct, Effect, Sparse

SPARSE_BELOW = 0.12
"""Share of non-zero entries below which single paths are cheaper to probe (measured, N = 768)."""


def load_matrix(path: Path) -> tuple[Array, tuple[int, int]]:
    """Return the transport (N, N) float64 and the grid (rows, cols) of an .npz file.

    Raises
    ------
    ConfigError
        If the file is missing, is not an .npz of plain numbers, lacks `transport` or `grid`, or
        if they do not fit each other or are not finite and non-negative.
    """
    members = _read(path)
    grid = _grid(path, members["grid"])
    stored = members["transport"]
    cells = grid[0] * grid[1]
    if stored.shape != (cells, cells):
        raise _fault(
            path,
            f"`transport` has shape {stored.shape}, but the grid {grid[0]} x {grid[1]} "
            f"needs ({cells}, {cells})",
            "one row for each camera cell and one column for each projector cell, row-major",
        )
    if stored.dtype.kind not in "fiub":
        raise _fault(path, f"`transport` is of type {stored.dtype}", "store real numbers")
    transport: Array = stored.astype(np.float64)
    for wrong, what in ((~np.isfinite(transport), "not finite"), (transport < 0, "negative")):
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            raise _fault(
                path,
                f"`transport` has {np.count_nonzero(wrong)} entries that are {what}, "
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


def _read(path: Path) -> dict[str, NDArray[np.generic]]:
    """Read `transport` and `grid` of an .npz file."""
    try:
        with path.open("rb") as stream:
            if not zipfile.is_zipfile(stream):
                raise _fault(path, "it is not an .npz file", "write it with numpy.savez")
            stream.seek(0)
            with np.load(stream, allow_pickle=False) as archive:
                missing = [key for key in ("transport", "grid") if key not in archive]
                if missing:
                    raise _fault(
                        path,
                        f"it holds no {' and no '.join(missing)}",
                        "store `transport` (N, N) and `grid` [rows, cols] with numpy.savez",
                    )
                return {key: archive[key] for key in ("transport", "grid")}
    except OSError as err:
        raise _fault(path, err.strerror or str(err), "check [scene] path") from err
    except (ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error) as err:
        raise _fault(path, f"it is damaged: {err}", "write it again with numpy.savez") from err


def _grid(path: Path, value: NDArray[np.generic]) -> tuple[int, int]:
    """Check the `grid` member."""
    sound = value.shape == (2,) and value.dtype.kind in "iuf"
    numbers = value.astype(np.float64) if sound else np.zeros(2)
    if not np.all(np.isfinite(numbers) & (numbers >= 1) & (numbers == np.rint(numbers))):
        raise _fault(
            path,
            f"`grid` is {value.tolist()!r}",
            "two positive whole numbers: rows, columns",
        )
    return int(numbers[0]), int(numbers[1])


def _fault(path: Path, what: str, hint: str) -> ConfigError:
    return ConfigError(f"scene file {path}: {what}", hint=hint)
