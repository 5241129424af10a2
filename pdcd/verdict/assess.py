"""From the pictures of a run to the verdict on it: picks the numbers that are judged."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from pdcd.arrays import Floats
from pdcd.pictures.darkroom import DecodedRun
from pdcd.pictures.weights import sum_realised_matrices
from pdcd.probing.deviation import Deviation
from pdcd.protocol.result import Quality
from pdcd.recipes.parts import FLOODLIT
from pdcd.recipes.recipe import Extremes, RecipePhoto
from pdcd.runs.record import RunRecord, ShotRecord
from pdcd.verdict import answer, quality
from pdcd.verdict.evidence import Evidence
from pdcd.verdict.limits import VerdictFinding, combine_findings
from pdcd.verdict.matrices import (
    compute_blocked_weight,
    compute_direct_weight_errors,
    list_blocked_parts,
    warp_tear_share,
)
from pdcd.verdict.placement import (
    LightSample,
    estimate_direct_shares,
    fit_fingerprints,
    fit_stack_fingerprints,
)
from pdcd.words import NormaliseName

_LIGHT = (
    "indirect", "direct", "fraction", "diagonal", "off-diagonal", "warped", "long-range",
    "short-range", "keyed", "epipolar", "stereo",
)  # fmt: skip
"""Goals whose answer is light that paths bring, and so never below zero."""
_NO_WEIGHT = 1e-9
"""Weight that is none."""
_LEAST_SHOWN = 0.05
"""Least share of the direct light that a picture of it is taken to show."""
_BRIGHT = 95.0
"""Percentile of the field's light that is that of bright places."""
_STACK = 24
"""Photos of single codes that are looked at."""


def assess_run(record: RunRecord, decoded: DecodedRun, deviations: dict[str, Deviation]) -> Quality:
    """The verdict on a run that was decoded; `judge_deviations` are those of its photos."""
    if record.cells is None:
        return combine_findings([])
    seen = Evidence.of(decoded, record.cells, deviations)
    shots = [shot for shot in record.shots if shot.name in set(seen.names)]
    weights = compute_direct_weight_errors(seen.photos, seen.panels, record.normalise)
    return combine_findings(
        itertools.chain(
            quality.judge_saturation({name: _saturated_share(seen, name) for name in seen.names}),
            _light(seen),
            answer.judge_noise(*_of_answer(seen)),
            _errors(seen),
            _stray(seen),
            answer.judge_leak(record.leak),
            quality.judge_room_change(record.room_changed),
            quality.judge_warp_tears(warp_tear_share(seen.photos, shots)),
            _placement(
                seen, record.grid, upright=record.panels is not None and record.panels.upright
            ),
            _elsewhere(seen, record),
            quality.judge_refreshes(shots),
            quality.judge_exposure_times(shots, _told_s(decoded)),
            quality.judge_deviations({photo.name: deviations[photo.name] for photo in seen.photos}),
            quality.judge_direct_weights(weights),
            _direct_left(seen, record.normalise),
            _blocked_left(seen, record.shots),
            _direct_unseen(seen),
            [] if seen.transport is None else answer.judge_common_light(seen.transport.common),
            _pair_sum(seen),
            _unmeasured(seen, record.how.codes),
        )
    )


def _told_s(decoded: DecodedRun) -> dict[str, float]:
    """Exposure of each shot as its file says, s."""
    said = {name: shot.exif.get("exposure_s") for name, shot in decoded.shots.items()}
    return {name: told for name, told in said.items() if isinstance(told, float)}


def _saturated_share(seen: Evidence, name: str) -> float:
    """Of the quads of the field in a shot."""
    saturated = int(np.count_nonzero(seen.shots[name].saturated & seen.field))
    return saturated / max(int(np.count_nonzero(seen.field)), 1)


def _light(seen: Evidence) -> Iterator[VerdictFinding]:
    """Whether shots that were lit have light, and none outside the field."""
    planned, thin = seen.planned, seen.thin
    lit = [n for n in seen.names if not planned[n].of_leaks]
    for name in _some(lit):
        shot = seen.shots[name]
        if not shot.realised.total_s > 0.0:  # meant to be dark, as one pattern of a few cells is
            continue
        light, variance = thin.light(shot), thin.variance(shot)
        yield from quality.judge_light(name, thin.inside(light), thin.inside(variance))
        grey = light.mean(axis=1)
        yield from quality.judge_light_outside(name, thin.inside(grey), thin.outside(grey))


def _some(names: Sequence[str]) -> Sequence[str]:
    """At most `_STACK` of them, evenly spread."""
    return names[:: -(-len(names) // _STACK)] if names else names


def _of_answer(seen: Evidence) -> tuple[Floats, Floats, Floats]:
    """Image, sigma and error by the sensor of the answer, (n, C) each."""
    made = seen.answer
    return seen.inside(made.image), seen.inside(made.sigma), seen.inside(made.sensor)


def _errors(seen: Evidence) -> Iterator[VerdictFinding]:
    """How far the answer may be off, by a sigma that was measured and by light below zero."""
    if seen.transport is not None:
        return
    recipe = seen.recipe
    image, sigma, sensor = _of_answer(seen)
    if seen.answer.kind == "measured":
        yield from answer.judge_error_bars(image, sigma, sensor, recipe.target.cells)
    if recipe.target.goal.name in _LIGHT:
        yield from answer.judge_negative_light(image, sensor)


def _unmeasured(seen: Evidence, codes: int) -> Iterator[VerdictFinding]:
    """What so many codes may err, where sigma is without it: by the weights of paths."""
    if seen.transport is None and seen.answer.kind == "sensor":
        image = seen.inside(seen.answer.image)
        yield from answer.judge_unmeasured_codes(_by_single_paths(seen, image), codes)


def _by_single_paths(seen: Evidence, image: Floats) -> float:
    """RMS error by codes over that of the answer, (n, C) in the field, if each point got all its
    indirect light by one path: what its weight is off, of all paths alike."""
    rule = seen.recipe.answer
    if isinstance(rule, Extremes):
        weights = dict.fromkeys(rule.photos, max(abs(rule.largest), abs(rule.smallest)))
    else:
        weights = {name: abs(weight) for weight, name in rule}
    all_light = seen.pictures.get("indirect", seen.pictures.get("white"))
    light = _rms(image if all_light is None else seen.inside(all_light.image))
    off = sum(weights[name] * seen.deviations[name].off_rms for name in weights)
    answer_rms = _rms(image)
    return float(off * light / answer_rms) if answer_rms > 0.0 else np.inf


def _rms(values: Floats) -> float:
    known = np.isfinite(values)
    return float(np.sqrt(np.mean(values[known] ** 2))) if known.any() else 0.0


def _stray(seen: Evidence) -> Iterator[VerdictFinding]:
    """The worst of the shots with a black projector, against bright places of the white photo;
    where there is none, against the shot which it belongs to."""
    found, white = [], _white_rate(seen)
    for name in seen.names:
        base, shot = name.partition("-black-")[0], seen.planned[name]
        if not shot.primal_black or shot.dual_black or base not in seen.shots:
            continue
        black, lit = seen.shots[name], seen.shots[base]
        dark, bright = (
            float(seen.thin.inside(seen.thin.light(one)).mean()) for one in (black, lit)
        )
        through = lit.realised.total_s
        leak = black.realised.total_s / through if through > 0.0 else 0.0
        stray = dark - leak * bright
        if white is not None:
            open_s = float(black.realised.open_s.mean())
            rate = stray / open_s if open_s > 0.0 else 0.0
            # The white photo holds the room's light, too.
            found.append((rate / max(white - rate, _NO_WEIGHT), name, dark, bright, leak))
        else:
            found.append((stray / bright if bright > 0.0 else 0.0, name, dark, bright, leak))
    if found and white is not None:
        yield from quality.judge_room_light(*max(found)[:2])
    elif found:
        yield from quality.judge_stray_light(*max(found)[1:])


def _white_rate(seen: Evidence) -> float | None:
    """Light within a second in bright places of a photo of all light, None where there is none."""
    for name, shot in seen.planned.items():
        if not shot.all_light or name not in seen.shots:
            continue
        white = seen.shots[name]
        light = seen.thin.inside(seen.thin.light(white).mean(axis=1))
        open_s = float(white.realised.open_s.mean())
        rate = float(np.percentile(light, _BRIGHT)) / open_s if light.size and open_s > 0.0 else 0.0
        if rate > 0.0:
            return rate
    return None


def _placement(seen: Evidence, grid: tuple[int, int], *, upright: bool) -> Iterator[VerdictFinding]:
    """What the photos say of where the panels are. upright : as blocks showed them."""
    told: list[LightSample] = []
    prints: list[LightSample] = []
    white = None
    for photo in seen.recipe.photos:
        if any(name not in seen.shots for _, name in photo.shots):
            continue  # a sum of single codes, which the stack tells of
        samples = _samples(photo, seen)
        if photo.wanted.uniform is not None:
            told += samples
        if any(seen.planned[name].white for _, name in photo.shots):
            white = samples[0].light
        elif photo in seen.photos:
            prints = prints or samples
    stack = _some([n for n in seen.recipe.stack if n in seen.shots])
    yield from quality.judge_panel_places(
        estimate_direct_shares(told, grid),
        [f for s in prints[:1] for f in fit_fingerprints(_against(s, white, prints), grid)],
        list(fit_stack_fingerprints([seen.sample([(1.0, n)]) for n in stack], grid)),
        upright=upright,
    )


def _elsewhere(seen: Evidence, record: RunRecord) -> Iterator[VerdictFinding]:
    """What photos of blocks say of where panels and camera are."""
    look = record.panels
    if look is None:
        return
    from pdcd.pictures.misplaced import (  # few runs have looked
        estimate_lost_direct,
        find_quads_beside_mask,
        mean_cell_px,
    )
    from pdcd.verdict import misplaced

    size_px = record.projector.field_size_px
    windows = {shot.name: shot.window for shot in record.shots}
    shown = [windows[n] for n in seen.names if n in windows and not seen.planned[n].white]
    lost = estimate_lost_direct(record, next(iter(shown), "whole"))
    image = seen.inside(seen.answer.image)
    known = np.isfinite(image)
    answer_rms = float(np.sqrt(np.mean(image[known] ** 2))) if known.any() else 0.0
    direct = look.direct
    share = misplaced.predict_indirect_error(direct, lost.rms)
    white = seen.pictures.get("white")
    if white is not None and answer_rms > 0.0 and record.goal.name != "fraction":
        light = direct * seen.inside(white.image)
        if lost.mean < misplaced.HOPELESS and "direct" in seen.pictures:
            light = seen.inside(seen.pictures["direct"].image) / (1.0 - lost.mean)
        share = lost.rms * float(np.sqrt(np.nanmean(light**2))) / answer_rms
    yield from misplaced.judge_unseen_panels(look, measured=misplaced.is_place_measured(record))
    yield from misplaced.judge_mask_place(
        look, record.mask, size_px, lost, share, mean_cell_px(record)
    )
    beside = None if record.cells is None else find_quads_beside_mask(record, record.cells)
    if beside is not None and beside.any():
        yield from misplaced.judge_field_beside_mask(
            beside, seen.field, seen.answer.image, seen.thin.step
        )
    yield from misplaced.judge_camera_place(
        look, record.camera_place, size_px, mean_cell_px(record)
    )


def _samples(photo: RecipePhoto, seen: Evidence) -> list[LightSample]:
    """What was added in a photo, and what was subtracted, each without what leaks through black."""
    sides: dict[float, list[tuple[float, str]]] = {1.0: [], -1.0: []}
    of = {name: sign for sign, name in photo.shots}
    for name, sign in of.items():
        base = of.get(name.partition("-black-")[0], sign)
        side = 1.0 if base > 0.0 else -1.0
        sides[side].append((side * sign, name))
    return [seen.sample(terms) for terms in sides.values() if terms]


def _against(sample: LightSample, white: Floats | None, pair: list[LightSample]) -> LightSample:
    """A sample with its reference: the white photo, or all that a signed pair gathered."""
    reference = white
    if white is None and len(pair) == 2:
        reference = pair[0].light + pair[1].light
    return LightSample(sample.light, sample.realised, reference)


def _direct_left(seen: Evidence, normalise: NormaliseName) -> Iterator[VerdictFinding]:
    """What is direct light in an answer of one photo without any."""
    direct = seen.pictures.get("direct")
    if direct is None or len(seen.photos) != 1:
        return
    (photo,) = seen.photos
    if photo.wanted.uniform is None or photo.wanted.uniform[0] != 0.0:
        return
    there, left = seen.inside(direct.image), seen.inside(seen.answer.image)
    weight, drawn = abs(seen.deviations[photo.name].diagonal_mean), _at_borders(seen, photo)
    # What is left of it in this picture is missing in that of direct light.
    whole = there / max(1.0 - weight, _LEAST_SHOWN)
    found = list(quality.judge_direct_light(max(weight, drawn), whole, left, taken_out=False))
    if found and seen.takes_out(photo, normalise):
        found = list(quality.judge_direct_light(max(weight, drawn), there, left, taken_out=True))
    yield from found


def _at_borders(seen: Evidence, photo: RecipePhoto) -> float:
    """RMS over the quads of the weight of direct light that gets through between cells.

    It lies along the borders of cells, in lines that are one quad wide or, where quads are finer
    than that, as wide as the panels are apart.
    """
    apart, quads = seen.apart[photo.name], max(int(np.count_nonzero(seen.field)), 1)
    quad = float(np.sqrt(seen.recipe.target.cells / quads))
    lines = max(min(2.0 * quad, 1.0), apart)
    return apart / float(np.sqrt(lines))


def _blocked_left(seen: Evidence, shots: Sequence[ShotRecord]) -> Iterator[VerdictFinding]:
    """What is left of light that was to be blocked by its depth, or by its row.

    Where windows cut cells, what holds between cells says nothing of direct light, which goes from
    point to point.
    """
    white, rule = seen.pictures.get("white"), seen.recipe.answer
    if white is None or isinstance(rule, Extremes) or "white" in [name for _, name in rule]:
        return
    if "direct" in seen.pictures:
        return  # `_direct_left` says it, and knows what was taken out
    if any(shot.window != "whole" for shot in shots):
        return
    if not any(list_blocked_parts(photo.wanted) for photo in seen.photos):
        return
    shares = {name: share for share, name in rule}
    through = [
        shares[photo.name]
        * compute_blocked_weight(
            sum_realised_matrices(photo.shots, seen.panels),
            photo.wanted,
            seen.deviations[photo.name].weight_s,
        )
        for photo in seen.photos
    ]
    weight = abs(sum(through))
    there, left = seen.inside(white.image), seen.inside(seen.answer.image)
    # What is left of it in this picture is missing in the difference.
    whole = (there - left) / max(1.0 - weight, _LEAST_SHOWN)
    yield from quality.judge_direct_light(
        weight,
        whole,
        left,
        taken_out=False,
        light="light that was to be blocked",
        advice="look at contrast, guards and places of the panels",
    )


def _direct_unseen(seen: Evidence) -> Iterator[VerdictFinding]:
    """Direct light in an answer that is to have none in some cells, where no photo shows how much
    there is. Off the axis it comes another way."""
    rule = seen.recipe.answer
    if not seen.photos or isinstance(rule, Extremes):
        return
    if {"white", "direct"} & seen.pictures.keys():
        return
    shares = {name: share for share, name in rule}
    wanted, got = np.zeros((2, seen.photos[0].wanted.cells))
    for photo in seen.photos:
        realised = sum_realised_matrices(photo.shots, seen.panels)
        wanted += shares[photo.name] * photo.wanted.diagonal()
        got += shares[photo.name] * realised.coaxial / seen.deviations[photo.name].weight_s
    none = np.abs(wanted) < _NO_WEIGHT
    if none.any():
        yield from quality.judge_unseen_direct(float(np.abs(got[none]).sum() / none.size))


def _pair_sum(seen: Evidence) -> Iterator[VerdictFinding]:
    """What a complement pair adds up to, against the floodlit shot."""
    flood = seen.pictures.get(FLOODLIT)
    if flood is None:
        return
    both = seen.pictures["white"]
    there, sums = seen.inside(flood.image), seen.inside(both.image)
    noise = sum(seen.inside(p.sensor) ** 2 for p in (flood, both))
    yield from answer.judge_pair_sum(sums, there, np.asarray(noise))
