"""A look at what gets into a photo when panels are black, and the black exposures that follow.

One short dark photo is taken once the first photo of the codes is there. It shows an open mask in
front of a black projector, then, after a pause, a closed mask in front of a lit projector. It
contains ambient light, the light of a black projector and what a closed mask lets through, all
together. Where that would be too much (`pdcd.pictures.leaks`), a second photo without the lit
projector separates them, and black exposures that measure the leak are added to the shots.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from pdcd.bench.tables import Config
from pdcd.errors import RequestError
from pdcd.panels.frames import BLACK, WHITE, Frames
from pdcd.panels.patterns import make_empty_patterns
from pdcd.panels.schedule import count_slot_rows
from pdcd.planning.memory import check_memory
from pdcd.planning.plan import LeakProbe, Plan
from pdcd.printable import to_percent
from pdcd.protocol.plan_summary import LeakErrors
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.make import make_recipe
from pdcd.recipes.recipe import Shot
from pdcd.runs.record import ShotRecord
from pdcd.words import BlackLevel

_LIMIT = 0.01
"""RMS error of the answer by leaks that is accepted where no error was asked for."""
_LOOK_S = 0.25
"""Time for which a dark photo shows each of its two states."""


@dataclass(frozen=True)
class _BlackLevels:
    """Black exposures to begin with, and a look or none."""

    level: BlackLevel
    look: LeakProbe | None


def resolve_black_level(
    request: CaptureRequest, config: Config, *, average: bool = False
) -> _BlackLevels:
    """Black exposures of a request, which may `average` against the noise of ambient light; "auto"
    begins without any, and looks. The transport matrix needs none: its equations have an unknown
    for light that comes whatever is shown."""
    asked = request.black_level or config.schedule.black_level
    if asked != "auto":
        return _BlackLevels(asked, None)
    if request.goal == "transport":
        return _BlackLevels("none", None)
    wanted = request.error or request.until_error or _LIMIT
    may_add = request.seconds is None
    return _BlackLevels("none", LeakProbe(wanted, may_add=may_add, average=average and may_add))


@dataclass(frozen=True)
class DarkFrames:
    """What a dark photo shows: an open mask alone for `rows`; then a `pause`; then a lit projector
    alone for as long, or both panels black. shot : the one whose aperture is used."""

    shot: Shot
    rows: int
    pause: int
    grid: tuple[int, int]
    row_hz: float

    @classmethod
    def of(cls, plan: Plan) -> DarkFrames:
        """The frames of a plan: each state for `_LOOK_S`, and no longer than the answer's shots."""
        shot = plan.last_exposed
        rows = min(max(2, round(_LOOK_S * plan.row_hz)), plan.refreshes(shot))
        pause = max(2, math.ceil(plan.settle_s * plan.row_hz))
        return cls(shot, rows, pause, plan.grid, plan.row_hz)

    @property
    def phase_s(self) -> float:
        """Time for which each of the two states is shown."""
        return self.rows / self.row_hz

    @property
    def seconds(self) -> float:
        """Time for which all of it is shown."""
        return (2 * self.rows + self.pause) / self.row_hz

    def frames(self, *, lit: bool) -> Frames:
        """Refreshes of the photo; `lit` : whether the projector is lit at the end."""
        primal = np.full(2 * self.rows + self.pause, BLACK, dtype=np.int32)
        dual = primal.copy()
        dual[: self.rows] = WHITE
        if lit:
            primal[-self.rows :] = WHITE
        return Frames(
            primal_patterns=make_empty_patterns(),
            dual_patterns=make_empty_patterns(),
            primal_index=primal,
            dual_index=dual,
            shift=np.zeros(primal.size, dtype=np.uint8),
            code=np.zeros(primal.size, dtype=np.int32),
            guard=dual == BLACK,
            grid=self.grid,
            lattice=self.grid,
            window="whole",
        )


def choose_black_level(leaks: LeakErrors) -> BlackLevel:
    """Which black exposures bring the error by leaks below its limit."""
    ambient, mask = leaks.ambient or 0.0, leaks.mask or 0.0
    if leaks.both <= leaks.limit:
        return "none"
    if mask <= leaks.limit:
        return "ambient"
    return "mask" if ambient <= leaks.limit else "both"


def note_harmless_leaks(plan: Plan, leaks: LeakErrors) -> Plan:
    """The plan after a look that requires nothing."""
    text = f"black exposures: none, after a look at a dark photo: {_said(leaks)}"
    return replace(plan, look=None, leaks=leaks, reasons=_reasons(plan, text))


def with_black_exposures(
    plan: Plan, leaks: LeakErrors, config: Config, taken: Sequence[ShotRecord]
) -> Plan:
    """The plan with the black exposures of `choose_black_level` for all its photos; codes stay.

    taken : the shots so far. A black exposure lasts as long as the shot it belongs to, even if the
    plan has changed since that was taken. Raises RequestError where none can be added.
    """
    level = choose_black_level(leaks)
    if plan.look is not None and not plan.look.may_add:
        raise RequestError("the time asked for leaves no room for them")
    plan = _as_taken(plan, config, taken)
    how = msgspec.structs.replace(plan.how, black_level=level)
    recipe = make_recipe(plan.recipe.target, how)
    check_memory(recipe, how, config)
    text = f"black exposures: {level}, decided after a look at dark photos: {_said(leaks)}"
    return replace(
        plan,
        recipe=recipe,
        how=how,
        look=None,
        leaks=leaks,
        reasons=_reasons(plan, text),
    )


def _as_taken(plan: Plan, config: Config, taken: Sequence[ShotRecord]) -> Plan:
    """The plan with white shots as long as they were: a pilot that ends early changes the rest.

    Raises RequestError where shots were not taken as planned.
    """
    planned = {shot.name: shot for shot in plan.recipe.shots}
    delay = abs(config.mask_delay_rows)
    for record in taken:
        shot = planned.get(record.name)
        if shot is not None and shot.white:
            plan = replace(
                plan, white_slots=(record.refreshes - delay) // count_slot_rows(plan.schedule)
            )
    even = all(
        record.level == 1.0 and record.refreshes - delay == plan.refreshes(planned[record.name])
        for record in taken
        if record.name in planned
    )
    if not even:
        raise RequestError("codes were shown more often than planned, or unequally often")
    return plan


def with_leak_probe(plan: Plan, look: LeakProbe | None) -> Plan:
    """The plan with a look to come, and a line about it."""
    bare = replace(plan, look=look)
    return bare if look is None else replace(bare, reasons=_reasons(bare, _foretold(bare, look)))


def _foretold(plan: Plan, look: LeakProbe) -> str:
    dark_s = DarkFrames.of(plan).seconds + plan.delay_s + 2.0 * plan.settle_s
    then = "are added" if look.may_add else "would be needed, which a warning says"
    return (
        f"black exposures: decided after a look at one dark photo of {dark_s:.2g} s; they "
        f"{then} where ambient light or leaks are more than {100.0 * look.limit:.3g} % of the "
        "picture" + ", and more light where ambient light is too noisy" * look.average
    )


def _said(leaks: LeakErrors) -> str:
    limit = f"(limit {to_percent(leaks.limit)})"
    if not leaks.both:
        return (
            f"no ambient light and no leak, of which {to_percent(leaks.floor)} of the picture "
            f"would have been seen {limit}"
        )
    if leaks.ambient is None or leaks.mask is None:
        return (
            f"ambient light and leaks make at most {to_percent(leaks.both)} of the picture {limit}"
        )
    return (
        f"ambient light and a leaking projector make {to_percent(leaks.ambient)} of the picture, a "
        f"leaking mask {to_percent(leaks.mask)} {limit}"
    )


def _reasons(plan: Plan, text: str) -> tuple[str, ...]:
    kept = [reason for reason in plan.reasons if not reason.startswith("black exposures:")]
    return (*kept, text)
