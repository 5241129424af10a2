"""Who watches a long computation: hears that it lives and how far it is, and may end it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager


def _nobody(*told: float) -> None:
    """Stands for one who does not listen."""


class Watch:
    """Given to a computation, which calls it every few hundredths of a second.

    Work is counted in units of whatever the computation likes, as long as each takes about the same
    time. It says first what is to be expected, then what of it is done. `alive` hears every sign of
    life, `step` how much is done, of how much; either may raise, which ends the work. `stage` says
    in a few words what is worked on, where the computation says so.
    """

    def __init__(
        self,
        alive: Callable[[], None] = _nobody,
        step: Callable[[float, float], None] = _nobody,
    ) -> None:
        self._alive = alive
        self._step = step
        self._done = 0.0
        self._total = 0.0
        self.stage = ""

    def __call__(self) -> None:
        """Give a sign of life."""
        self._alive()

    def step(self, done: float, total: float) -> None:
        """Tell how much is done, of how much."""
        self._step(done, total)

    def expect(self, units: float) -> None:
        """There is so much more to do."""
        self._total += units

    def did(self, units: float) -> None:
        """So much more of what was expected is done; a sign of life, too."""
        self._done = min(self._done + units, self._total)
        self()
        if self._total > 0.0:
            self.step(self._done, self._total)

    @contextmanager
    def piece(self, units: float, signs: int | None = None) -> Iterator[Callable[[], None]]:
        """A piece of what was expected, during which about so many signs of life are given.

        Each sign counts for its share, or for a tenth of what is left where nobody knows how many
        there will be; the rest is done when the piece is.
        """
        left = units

        def alive() -> None:
            nonlocal left
            now = left / 10.0 if signs is None else min(units / max(signs, 1), left)
            left -= now
            self.did(now)

        yield alive
        self.did(left)
