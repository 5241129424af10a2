"""Whether the codes of both panels meet in time, from the differences between parts of a photo.

Where the mask is later or earlier than believed, each of its codes meets the one before or after it
on the projector as well. For how long a cell is then lit through its own mask differs from part to
part with the order of its codes, which is known. The scene is the same in all parts, and the chance
of codes follows another order. So direct light that gets past the codes is measured to a few
thousandths, however little is known of the scene.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdcd.arrays import Floats
from pdcd.pictures.slow_light import fit_part_differences, number_patches
from pdcd.probing.deviation import weight_s
from pdcd.verdict.evidence import Evidence, compute_rms

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


def measure_crossed_light(seen: Evidence) -> CrossedLight | None:
    """Measured from the parts of a photo of all indirect light, with a white photo; None where
    there are too few of these, or where codes meet. For the verdict on panels."""
    white = [p for p in seen.decoded.recipe.photos if p.wanted.uniform == (1.0, 1.0)]
    coded = [p for p in seen.photos if p.wanted.uniform == (0.0, 1.0)]
    if not white or not coded:
        return None
    samples = {
        name: seen.sample([(1.0, name)])
        for sign, name in coded[0].shots
        if sign > 0.0 and name in seen.decoded.crossed
    }
    weights_s = {name: weight_s(one.realised, coded[0].wanted) for name, one in samples.items()}
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
    whole = seen.sample(white[-1].shots)
    full = whole.realised.coaxial
    all_light = np.divide(whole.light, full, out=np.full(full.shape, np.nan), where=full > 0.0)
    return compute_crossed_light(light, believed, (late, early), all_light, seen.cells.grid)


def compute_crossed_light(
    light: Floats,
    believed: Floats,
    crossed: tuple[Floats, Floats],
    all_light: Floats,
    grid: tuple[int, int],
) -> CrossedLight | None:
    """The same from the light of P parts on N cells.

    light : (P, N), of parts in units of indirect light, NaN where it is not known. believed :
    (P, N), share of the direct light that is believed to get past the codes. crossed : how much
    more would if the mask were late, and if it were early. all_light : (N,).
    """
    known = np.isfinite(all_light - light.mean(axis=0))
    light, believed, all_light = light[:, known], believed[:, known], all_light[known]
    more = [one[:, known] for one in crossed]
    # The light that is believed to get past the codes is subtracted.
    direct = np.maximum(all_light - light.mean(axis=0), 0.0) / (1.0 - believed.mean(axis=0))
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
