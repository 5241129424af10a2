"""More exposures against the noise of ambient light: how often everything is shown, by which codes.

Black exposures subtract ambient light from a photo, but not its shot noise, and they add their own.
The light fills the sensor, so that longer exposures would not help: more of them do. Where codes
are all that an answer is made of, more exposures become more parts, each with codes of its own,
which lowers the error of the codes as well and measures it. Else every shot is repeated.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

import msgspec

from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import Config
from pdcd.errors import RequestError
from pdcd.panels.lattice import Lattice
from pdcd.planning.defaults import readout_s
from pdcd.planning.memory import check_memory
from pdcd.planning.pairs import make_pattern_pairs
from pdcd.planning.plan import Plan
from pdcd.printable import to_percent
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.make import make_recipe
from pdcd.recipes.parts import FEWEST_PARTS
from pdcd.recipes.recipe import Combination, Extremes, RecipePhoto
from pdcd.watch import Watch

NOISE = 0.018
"""RMS noise of ambient light, over the RMS of the picture, that a plain capture accepts. With the
error of the codes themselves, 0.8 % at most where nothing disturbs them, it makes 2 %."""
MOST_EXPOSURES = 112
"""Most exposures of codes, black ones not counted: 7 parts sixteen times, for a quarter of the
noise. To get below that, darken the room."""
_MEMORY_SHARE = 0.5
"""Share of the memory limit that may be used for what is kept of all photos: the rest is for making
pictures of them."""
MOST_S = 600.0
"""Most seconds that this adds, files included, as nobody asked for it."""


def predict_plan_noise(
    plan: Plan, variances: Mapping[str, float], taken: Plan, names: Iterable[str]
) -> float:
    """RMS noise of a whole plan, over the RMS of its answer.

    variances : of each photo, as `pdcd.pictures.leaks.predict_photo_variances` has them for the
    shots `names` of the plan `taken`, which is this one or one before it. They fall in proportion
    to refreshes.
    """
    there, total = frozenset(names), 0.0
    photos = {photo.name: photo for photo in plan.recipe.photos}
    before = {photo.name: photo for photo in taken.recipe.photos}
    for name, variance in variances.items():
        had = _refreshes(taken, before[name], there)
        wanted = _refreshes(plan, photos[name], None)
        total += variance * had / wanted if wanted else variance
    return math.sqrt(total)


def extend_for_noise(
    plan: Plan,
    noise: float,
    request: CaptureRequest,
    config: Config,
    camera: CameraInfo | None,
    watch: Watch,
) -> tuple[Plan, str, bool]:
    """The plan with everything shown as often as its `noise` calls for, as far as time and memory
    go; the decision in words, "" where no more is needed; and whether the plan is quiet enough now.

    Codes that the plan has in parts stay; more parts are added.
    """
    wanted = max(1, math.ceil((noise / NOISE) ** 2))
    if wanted == 1:
        return _noted(plan, noise, 1), "", True
    once_s = _once_s(plan, config, camera)
    times = min(wanted, MOST_EXPOSURES // plan.how.parts, 1 + int(MOST_S / once_s))
    found = plan
    while times > 1:
        try:
            found = _shown(plan, times, request, config, watch)
            break
        except RequestError:  # more than memory holds
            times -= 1
    times = max(times, 1)
    left = noise / math.sqrt(times)
    found = _noted(found, left, times)
    text = _told(found, noise, times, (times - 1) * once_s)
    return replace(found, reasons=(*found.reasons, text)), text, times == wanted


def _rule(plan: Plan) -> Combination:
    """Photos of the answer, which is a sum of them wherever the noise is known."""
    rule = plan.recipe.answer
    return () if isinstance(rule, Extremes) else rule


def _refreshes(plan: Plan, photo: RecipePhoto, names: frozenset[str] | None) -> int:
    """Refreshes of the lit shots of a photo, of all or of those with these names."""
    own = {name for _, name in photo.shots}
    return sum(
        plan.refreshes(shot)
        for shot in plan.recipe.shots
        if shot.name in own
        and not (shot.primal_black or shot.dual_black)
        and (names is None or shot.name in names)
    )


def _once_s(plan: Plan, config: Config, camera: CameraInfo | None) -> float:
    """Seconds that it takes to show everything once more, files included."""
    names = {name for _, name in _rule(plan)}
    own = {name for photo in plan.recipe.photos if photo.name in names for _, name in photo.shots}
    file_s = readout_s(config, camera) + config.trigger.lag_s
    return sum(plan.exposure_s(shot) + file_s for shot in plan.recipe.shots if shot.name in own)


def _shown(plan: Plan, times: int, request: CaptureRequest, config: Config, watch: Watch) -> Plan:
    """A plan with everything shown so many `times`. Raises RequestError for too little memory."""
    how = plan.how
    # Photos that are not of codes, as the white one of direct light, have no parts.
    split = len(_rule(plan)) == 1 and times * how.parts >= FEWEST_PARTS
    if split:
        codes, parts = how.pilot + times * how.coded, times * how.parts
        how = msgspec.structs.replace(how, codes=codes, parts=parts)
    else:
        how = msgspec.structs.replace(how, repeat=times)
    recipe = make_recipe(plan.recipe.target, how)
    check_memory(recipe, how, config, _MEMORY_SHARE)
    patterns = plan.patterns
    if split:
        family, lattice = how.family or config.schedule.family, Lattice(plan.grid, plan.window)
        curves, passes = plan.curves, plan.passes
        more = make_pattern_pairs(
            recipe, how, family, lattice,
            p=request.p, seed=request.seed, watch=watch, curves=curves, passes=passes,
        )  # fmt: skip
        patterns = {name: patterns.get(name, pair) for name, pair in more.items()}
    return replace(plan, recipe=recipe, how=how, patterns=patterns)


def _noted(plan: Plan, noise: float, times: int) -> Plan:
    if plan.leaks is None:
        return plan
    return replace(plan, leaks=msgspec.structs.replace(plan.leaks, noise=noise, times=times))


def _told(plan: Plan, noise: float, times: int, seconds: float) -> str:
    """What was decided, what it costs, and what is left to do where it is not enough."""
    limit, left = f"limit {to_percent(NOISE)}", noise / math.sqrt(times)
    text = f"noise: ambient light would leave {to_percent(noise)} of the picture ({limit})"
    if times > 1:
        exposures = plan.how.parts * plan.how.repeat
        text += (
            f": {times} times as many exposures, which are {exposures} of codes beside their black "
            f"ones, {seconds:.3g} s more, leave {to_percent(left)}"
        )
    if left > NOISE:
        text += (
            f"; more than {MOST_EXPOSURES} of them, {MOST_S:g} s, or what memory holds are "
            "taken only if you ask: darken the room, or name an error"
        )
    return text
