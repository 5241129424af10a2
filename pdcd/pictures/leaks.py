"""The error of an answer by the light that got in while panels were black, from dark photos.

A photo is ``sum over time of m(t) (T i(t) + a)``. Ambient light `a`, and the light of a black
projector, get in for as long as the mask is open (limitations L2, L3). What a closed mask lets
through gets in for as long as the projector is lit (L1). A dark photo shows both for a
known time, so that their part in any photo follows from the times for which its panels were open
and lit. These are upper bounds: what leaks from cells that are lit anyway is no error.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pdcd.arrays import Bools, Floats
from pdcd.pictures.exposed import ExposedShot
from pdcd.pictures.to_cells import CellLight, average_shot
from pdcd.pictures.weights import RealisedShot, weigh_cells
from pdcd.recipes.recipe import Extremes, Recipe, RecipePhoto, Rule, list_rule_photos
from pdcd.sensor.cells import CellMap
from pdcd.words import NormaliseName

_SURE = 5.0
"""Mean of a leak over its standard error from which it counts as real, and not as noise."""


@dataclass(frozen=True)
class DarkPhotoLight:
    """Light of cells in scene units, (N, C), and its variance."""

    light: Floats
    variance: Floats

    @classmethod
    def of(cls, found: CellLight) -> DarkPhotoLight:
        """Of the means of a dark photo."""
        return cls(found.light, found.error**2)

    def less(self, other: DarkPhotoLight) -> DarkPhotoLight:
        """The difference to another."""
        return DarkPhotoLight(self.light - other.light, self.variance + other.variance)

    @property
    def seen(self) -> bool:
        """Whether there is light beyond the sensor's noise."""
        known = np.isfinite(self.variance)
        light, variance = self.light[known], self.variance[known]
        return bool(abs(light.sum()) > _SURE * np.sqrt(variance.sum()))


@dataclass(frozen=True)
class LeakAnswer:
    """The answer on cells, leaks included, and its variance by the sensor, (N, C) each; and the
    factors, (N, 1) each, by which a leak through an open mask and one through a closed mask enter
    it. Only `seen` cells count. gross : (2, N, 1), the first factor of the photos that are added
    and of those that are subtracted, separately."""

    image: Floats
    variance: Floats
    open: Floats
    closed: Floats
    seen: Bools
    gross: Floats

    def ambient(self, dark: DarkPhotoLight) -> float:
        """RMS error by the light of an open mask in front of a black projector, over the RMS of the
        answer without it; 0 where it does not stand above the noise."""
        return self._error([(self.open, dark)])

    def changed(self, before: DarkPhotoLight, after: DarkPhotoLight) -> float:
        """The same by a change of such light, at most: if all photos that are added got the light
        `before`, and all that are subtracted the light `after`, or the other way round."""
        most, between = self.gross.max(axis=0), (before.less(after), after.less(before))
        return max(self._error([(most, dark)]) for dark in between)

    def mask(self, dark: DarkPhotoLight) -> float:
        """The same by the light of a closed mask in front of a lit projector."""
        return self._error([(self.closed, dark)])

    def both(self, ambient: DarkPhotoLight, mask: DarkPhotoLight) -> float:
        """The same by the two together, of which each counts where it stands above the noise."""
        parts = [(self.open, ambient), (self.closed, mask)]
        return self._error([part for part in parts if self._error([part])])

    def most(self, dark: DarkPhotoLight) -> float:
        """The same by a dark photo whose light may have come through either panel: at most."""
        return self._error([(np.maximum(abs(self.open), abs(self.closed)), dark)])

    def floor(self, *darks: DarkPhotoLight) -> float:
        """The least error by such dark photos, through any panel, that stands above the noise."""
        share = np.maximum(abs(self.open), abs(self.closed))
        return self._figures([(share, dark) for dark in darks])[1]

    def rms(self, dark: DarkPhotoLight) -> float:
        """RMS of the answer without the leak of an open mask, and without the sensor's noise."""
        leak = (self.open * dark.light)[self.seen]
        noise = float(np.mean(self.variance[self.seen] + (self.open**2 * dark.variance)[self.seen]))
        square = float(np.mean((self.image[self.seen] - leak) ** 2)) - noise
        return float(np.sqrt(max(square, _SURE * noise / np.sqrt(leak.size))))

    def _error(self, parts: list[tuple[Floats, DarkPhotoLight]]) -> float:
        if not parts:
            return 0.0
        error, floor, mean = self._figures(parts)
        return error if mean > floor else 0.0

    def _figures(self, parts: list[tuple[Floats, DarkPhotoLight]]) -> tuple[float, float, float]:
        """RMS of a leak, the mean from which it counts as real, and its mean: each over the RMS of
        the answer without it.

        The square of the sensor's noise, which does not vanish in a mean, is subtracted.
        """
        zero = np.zeros(())
        leak = sum((share * dark.light for share, dark in parts), zero)[self.seen]
        variance = sum((share**2 * dark.variance for share, dark in parts), zero)[self.seen]
        noise = float(np.mean(self.variance[self.seen] + variance))
        true = float(np.mean((self.image[self.seen] - leak) ** 2)) - noise
        least = max(noise / leak.size, np.finfo(np.float64).tiny)
        rms = np.sqrt(max(true, least))
        power = max(float(np.mean(leak**2) - np.mean(variance)), 0.0)
        sure = _SURE * np.sqrt(variance.sum()) / leak.size
        return float(np.sqrt(power) / rms), float(sure / rms), float(abs(leak.mean()) / rms)


@dataclass(frozen=True, eq=False)
class ShotMeans:
    """The shots of an answer on cells.

    panels : what the panels did in them. light : what their cells got. seen : (N,), cells that any
    quad sees.
    """

    panels: Mapping[str, RealisedShot]
    light: Mapping[str, CellLight]
    seen: Bools

    @classmethod
    def of(cls, recipe: Recipe, shots: Mapping[str, ExposedShot], cells: CellMap) -> ShotMeans:
        """Means of the shots that `make_leak_answers` needs."""
        used = _answer_photos(recipe)
        photos = [photo for photo in recipe.photos if photo.name in used]
        names = dict.fromkeys(name for photo in photos for _, name in photo.shots)
        light = {name: average_shot(shots[name], cells) for name in names}
        return cls(shots, light, cells.seen())


def make_leak_answers(
    recipe: Recipe, means: ShotMeans, lit_s: Mapping[str, float], *, normalise: NormaliseName
) -> list[LeakAnswer]:
    """The answer of a recipe without corrections, on cells. If it is made of the largest and
    smallest of photos, whose difference a leak hardly changes, the other pictures follow.

    lit_s : for each shot, how long an average cell of the projector was lit; 0 for the others.
    Raises DecodeError when a photo gathered no light at all.
    """
    photos = {photo.name: photo for photo in recipe.photos}
    found = {
        name: _of_photo(photos[name], means, lit_s, normalise) for name in _answer_photos(recipe)
    }
    return [_of_rule(rule, found) for rule in _answer_rules(recipe)]


def predict_photo_variances(
    recipe: Recipe, means: ShotMeans, dark: DarkPhotoLight, *, normalise: NormaliseName
) -> dict[str, float]:
    """Variance that each photo of a recipe brings into the answer once black exposures have removed
    the ambient light of `dark`, over the square of the answer's RMS. Only for answers that are sums
    of photos. Raises DecodeError when a photo gathered no light at all.

    A black exposure is as long as the shot that it belongs to, and holds its ambient light: the
    noise of that part of the light counts twice. What a closed mask lets through is too little to
    matter.
    """
    if isinstance(recipe.answer, Extremes):
        return {}
    answer = make_leak_answers(recipe, means, {}, normalise=normalise)[0]
    photos, found = {photo.name: photo for photo in recipe.photos}, {}
    seen = means.seen
    for share, name in recipe.answer:
        one = _of_photo(photos[name], means, {}, normalise)
        leak, light = (one.open * dark.light)[seen].sum(), one.image[seen].sum()
        again = float(np.clip(leak / light, 0.0, 1.0)) if light else 0.0
        found[name] = (1.0 + again) * share**2 * float(one.variance[seen].mean())
    square = answer.rms(dark) ** 2
    return {name: variance / square for name, variance in found.items()} if square else {}


def _answer_rules(recipe: Recipe) -> list[Rule]:
    """Rules of the pictures whose leaks are computed."""
    extremes = isinstance(recipe.answer, Extremes)
    return list(recipe.pictures.values()) if extremes else [recipe.answer]


def _answer_photos(recipe: Recipe) -> dict[str, None]:
    """Names of the photos that these are made of."""
    return dict.fromkeys(name for rule in _answer_rules(recipe) for name in list_rule_photos(rule))


def _of_photo(
    photo: RecipePhoto, means: ShotMeans, lit_s: Mapping[str, float], normalise: NormaliseName
) -> LeakAnswer:
    weights = weigh_cells(photo, means.panels, normalise)
    weight = weights.cells_s.reshape(-1, 1)
    light, noise, dark_s = np.zeros(()), np.zeros(()), 0.0
    gross = np.zeros((2, means.seen.size, 1))
    for sign, name in photo.shots:
        gross[int(sign < 0.0)] += abs(sign) * means.panels[name].realised.open_s[:, None] / weight
        light = light + sign * means.light[name].light
        noise = noise + means.light[name].error ** 2
        lit = float(means.panels[name].realised.coaxial.mean())
        dark_s += sign * max(0.0, lit_s.get(name, 0.0) - lit)
    opened = weights.realised.open_s.reshape(-1, 1)
    closed = np.full_like(opened, dark_s)
    return LeakAnswer(
        light / weight, noise / weight**2, opened / weight, closed / weight, means.seen, gross
    )


def _of_rule(rule: Rule, photos: Mapping[str, LeakAnswer]) -> LeakAnswer:
    taken = [photos[name] for name in list_rule_photos(rule)]
    seen = taken[0].seen
    if isinstance(rule, Extremes):
        images = np.stack([photo.image for photo in taken])
        share, squares = rule.largest + rule.smallest, rule.largest**2 + rule.smallest**2
        return LeakAnswer(
            rule.largest * images.max(axis=0) + rule.smallest * images.min(axis=0),
            squares * np.mean([photo.variance for photo in taken], axis=0),
            share * np.mean([photo.open for photo in taken], axis=0),
            share * np.mean([photo.closed for photo in taken], axis=0),
            seen,
            abs(share) * np.mean([photo.gross for photo in taken], axis=0),
        )
    shares = np.array([share for share, _ in rule])
    against = [share < 0.0 for share, _ in rule]
    turned = [
        photo.gross[::-1] if other else photo.gross
        for photo, other in zip(taken, against, strict=True)
    ]
    return LeakAnswer(
        np.tensordot(shares, [photo.image for photo in taken], 1),
        np.tensordot(shares**2, [photo.variance for photo in taken], 1),
        np.tensordot(shares, [photo.open for photo in taken], 1),
        np.tensordot(shares, [photo.closed for photo in taken], 1),
        seen,
        np.tensordot(abs(shares), turned, 1),
    )
