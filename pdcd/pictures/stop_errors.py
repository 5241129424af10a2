"""Errors of pictures because the comparison of lens stops on the scene has limited precision."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pdcd.arrays import Floats
from pdcd.bench.stops import stop_of
from pdcd.pictures.picture import Picture, PictureWithErrors, add_code_error
from pdcd.recipes.recipe import Extremes, Recipe
from pdcd.runs.record import RunRecord
from pdcd.sensor.cells import CellMap


def with_stop_errors(
    pictures: Mapping[str, PictureWithErrors],
    recipe: Recipe,
    photos: Mapping[str, Picture],
    record: RunRecord,
    cells: CellMap,
) -> dict[str, PictureWithErrors]:
    """Adds to the code error the uncertainty of stops that were compared on the scene: all photos
    taken at one stop are too bright, or too dark, alike. photos : scaled ones.
    """
    stops = _stop_sigmas(record, recipe)
    found = dict(pictures)
    for f_number, sigma in set(stops.values()):
        for name, picture in pictures.items():
            rule = recipe.pictures[name]
            if isinstance(rule, Extremes):
                of_stop: list[tuple[float, Picture]] = (
                    [(1.0, picture)] if set(rule.photos) & set(stops) else []
                )
            else:
                here = f_number, sigma
                of_stop = [(c, photos[one]) for c, one in rule if stops.get(one) == here]
            if of_stop:
                light = sum(c * one.image for c, one in of_stop)
                found[name] = _more_error(found[name], sigma * np.abs(light), cells)
    return found


def _more_error(picture: PictureWithErrors, error: Floats, cells: CellMap) -> PictureWithErrors:
    """A picture with one more error (h, w, C) that neighbours share."""
    of_cells = picture.of_cells
    if of_cells is not None:
        of_cells = np.hypot(of_cells, cells.mean(error).reshape(of_cells.shape))
    return replace(add_code_error(picture, error), of_cells=of_cells)


def _stop_sigmas(record: RunRecord, recipe: Recipe) -> dict[str, tuple[float, float]]:
    """By photo, its stop and the standard deviation of that stop's light relative to the run's own
    stop; only photos that were taken at another stop."""
    taken = {shot.name: stop_of(shot.f_number, record.stops) for shot in record.shots}
    of_sums = [taken[name] for name in recipe.stack if name in taken]
    found = {}
    for photo in recipe.photos:
        stops = [taken[name] for _, name in photo.shots if name in taken]
        worst = max(stops or of_sums, key=lambda stop: stop.sigma, default=None)
        if record.stops and worst is not None and worst.sigma > 0.0:
            found[photo.name] = worst.f_number, worst.sigma
    return found
