"""What the verdict says of shots, panels and codes; pure functions of numbers.

Each function looks at one thing and yields what it finds: nothing where all is well. All limits
stand in `pdcd.verdict.limits`. docs/quality.md says the same for users, with what to do.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from pdcd.arrays import Floats
from pdcd.bench.exposure_time import OFF_S, OFF_SHARE, describe_time_conflict
from pdcd.printable import to_percent
from pdcd.probing.deviation import Deviation
from pdcd.runs.record import ShotRecord
from pdcd.verdict.limits import LIMITS, Grade, VerdictFinding, VerdictLimits, choose_grade
from pdcd.verdict.placement import PlacementFit

_UNSURE = 1.0 / 3.0
"""Share of direct light that was taken out which may be wrong: what leaks goes by the exponential
of the panels' times, and these are known to some ten per cent where nobody measured them."""
_UNSEEN = 10.0
"""Direct light over the rest of a scene, where no photo tells."""


def judge_saturation(
    shares: dict[str, float], limits: VerdictLimits = LIMITS
) -> Iterator[VerdictFinding]:
    """Saturated share of the field by shot: the worst of them."""
    name, share = max(shares.items(), key=lambda item: item[1], default=("", 0.0))
    grade = choose_grade(share, limits.saturated)
    if grade:
        yield VerdictFinding(
            grade,
            f"shot {name}: {to_percent(share)} of the field is saturated (limit "
            f"{to_percent(limits.saturated[0])}); close the aperture, or take fewer passes",
        )


def judge_light(
    name: str, light: Floats, variance: Floats, limits: VerdictLimits = LIMITS
) -> Iterator[VerdictFinding]:
    """Whether a shot that was lit has light; light, variance (n, C) of pixels in the field."""
    seen = light.mean(axis=1)
    noise = variance.mean(axis=1) / variance.shape[1]
    if not seen.size:
        yield VerdictFinding(Grade.BAD, f"shot {name}: no pixel of the camera sees the field")
        return
    error = float(np.sqrt(noise.sum())) / seen.size
    mean = float(seen.mean())
    if not mean > limits.dark * error:
        yield VerdictFinding(
            Grade.BAD,
            f"shot {name}: no light, its mean is {_times(mean, error)} times its error (limit "
            f"{limits.dark:g}); look at lens cap, shutter, projector and mask",
        )
        return
    # What is left of the square when the noise's share is taken off; never less than the mean's.
    power = max(float(np.mean(seen**2) - noise.mean()), mean**2)
    share = float(np.sqrt(noise.mean() / power))
    grade = choose_grade(share, limits.noisy_shot)
    if grade:
        yield VerdictFinding(
            grade,
            f"shot {name} is under-exposed: its noise is {to_percent(share)} of its light (limit "
            f"{to_percent(limits.noisy_shot[0])}); open the aperture, or expose longer",
        )


def judge_stray_light(
    name: str, black: float, lit: float, leak: float, limits: VerdictLimits = LIMITS
) -> Iterator[VerdictFinding]:
    """Mean light of a black shot and of its lit one; `leak` is what panels let through, over lit"""
    if not lit > 0.0:
        return
    share = black / lit - leak
    grade = choose_grade(share, limits.stray)
    if grade:
        yield VerdictFinding(
            grade,
            f"ambient or stray light: shot {name} has {to_percent(share)} of the light of the lit "
            f"shot beyond what the panels let through (limit {to_percent(limits.stray[0])}): it is "
            "taken off, but if it changes a little from photo to photo, what is left changes much; "
            "darken the room, or cover the way of the light",
        )


def judge_room_light(
    share: float, name: str, limits: VerdictLimits = LIMITS
) -> Iterator[VerdictFinding]:
    """Light of a black shot within a second, over that of the white photo's bright places; `name`
    is the shot's. Where there is a white photo it tells more than `judge_stray_light`: a shot of
    codes may have little light because its scene has little of what is asked for."""
    grade = choose_grade(share, limits.room)
    if grade:
        yield VerdictFinding(
            grade,
            f"ambient or stray light: the room's light is {to_percent(share)} of white in shot "
            f"{name} (limit {to_percent(limits.room[0])}): it is taken off, but if it changes a "
            "little from photo to photo, what is left changes much; darken the room",
        )


def judge_room_change(error: float, limits: VerdictLimits = LIMITS) -> Iterator[VerdictFinding]:
    """RMS error over the RMS of the answer, had the room's light changed for all of it as it did
    between a dark photo before all shots and one after them."""
    if error >= limits.changed:
        yield VerdictFinding(
            Grade.DOUBTFUL,
            "the room's light was not the same before and after the photos: the difference makes "
            f"up to {to_percent(error)} of the answer (limit {to_percent(limits.changed)}); see "
            "that no light is switched, and capture again",
        )


def judge_light_outside(
    name: str, inside: Floats, outside: Floats, limits: VerdictLimits = LIMITS
) -> Iterator[VerdictFinding]:
    """Light (n,) of pixels inside and outside the field, which panels leave black."""
    if not inside.size or not outside.size:
        return
    within = float(np.median(inside))
    share = float(np.median(outside)) / within if within > 0.0 else 0.0
    if share >= limits.outside:
        yield VerdictFinding(
            Grade.DOUBTFUL,
            f"ambient or stray light: shot {name} has {to_percent(share)} of the field's light "
            f"outside it (limit {to_percent(limits.outside)}); darken the room, or check that "
            "[camera.place] says where the field lies",
        )


def judge_panel_places(
    shares: Floats,
    fits: Iterable[PlacementFit],
    stack: Iterable[PlacementFit],
    limits: VerdictLimits = LIMITS,
    *,
    upright: bool = False,
) -> Iterator[VerdictFinding]:
    """Whether panels are where they are believed to be (`pdcd.verdict.placement`).

    Two pages of a book send each other light from mirrored places. So a photo whose direct light
    comes from where it should, and more of it than by the codes of a panel that lies in another
    way, speaks of the scene. So does any photo of panels that blocks showed `upright`: they say
    where panels lie by themselves, and of fingerprints only one by inverse codes of the own place.
    """
    todo = "look at [projector.place], [mask.place] and [camera.place]"
    least, chance = limits.fingerprint
    in_place = float(np.median(shares)) if shares.size else 0.0
    strange = [f for f in fits if abs(f.share) > in_place]
    sure = [
        f
        for f in (*strange, *stack)
        if abs(f.share) <= limits.followed
        and min(abs(f.share) / least, abs(f.over_chance) / chance) > 1
    ]
    wrong = [f for f in sure if (f.share < 0.0 if f.name == "as believed" else not upright)]
    if wrong:
        worst = max(wrong, key=lambda f: abs(f.over_chance))
        how = [] if worst.name == "as believed" else [worst.name]
        how += ["inverted"] if worst.share < 0.0 else []
        yield VerdictFinding(
            Grade.BAD,
            f"a panel is {' and '.join(how)}: {to_percent(abs(worst.share))} of the light "
            f"follows codes that lie so (limit {to_percent(least)}); {todo}",
        )
    own = [f.share for f in stack if f.name == "as believed"]
    if wrong or not (shares.size or own):
        return
    if own:
        shares = np.array(own)
    middle, best = float(np.median(shares)), float(np.percentile(shares, 90.0))
    if middle < limits.inverted:
        yield VerdictFinding(
            Grade.BAD,
            f"the coded photo has more light than all there is (direct light {to_percent(middle)}, "
            f"limit {to_percent(limits.inverted)}): a panel is inverted, or there is much ambient "
            "light; look at the polarisers of the mask, or measure with black_level ambient",
        )
    elif best < limits.direct:
        yield VerdictFinding(
            Grade.DOUBTFUL,
            f"no direct light in the scene (at most {to_percent(best)} in nine of ten places, "
            f"limit {to_percent(limits.direct)}): mask and projector do not show the same place, "
            f"or one is much out of focus; {todo}",
        )


def judge_refreshes(shots: Sequence[ShotRecord]) -> Iterator[VerdictFinding]:
    """Whether panels showed what they were to show, while the shutter was open."""
    unequal = [s for s in shots if s.level is None]
    if unequal:
        yield VerdictFinding(
            Grade.DOUBTFUL,
            f"{sum(s.missed for s in unequal)} refreshes were missed in {_shots(unequal)}, so that "
            "codes got unequal light; let nothing else run on the display, or set rig.on_miss to "
            "balance",
        )
    early = [s for s in shots if s.refreshes and s.close_ns < max(s.end_ns)]
    if early:
        worst_s = max(max(s.end_ns) - s.close_ns for s in early) * 1e-9
        yield VerdictFinding(
            Grade.BAD,
            f"the shutter closed {worst_s:.3g} s before the panels went black in "
            f"{_shots(early)}; give the shutter more time (trigger lag)",
        )
    unverified = [s for s in shots if s.refreshes and not s.verified]
    if unverified:
        yield VerdictFinding(
            Grade.DOUBTFUL,
            f"presentation times are not verified in {_shots(unverified)} (time source "
            f"{unverified[0].source}): nobody knows whether refreshes were lost; use a display "
            "with a verified time source",
        )


def judge_exposure_times(
    shots: Sequence[ShotRecord], told_s: Mapping[str, float]
) -> Iterator[VerdictFinding]:
    """Whether planned, logged and the camera's own exposure agree; `told_s` is the camera's, by
    shot, 0 where its file says nothing."""
    found = []
    for shot in shots:
        open_s = (shot.close_ns - shot.open_ns) * 1e-9
        doubt = describe_time_conflict(shot.planned_s or open_s, open_s, told_s.get(shot.name, 0.0))
        if doubt:
            found.append((shot, doubt))
    if found:
        yield VerdictFinding(
            Grade.DOUBTFUL,
            f"{_shots([shot for shot, _ in found])}: {found[0][1]} (limit the larger of {OFF_S:g} "
            f"s and {to_percent(OFF_SHARE)}); see that nothing stops this program, that the camera "
            "stands at bulb, and look at the shutter's cable",
        )


def judge_deviations(
    found: dict[str, Deviation], limits: VerdictLimits = LIMITS
) -> Iterator[VerdictFinding]:
    """Realised probing matrices against the wanted ones, photo by photo."""
    for name, one in found.items():
        wrong = abs(one.diagonal_mean)
        grade = choose_grade(wrong, limits.diagonal)
        if grade:
            yield VerdictFinding(
                grade,
                f"photo {name}: direct light has a weight that is {to_percent(wrong)} off (limit "
                f"{to_percent(limits.diagonal[0])}); look at contrast, guards and offset of the "
                "panels, or take more codes",
            )
        grade = choose_grade(one.off_rms, limits.off_rms)
        if grade:
            yield VerdictFinding(
                grade,
                f"photo {name}: paths have weights that are {to_percent(one.off_rms)} off (limit "
                f"{to_percent(limits.off_rms[0])}); take more codes",
            )


def judge_direct_weights(
    found: dict[str, float], limits: VerdictLimits = LIMITS
) -> Iterator[VerdictFinding]:
    """Cell by cell, how far the weight of direct light is off the wanted one: RMS over the cells,
    photo by photo. A photo that is scaled by its direct light is right on average whatever the
    panels did."""
    for name, wrong in found.items():
        grade = choose_grade(wrong, limits.error)
        if grade:
            yield VerdictFinding(
                grade,
                f"photo {name}: direct light has weights that are {to_percent(wrong)} off from "
                f"cell to cell (RMS, limit {to_percent(limits.error[0])}); look at guards, lag and "
                "offset of the panels, or take more codes",
            )


def judge_direct_light(
    weight: float,
    direct: Floats,
    answer: Floats,
    *,
    taken_out: bool,
    light: str = "direct light",
    advice: str = "take quarter windows, and look at contrast, guards and places of the panels",
    limits: VerdictLimits = LIMITS,
) -> Iterator[VerdictFinding]:
    """An answer without direct light: how much of it is some all the same.

    weight : of direct light in the photo, on average. direct, answer : (n, 3) both pictures.
    light, advice : what it is called, and what to do, where it is that of some depths or rows.
    taken_out : it was, by what is known of the panels
    (`pdcd.pictures.combine.remove_direct_light`); then `_UNSURE` of it counts.
    """
    known = np.isfinite(direct) & np.isfinite(answer)
    squares = [float(np.sum(picture[known] ** 2)) for picture in (direct, answer)]
    if not squares[1] > 0.0:
        return
    share = weight * float(np.sqrt(squares[0] / squares[1]))
    grade = choose_grade(_UNSURE * share if taken_out else share, limits.direct_left)
    if not grade:
        return
    limit = to_percent(limits.direct_left[0])
    if taken_out:
        text = (
            f"direct light as strong as {to_percent(share)} of the picture was taken out of it, by "
            f"what is known of the panels (limit {limit}, where a third of that may be wrong)"
        )
    else:
        text = (
            f"{to_percent(share)} of the picture is {light} (limit {limit}), which has a weight of "
            f"{to_percent(weight)} in it"
        )
    yield VerdictFinding(grade, f"{text}; {advice}")


def judge_warp_tears(share: float, limits: VerdictLimits = LIMITS) -> Iterator[VerdictFinding]:
    """Share of the cells that share windows with others that are matched elsewhere."""
    grade = choose_grade(share, limits.torn)
    if grade:
        yield VerdictFinding(
            grade,
            f"{to_percent(share)} of the cells share windows with others that are matched with "
            f"another place (limit {to_percent(limits.torn[0])}), and see that; take whole windows",
        )


def judge_unseen_direct(weight: float, limits: VerdictLimits = LIMITS) -> Iterator[VerdictFinding]:
    """Mean weight of direct light that was to be blocked, and that no photo shows."""
    if grade := choose_grade(_UNSEEN * weight, limits.direct_left):
        yield VerdictFinding(
            grade,
            f"direct light that was to be blocked has a weight of {to_percent(weight)} (limit "
            f"{to_percent(limits.direct_left[0] / _UNSEEN)}), and no photo tells how much there "
            "is; look at contrast and places of the panels, take --schedule auto or tail before a "
            "slow mask, or take indirect, which shows it",
        )


def _shots(shots: Sequence[ShotRecord]) -> str:
    more = f" and {len(shots) - 1} more" if len(shots) > 1 else ""
    return f"shot {shots[0].name}{more}"


def _times(value: float, error: float) -> str:
    return f"{value / error:.2g}" if error > 0.0 else "0"
