"""What to keep of the light transport, as a value: the wanted probing matrix.

The goals of this file weigh all diagonal entries alike and all others alike, so two numbers are
the whole matrix: Tables 1 and 2 of the paper, rows white, indirect, direct; and section 5's direct
light plus a fraction of the indirect.
"""

from __future__ import annotations

from dataclasses import dataclass

from pdcd.errors import ConfigError


@dataclass(frozen=True)
class Goal:
    """Wanted ``Pi = diagonal * I + off * (1 - I)``."""

    name: str
    diagonal: float
    off: float


WHITE = Goal("white", 1.0, 1.0)
INDIRECT = Goal("indirect", 0.0, 1.0)
DIRECT = Goal("direct", 1.0, 0.0)


def goal(name: str, p: float | None = None) -> Goal:
    """The goal of that name; `p` is the kept share of indirect light, for "fraction" only."""
    fixed = {g.name: g for g in (WHITE, INDIRECT, DIRECT)}
    if name in fixed:
        if p is not None:
            raise ConfigError(
                f"goal {name} takes no p",
                hint="leave p out, or ask for the goal fraction",
            )
        return fixed[name]
    if name != "fraction":
        raise ConfigError(
            f"unknown goal {name!r}", hint=f"known goals: {', '.join([*fixed, 'fraction'])}"
        )
    if p is None or not 0.0 < p < 1.0:
        raise ConfigError(
            "goal fraction needs p between 0 and 1",
            hint="p is the share of indirect light to keep beside the direct, such as 0.25",
        )
    return Goal("fraction", 1.0, p)
