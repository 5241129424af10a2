"""One field for both panels, from what the camera sees of them.

At places of the photo, mask pixel and projector pixel are both known, so a map leads directly from
one to the other; the camera's lens and where its samples lie cancel. All three maps lead to the
projector's picture, which the projector's own map fills; the field lies in it
(`pdcd.calibration.geometry.shared_field`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdcd.arrays import Floats
from pdcd.calibration.geometry.fit import FittedMap, PointPairs, fit_map
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map

_ACROSS = 96
"""Places along the photo's width at which both panels are looked up."""
_COMPOSED_NODES = (10, 12)
"""Rows and columns of nodes of the composed residual: two residuals one after the other."""
_LEAST_PLACES = 200
"""Places that must lie on both panels."""
_SURE_PX = 1e-3
"""Error of the composed model itself, in projector pixels."""


@dataclass(frozen=True, eq=False)
class ComposedMaps:
    """mask : from mask pixels to projector pixels. through : both maps of the camera, whose errors
    are the composed map's."""

    mask: FittedMap
    projector_of: FittedMap
    mask_of: FittedMap

    def sigma_px(self, mask_px: Floats) -> Floats:
        """Standard deviation of the mask's map at its pixels (n, 2), (n, 2), in projector pixels,
        from the errors of both of the camera's maps. NaN where the camera does not see the mask."""
        seen = self.mask_of.map.from_field(mask_px / self.mask_of.target_size_px)
        known = np.isfinite(seen).all(axis=-1)
        found = np.full(mask_px.shape, np.nan)
        found[known] = np.sqrt(
            np.diagonal(_covariance(self.projector_of, self.mask_of, seen[known]), axis1=1, axis2=2)
        )
        return found

    @property
    def maps(self) -> dict[str, Map]:
        """The maps of projector, mask and camera to the projector's picture."""
        return {
            "projector": Map.filling(self.projector_of.target_size_px),
            "mask": self.mask.map,
            "camera": self.projector_of.map,
        }


def compose_maps(projector_of: FittedMap, mask_of: FittedMap) -> ComposedMaps:
    """The map from mask to projector, composed of the camera's maps to both.

    Raises CalibrationError where the camera sees too little that lies on both panels.
    """
    frame = projector_of.map.size_px
    if mask_of.map.size_px != frame:
        raise ValueError("both maps must be of one camera")
    step = frame[0] / _ACROSS
    x = np.arange(0.5 * step, frame[0], step)
    y = np.arange(0.5 * step, frame[1], step)
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    on_mask, on_projector = mask_of.to_target(places), projector_of.to_target(places)
    with np.errstate(invalid="ignore"):
        both = np.ones(len(places), dtype=np.bool_)
        for at, size in (
            (on_mask, mask_of.target_size_px),
            (on_projector, projector_of.target_size_px),
        ):
            both &= ((at >= 0.0) & (at <= size)).all(axis=-1)
    if both.sum() < _LEAST_PLACES:
        raise CalibrationError(
            f"only {both.mean():.1%} of the photo shows both the mask and the projector's picture",
            device="mask",
            hint="move the projector's picture to where the camera sees through the mask",
        )
    # Their own errors are correlated over long distances, so they are no use as weights.
    sigma = np.full((int(both.sum()), 2), _SURE_PX)
    pairs = PointPairs(on_mask[both], on_projector[both], sigma)
    fitted = fit_map(
        pairs, mask_of.target_size_px, projector_of.target_size_px, "mask", nodes=_COMPOSED_NODES
    )
    return ComposedMaps(fitted, projector_of, mask_of)


def _covariance(projector_of: FittedMap, mask_of: FittedMap, places: Floats) -> Floats:
    """Covariance of the composed map at places of the photo, (n, 2, 2), projector pixels squared:
    P(M^-1(m)), so an error of M moves the place by its inverse slope."""
    across = projector_of.slope(places) @ np.linalg.inv(mask_of.slope(places))
    by_mask = across @ mask_of.covariance_px(places) @ np.swapaxes(across, 1, 2)
    return np.asarray(projector_of.covariance_px(places) + by_mask)
