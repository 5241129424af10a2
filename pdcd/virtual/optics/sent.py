"""The indirect light that is wanted at places between the centres of cells."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import sparse

from pdcd.probing.wanted import WantedMatrix
from pdcd.virtual.optics.products import SitePairs
from pdcd.virtual.scene.effects import Array
from pdcd.virtual.scene.scene import Scene

_PAIRS = 1 << 14
"""Pairs of cells whose light is looked up together; bounds the memory."""
_ROWS = 64
"""Rows of the wanted matrix that light the scene together, for the same reason."""


def compute_sent_light(
    scene: Scene,
    pairs: SitePairs,
    meant: WantedMatrix,
    light: sparse.csr_array,
    alive: Callable[[], None],
) -> Array:
    """``sum over m of W_nm (T l_m)_k`` for pairs (n, k) of cells, (pairs, 3).

    n is the cell of the codes that a place lies in, whose row of the wanted matrix W applies there;
    k is a cell of the scene whose light the place partly gets.

    scene : with its indirect effects only. light : (cells of W, cells of the scene); l_m is the
    share of each scene cell that m lights. `alive` is called now and then; it may raise to end the
    work.
    """
    cell, part = pairs.mask, pairs.other
    if meant.uniform is not None:
        own, others = meant.uniform
        sent = others * scene.apply(np.asarray(light.sum(axis=0)).reshape(1, -1))[0, part]
        for start in range(0, len(sent), _PAIRS):
            alive()
            some = slice(start, start + _PAIRS)
            sent[some] += (own - others) * _of_cells(scene, part[some], light[cell[some]])
        return np.asarray(sent)
    sent = np.zeros((cell.size, 3))
    for camera, projector in zip(*meant.products(), strict=True):
        sent += camera[cell, None] * scene.apply((projector @ light)[None])[0, part]
    banded = meant.banded()
    if not banded.parts:
        return sent
    order = np.argsort(cell, kind="stable")
    for start in range(0, light.shape[0], _ROWS):
        alive()
        stop = min(start + _ROWS, light.shape[0])
        these = order[slice(*np.searchsorted(cell[order], (start, stop)))]
        if these.size:
            seen = scene.apply(banded.rows(start, stop) @ light)
            sent[these] += seen[cell[these] - start, part[these]]
    return sent


def _of_cells(scene: Scene, seen: np.ndarray, light: sparse.csr_array) -> Array:
    """The light of cells `seen` (P,), each lit by its own row of `light` (P, N): (P, 3)."""
    found, counts = np.zeros((seen.size, 3)), np.diff(light.indptr)
    which = np.repeat(np.arange(seen.size), counts)
    sent = scene.entries(seen[which], light.indices.astype(np.int64)) * light.data[:, None]
    np.add.at(found, which, sent)
    return found
