"""Pictures of a stream: the parts of one set are photographed over and over, the newest count.

A picture is what the newest parts make of the scene in front of the camera, decoded as a run of
these parts alone would be. The spread of the parts of the set shows the error of the codes. Each
part is kept as the few values needed for that, and only the newest is worked out anew.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from pdcd.arrays import Bools, Floats
from pdcd.panels.frames import FrameLog, Frames
from pdcd.pictures.bars import (
    add_common_errors,
    add_known_errors,
    add_part_errors,
    combine_picture_errors,
    make_pictures_with_errors,
)
from pdcd.pictures.combine import list_white_photos
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.exposed import ExposedShot
from pdcd.pictures.photos import make_corrected_photos
from pdcd.pictures.picture import Picture, PictureWithErrors, combine_photos
from pdcd.pictures.quad_samples import QuadSample
from pdcd.pictures.sigma import (
    estimate_photo_quad_shares,
    sample_part_quads,
    to_quad_errors,
)
from pdcd.pictures.to_cells import average_light, average_part, choose_part_cells
from pdcd.recipes.parts import FEWEST_PARTS, select_parts
from pdcd.recipes.recipe import Recipe, list_rule_photos
from pdcd.runs.record import ShotRecord
from pdcd.watch import Watch

_QUADS_EVERY = 16
"""Pictures after which the error of single quads by codes is estimated again: it is much work, and
alike in all parts."""
_QUADS_ALONG = 2
"""Quads that are sampled for that along a side of a cell or half of one: fewer than in a capture,
as a stream must not halt for it."""


class RollingPictures:
    """Makes pictures of the parts that were photographed last.

    The darkroom starts with one complete set of shots, none of which counts as a part of the
    stream. over : how many of the newest parts make a picture.
    """

    def __init__(self, darkroom: Darkroom, over: int, watch: Watch) -> None:
        """Raises DecodeError for a set that no pictures can be made of."""
        recipe, shots = darkroom.exposed(watch)
        self._darkroom, self._over = darkroom, over
        self._recipe = keep_answer(recipe)
        # Single photos are not taken again, nor are sums of them.
        self._kept = {name: shots[name] for name in recipe.stack if name in shots}
        planned = {shot.name for shot in recipe.shots}
        self._kept |= {name: one for name, one in shots.items() if name not in planned}
        paths = any(photo.paths for photo in recipe.photos)
        self._learned = darkroom.learned(watch) if paths else None
        self._parted = choose_part_cells(darkroom.cells)
        self._whites: dict[str, tuple[list[ExposedShot], Picture]] = {}
        """Photos of all light, with the shots they were made of: a set has each once."""
        self._newest: list[int] = []
        self._told: dict[int, Floats] = {}
        """The picture of each part on cells, for comparing parts."""
        self._of_quads: dict[str, Floats] = {}
        """Errors of single quads (`estimate_photo_quad_shares`), as estimated last."""
        self._due = 0
        """Pictures until that is estimated again."""
        self._lost: Bools | None = None
        self._picked: QuadSample | None = None

    @property
    def over(self) -> int:
        """Parts that the last picture is made of."""
        return min(self._over, len(self._newest))

    def renew(self, shot: ShotRecord, frames: Frames, log: FrameLog) -> None:
        """A shot was taken again; arguments and errors as of `Darkroom.renew`."""
        self._darkroom.renew(shot, frames, log)

    def picture(self, part: int, alive: Callable[[], None]) -> PictureWithErrors:
        """The answer from the newest parts, of which `part` was photographed just now. Raises
        DecodeError."""
        self._newest = [*(one for one in self._newest if one != part), part]
        chosen = self._newest[-self._over :]
        shots = self._shots()
        if len(chosen) >= FEWEST_PARTS:  # they tell their error themselves
            made = make_pictures_with_errors(
                self._darkroom.record, select_parts(self._recipe, chosen), shots, self._learned,
                self._darkroom.cells, alive, *self._darkroom.seen_light(),
            )  # fmt: skip
            return made[self._recipe.answer_name]
        alone = self._photos([part], shots, alive)
        of_part = select_parts(self._recipe, [part])
        picture = combine_photos(of_part, alone)[of_part.answer_name]
        self._told[part] = average_part(picture, self._parted)
        return self._with_bars(chosen, alone, shots, alive)

    def find_full_quads(self) -> Bools | None:
        """Quads that light has saturated in the newest shots of the answer, (h, w); None where
        there are none."""
        return self._darkroom.find_full_quads(self._recipe)

    def _shots(self) -> dict[str, ExposedShot]:
        """The newest of each shot."""
        names = [shot.name for shot in self._recipe.shots if shot.name not in self._kept]
        return {**self._kept, **{name: self._darkroom.renewed(name) for name in names}}

    def _photos(
        self, parts: list[int], shots: Mapping[str, ExposedShot], alive: Callable[[], None]
    ) -> dict[str, Picture]:
        """Scaled photos of these parts."""
        record, recipe = self._darkroom.record, select_parts(self._recipe, parts)
        borders, room = self._darkroom.seen_light()
        used = {
            photo.name: [shots[name] for _, name in photo.shots]
            for photo in recipe.photos
            if photo.name in list_white_photos(recipe)
        }
        same = {
            name: picture
            for name, (before, picture) in self._whites.items()
            if all(one is old for one, old in zip(used[name], before, strict=True))
        }
        made = make_corrected_photos(
            recipe, shots, self._learned, self._darkroom.cells,
            normalise=record.normalise, smooth=record.smooth, alive=alive, borders=borders,
            room=room, whites=same,
        )  # fmt: skip
        self._whites = {name: (taken, made[name]) for name, taken in used.items()}
        return made

    def _with_bars(
        self,
        chosen: list[int],
        alone: dict[str, Picture],
        shots: Mapping[str, ExposedShot],
        alive: Callable[[], None],
    ) -> PictureWithErrors:
        """The picture of the `chosen` parts, the newest of which make the photos `alone`. Its error
        comes from all known parts, where there are enough of them."""
        darkroom, name = self._darkroom, self._recipe.answer_name
        recipe, cells = select_parts(self._recipe, chosen), darkroom.cells
        scaled = alone if len(chosen) == 1 else self._photos(chosen, shots, alive)
        whole, by_codes = combine_photos(recipe, scaled), dict[str, Floats]()
        told = [self._told[part] for part in self._newest]
        if len(told) < FEWEST_PARTS:
            bars = add_known_errors(recipe, whole)
        else:
            by_codes = self._quad_errors(scaled, shots, len(chosen))
            single = combine_picture_errors(recipe, scaled, by_codes)
            bars = add_part_errors(whole, {name: told}, cells, single, len(chosen))
        borders, _ = darkroom.seen_light()
        made = add_common_errors(
            darkroom.record, recipe, shots, scaled, {name: bars[name]}, by_codes, self._learned,
            cells, borders,
        )  # fmt: skip
        return made[name]

    def _quad_errors(
        self, photos: Mapping[str, Picture], shots: Mapping[str, ExposedShot], over: int
    ) -> dict[str, Floats]:
        """As of `pdcd.pictures.sigma.estimate_photo_quad_errors`."""
        if self._due == 0:
            self._due = _QUADS_EVERY
            self._pick(shots)
            if self._picked is not None:
                parts = select_parts(self._recipe, self._newest)
                self._of_quads = estimate_photo_quad_shares(parts, shots, self._picked)
        self._due -= 1
        return {
            name: to_quad_errors(share / over, average_light(photos[name], self._parted))
            for name, share in self._of_quads.items()
        }

    def _pick(self, shots: Mapping[str, ExposedShot]) -> None:
        """Pick other quads than before where other quads are saturated."""
        used = [shots[name] for photo in self._recipe.photos for _, name in photo.shots]
        lost = np.logical_or.reduce([one.saturated for one in used])
        if self._lost is None or (lost != self._lost).any():
            self._lost = lost
            self._picked = sample_part_quads(used, self._darkroom.cells, _QUADS_ALONG)


def keep_answer(recipe: Recipe) -> Recipe:
    """The recipe of the answer alone, with the photos that it needs. A photo of indirect light also
    needs a white one, which shows how much direct light got into it."""
    rule = recipe.answer
    names = set(list_rule_photos(rule))
    photos = {photo.name: photo for photo in recipe.photos}
    white = list_white_photos(recipe)
    if white and any(photos[name].wanted.uniform == (0.0, 1.0) for name in names):
        names.add(white[-1])
    return replace(
        recipe,
        photos=tuple(photo for photo in recipe.photos if photo.name in names),
        pictures={recipe.answer_name: rule},
    )
