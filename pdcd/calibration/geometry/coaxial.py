"""Are mask and projector coaxial? Two cards at two distances tell.

The projector's and the mask's centres of projection are apart by b = (right, down, along). A pixel
of the mask that sees the point u of the projector on a card at distance Z1 sees another one on a
card at Z2:

    u(Z1) - u(Z2) = (1 / Z1 - 1 / Z2) (f b_right_down - b_along (u - c)),

f the projector's focal length in its pixels, c the point where its axis meets its picture. Sideways
distance moves the whole picture; distance along the axis makes it grow about c. (For points at
distance Z the mask sees x = X / Z with X taken from its own centre: one subtracts two projections.)

On a scene of depth, that movement is misregistration that no map takes out:
f b (1 / Znear - 1 / Zfar) must stay small against the guard of the cells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.errors import CalibrationError
from pdcd.panels.map import Map, between

Floats = NDArray[np.float64]

PLACES = (6, 8)
"""Rows and columns of places on the mask that are compared."""
LEAST_SHARE = 0.5
"""Share of these places that both cards must show."""
UNEXPLAINED = 3.0
"""Residual, over the maps' error, that says that something else than the card moved."""


@dataclass(frozen=True, eq=False)
class Parallax:
    """How far the centres of projection are apart.

    apart_m : (3,) right, down, along the axis. covariance : (3, 3). focal_px : the projector's.
    left_px : what the two cards show besides, root mean square.
    """

    apart_m: Floats
    covariance: Floats
    focal_px: float
    left_px: float

    @property
    def sideways_m(self) -> float:
        """Length of the part across the axis."""
        return float(np.hypot(*self.apart_m[:2]))

    @property
    def sideways_sigma_m(self) -> float:
        """Its standard deviation; of the larger axis where it is next to nothing."""
        sideways = self.apart_m[:2]
        length = self.sideways_m
        spread = self.covariance[:2, :2]
        largest = float(np.sqrt(np.linalg.eigvalsh(spread)[-1]))
        if length < largest:
            return largest
        along = sideways / length
        return float(np.sqrt(along @ spread @ along))

    def offset_px(self, near_m: float, far_m: float) -> float:
        """By how much registration varies from the nearest to the farthest point of a scene, in
        projector pixels, on the axis."""
        return self.focal_px * self.sideways_m * (1.0 / near_m - 1.0 / far_m)

    def deepest_m(self, near_m: float, budget_px: float) -> float:
        """The farthest point of a scene that begins at ``near_m``, if registration may vary by
        ``budget_px``; infinite where any distance will do."""
        moved = self.focal_px * self.sideways_m
        left = 1.0 / near_m - (budget_px / moved if moved > 0.0 else np.inf)
        return 1.0 / left if left > 0.0 else float("inf")


def parallax(
    cards: tuple[Map, Map],
    projectors: tuple[Map, Map],
    distances_m: tuple[float, float],
    focal_px: float,
    sigma_px: float,
) -> Parallax:
    """The distance of the centres of projection, by maps of two cards. The projector's axis meets
    the middle of its picture: it has no lens shift.

    Parameters
    ----------
    cards, projectors : the mask's map and the projector's with the first card, with the second.
    distances_m : of the cards from the projector.
    focal_px : focal length of the projector, in its pixels (its width times the throw ratio).
    sigma_px : error of the maps, in projector pixels, taken to be one for the whole field, which is
        the worst there is.

    Raises CalibrationError for distances that cannot be, cards that do not overlap, and a movement
    that parallax does not explain.
    """
    near, far = distances_m
    per_m = 1.0 / near - 1.0 / far if min(distances_m) > 0.0 else 0.0
    if abs(per_m) < 1e-3:
        raise CalibrationError(
            f"cards at {near:g} m and {far:g} m tell no parallax",
            hint="put them a tenth of their distance apart, and measure from the projector",
        )
    width, height = cards[0].size_px
    rows, cols = PLACES
    x, y = (np.arange(cols) + 0.5) / cols * width, (np.arange(rows) + 0.5) / rows * height
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    first, second = (
        between(card, projector, points) for card, projector in zip(cards, projectors, strict=True)
    )
    size = np.array(projectors[0].size_px, dtype=np.float64)
    good = np.isfinite(first + second).all(axis=-1)
    with np.errstate(invalid="ignore"):
        for each in (first, second):
            good &= ((each >= 0.0) & (each <= size)).all(axis=-1)
    if good.mean() < LEAST_SHARE:
        raise CalibrationError(
            f"both cards show {good.mean():.0%} of the mask only",
            device="mask",
            hint="use cards that fill the field, and calibrate the geometry with each",
        )
    return _solved(
        (first - second)[good], 0.5 * (first + second)[good] - 0.5 * size,
        per_m, focal_px, sigma_px * np.sqrt(2.0),
    )  # fmt: skip


def _solved(
    moved: Floats, from_axis: Floats, per_m: float, focal_px: float, sigma_px: float
) -> Parallax:
    """Least squares of the movement (n, 2) of places (n, 2) from the axis."""
    count = len(moved)
    rows = np.zeros((count, 2, 3))
    rows[:, 0, 0] = rows[:, 1, 1] = focal_px * per_m
    rows[:, :, 2] = -from_axis * per_m
    matrix, wanted = rows.reshape(-1, 3), moved.reshape(-1)
    inverse = np.linalg.inv(matrix.T @ matrix)
    apart_m = inverse @ matrix.T @ wanted
    left = float(np.sqrt(np.mean((wanted - matrix @ apart_m) ** 2)))
    if left > UNEXPLAINED * sigma_px:
        raise CalibrationError(
            f"{left:.2f} px of what the two cards show is no parallax",
            hint="put both cards square to the axis, flat, and touch nothing else between them",
        )
    # Errors that neighbours share do not average out: as if there were one place only.
    covariance = inverse * sigma_px**2 * count
    return Parallax(np.asarray(apart_m), np.asarray(covariance), focal_px, left)
