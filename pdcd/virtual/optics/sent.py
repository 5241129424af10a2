"""What light that wandered is wanted at places between the centres of cells."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pdcd.probing.wanted import Wanted
from pdcd.virtual.optics.products import Pairs
from pdcd.virtual.scene.effects import Array
from pdcd.virtual.scene.scene import Scene

PAIRS = 1 << 14
"""Pairs of cells whose light is looked up together; bounds the memory."""
ROWS = 64
"""Rows of the wanted matrix that are shown to the scene together, for the same reason."""


def sent_to(scene: Scene, pairs: Pairs, meant: Wanted, alive: Callable[[], None]) -> Array:
    """``sum over m of W_nm T_km``, (pairs, 3): of pairs of the cell n that places lie in, whose row
    of the wanted matrix W counts there, and of one, k, whose light they have a part of.

    scene : of the light that wandered, of the cells of W unless that wants all others alike.
    `alive` is called now and then, and may raise to end the work.
    """
    cell, part = pairs.mask, pairs.other
    if meant.uniform is not None:
        own, others = meant.uniform
        sent = others * scene.white()[part]
        for start in range(0, len(sent), PAIRS):
            some = slice(start, start + PAIRS)
            sent[some] += (own - others) * scene.entries(part[some], cell[some])
        return sent
    sent = np.zeros((cell.size, 3))
    for camera, projector in zip(*meant.products(), strict=True):
        sent += camera[cell, None] * scene.apply(projector[None])[0, part]
    banded = meant.banded()
    if not banded.parts:
        return sent
    order = np.argsort(cell, kind="stable")
    for start in range(0, scene.cells, ROWS):
        alive()
        stop = min(start + ROWS, scene.cells)
        these = order[slice(*np.searchsorted(cell[order], (start, stop)))]
        if these.size:
            seen = scene.apply(banded.rows(start, stop))
            sent[these] += seen[cell[these] - start, part[these]]
    return sent
