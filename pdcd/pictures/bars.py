"""The pictures of a run with their whole error, as far as it is known: of codes by what parts show.

The error of the codes is told of cells, and lies on their quads as light does. Nothing finer is
asked of a part of a photo: its shots are averaged over cells first, once each, and all parts are
worked out on these few values. A part then has the weight of a cell where the photo has that of
each quad; it is the same in all parts, whose differences alone are looked at.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
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
from pdcd.pictures.stop_errors import with_stop_errors
from pdcd.pictures.to_cells import (
    AveragedShots,
    are_all_quads_used,
    average_image,
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
"""Pixels of a picture by which its causes of error are told apart."""
_Photos = Callable[[Recipe, Mapping[str, ExposedShot], CellMap], dict[str, Picture]]
"""Scales and corrects the photos of a recipe."""
_UNSURE_DIRECT = 0.5
"""Share of the direct light that slow panels let through by which the realised matrix may be off:
0.3 of 0.6 % before a stranger's fold, where rows are set last."""


def make_pictures_with_errors(
    record: RunRecord,
    recipe: Recipe,
    shots: Mapping[str, ExposedShot],
    learned: PilotFindings | None,
    cells: CellMap,
    alive: Callable[[], None],
    borders: BorderMeasurement | None = None,
    room: Floats | None = None,
) -> dict[str, PictureWithErrors]:
    """All pictures of a recipe with sensor and code error: of what the parts show, if there are
    enough; and with what all parts get wrong alike, as far as it is known.

    shots : of the run, and sums of them. learned : of its pilot, if any. borders : what a photo of
    the light along borders of cells tells, if there is one; all parts have the same of it, and of
    the light of the `room`, (N, C), that a dark photo tells.
    """
    averaged, told, coarse = None, NO_SMOOTH_MODELS, None
    by_codes: Mapping[str, Floats] = {}
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
    else:
        bars = add_known_errors(recipe, whole)
    return add_common_errors(record, recipe, shots, scaled, bars, by_codes, learned, cells, borders)


def add_common_errors(
    record: RunRecord, recipe: Recipe, shots: Mapping[str, ExposedShot],
    scaled: Mapping[str, Picture], bars: Mapping[str, PictureWithErrors],
    by_codes: Mapping[str, Floats], learned: PilotFindings | None, cells: CellMap,
    borders: BorderMeasurement | None,
) -> dict[str, PictureWithErrors]:  # fmt: skip
    """Pictures, `bars` of photos `scaled`, that know what all parts get wrong alike, too, and what
    of their code error comes from where (`PictureWithErrors.causes`)."""
    norm = record.normalise
    made = with_beside_light(bars, recipe, shots, scaled, by_codes, learned, cells, norm)
    steps: list[tuple[ErrorCause, Mapping[str, PictureWithErrors]]] = [("codes", made)]
    removed = [
        (photo, *find_removed_direct(photo, recipe, shots, cells, normalise=norm))
        for photo in recipe.photos
    ]
    strips = [one for one in removed if one[2] is not None]
    made = _with_direct_light(made, recipe, strips, scaled, cells, borders)
    steps.append(("maps", made))
    slow = [one for one in removed if one[2] is None]
    made = _with_direct_light(made, recipe, slow, scaled, cells, borders)
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
    """Mean square of a picture's code error by cause, where the `whole` error is known: what each
    of the steps that made it has added. Some pixels, evenly spread, are looked at."""
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
    return average_image(picture.code, cells).reshape(*cells.grid, -1)


def _averaged_borders(
    borders: BorderMeasurement, shots: Mapping[str, ExposedShot], cells: CellMap
) -> BorderMeasurement:
    """What a photo of the light along borders tells, as the averaged shots have it."""
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
    """Every picture as each part alone makes it, (rows, cols, C) in scene units, on the quads of
    the camera that its shots are averaged for."""
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
    """Pictures whose sigma is the sensor's, with the code error that their parts show.

    parts : of `_part_images`, of which the pictures are of `over`, None for all. single : of
    `pdcd.pictures.sigma.estimate_photo_quad_errors`, where anything is known of it.
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
    """Code error of a picture on cells by what its parts show, (rows, cols, C); where these are of
    half cells, that of means over whole ones comes second."""
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
    """Pictures of too few parts to tell what their codes err: of that their sigma has nothing."""
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
    """Pictures whose code error knows of light from right beside each cell, which all parts get
    wrong alike (`pdcd.pictures.beside`). What chance makes of it is no error of means over cells.

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
    """Errors of photos (rows, cols, C) -> of the pictures that are made of those, by name."""
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
) -> dict[str, PictureWithErrors]:
    """Pictures whose code error knows of direct light that was taken out of a photo of indirect
    light, and may be wrong, in all parts alike: along the borders of whole cells that both panels
    draw in two places (`pdcd.pictures.border_light.BorderLight.error`), or what slow panels let
    through (`_UNSURE_DIRECT`).

    removed : of photos, with what `find_removed_direct` says of each. photos : scaled ones.
    borders : what a photo of this light tells, if there is one.
    """
    white, found = list_white_photos(recipe), dict(pictures)
    for photo, share, light in removed:
        if light is not None:
            error: Floats = light.error(photos[photo.name], photos[white[-1]], borders)
        elif share is not None:
            error = _UNSURE_DIRECT * np.abs(share)[..., None] * photos[white[-1]].image
        else:
            continue
        for name, made in _with_photo_error(found, recipe, photo.name, error).items():
            found[name] = replace(made, of_cells=_with_means(found[name], error, cells))
    return found


def _with_photo_error(
    pictures: Mapping[str, PictureWithErrors], recipe: Recipe, photo: str, error: Errors
) -> dict[str, PictureWithErrors]:
    """Of the pictures those that a photo is a part of, with its error (h, w, C) in their code
    error; what they know of means over cells is left out."""
    found = {}
    for name, picture in pictures.items():
        part = _part_of(recipe, name, photo)
        if part:
            found[name] = add_code_error(picture, part * error)
    return found


def _part_of(recipe: Recipe, picture: str, photo: str) -> float:
    """How often a photo counts in a picture; 0 in one of extremes, of which nobody can say."""
    rule = recipe.pictures[picture]
    if isinstance(rule, Extremes):
        return 0.0
    return sum((abs(weight) for weight, one in rule if one == photo), 0.0)


def _with_means(picture: PictureWithErrors, error: Floats, cells: CellMap) -> Floats | None:
    """The code error of a picture's means over cells, with that of the quads at their borders."""
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
    """Pictures whose code error knows of direct light that goes through wrong cells because the
    mask lies elsewhere (`pdcd.pictures.lost_direct`), where they are made of a photo of indirect
    light, and a white one tells how much light there is.

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
    """Pictures of which nothing is known where quads see a place beside the mask's picture."""
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
