"""Whether the codes of both panels meet in time, from the differences between parts of a photo.

Where the mask is later or earlier than believed, each of its codes meets the one before or after it
on the projector as well. For how long a cell is then lit through its own mask differs from part to
part with the order of its codes, which is known. The scene is the same in all parts, and the chance
of codes follows another order. So direct light that gets past the codes is measured to a few
thousandths, however little is known of the scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdcd.arrays import Floats
from pdcd.pictures.slow_light import fit_part_differences, number_patches
from pdcd.probing.deviation import weight_s
from pdcd.recipes.recipe import RecipePhoto
from pdcd.verdict.evidence import Evidence, compute_rms
from pdcd.verdict.placement import LightSample

_FEWEST_PARTS = 3
"""Least number of parts for an estimate."""
_SURE = 4.0
"""Standard deviations from which light counts as getting past the codes."""


@dataclass(frozen=True)
class CrossedLight:
    """Direct light that gets past the codes: as a share of all direct light, and its RMS over that
    of the answer."""

    lost: float
    share: float


def measure_crossed_light(seen: Evidence, single: Sequence[LightSample]) -> CrossedLight | None:
    """Measured from the parts of a photo without direct light; None where there are too few of
    these, where nothing shows how much direct light there is, or where codes meet. For the verdict
    on panels. single : photos of one code each through an open mask, which stand in for a white
    photo."""
    white = [p for p in seen.decoded.recipe.photos if p.wanted.uniform == (1.0, 1.0)]
    photo = _find_photo(seen, white=bool(white))
    if photo is None:
        return None
    samples = {
        name: seen.sample([(1.0, name)])
        for sign, name in photo.shots
        if sign > 0.0 and name in seen.decoded.crossed
    }
    weights_s = {name: weight_s(one.realised, photo.wanted) for name, one in samples.items()}
    names = [name for name, weight in weights_s.items() if weight > 0.0]
    if len(names) < _FEWEST_PARTS:
        return None
    light, believed, late, early = (
        np.stack([one / weights_s[name] for name, one in zip(names, each, strict=True)])
        for each in (
            [samples[name].light for name in names],
            [samples[name].realised.coaxial for name in names],
            *([seen.decoded.crossed[name][side] for name in names] for side in (0, 1)),
        )
    )
    whole = [seen.sample(white[-1].shots)] if white else single
    by_blocks = not (white and _is_indirect(photo))
    direct = _estimate_direct_light(seen, whole, light, believed, by_blocks=by_blocks)
    if direct is None:
        return None
    return compute_crossed_light(light, believed, (late, early), direct, seen.cells.grid)


def _find_photo(seen: Evidence, *, white: bool) -> RecipePhoto | None:
    """The photo of the answer that has all indirect light, beside a white one; else the answer's
    only photo, if it has no direct light. None for other answers."""
    indirect = [photo for photo in seen.photos if _is_indirect(photo)]
    if white and indirect:
        return indirect[0]
    alone = len(seen.photos) == 1 and not seen.photos[0].wanted.diagonal().any()
    return seen.photos[0] if alone else None


def _is_indirect(photo: RecipePhoto) -> bool:
    return photo.wanted.uniform == (0.0, 1.0)


def _estimate_direct_light(
    seen: Evidence,
    whole: Sequence[LightSample],
    light: Floats,
    believed: Floats,
    *,
    by_blocks: bool,
) -> Floats | None:
    """Direct light of cells, (N,), NaN where it is not known.

    whole : photos that together have all light. light, believed : as of `compute_crossed_light`.
    by_blocks : whether it is the share of all light that blocks on the projector showed; else it is
    what `light`, all the indirect light, leaves of it.
    """
    look = seen.record.panels
    if not whole or (by_blocks and look is None):
        return None
    full = np.sum([one.realised.coaxial for one in whole], axis=0)
    total = np.sum([one.light for one in whole], axis=0)
    all_light = np.divide(total, full, out=np.full(full.shape, np.nan), where=full > 0.0)
    if by_blocks and look is not None:
        return np.asarray(look.direct * all_light)
    # The light that is believed to get past the codes is subtracted.
    direct = np.maximum(all_light - light.mean(axis=0), 0.0) / (1.0 - believed.mean(axis=0))
    return np.asarray(direct)


def compute_crossed_light(
    light: Floats,
    believed: Floats,
    crossed: tuple[Floats, Floats],
    direct: Floats,
    grid: tuple[int, int],
) -> CrossedLight | None:
    """The same from the light of P parts on N cells.

    light : (P, N), of parts in units of the light that is wanted, NaN where it is not known.
    believed : (P, N), share of the direct light that is believed to get past the codes. crossed :
    how much more would if the mask were late, and if it were early. direct : (N,).
    """
    known = np.isfinite(direct - light.mean(axis=0))
    light, believed, direct = light[:, known], believed[:, known], direct[known]
    more = [one[:, known] for one in crossed]
    light = light - believed * direct
    times, sigma = fit_part_differences(
        light, [one * direct for one in more], number_patches(grid)[known]
    )
    each = zip(times, sigma, more, strict=True)
    past = float(sum(n * one.mean() for n, error, one in each if n > _SURE * error))
    answer = compute_rms(light.mean(axis=0))
    if not past > 0.0 or not answer > 0.0:
        return None
    # This light is missing in the direct light that was computed above.
    return CrossedLight(past / (1.0 + past), past * compute_rms(direct) / answer)
