"""The verdict on where panels and camera are: from light that follows codes, and from photos of
blocks where these were taken.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from pdcd.arrays import Floats
from pdcd.recipes.parts import LATE
from pdcd.recipes.recipe import RecipePhoto
from pdcd.verdict.causes import Cause, VerdictFinding, judge
from pdcd.verdict.evidence import Evidence, list_evenly
from pdcd.verdict.meeting import judge_meeting, list_single_codes
from pdcd.verdict.placement import (
    LightSample,
    PlacementFit,
    fit_fingerprints,
    fit_stack_fingerprints,
    map_direct_shares,
)

_CHANCE = 6.0
"""Fit over chance from which light counts as following codes: misplaced panels have 14 to 54,
others up to 3."""
_TOO_MUCH = 1.5
"""Share of light that follows codes above which the fit is wrong, as there is not so much. It comes
out where codes hardly differ from cell to cell, as at the borders of matched ones."""


def judge_panels(seen: Evidence) -> Iterator[VerdictFinding]:
    """All findings on where panels and camera are."""
    yield from _judge_light(seen)
    if seen.record.panels is not None:
        from pdcd.verdict.misplaced import judge_blocks  # few runs have looked

        yield from judge_blocks(seen, seen.record.panels)


def _judge_light(seen: Evidence) -> Iterator[VerdictFinding]:
    """Findings from the light of the photos on where the panels are."""
    record, shots = seen.record, seen.decoded.shots
    told: list[LightSample] = []
    prints: list[LightSample] = []
    white = None
    for photo in seen.decoded.recipe.photos:
        if any(name not in shots for _, name in photo.shots):
            continue  # a sum of single codes; the stack is used instead
        samples = _list_samples(photo, seen)
        if photo.wanted.uniform is not None:
            told += samples
        if any(seen.planned[name].white for _, name in photo.shots):
            white = samples[0].light
        elif photo in seen.photos:
            prints = prints or samples
    fits: Iterable[PlacementFit] = ()
    if prints:
        if white is None and len(prints) == 2:  # all that a signed pair gathered
            white = prints[0].light + prints[1].light
        sample = LightSample(prints[0].light, prints[0].realised, white)
        fits = fit_fingerprints(sample, record.grid)
    stack = list_evenly([n for n in seen.decoded.recipe.stack if n in shots])
    single = list_single_codes(seen, stack)
    shares = map_direct_shares(told, record.grid)
    found = judge_panel_places(
        shares[np.isfinite(shares)],
        fits,
        list(fit_stack_fingerprints(single, record.grid)),
        upright=record.panels is not None and record.panels.upright,
    )
    # A panel that lies in another way leaves no direct light at its codes, either.
    if not any(one.cause is Cause.WRONG_WAY for one in found):
        found = judge_meeting(seen, shares, single, found)
    yield from found


def _list_samples(photo: RecipePhoto, seen: Evidence) -> list[LightSample]:
    """What a photo adds, and what it subtracts, each without leaks through black."""
    sides: dict[float, list[tuple[float, str]]] = {1.0: [], -1.0: []}
    of = {name: sign for sign, name in photo.shots}
    for name, sign in of.items():
        lit, black, _ = name.partition("-black-")
        base = of.get(lit + LATE if black and name.endswith(LATE) else lit, sign)
        side = 1.0 if base > 0.0 else -1.0
        sides[side].append((side * sign, name))
    return [seen.sample(terms) for terms in sides.values() if terms]


def judge_panel_places(
    shares: Floats,
    fits: Iterable[PlacementFit],
    stack: Iterable[PlacementFit],
    *,
    upright: bool = False,
) -> list[VerdictFinding]:
    """Whether panels are where they are believed to be (`pdcd.verdict.placement`).

    shares : of direct light. fits, stack : of one photo and of single codes.

    Scenes can look like a misplaced panel: two pages of a book send each other light from mirrored
    places. So a fit of one photo is ignored if more direct light comes from where it should than by
    the codes of the panel that lies in another way. If blocks showed the panels `upright`, only a
    fit of inverse codes at the believed place counts.
    """
    in_place = float(np.median(shares)) if shares.size else 0.0
    strange = [fit for fit in fits if abs(fit.share) > in_place]
    stack = list(stack)
    wrong = [
        fit
        for fit in (*strange, *stack)
        if Cause.WRONG_WAY.value.bad <= abs(fit.share) <= _TOO_MUCH
        and abs(fit.over_chance) >= _CHANCE
        and (fit.share < 0.0 if fit.name == "as believed" else not upright)
    ]
    if wrong:
        worst = max(wrong, key=lambda fit: abs(fit.over_chance))
        how = [] if worst.name == "as believed" else [worst.name]
        how += ["inverted"] if worst.share < 0.0 else []
        return judge(Cause.WRONG_WAY, abs(worst.share), how=" and ".join(how))
    own = [fit.share for fit in stack if fit.name == "as believed"]
    if own and not shares.size:  # single codes went through an open mask, which blocks nothing
        shares = np.array(own)
    if not shares.size:
        return []
    found = judge(Cause.LESS_THAN_NO_DIRECT, float(np.median(shares)))
    return found or judge(Cause.NO_DIRECT, float(np.percentile(shares, 90.0)))
