"""Which pixels of a device lie on another one."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pdcd.panels.map import Map, between

Floats = NDArray[np.float64]

NODE_PX, LEAST_NODES = 8.0, 48
"""Pixels between places at which maps are asked, and how many these are along a side at least: a
lens bends by less than a hundredth of a pixel between them."""


def lies_on(device: Map, other: Map, edge_px: float = 0.0) -> NDArray[np.bool_]:
    """Pixels of a device, (height, width), all of which lie on another one, and not within
    `edge_px` of its edge, in its own pixels; below zero: nor further beyond it.

    device, other : maps to one field.
    """
    width, height = device.size_px
    x, y = (
        np.linspace(0.0, n, 1 + max(math.ceil(n / NODE_PX), LEAST_NODES)) for n in (width, height)
    )
    nodes = between(device, other, np.stack(np.meshgrid(x, y), axis=-1))
    at = _between(_between(nodes, height).swapaxes(0, 1), width).swapaxes(0, 1)
    with np.errstate(invalid="ignore"):  # no number where the other one has no such place
        on = np.asarray((at >= edge_px) & (at <= np.array(other.size_px) - edge_px))
    inside = np.asarray(on.all(axis=-1))
    return np.asarray(inside[1:, 1:] & inside[1:, :-1] & inside[:-1, 1:] & inside[:-1, :-1])


def _between(nodes: Floats, size: int) -> Floats:
    """Values at the ends of pixels, (size + 1, ...), of values at nodes evenly along them."""
    place = np.linspace(0.0, len(nodes) - 1.0, size + 1)
    first = np.minimum(place.astype(np.int64), len(nodes) - 2)
    share = (place - first).reshape(-1, *(1,) * (nodes.ndim - 1))
    return np.asarray((1.0 - share) * nodes[first] + share * nodes[first + 1])
