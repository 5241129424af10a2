"""From the pictures of a run to the verdict on it: picks the numbers that `quality` judges.

All that looks at pixels looks at some `PIXELS` of them, evenly spread, and at means over cells of
those. So it takes the same few hundredths of a second for a frame of any size.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.pictures.combine import share_taken_out
from pdcd.pictures.darkroom import Decoded
from pdcd.pictures.exposed import Exposed
from pdcd.pictures.weights import divided_by_row, realised_photo
from pdcd.probing.deviation import Deviation, weight_s
from pdcd.probing.realised import Factors, signed_sum
from pdcd.probing.wanted import Full
from pdcd.protocol.result import Quality
from pdcd.recipes.parts import FLOODLIT
from pdcd.recipes.recipe import Extremes, Photo, Shot
from pdcd.runs.record import RunRecord
from pdcd.sensor.cells import CellMap
from pdcd.verdict import quality
from pdcd.verdict.answer_error import error_of, negative_light
from pdcd.verdict.blocked_left import blocked_parts, blocked_weight
from pdcd.verdict.placement import Sample, direct_shares, fingerprints, stack_fingerprints
from pdcd.verdict.quality import Finding
from pdcd.verdict.torn import torn_share

Floats = NDArray[np.float64]

LIGHT = (
    "indirect", "direct", "fraction", "diagonal", "off-diagonal", "warped", "long-range",
    "short-range", "keyed", "epipolar", "stereo",
)  # fmt: skip
"""Goals whose answer is light that paths bring, and so never below zero."""
PIXELS = 2**14
"""Pixels that are looked at, at most four times as many."""
PER_CELL = 4
"""The same for each cell, where that is more: of those that see the field."""
NO_WEIGHT = 1e-9
"""Weight that is none."""
LEAST_SHOWN = 0.05
"""Least share of the direct light that a picture of it is taken to show."""
STACK = 24
"""Photos of single codes that are looked at."""


@dataclass(frozen=True)
class Thinned:
    """Every `step`-th pixel, down and right; `cell` (n,) of each, -1 outside the field."""

    step: int
    cell: NDArray[np.int64]
    cells: int

    @classmethod
    def of(cls, cells: CellMap) -> Thinned:
        """Pixels of a frame, with the cell that the centre of each lies in."""
        (rows, cols), (height, width) = cells.grid, cells.frame
        field_share = max(float(np.mean(cells.known)), 1.0 / (height * width))
        least = max(PIXELS, PER_CELL * rows * cols / field_share)
        step = max(1, int(np.sqrt(height * width / least)))
        x, y = np.meshgrid(np.arange(step // 2, width, step), np.arange(step // 2, height, step))
        field = cells.filled.to_field(np.stack([x, y], axis=-1) + 0.5).reshape(-1, 2)
        with np.errstate(invalid="ignore"):  # beyond the horizon
            inside = np.asarray(((field >= 0.0) & (field < 1.0)).all(axis=1))
        right, down = np.floor(np.where(inside[:, None], field, 0.0) * (cols, rows)).T
        cell = np.where(inside, down * cols + right, -1.0).astype(np.int64)
        return cls(step, cell, rows * cols)

    def pick(self, image: NDArray[Any]) -> Floats:
        """(h, w, C) -> (n, C)."""
        return self._flat(image[self._each, self._each])

    def light(self, shot: Exposed) -> Floats:
        """(n, C), light of a shot."""
        return self._flat(shot.light_at(self._each, self._each))

    def variance(self, shot: Exposed) -> Floats:
        """(n, C), its variance."""
        return self._flat(shot.variance_at(self._each, self._each))

    def blown(self, shot: Exposed) -> NDArray[np.bool_]:
        """(n,), where it is saturated."""
        return shot.saturated[self._each, self._each].ravel()

    def _flat(self, some: NDArray[Any]) -> Floats:
        return np.asarray(some, dtype=np.float64).reshape(self.cell.size, -1)

    @property
    def _each(self) -> slice:
        return slice(self.step // 2, None, self.step)

    def inside(self, values: Floats) -> Floats:
        """Those of the field."""
        return values[self.cell >= 0]

    def outside(self, values: Floats) -> Floats:
        """Those beside the field."""
        return values[self.cell < 0]

    def mean(self, values: Floats, blown: NDArray[np.bool_]) -> Floats:
        """(n,) -> mean over each cell (N,) of pixels that are not `blown`, NaN where none is."""
        known = (self.cell >= 0) & ~blown
        count = np.bincount(self.cell[known], minlength=self.cells)
        total = np.bincount(self.cell[known], values[known], minlength=self.cells)
        mean: Floats = np.full(self.cells, np.nan)
        np.divide(total, count, out=mean, where=count > 0)
        return mean


def assess(record: RunRecord, decoded: Decoded, deviations: dict[str, Deviation]) -> Quality:
    """The verdict on a run that was decoded; `deviations` are those of its photos."""
    if record.cells is None:
        return quality.verdict([])
    thin = Thinned.of(record.cells)
    recipe, answer = decoded.recipe, decoded.answer
    photos = _resting(decoded)
    used = {photo.name for photo in photos}
    names = list(dict.fromkeys(_shots_of(photos, decoded)))
    shots = [shot for shot in record.shots if shot.name in set(names)]
    planned = {shot.name: shot for shot in recipe.shots}
    lit = [n for n in names if not (planned[n].primal_black or planned[n].dual_black)]
    image, sigma, sensor = (
        thin.inside(thin.pick(a)) for a in (answer.image, answer.sigma, answer.sensor)
    )
    return quality.verdict(
        itertools.chain(
            quality.saturation({n: _saturated_share(decoded, n) for n in names}),
            _light(lit, decoded, thin),
            quality.answer_of(image, sigma, sensor),
            _errors(record, decoded, image, sigma, sensor),
            _stray(names, planned, decoded, thin),
            quality.leak_left(record.leak),
            quality.torn_windows(torn_share(photos, shots)),
            _placement(photos, decoded, planned, thin, record.grid),
            quality.refreshes(shots),
            quality.deviations({n: d for n, d in deviations.items() if n in used}),
            quality.direct_weights(_direct_weights(record, photos, decoded)),
            _direct_left(record, photos, decoded, deviations, thin),
            _blocked_left(record, photos, decoded, deviations, thin),
            _direct_unseen(photos, decoded, deviations),
            _of_kind(decoded),
            _pair_sum(decoded, thin),
        )
    )


def _of_kind(decoded: Decoded) -> Iterator[Finding]:
    """What counts for slices of T, and what for pictures alone."""
    if decoded.transport is None:
        return quality.sigma_of(decoded.answer.kind)
    # Entries of T have no parts that could measure anything.
    return quality.common_light(decoded.transport.common)


def _errors(
    record: RunRecord, decoded: Decoded, image: Floats, sigma: Floats, sensor: Floats
) -> Iterator[Finding]:
    """How far the answer may be off, by its sigma and by light below zero.

    A modelled sigma counts where it speaks of one photo of far light. Of a difference it is mostly
    too large; but there light below zero shows what is wrong.
    """
    recipe = decoded.recipe
    rule = recipe.answer
    if decoded.transport is not None:
        return
    measured = decoded.answer.kind == "measured"
    alone = [] if isinstance(rule, Extremes) else [name for _, name in rule]
    far = any(p.beyond and alone == [p.name] for p in recipe.photos)
    if measured or far:
        yield from error_of(image, sigma, sensor, recipe.target.cells, measured)
    if recipe.target.goal.name in LIGHT:
        yield from negative_light(image, sensor)


def _resting(decoded: Decoded) -> list[Photo]:
    """The photos that the answer is made of."""
    rule = decoded.recipe.answer
    named = rule.photos if isinstance(rule, Extremes) else [name for _, name in rule]
    return [photo for photo in decoded.recipe.photos if photo.name in set(named)]


def _shots_of(photos: Iterable[Photo], decoded: Decoded) -> Iterator[str]:
    for photo in photos:
        for _, name in photo.shots:
            if name in decoded.shots:
                yield name
            else:
                yield from decoded.recipe.stack


def _saturated_share(decoded: Decoded, name: str) -> float:
    """Of the quads of the field in a shot."""
    field = decoded.cells.known
    saturated = int(np.count_nonzero(decoded.shots[name].saturated & field))
    return saturated / max(int(np.count_nonzero(field)), 1)


def _pair_sum(decoded: Decoded, thin: Thinned) -> Iterator[Finding]:
    """What a complement pair adds up to, against the floodlit shot."""
    flood = decoded.pictures.get(FLOODLIT)
    if flood is None:
        return
    both = decoded.pictures["white"]
    there, sums = (thin.inside(thin.pick(p.image)) for p in (flood, both))
    noise = sum(thin.inside(thin.pick(p.sensor)) ** 2 for p in (flood, both))
    yield from quality.pair_sum(sums, there, np.asarray(noise))


def _direct_weights(record: RunRecord, photos: list[Photo], decoded: Decoded) -> dict[str, float]:
    """Of photos that direct light alone scales, by one number for all cells, of those that keep a
    share of it beside other matched cells, and of an answer that is one photo of any weights: how
    far the weights of cells are off, over the wanted ones."""
    shots = {**decoded.shots, **decoded.sums}
    found = {}
    for photo in photos:
        wanted = photo.wanted.diagonal()
        power = float(np.mean(wanted**2))
        scaled = photo.wanted.by_direct and not photo.wanted.by_light
        alone = not photo.wanted.others(np.ones((1, wanted.size))).any()
        full = [w * part.matrix for w, part in photo.wanted.parts if isinstance(part, Full)]
        if full and len(photos) == 1:  # where hardly any direct light is wanted, what else is
            power, scaled = max(power, float(np.mean(full[0] ** 2))), power > 0.0
        elsewhere = photo.wanted.matched is not None
        # Cells whose partner lies beyond the field have no weight at all.
        counts = np.mean(wanted > 0.0) > 0.5 if elsewhere else scaled or alone
        if not counts or not power > 0.0:
            continue
        if divided_by_row(photo, shots, record.normalise):
            continue
        realised = realised_photo(photo.shots, shots)
        off = realised.coaxial / weight_s(realised, photo.wanted) - wanted
        found[photo.name] = float(np.sqrt(np.mean(off**2) / power))
    return found


def _direct_left(
    record: RunRecord,
    photos: list[Photo],
    decoded: Decoded,
    deviations: dict[str, Deviation],
    thin: Thinned,
) -> Iterator[Finding]:
    """What is direct light in an answer of one photo without any."""
    direct = decoded.pictures.get("direct")
    if direct is None or len(photos) != 1:
        return
    (photo,) = photos
    if photo.wanted.uniform is None or photo.wanted.uniform[0] != 0.0:
        return
    there, left = (thin.inside(thin.pick(p.image)) for p in (direct, decoded.answer))
    weight, drawn = abs(deviations[photo.name].diagonal_mean), _at_borders(decoded, photo)
    # What is left of it in this picture is missing in that of direct light.
    whole = there / max(1.0 - weight, LEAST_SHOWN)
    found = list(quality.direct_left(max(weight, drawn), whole, left, taken_out=False))
    if found and drawn == 0.0 and _taken_out(record, photo, decoded):
        found = list(quality.direct_left(weight, there, left, taken_out=True))
    yield from found


def _blocked_left(
    record: RunRecord,
    photos: list[Photo],
    decoded: Decoded,
    deviations: dict[str, Deviation],
    thin: Thinned,
) -> Iterator[Finding]:
    """What is left of light that was to be blocked by its depth, or by its row.

    Where windows cut cells, what holds between cells says nothing of direct light, which goes from
    point to point.
    """
    white, rule = decoded.pictures.get("white"), decoded.recipe.answer
    if white is None or isinstance(rule, Extremes) or "white" in [name for _, name in rule]:
        return
    if "direct" in decoded.pictures:
        return  # `_direct_left` says it, and knows what was taken out
    if any(shot.window != "whole" for shot in record.shots):
        return
    if not any(blocked_parts(photo.wanted) for photo in photos):
        return
    shots, shares = {**decoded.shots, **decoded.sums}, {name: share for share, name in rule}
    through = [
        shares[photo.name]
        * blocked_weight(
            realised_photo(photo.shots, shots), photo.wanted, deviations[photo.name].weight_s
        )
        for photo in photos
    ]
    weight = abs(sum(through))
    there, left = (thin.inside(thin.pick(p.image)) for p in (white, decoded.answer))
    # What is left of it in this picture is missing in the difference.
    whole = (there - left) / max(1.0 - weight, LEAST_SHOWN)
    yield from quality.direct_left(
        weight,
        whole,
        left,
        taken_out=False,
        light="light that was to be blocked",
        advice="look at contrast, guards and places of the panels",
    )


def _direct_unseen(
    photos: list[Photo], decoded: Decoded, deviations: dict[str, Deviation]
) -> Iterator[Finding]:
    """Direct light in an answer that is to have none in some cells, where no photo shows how much
    there is. Off the axis it comes another way."""
    rule = decoded.recipe.answer
    if not photos or isinstance(rule, Extremes) or {"white", "direct"} & decoded.pictures.keys():
        return
    shots, shares = {**decoded.shots, **decoded.sums}, {name: share for share, name in rule}
    wanted, got = np.zeros((2, photos[0].wanted.cells))
    for photo in photos:
        realised = realised_photo(photo.shots, shots)
        wanted += shares[photo.name] * photo.wanted.diagonal()
        got += shares[photo.name] * realised.coaxial / deviations[photo.name].weight_s
    none = np.abs(wanted) < NO_WEIGHT
    if none.any():
        yield from quality.direct_unseen(float(np.abs(got[none]).sum() / none.size))


def _taken_out(record: RunRecord, photo: Photo, decoded: Decoded) -> bool:
    """Whether direct light was taken out of a photo: not where there was too much of it."""
    shots = {**decoded.shots, **decoded.sums}
    share = share_taken_out(photo, decoded.recipe, shots, decoded.cells, normalise=record.normalise)
    return share is not None


def _at_borders(decoded: Decoded, photo: Photo) -> float:
    """RMS over the quads of the weight of direct light that gets through between cells.

    It lies along the borders of cells, in lines that are one quad wide or, where quads are finer
    than that, as wide as the panels are apart.
    """
    apart, cells = decoded.apart_in(photo), decoded.cells
    seen = max(int(np.count_nonzero(cells.known)), 1)
    quad = float(np.sqrt(decoded.recipe.target.cells / seen))
    lines = max(min(2.0 * quad, 1.0), apart)
    return apart / float(np.sqrt(lines))


def _light(names: Iterable[str], decoded: Decoded, thin: Thinned) -> Iterator[Finding]:
    for name in _some(list(names)):
        shot = decoded.shots[name]
        if not shot.realised.total_s > 0.0:  # meant to be dark, as one pattern of a few cells is
            continue
        light, variance = thin.light(shot), thin.variance(shot)
        yield from quality.light_of(name, thin.inside(light), thin.inside(variance))
        grey = light.mean(axis=1)
        yield from quality.outside_field(name, thin.inside(grey), thin.outside(grey))


def _some(names: list[str]) -> list[str]:
    """At most `STACK` of them, evenly spread."""
    return names[:: -(-len(names) // STACK)] if names else names


def _stray(
    names: list[str], planned: dict[str, Shot], decoded: Decoded, thin: Thinned
) -> Iterator[Finding]:
    """The worst of the shots with a black projector, against that which it belongs to."""
    found = []
    for name in names:
        base = name.partition("-black-")[0]
        if not planned[name].primal_black or planned[name].dual_black or base not in decoded.shots:
            continue
        black, lit = decoded.shots[name], decoded.shots[base]
        dark, bright = (float(thin.inside(thin.light(s)).mean()) for s in (black, lit))
        through = lit.realised.total_s
        leak = black.realised.total_s / through if through > 0.0 else 0.0
        found.append((dark / bright - leak if bright > 0.0 else 0.0, name, dark, bright, leak))
    if found:
        yield from quality.stray_light(*max(found)[1:])


def _placement(
    photos: list[Photo],
    decoded: Decoded,
    planned: dict[str, Shot],
    thin: Thinned,
    grid: tuple[int, int],
) -> Iterator[Finding]:
    """What the photos say of where the panels are."""
    told: list[Sample] = []
    prints: list[Sample] = []
    white = None
    for photo in decoded.recipe.photos:
        if any(name not in decoded.shots for _, name in photo.shots):
            continue  # a sum of single codes, which the stack tells of
        samples = _samples(photo, decoded, thin)
        if photo.wanted.uniform is not None:
            told += samples
        if any(planned[name].white for _, name in photo.shots):
            white = samples[0].light
        elif photo in photos:
            prints = prints or samples
    stack = _some([n for n in decoded.recipe.stack if n in decoded.shots])
    yield from quality.placed(
        direct_shares(told, grid),
        [f for s in prints[:1] for f in fingerprints(_against(s, white, prints), grid)],
        list(stack_fingerprints([_sample([(1.0, n)], decoded, thin) for n in stack], grid)),
    )


def _samples(photo: Photo, decoded: Decoded, thin: Thinned) -> list[Sample]:
    """What was added in a photo, and what was subtracted, each without what leaks through black."""
    sides: dict[float, list[tuple[float, str]]] = {1.0: [], -1.0: []}
    of = {name: sign for sign, name in photo.shots}
    for name, sign in of.items():
        base = of.get(name.partition("-black-")[0], sign)
        side = 1.0 if base > 0.0 else -1.0
        sides[side].append((side * sign, name))
    return [_sample(terms, decoded, thin) for terms in sides.values() if terms]


def _sample(terms: list[tuple[float, str]], decoded: Decoded, thin: Thinned) -> Sample:
    shots: list[tuple[float, Exposed]] = [(sign, decoded.shots[name]) for sign, name in terms]
    grey = sum((s * thin.light(e).mean(axis=1) for s, e in shots), np.zeros(len(thin.cell)))
    blown = np.logical_or.reduce([thin.blown(e) for _, e in shots])
    realised: Factors = signed_sum((sign, shot.realised) for sign, shot in shots)
    return Sample(thin.mean(grey, blown), realised)


def _against(sample: Sample, white: Floats | None, pair: list[Sample]) -> Sample:
    """A sample with its reference: the white photo, or all that a signed pair gathered."""
    reference = white
    if white is None and len(pair) == 2:
        reference = pair[0].light + pair[1].light
    return Sample(sample.light, sample.realised, reference)
