"""Watching a long computation: it gives signs of life, reports its progress, and can be ended."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager


def _nobody(*told: float) -> None:
    """Ignore what is reported."""


class Watch:
    """Given to a computation, which calls it every few hundredths of a second.

    Work is counted in any units, as long as each takes about the same time. The computation first
    says how many units to expect, then how many are done. `alive` is called at every sign of life,
    `step` with the work done and the work in all; either may raise to end the work. `stage` says in
    a few words what is being worked on, if the computation sets it.
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
        """Report the work done and the work in all."""
        self._step(done, total)

    def expect(self, units: float) -> None:
        """Add `units` to the work that is to be done."""
        self._total += units

    def did(self, units: float) -> None:
        """Report `units` more of the expected work as done; also a sign of life."""
        self._done = min(self._done + units, self._total)
        self()
        if self._total > 0.0:
            self.step(self._done, self._total)

    @contextmanager
    def piece(self, units: float) -> Iterator[Callable[[], None]]:
        """A piece of the expected work, during which an unknown number of signs of life are given.

        Each counts for a tenth of what is left; the rest counts as done at the end of the piece.
        """
        left = units

        def alive() -> None:
            nonlocal left
            now = left / 10.0
            left -= now
            self.did(now)

        yield alive
        self.did(left)
