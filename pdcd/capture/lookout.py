"""The look at leaks that a run takes by itself: a dark photo, and what is done about it."""

from __future__ import annotations

from dataclasses import dataclass

from pdcd.capture.job import Journal
from pdcd.capture.shots import ShotTaker
from pdcd.capture.worker.answers import Planned, Stray
from pdcd.capture.worker.desk import Desk
from pdcd.capture.worker.hands import Hands
from pdcd.errors import SyncError
from pdcd.planning.look import due
from pdcd.recipes.recipe import Shot
from pdcd.runs.record import DarkPhoto, ShotRecord

NAMES = ("look-dark", "look-ambient")
"""Dark photos, as their RAW files are called."""


@dataclass
class Lookout:
    """Looks once in a run, as soon as there is something to hold a dark photo against."""

    taker: ShotTaker
    hands: Hands
    journal: Journal
    done: bool = False
    decided: str = ""
    """What was done about the noise of ambient light, in words."""

    def look(self, planned: Planned, shots: list[ShotRecord]) -> Planned | None:
        """The plan to go on by after a look; None where none is due."""
        plan = planned.plan
        if self.done or not due(plan, frozenset(shot.name for shot in shots)):
            return None
        self.done = True
        darks: list[DarkPhoto] = []
        for name in NAMES:
            try:
                darks.append(self.taker.dark(plan, name, lit=not darks))
            except SyncError as err:
                self.journal.warn(f"no look at ambient light and leaks: {err.message}")
                return None
            watch = self.journal.job.watch()
            found = self.hands.do(watch, Desk.stray, shots, darks)
            if found.outcome != "unsure":
                break
        told = _told(found)
        for text in (*(() if told is None else (told,)), *found.told):
            self.journal.warn(text)
        self.decided = found.decided
        return found.planned


def next_shot(planned: Planned, shots: list[ShotRecord]) -> Shot | None:
    """The first shot of a plan that was not taken yet; others come along with their exposures."""
    taken = {shot.name for shot in shots}
    wanted = (shot for shot in planned.plan.recipe.shots if not shot.beside)
    return next((shot for shot in wanted if shot.name not in taken), None)


def _told(found: Stray) -> str | None:
    """What the user must know of a look."""
    if found.outcome == "quiet":
        return None
    leaks = found.leaks
    share = f"{100.0 * leaks.both:.2g} % of the picture (limit {100.0 * leaks.limit:.3g} %)"
    level = found.planned.summary.black_level
    if found.outcome == "added":
        return (
            f"ambient light and leaks would have made {share}: black exposures were added "
            f"(black level {level})"
        )
    return f"ambient light and leaks make {share}, and black exposures are not added: {found.why}"
