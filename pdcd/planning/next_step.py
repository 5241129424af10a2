"""What comes next in a run, by its plan and the shots that it has."""

from __future__ import annotations

from collections.abc import Collection
from typing import Literal

from pdcd.codes.pilot.codes import SCOUTS
from pdcd.planning.plan import Plan
from pdcd.recipes.recipe import Shot

_Step = Literal["scouts", "pilot", "dark"] | Shot | None
"""To evaluate the scouts of a pilot, or all of its photos; to take a dark photo; to take a shot; or
nothing more."""


def choose_next_step(plan: Plan, taken: Collection[str], *, looked: bool, fresh: bool) -> _Step:
    """What a run does next.

    taken : names of the shots it has. looked : whether its look at a dark photo is done. fresh :
    whether the last of these shots has only just come, so that a pilot may have to be evaluated.
    """
    late = plan.how.late
    if fresh and (late or not looked):  # a look comes after all that a pilot may change
        if (
            has_first_pilot_photos(plan, len(taken)) and not late
        ):  # without ambient light these see enough
            return "scouts"
        if is_pilot_complete(plan, len(taken)):
            return "pilot"
    if not looked and is_dark_photo_due(plan, taken):
        return "dark"
    # Shots beside others come along with their exposures.
    wanted = (shot for shot in plan.recipe.shots if not shot.beside)
    return next((shot for shot in wanted if shot.name not in taken), None)


def has_first_pilot_photos(plan: Plan, taken: int) -> bool:
    """Whether the scouts of a pilot, and no more, are among the first `taken` shots of a plan."""
    return plan.how.pilot > SCOUTS and taken == _position(plan, plan.recipe.stack[SCOUTS - 1]) + 1


def is_pilot_complete(plan: Plan, taken: int) -> bool:
    """Whether a pilot is complete after the first `taken` shots, and has codes left to guide."""
    if plan.how.pilot <= SCOUTS or not plan.how.coded:
        return False
    return taken == _position(plan, plan.recipe.stack[-1]) + 1


def is_dark_photo_due(plan: Plan, taken: Collection[str]) -> bool:
    """Whether a plan wants a dark photo, and the shots that it is compared with are there: all of
    them, or those of the first part."""
    if plan.look is None:
        return False
    return all(shot.name in taken for shot in plan.recipe.shots if shot.part <= 1)


def is_last_of_part(plan: Plan, shot: Shot) -> bool:
    """Whether a shot is the last one of a part, so that there is an answer to judge."""
    # A shot beside another one comes with that.
    own = [s for s in plan.recipe.shots if s.part == shot.part and not s.beside]
    return shot.part > 0 and shot is own[-1]


def _position(plan: Plan, name: str) -> int:
    return next(i for i, shot in enumerate(plan.recipe.shots) if shot.name == name)
