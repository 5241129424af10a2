"""Whether a map can be used at all: finite, invertible, nowhere folded."""

from __future__ import annotations

import numpy as np

from pdcd.errors import ConfigError
from pdcd.maps.map import Map

SAMPLES = 33
"""Points a side at which a map is looked at, the device's corners included."""
FARTHEST = 100.0
"""A device whose corner lies further off than so many widths of the field is not on this bench."""


def check(map_: Map, device: str) -> Map:
    """The map itself. Raises ConfigError where it is not finite, singular, folded or beyond all
    measure; `device` is whose it is."""
    width, height = map_.size_px
    numbers = [*map_.homography, *map_.radial, *map_.tangential]
    if not (width > 0 and height > 0 and np.isfinite(numbers).all()):
        raise _unsound(device, "has numbers that are not finite, or a device without pixels")
    if map_.residual:
        shapes = {len(row) for row in map_.residual}
        if len(shapes) != 1 or min(len(map_.residual), *shapes) < 2:
            raise _unsound(device, "has a residual that is no grid of at least 2 x 2 nodes")
        if not np.isfinite(np.array(map_.residual)).all():
            raise _unsound(device, "has a residual that is not finite")
    full = np.array(map_.homography).reshape(3, 3)
    if np.linalg.matrix_rank(full) < 3:
        raise _unsound(device, "has a singular homography")
    x, y = np.meshgrid(np.linspace(0.0, width, SAMPLES), np.linspace(0.0, height, SAMPLES))
    points = np.stack([x, y], axis=-1)
    field = map_.to_field(points)
    if not np.isfinite(field).all():
        raise _unsound(device, "sends part of the device beyond infinity")
    if np.abs(field).max() > FARTHEST:
        raise _unsound(device, f"places a corner {np.abs(field).max():.3g} fields away")
    turned = np.linalg.det(map_.jacobian(points))
    if not (turned > 0.0).all() and not (turned < 0.0).all():
        raise _unsound(device, "folds: some places of the field have two pixels")
    back = map_.from_field(field)
    if not np.allclose(back, points, atol=1e-6 * max(width, height)):
        raise _unsound(device, "cannot be inverted over the whole device")
    return map_


def _unsound(device: str, what: str) -> ConfigError:
    return ConfigError(
        f"the map of the {device} {what}",
        device=device,
        hint="mend its place in the configuration, or calibrate the geometry anew",
    )
