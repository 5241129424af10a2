"""The pictures of a run with their whole error, as far as it is known.

The spread of a photo's parts shows the error of its codes. That error is estimated for cells, and
spread over their quads in proportion to light. Parts are never worked out at full resolution: each
shot is averaged over cells once, and all parts are made from these few values. A part is therefore
divided by the weight of a cell, where the photo is divided by that of each quad. The difference is
the same in all parts, and only the differences between parts are used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.pictures.combine import find_removed_direct, list_white_photos
from pdcd.pictures.exposed import AmbientLight, ComputedShot, ExposedShot
from pdcd.pictures.learn import PilotFindings
from pdcd.pictures.photos import NO_SMOOTH_MODELS, fit_smooth_models, make_corrected_photos
from pdcd.pictures.picture import (
    ErrorCause,
    Errors,
    Picture,
    PictureWithErrors,
    add_code_error,
    combine_photos,
    compute_sigma,
    with_error_bars,
)
from pdcd.pictures.sigma import (
    compute_neighbour_weight,
    estimate_photo_quad_errors,
    measure_error_bars,
)
from pdcd.pictures.slow_light import UNSURE_SLOW_LIGHT, estimate_slow_light_errors
from pdcd.pictures.stop_errors import with_stop_errors
from pdcd.pictures.to_cells import (
    AveragedShots,
    are_all_quads_used,
    average_shots,
    average_unmixed,
    choose_part_cells,
    find_seen_cells,
)
from pdcd.pictures.to_quads import spread_errors
from pdcd.pictures.weights import weigh_cells
from pdcd.recipes.parts import FEWEST_PARTS, list_parts, select_parts
from pdcd.recipes.recipe import Extremes, Recipe, RecipePhoto, list_rule_photos
from pdcd.runs.record import RunRecord
from pdcd.sensor.cells import CellMap
from pdcd.words import NormaliseName

if TYPE_CHECKING:
    from pdcd.pictures.border_light import BorderLight, BorderMeasurement

_LOOKED_AT = 2**14
"""Number of pixels of a picture from which its causes of error are estimated."""
_Photos = Callable[[Recipe, Mapping[str, ExposedShot], CellMap], dict[str, Picture]]
"""Scales and corrects the photos of a recipe."""
_NOTHING_TOLD: Mapping[str, float] = MappingProxyType({})
_NOTHING_SLOW: Mapping[str, Floats] = MappingProxyType({})


def make_pictures_with_errors(
    record: RunRecord,
    recipe: Recipe,
    shots: Mapping[str, ExposedShot],
    learned: PilotFindings | None,
    cells: CellMap,
    alive: Callable[[], None],
    borders: BorderMeasurement | None = None,
    room: Floats | None = None,
    slow: Mapping[str, Floats] = _NOTHING_SLOW,
) -> dict[str, PictureWithErrors]:
    """All pictures of a recipe with their sensor and code error.

    The code error is what the spread of the parts shows, if there are enough parts, together with
    what all parts get wrong alike, as far as it is known.

    shots : of the run, and sums of them. learned : findings of its pilot, if any. borders : what a
    photo of the light along borders of cells shows, if there is one. room : (N, C), light of the
    room from a dark photo. Both are the same for all parts. slow : of each shot of codes
    (`pdcd.pictures.weights.RealisedMatrix.slow`).
    """
    averaged, told, coarse = None, NO_SMOOTH_MODELS, None
    by_codes: Mapping[str, Floats] = {}
    unsure: Mapping[str, float] = {}
    if len(list_parts(recipe)) >= FEWEST_PARTS:
        used = _used(recipe, shots)
        averaged = average_shots(used, cells)
        coarse = None if borders is None else _averaged_borders(borders, shots, cells)
        if record.smooth:
            light = averaged
            if not are_all_quads_used(cells):
                light = average_shots(used, cells, all_quads=True)
            told = fit_smooth_models(
                recipe, light.shots, learned, light.cells, seen=find_seen_cells(cells),
                normalise=record.normalise, alive=alive, room=room,
            )  # fmt: skip

    def photos(
        part: Recipe,
        shots: Mapping[str, ExposedShot],
        cells: CellMap,
        borders: BorderMeasurement | None = None,
    ) -> dict[str, Picture]:
        return make_corrected_photos(
            part, shots, learned, cells, normalise=record.normalise, smooth=record.smooth,
            alive=alive, told=told, borders=borders, room=room,
        )  # fmt: skip

    scaled = photos(recipe, shots, cells, borders)
    alive()
    whole = combine_photos(recipe, scaled)
    if averaged is not None:
        images = _part_images(recipe, averaged, partial(photos, borders=coarse))
        by_codes = estimate_photo_quad_errors(recipe, shots, scaled, cells)
        single = combine_picture_errors(recipe, scaled, by_codes)
        bars = add_part_errors(whole, images, cells, single)
        unsure = estimate_slow_light_errors(recipe, averaged, slow, room)
    else:
        bars = add_known_errors(recipe, whole)
    return add_common_errors(
        record, recipe, shots, scaled, bars, by_codes, learned, cells, borders, unsure
    )


def add_common_errors(
    record: RunRecord, recipe: Recipe, shots: Mapping[str, ExposedShot],
    scaled: Mapping[str, Picture], bars: Mapping[str, PictureWithErrors],
    by_codes: Mapping[str, Floats], learned: PilotFindings | None, cells: CellMap,
    borders: BorderMeasurement | None, unsure: Mapping[str, float] = _NOTHING_TOLD,
) -> dict[str, PictureWithErrors]:  # fmt: skip
    """Adds to the pictures `bars`, made of the photos `scaled`, the errors that all parts share,
    and finds how much of the code error each cause makes (`PictureWithErrors.causes`).

    unsure : of `estimate_slow_light_errors`; other photos have `UNSURE_SLOW_LIGHT`.
    """
    norm = record.normalise
    made = with_beside_light(bars, recipe, shots, scaled, by_codes, learned, cells, norm)
    steps: list[tuple[ErrorCause, Mapping[str, PictureWithErrors]]] = [("codes", made)]
    removed = [
        (photo, *find_removed_direct(photo, recipe, shots, cells, normalise=norm))
        for photo in recipe.photos
    ]
    strips = [one for one in removed if one[2] is not None]
    made = _with_direct_light(made, recipe, strips, scaled, cells, borders, unsure)
    steps.append(("maps", made))
    let_through = [one for one in removed if one[2] is None]
    made = _with_direct_light(made, recipe, let_through, scaled, cells, borders, unsure)
    steps.append(("timing", made))
    made = with_stop_errors(made, recipe, scaled, record, cells)
    steps.append(("stops", made))
    if record.panels is not None:
        made = _with_misplaced_light(made, recipe, scaled, record, cells)
        steps.append(("maps", made))
        made = _without_blind(made, record, cells)
    return {name: replace(one, causes=_find_causes(name, steps, one)) for name, one in made.items()}


def _find_causes(
    name: str,
    steps: Sequence[tuple[ErrorCause, Mapping[str, PictureWithErrors]]],
    whole: PictureWithErrors,
) -> dict[ErrorCause, float]:
    """Mean square of a picture's code error by cause: what each step has added to it, where the
    `whole` error is known. It is computed from some pixels, evenly spread."""
    height, width = whole.image.shape[:2]
    step = max(1, math.isqrt(height * width // _LOOKED_AT))
    some = np.s_[step // 2 :: step, step // 2 :: step]
    known = np.isfinite(whole.sigma[some])
    found: dict[ErrorCause, float] = {}
    before = 0.0
    if known.any():
        for cause, made in steps:
            square = float(np.mean(np.square(made[name].code[some][known], dtype=np.float64)))
            found[cause] = found.get(cause, 0.0) + max(square - before, 0.0)
            before = square
    return found


def _of_cells(picture: PictureWithErrors, cells: CellMap) -> Errors:
    """The code error of means over cells, (rows, cols, C)."""
    if picture.of_cells is not None:
        return picture.of_cells
    return cells.mean(picture.code).reshape(*cells.grid, -1)


def _averaged_borders(
    borders: BorderMeasurement, shots: Mapping[str, ExposedShot], cells: CellMap
) -> BorderMeasurement:
    """A photo of the light along borders, averaged over cells as the shots are."""
    alike = next(iter(shots.values()))
    light, dark = borders.light, np.zeros(cells.frame, np.bool_)
    photo = ComputedShot(light.light, light.variance, dark, alike.realised, {})
    of_near = ComputedShot(borders.indirect, light.variance, dark, alike.realised, {})
    found = average_shots({"": photo, "near": of_near}, cells).shots
    averaged = AmbientLight(found[""].light, np.zeros(found[""].light.shape))
    return replace(borders, light=averaged, indirect=found["near"].light)


def _used(recipe: Recipe, shots: Mapping[str, ExposedShot]) -> dict[str, ExposedShot]:
    """The shots of a recipe's photos."""
    names = dict.fromkeys(name for photo in recipe.photos for _, name in photo.shots)
    return {name: shots[name] for name in names}


def _part_images(
    recipe: Recipe, averaged: AveragedShots, photos: _Photos
) -> dict[str, list[Floats]]:
    """Every picture as each part alone makes it, (rows, cols, C) in scene units, at the resolution
    of the averaged shots."""
    found: dict[str, list[Floats]] = {name: [] for name in recipe.pictures}
    for number in list_parts(recipe):
        part = select_parts(recipe, {number})
        made = combine_photos(part, photos(part, averaged.shots, averaged.cells))
        for name, picture in made.items():
            image = picture.image.copy()
            image.reshape(-1, image.shape[2])[averaged.unseen] = 0.0
            found[name].append(image)
    return found


def add_part_errors(
    pictures: Mapping[str, Picture],
    parts: Mapping[str, list[Floats]],
    cells: CellMap,
    single: Mapping[str, Floats],
    over: int | None = None,
) -> dict[str, PictureWithErrors]:
    """Completes pictures whose sigma is the sensor's by the code error that their parts show.

    parts : of `_part_images`. over : how many of them the pictures are made of, None for all.
    single : errors of single quads (`pdcd.pictures.sigma.estimate_photo_quad_errors`), where known.
    """
    found, parted = {}, choose_part_cells(cells)
    for name, picture in pictures.items():
        seen = average_unmixed(picture, parted)
        code, of_cells = _code_of_parts(seen, parts[name], cells.grid, over)
        more = single.get(name)
        both = code if more is None else np.hypot(code, more)
        of_quads = spread_errors(both, picture, seen.image, parted)
        found[name] = replace(with_error_bars(picture, of_quads, "measured"), of_cells=of_cells)
    return found


def _code_of_parts(
    seen: Picture, parts: list[Floats], grid: tuple[int, int], over: int | None
) -> tuple[Errors, Errors]:
    """Code error of a picture on cells, (rows, cols, C), from its parts, and that of means over
    whole cells. They differ only where the parts are of half cells."""
    code = measure_error_bars(seen, parts, over).code
    if seen.image.shape[0] == grid[0]:
        return code, code
    sigma = np.sqrt(_of_halves(seen.sigma**2) / 4.0)
    whole = Picture(_of_halves(seen.image), sigma)
    return code, measure_error_bars(whole, [_of_halves(one) for one in parts], over).code


def _of_halves(image: NDArray[np.floating]) -> Floats:
    """Means over the four pieces of each cell, (2 rows, 2 cols, C) -> (rows, cols, C)."""
    rows, cols = image.shape[0] // 2, image.shape[1] // 2
    return np.asarray(image.reshape(rows, 2, cols, 2, -1).mean(axis=(1, 3)), dtype=np.float64)


def add_known_errors(
    recipe: Recipe, pictures: Mapping[str, Picture]
) -> dict[str, PictureWithErrors]:
    """Pictures with too few parts to estimate the code error, which their sigma leaves out."""
    coded = {p.name for p in recipe.photos if any(_is_coded(recipe, name) for _, name in p.shots)}
    found = {}
    for name, picture in pictures.items():
        photos = list_rule_photos(recipe.pictures[name])
        none: Errors = np.zeros_like(picture.sigma)
        found[name] = with_error_bars(picture, none, "sensor" if coded & set(photos) else "whole")
    return found


def _is_coded(recipe: Recipe, shot: str) -> bool:
    """Whether a shot, or a sum of single ones, shows codes."""
    of = {one.name: one for one in recipe.shots}.get(shot)
    return of is None or (not of.white and recipe.programs[of.program].coded)


def with_beside_light(
    pictures: Mapping[str, PictureWithErrors],
    recipe: Recipe,
    shots: Mapping[str, ExposedShot],
    photos: Mapping[str, Picture],
    by_codes: Mapping[str, Floats],
    learned: PilotFindings | None,
    cells: CellMap,
    normalise: NormaliseName = "auto",
) -> dict[str, PictureWithErrors]:
    """Adds to the code error what light from right beside each cell makes wrong in all parts alike
    (`pdcd.pictures.beside`). Its random part does not count in the error of means over cells.

    photos : scaled ones. by_codes : of `estimate_photo_quad_errors`. learned : of a pilot, if any.
    """
    each = [weigh_cells(photo, shots, normalise) for photo in recipe.photos]
    weighed = [
        (one, weight) for one in each if (weight := compute_neighbour_weight(one, cells.grid))
    ]
    if not weighed:
        return dict(pictures)
    from pdcd.pictures.beside import (
        estimate_neighbour_errors,  # most photos are taken through whole cells
    )

    single = [shots[name] for name in recipe.stack if name in shots]
    errors = estimate_neighbour_errors(weighed, photos, single, by_codes, learned, cells)
    found = dict(pictures)
    for name, error in errors.items():
        for one, made in _with_photo_error(found, recipe, name, error.of_quads).items():
            even = _part_of(recipe, one, name) * error.even
            found[one] = replace(made, of_cells=np.hypot(_of_cells(found[one], cells), even))
    return found


def combine_picture_errors(
    recipe: Recipe, photos: Mapping[str, Picture], errors: Mapping[str, Floats]
) -> dict[str, Floats]:
    """Errors of photos, (rows, cols, C) -> of the pictures made of these photos, by name."""
    if not errors:
        return {}
    none = np.zeros_like(next(iter(errors.values())))
    alone = {name: errors.get(name, none) for name in photos}
    return {
        name: np.asarray(compute_sigma(rule, photos, alone))
        for name, rule in recipe.pictures.items()
        if not isinstance(rule, Extremes)
    }


def _with_direct_light(
    pictures: Mapping[str, PictureWithErrors],
    recipe: Recipe,
    removed: Sequence[tuple[RecipePhoto, Floats | None, BorderLight | None]],
    photos: Mapping[str, Picture],
    cells: CellMap,
    borders: BorderMeasurement | None,
    unsure: Mapping[str, float],
) -> dict[str, PictureWithErrors]:
    """Adds to the code error the uncertainty of the direct light that was removed from photos of
    indirect light, which is the same in all parts. This is light along borders of whole cells that
    the panels draw in two places (`pdcd.pictures.border_light.BorderLight.error`), or light that
    slow panels let through.

    removed : photos, each with the result of `find_removed_direct`. photos : scaled ones.
    borders : what a photo of the light along borders shows, if there is one. unsure : of
    `estimate_slow_light_errors`.
    """
    white, found = list_white_photos(recipe), dict(pictures)
    for photo, share, light in removed:
        if light is not None:
            error: Floats = light.error(photos[photo.name], photos[white[-1]], borders)
        elif share is not None:
            off = unsure.get(photo.name, UNSURE_SLOW_LIGHT)
            error = off * np.abs(share)[..., None] * photos[white[-1]].image
        else:
            continue
        for name, made in _with_photo_error(found, recipe, photo.name, error).items():
            found[name] = replace(made, of_cells=_with_means(found[name], error, cells))
    return found


def _with_photo_error(
    pictures: Mapping[str, PictureWithErrors], recipe: Recipe, photo: str, error: Errors
) -> dict[str, PictureWithErrors]:
    """The pictures that a photo is a part of, with its error (h, w, C) added to their code error.
    Their errors of means over cells are dropped."""
    found = {}
    for name, picture in pictures.items():
        part = _part_of(recipe, name, photo)
        if part:
            found[name] = add_code_error(picture, part * error)
    return found


def _part_of(recipe: Recipe, picture: str, photo: str) -> float:
    """Total weight of a photo in a picture; 0 in one of extremes, where it is not known."""
    rule = recipe.pictures[picture]
    if isinstance(rule, Extremes):
        return 0.0
    return sum((abs(weight) for weight, one in rule if one == photo), 0.0)


def _with_means(picture: PictureWithErrors, error: Floats, cells: CellMap) -> Floats | None:
    """The code error of a picture's means over cells, with an added error of its quads."""
    if picture.of_cells is None:
        return None
    more = cells.error_of_mean(error**2).reshape(picture.of_cells.shape)
    return np.asarray(np.hypot(picture.of_cells, more))


def _with_misplaced_light(
    pictures: Mapping[str, PictureWithErrors],
    recipe: Recipe,
    photos: Mapping[str, Picture],
    record: RunRecord,
    cells: CellMap,
) -> dict[str, PictureWithErrors]:
    """Adds to the code error the direct light that goes through wrong cells because the mask lies
    elsewhere (`pdcd.pictures.lost_direct`). This concerns pictures made of a photo of indirect
    light, where a white photo shows how much light there is.

    photos : scaled ones.
    """
    from pdcd.pictures.lost_direct import estimate_misplaced_light  # few runs have looked

    white, found = list_white_photos(recipe), dict(pictures)
    windows = {shot.name: shot.window for shot in record.shots}
    for photo in recipe.photos:
        if photo.wanted.uniform == (0.0, 1.0) and white:
            window = windows.get(photo.shots[0][1], "whole")
            images = photos[white[-1]].image, photos[photo.name].image
            error = estimate_misplaced_light(record, window, cells, *images)
            if error is not None:
                found |= _with_photo_error(found, recipe, photo.name, error)
    return found


def _without_blind(
    pictures: Mapping[str, PictureWithErrors], record: RunRecord, cells: CellMap
) -> dict[str, PictureWithErrors]:
    """Pictures whose error is infinite where quads see a place beside the mask's picture."""
    from pdcd.pictures.lost_direct import find_quads_beside_mask  # few runs have looked

    beside = find_quads_beside_mask(record, cells)
    if beside is None or not beside.any():
        return dict(pictures)

    def blind(sigma: NDArray[np.floating]) -> NDArray[np.floating]:
        return np.where(beside[..., None], np.inf, sigma).astype(sigma.dtype)

    return {
        name: replace(picture, sigma=blind(picture.sigma), sensor=blind(picture.sensor))
        for name, picture in pictures.items()
    }
