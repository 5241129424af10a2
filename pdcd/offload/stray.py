"""From dark photos to the leaks of an answer, in figures."""

from __future__ import annotations

from collections.abc import Sequence

from pdcd.errors import PdcdError
from pdcd.offload.answers import DarkPhoto
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.leaks import Dark, answers_of
from pdcd.pictures.watch import Watch
from pdcd.planning.look import lit_s
from pdcd.planning.plan import Plan
from pdcd.request import Leaks


def leaks_in(plan: Plan, darkroom: Darkroom, darks: Sequence[DarkPhoto], watch: Watch) -> Leaks:
    """RMS errors that leaks make of the answer so far.

    darks : a dark photo; and where it may matter whose the leak is, one without the lit projector,
    too. Of one alone only an upper bound is told. Raises DecodeError.
    """
    look = plan.look
    if look is None:
        raise PdcdError("this plan looks at no dark photo")
    recipe, shots, cells = darkroom.exposed(watch)
    lit = {shot.name: lit_s(plan, shot) for shot in recipe.shots}
    answers = answers_of(recipe, shots, lit, cells, normalise=darkroom.record.normalise)
    found = []
    for photo in darks:
        light, variance = darkroom.light_of(
            photo.raw, photo.sha256, photo.iso, photo.f_number, photo.exposure_s
        )
        error = cells.error_of_mean(variance)
        found.append(Dark(cells.mean(light) / photo.phase_s, (error / photo.phase_s) ** 2))
    ambient = mask = None
    if len(found) == 1:
        both = max(answer.most(found[0]) for answer in answers)
    else:
        other = found[0].less(found[1])
        ambient = max(answer.ambient(found[1]) for answer in answers)
        mask = max(answer.mask(other) for answer in answers)
        both = max(answer.both(found[1], other) for answer in answers)
    return Leaks(
        ambient=ambient,
        mask=mask,
        both=both,
        floor=max(answer.floor(*found) for answer in answers),
        limit=look.limit,
        raw=tuple(photo.raw for photo in darks),
    )
