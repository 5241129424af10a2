"""One exposure without a daemon, camera or file: patterns in, realised matrix and photo out.

The refreshes, their times and the optics are the program's own; what the photo ought to be is
worked out by each test from the transport matrix.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pdcd.panels.patterns import pack_levels
from pdcd.panels.schedule import build_frames
from pdcd.probing.panel import PanelOptics
from pdcd.probing.realised import Factors, collect_factors, compute_factors
from pdcd.virtual.scene.effects import DenseEffect, DirectEffect
from pdcd.virtual.scene.scene import Scene
from tests.frame_logs import REFRESH_NS, make_log

Floats = NDArray[np.float64]
Grid = tuple[int, int]

REFRESH_S = REFRESH_NS * 1e-9
SETTLE_NS = 50_000_000


def show(
    lights: ArrayLike,
    masks: ArrayLike,
    grid: Grid,
    *,
    window: str = "whole",
    guards: bool = True,
    projector: PanelOptics | None = None,
    mask: PanelOptics | None = None,
    primal_black: bool = False,
    dual_black: bool = False,
    offset_cells: tuple[float, float] = (0.0, 0.0),
) -> Factors:
    """Show levels (K, L) of both panels once, on time."""
    frames = build_frames(
        (pack_levels(np.asarray(lights, dtype=float)), pack_levels(np.asarray(masks, dtype=float))),
        grid,
        window=window,
        schedule="full" if guards else "none",
        passes=1,
        primal_black=primal_black,
        dual_black=dual_black,
    )
    log = make_log(len(frames), start_ns=SETTLE_NS)
    parts = compute_factors(
        frames,
        log,
        projector or PanelOptics(),
        mask or PanelOptics(),
        open_ns=0,
        close_ns=int(log.end_ns[0]) + SETTLE_NS,
        offset_cells=offset_cells,
    )
    return collect_factors(parts)


def scene_of(transport: Floats, grid: Grid, ambient: float = 0.0) -> Scene:
    """A scene whose light from a cell to itself is direct, and all else comes from elsewhere."""
    own = np.diag(transport).copy()
    cells = own.size
    effects = (DirectEffect("direct", own), DenseEffect("indirect", transport - np.diag(own)))
    return Scene("test", grid, effects, np.full((cells, 3), ambient) if ambient else None)


def photo(factors: Factors, scene: Scene) -> Floats:
    """What the exposure collects, in refreshes of full light, (N,)."""
    seen = scene.photo(factors.left, factors.right, factors.coaxial, factors.open_s)
    return np.asarray(seen[:, 0] / REFRESH_S)


def transport(cells: int, seed: int = 0) -> Floats:
    """Direct light near 1 and spread-out indirect light, (N, N)."""
    rng = np.random.default_rng(seed)
    return np.asarray(np.diag(0.5 + rng.random(cells)) + 0.1 * rng.random((cells, cells)))
