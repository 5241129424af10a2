"""The way of one class through the files of a program."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

from tests.walk.trace import Step


@dataclass(frozen=True)
class Route:
    """Where objects of a class were passed, in order of time.

    steps : the first call at each place of the source that passes one on, of those only the ones
        that led to another file than the step before; the first is where the way begins.
    """

    held: str
    steps: tuple[Step, ...]

    @property
    def files(self) -> tuple[str, ...]:
        """The files that it came to, in order."""
        return tuple(step.callee for step in self.steps)

    @property
    def moves(self) -> int:
        """How often it went from one file to another."""
        return max(0, len(self.steps) - 1)

    @property
    def returns(self) -> int:
        """How often it came back to a room that it had left."""
        return len(self.comebacks())

    def comebacks(self) -> list[Step]:
        """The steps that led back to a room that it had left."""
        found, seen, last = [], set[str](), None
        for step in self.steps:
            room = room_of(step.callee)
            if room != last and room in seen:
                found.append(step)
            seen.add(room)
            last = room
        return found

    def sites(self) -> Counter[str]:
        """Moves by the function that they led to and the file that called it."""
        return Counter(f"{s.caller} -> {s.callee} {s.function}" for s in self.steps[1:])


def room_of(file: str) -> str:
    """The folder of a file."""
    return file.rpartition("/")[0]


def route_of(held: str, steps: Iterable[Step]) -> Route:
    """The way of a class. Each place that calls a function counts once, so loops count once, and
    so does a place that two processes come by."""
    seen: set[tuple[str, int, str, str]] = set()
    first = []
    for step in steps:
        place = (step.caller, step.line, step.callee, step.function)
        if step.held == held and place not in seen:
            seen.add(place)
            first.append(step)
    return Route(held, tuple(next(group) for _, group in groupby(first, lambda s: s.callee)))


def homes(held: str, steps: Sequence[Step]) -> list[str]:
    """The modules that define a class of this name; more than one: the name is not clear."""
    return sorted({step.home for step in steps if step.held == held})
