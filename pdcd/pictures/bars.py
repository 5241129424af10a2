"""The pictures of a run with their whole error, as far as it is known: of codes by what parts show.

The error of the codes is told of cells, and lies on their quads as light does. Nothing finer is
asked of a part of a photo: its shots are averaged over cells first, once each, and all parts are
worked out on these few values. A part then has the weight of a cell where the photo has that of
each quad; it is the same in all parts, whose differences alone are looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pdcd.bench.stops import stop_of
from pdcd.pictures.combine import direct_taken_out, white_of
from pdcd.pictures.exposed import Ambient, Exposed, Print
from pdcd.pictures.learn import Learned
from pdcd.pictures.photos import NOTHING_TOLD, corrected_photos, told_by_parts
from pdcd.pictures.picture import Barred, Errors, Picture, barred, pictures_of, sigma_of
from pdcd.pictures.sigma import beside_weight, measured, single_of_photos
from pdcd.pictures.to_cells import (
    Averaged,
    all_counted,
    average_apart,
    average_shots,
    halve,
    mean_image,
    seen_cells,
)
from pdcd.pictures.to_quads import share_out
from pdcd.pictures.weights import Shown, weigh_cells
from pdcd.recipes.parts import FEWEST_PARTS, only_parts, part_numbers
from pdcd.recipes.recipe import Extremes, Recipe
from pdcd.runs.record import RunRecord
from pdcd.sensor.cells import CellMap
from pdcd.words import NormaliseName

if TYPE_CHECKING:
    from pdcd.pictures.border_light import SeenBorders

Floats = NDArray[np.float64]
Photos = Callable[[Recipe, Mapping[str, Exposed], CellMap], dict[str, Picture]]
"""Scales and corrects the photos of a recipe."""

LEAST_APART = 1e-4
"""Share of the field in which panels draw different cells below which nobody could see it."""

UNSURE_DIRECT = 0.5
"""Share of the direct light that slow panels let through by which that may be more or less than the
realised matrix says: 0.3 of 0.6 % before a stranger's fold, where rows are set last."""

LEAST_KEPT = 0.5
"""Share of direct light that must go through its own cells for the photos to tell how much there
is."""


def barred_pictures(
    record: RunRecord,
    recipe: Recipe,
    shots: Mapping[str, Exposed],
    learned: Learned | None,
    cells: CellMap,
    alive: Callable[[], None],
    borders: SeenBorders | None = None,
    room: Floats | None = None,
) -> dict[str, Barred]:
    """All pictures of a recipe with sensor and code error: of what the parts show, if there are
    enough; and with what all parts get wrong alike, as far as it is known.

    shots : of the run, and sums of them. learned : of its pilot, if any. borders : what a photo of
    the light along borders of cells tells, if there is one; all parts have the same of it, and of
    the light of the `room`, (N, 3), that a dark photo tells.
    """
    averaged, told, coarse = None, NOTHING_TOLD, None
    by_codes: dict[str, Floats] = {}
    if len(part_numbers(recipe)) >= FEWEST_PARTS:
        used = _used(recipe, shots)
        averaged = average_shots(used, cells)
        coarse = None if borders is None else _averaged_borders(borders, shots, cells)
        if record.smooth:
            light = averaged
            if not all_counted(cells):
                light = average_shots(used, cells, all_quads=True)
            told = told_by_parts(
                recipe, light.shots, learned, light.cells, seen=seen_cells(cells),
                normalise=record.normalise, alive=alive, room=room,
            )  # fmt: skip

    def photos(
        part: Recipe,
        shots: Mapping[str, Exposed],
        cells: CellMap,
        borders: SeenBorders | None = None,
    ) -> dict[str, Picture]:
        return corrected_photos(
            part, shots, learned, cells, normalise=record.normalise, smooth=record.smooth,
            alive=alive, told=told, borders=borders, room=room,
        )  # fmt: skip

    scaled = photos(recipe, shots, cells, borders)
    alive()
    whole = pictures_of(recipe, scaled)
    if averaged is not None:
        images = part_images(recipe, averaged, partial(photos, borders=coarse))
        by_codes = single_of_photos(recipe, shots, scaled, cells)
        single = of_pictures(recipe, scaled, by_codes)
        bars = barred_by_parts(whole, images, cells, single)
    else:
        bars = barred_alone(recipe, whole)
    normalise = record.normalise
    bars = with_beside_light(bars, recipe, shots, scaled, by_codes, learned, cells, normalise)
    bars = with_direct_light(bars, recipe, shots, scaled, cells, borders, normalise=normalise)
    bars = with_stop_errors(bars, recipe, scaled, _stop_sigmas(record, recipe), cells)
    if record.panels is None:
        return bars
    return without_blind(with_misplaced_light(bars, recipe, scaled, record, cells), record, cells)


def _stop_sigmas(record: RunRecord, recipe: Recipe) -> dict[str, tuple[float, float]]:
    """By photo, the stop it was taken at and how sure its light is beside that of the run's own
    stop; of those alone that were taken at another one."""
    taken = {shot.name: stop_of(shot.f_number, record.stops) for shot in record.shots}
    of_sums = [taken[name] for name in recipe.stack if name in taken]
    found = {}
    for photo in recipe.photos:
        stops = [taken[name] for _, name in photo.shots if name in taken]
        worst = max(stops or of_sums, key=lambda stop: stop.sigma, default=None)
        if record.stops and worst is not None and worst.sigma > 0.0:
            found[photo.name] = worst.f_number, worst.sigma
    return found


def with_stop_errors(
    pictures: Mapping[str, Barred],
    recipe: Recipe,
    photos: Mapping[str, Picture],
    stops: Mapping[str, tuple[float, float]],
    cells: CellMap,
) -> dict[str, Barred]:
    """Pictures whose code error knows how far stops may be off that were compared on the scene: all
    photos of one stop are too bright, or too dark, alike.

    photos : scaled ones. stops : by photo, its f-number and the relative error of its light.
    """
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


def _more_error(picture: Barred, error: Floats, cells: CellMap) -> Barred:
    """A picture with one more error (h, w, 3) that neighbours share."""
    code = np.hypot(picture.code, error).astype(picture.code.dtype)
    of_cells = picture.of_cells
    if of_cells is not None:
        of_cells = np.hypot(of_cells, mean_image(error, cells).reshape(of_cells.shape))
    made = barred(Picture(picture.image, picture.sensor), code, picture.kind)
    return replace(made, of_cells=of_cells)


def _of_cells(picture: Barred, cells: CellMap) -> Errors:
    """The code error of means over cells, (rows, cols, 3)."""
    if picture.of_cells is not None:
        return picture.of_cells
    return mean_image(picture.code, cells).reshape(*cells.grid, -1)


def _averaged_borders(
    borders: SeenBorders, shots: Mapping[str, Exposed], cells: CellMap
) -> SeenBorders:
    """What a photo of the light along borders tells, as the averaged shots have it."""
    alike = next(iter(shots.values()))
    light, dark = borders.light, np.zeros(cells.frame, np.bool_)
    photo = Print(light.light, light.variance, dark, alike.realised, {})
    of_near = Print(borders.indirect, light.variance, dark, alike.realised, {})
    found = average_shots({"": photo, "near": of_near}, cells).shots
    averaged = Ambient(found[""].light, np.zeros(found[""].light.shape))
    return replace(borders, light=averaged, indirect=found["near"].light)


def _used(recipe: Recipe, shots: Mapping[str, Exposed]) -> dict[str, Exposed]:
    """The shots of a recipe's photos."""
    names = dict.fromkeys(name for photo in recipe.photos for _, name in photo.shots)
    return {name: shots[name] for name in names}


def part_images(recipe: Recipe, averaged: Averaged, photos: Photos) -> dict[str, list[Floats]]:
    """Every picture as each part alone makes it, (rows, cols, 3) in scene units, on the quads of
    the camera that its shots are averaged for."""
    found: dict[str, list[Floats]] = {name: [] for name in recipe.pictures}
    for number in part_numbers(recipe):
        part = only_parts(recipe, {number})
        made = pictures_of(part, photos(part, averaged.shots, averaged.cells))
        for name, picture in made.items():
            image = picture.image.copy()
            image.reshape(-1, image.shape[2])[averaged.unseen] = 0.0
            found[name].append(image)
    return found


def barred_by_parts(
    pictures: Mapping[str, Picture],
    parts: Mapping[str, list[Floats]],
    cells: CellMap,
    single: Mapping[str, Floats],
) -> dict[str, Barred]:
    """Pictures whose sigma is the sensor's, with the code error that their parts show.

    parts : of `part_images`. single : what quads err by beside their cell, or half of one, as of
    `pdcd.pictures.sigma.single_of_photos`, where anything is known of it.
    """
    found, parted = {}, halve(cells)
    for name, picture in pictures.items():
        seen = average_apart(picture, parted)
        code, of_cells = _code_of_parts(seen, parts[name], cells.grid)
        more = single.get(name)
        both = code if more is None else np.hypot(code, more)
        of_quads = share_out(both, picture, seen.image, parted)
        found[name] = replace(barred(picture, of_quads, "measured"), of_cells=of_cells)
    return found


def _code_of_parts(
    seen: Picture, parts: list[Floats], grid: tuple[int, int]
) -> tuple[Errors, Errors]:
    """Code error of a picture on cells by what its parts show, (rows, cols, 3); where these are of
    half cells, that of means over whole ones comes second."""
    code = measured(seen, parts).code
    if seen.image.shape[0] == grid[0]:
        return code, code
    sigma = np.sqrt(_of_halves(seen.sigma**2) / 4.0)
    whole = Picture(_of_halves(seen.image), sigma)
    return code, measured(whole, [_of_halves(one) for one in parts]).code


def _of_halves(image: NDArray[np.floating]) -> Floats:
    """Means over the four pieces of each cell, (2 rows, 2 cols, 3) -> (rows, cols, 3)."""
    rows, cols = image.shape[0] // 2, image.shape[1] // 2
    return np.asarray(image.reshape(rows, 2, cols, 2, -1).mean(axis=(1, 3)), dtype=np.float64)


def barred_alone(recipe: Recipe, pictures: Mapping[str, Picture]) -> dict[str, Barred]:
    """Pictures of too few parts to tell what their codes err: of that their sigma has nothing."""
    coded = {p.name for p in recipe.photos if any(_is_coded(recipe, name) for _, name in p.shots)}
    found = {}
    for name, picture in pictures.items():
        rule = recipe.pictures[name]
        photos = rule.photos if isinstance(rule, Extremes) else [one for _, one in rule]
        none: Errors = np.zeros_like(picture.sigma)
        found[name] = barred(picture, none, "sensor" if coded & set(photos) else "whole")
    return found


def _is_coded(recipe: Recipe, shot: str) -> bool:
    """Whether a shot, or a sum of single ones, shows codes."""
    of = {one.name: one for one in recipe.shots}.get(shot)
    return of is None or (not of.white and recipe.programs[of.program].coded)


def with_beside_light(
    pictures: Mapping[str, Barred],
    recipe: Recipe,
    shots: Mapping[str, Exposed],
    photos: Mapping[str, Picture],
    by_codes: Mapping[str, Floats],
    learned: Learned | None,
    cells: CellMap,
    normalise: NormaliseName = "auto",
) -> dict[str, Barred]:
    """Pictures whose code error knows of light from right beside each cell, which all parts get
    wrong alike (`pdcd.pictures.beside`). What chance makes of it is no error of means over cells.

    photos : scaled ones. by_codes : of `single_of_photos`. learned : of a pilot, if any.
    """
    each = [weigh_cells(photo, shots, normalise) for photo in recipe.photos]
    weighed = [(one, weight) for one in each if (weight := beside_weight(one, cells.grid))]
    if not weighed:
        return dict(pictures)
    from pdcd.pictures.beside import beside_errors  # most photos are taken through whole cells

    single = [shots[name] for name in recipe.stack if name in shots]
    errors = beside_errors(weighed, photos, single, by_codes, learned, cells)
    found = dict(pictures)
    for name, error in errors.items():
        for one, made in _with_photo_error(found, recipe, name, error.of_quads).items():
            even = _part_of(recipe, one, name) * error.even
            found[one] = replace(made, of_cells=np.hypot(_of_cells(found[one], cells), even))
    return found


def of_pictures(
    recipe: Recipe, photos: Mapping[str, Picture], errors: Mapping[str, Floats]
) -> dict[str, Floats]:
    """Errors of photos (rows, cols, 3) -> of the pictures that are made of those, by name."""
    if not errors:
        return {}
    none = np.zeros_like(next(iter(errors.values())))
    alone = {name: errors.get(name, none) for name in photos}
    return {
        name: np.asarray(sigma_of(rule, photos, alone))
        for name, rule in recipe.pictures.items()
        if not isinstance(rule, Extremes)
    }


def with_direct_light(
    pictures: Mapping[str, Barred],
    recipe: Recipe,
    shots: Mapping[str, Shown],
    photos: Mapping[str, Picture],
    cells: CellMap,
    borders: SeenBorders | None = None,
    *,
    normalise: NormaliseName = "auto",
) -> dict[str, Barred]:
    """Pictures whose code error knows of direct light that was taken out of a photo of indirect
    light, and may be wrong, in all parts alike: along the borders of whole cells that both panels
    draw in two places (`pdcd.pictures.border_light.BorderLight.error`), or what slow panels let
    through (`UNSURE_DIRECT`).

    photos : scaled ones. borders : what a photo of this light tells, if there is one.
    """
    white, found = white_of(recipe), dict(pictures)
    for photo in recipe.photos:
        share, light = direct_taken_out(photo, recipe, shots, cells, normalise=normalise)
        if light is not None:
            error: Floats = light.error(photos[photo.name], photos[white[-1]], borders)
        elif share is not None:
            error = UNSURE_DIRECT * np.abs(share)[..., None] * photos[white[-1]].image
        else:
            continue
        for name, made in _with_photo_error(found, recipe, photo.name, error).items():
            found[name] = replace(made, of_cells=_with_means(found[name], error, cells))
    return found


def _with_photo_error(
    pictures: Mapping[str, Barred], recipe: Recipe, photo: str, error: Errors
) -> dict[str, Barred]:
    """Of the pictures those that a photo is a part of, with its error (h, w, 3) in their code
    error; what they know of means over cells is left out."""
    found = {}
    for name, picture in pictures.items():
        part = _part_of(recipe, name, photo)
        if part:
            code = np.hypot(picture.code, part * error).astype(picture.code.dtype)
            found[name] = barred(Picture(picture.image, picture.sensor), code, picture.kind)
    return found


def _part_of(recipe: Recipe, picture: str, photo: str) -> float:
    """How often a photo counts in a picture; 0 in one of extremes, of which nobody can say."""
    rule = recipe.pictures[picture]
    if isinstance(rule, Extremes):
        return 0.0
    return sum((abs(weight) for weight, one in rule if one == photo), 0.0)


def _with_means(picture: Barred, error: Floats, cells: CellMap) -> Floats | None:
    """The code error of a picture's means over cells, with that of the quads at their borders."""
    if picture.of_cells is None:
        return None
    more = cells.error_of_mean(error**2).reshape(picture.of_cells.shape)
    return np.asarray(np.hypot(picture.of_cells, more))


def with_misplaced_light(
    pictures: Mapping[str, Barred],
    recipe: Recipe,
    photos: Mapping[str, Picture],
    record: RunRecord,
    cells: CellMap,
) -> dict[str, Barred]:
    """Pictures whose code error knows of direct light that goes through wrong cells because the
    mask lies elsewhere (`pdcd.pictures.misplaced`), where they are made of a photo of indirect
    light, and a white one tells how much light there is.

    photos : scaled ones.
    """
    from pdcd.pictures.misplaced import direct_lost, lost_by_quad  # few runs have looked

    white, found, look = white_of(recipe), dict(pictures), record.panels
    windows = {shot.name: shot.window for shot in record.shots}
    for photo in recipe.photos:
        if photo.wanted.uniform != (0.0, 1.0) or not white or look is None:
            continue
        window = windows.get(photo.shots[0][1], "whole")
        lost = direct_lost(record, window)
        if lost.rms < LEAST_APART:
            continue
        all_light = photos[white[-1]].image
        if lost.mean > 1.0 - LEAST_KEPT:  # the photos do not tell any more how much there is
            error = lost.rms * look.direct * np.abs(all_light)
        else:
            share = lost_by_quad(record, window, cells)[..., None]
            direct = np.abs(all_light - photos[photo.name].image)
            error = share / np.maximum(1.0 - share, LEAST_KEPT) * direct
        found |= _with_photo_error(found, recipe, photo.name, error)
    return found


def without_blind(
    pictures: Mapping[str, Barred], record: RunRecord, cells: CellMap
) -> dict[str, Barred]:
    """Pictures of which nothing is known where quads see a place beside the mask's picture."""
    from pdcd.pictures.misplaced import beside_mask  # few runs have looked

    beside = beside_mask(record, cells)
    if beside is None or not beside.any():
        return dict(pictures)

    def blind(sigma: NDArray[np.floating]) -> NDArray[np.floating]:
        return np.where(beside[..., None], np.inf, sigma).astype(sigma.dtype)

    return {
        name: replace(picture, sigma=blind(picture.sigma), sensor=blind(picture.sensor))
        for name, picture in pictures.items()
    }
