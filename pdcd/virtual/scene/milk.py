"""A milky medium in front of a surface: what is left of the image, its blur, and a veil.

Light that crosses a medium of optical depth d and comes back has kept its way with probability
``exp(-2 d)`` (Beer-Lambert, there and back). Of the rest, part is scattered forwards and still
reaches the surface, some way off; part is scattered so often that it fills the vessel evenly and
comes back from everywhere; part is absorbed.
"""

from __future__ import annotations

import numpy as np

from pdcd.virtual.scene.effects import Array, Effect, LowRankEffect, make_direct_effects
from pdcd.virtual.scene.kernel import KernelEffect, make_gaussian_kernel

FORWARD = 0.3
"""Share of the scattered light that still reaches the surface."""
VEIL = 0.6
"""Share of the scattered light that comes back from anywhere in the vessel."""


def make_milk_effects(
    grid: tuple[int, int],
    pitch: tuple[float, float],
    depth: Array,
    albedo: Array,
    *,
    sigma: float,
    tint: Array,
    forward: float = FORWARD,
    veil: float = VEIL,
) -> tuple[Effect, ...]:
    """Return the effects of a surface seen through a milky medium.

    Parameters
    ----------
    grid : (rows, cols)
    pitch : (row, column) distance between cells
    depth : (N,) float64
        Optical depth of the medium in front of each cell; 0 where there is none.
    albedo : (N, 3) float64
        Reflectance of the surface, slope included.
    sigma : standard deviation of the blur, in the unit of `pitch`
    tint : (3,) colour of the medium
    forward, veil : shares of the scattered light, see `FORWARD` and `VEIL`
    """
    kept = np.exp(-2.0 * depth)
    scattered = 1.0 - kept
    effects: list[Effect] = [*make_direct_effects(albedo * kept[:, None])]
    if scattered.any():
        # The square root on either side keeps the path the same both ways.
        gate = np.sqrt(forward * scattered * albedo.mean(axis=1))
        effects.append(
            KernelEffect(
                "blur", grid, make_gaussian_kernel(grid, pitch, sigma), gate, gate, tint=tint
            ),
        )
        even = scattered[:, None]
        effects.append(LowRankEffect("veil", veil * even, even / even.sum(), tint=tint))
    return tuple(effects)
