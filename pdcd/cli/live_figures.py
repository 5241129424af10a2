"""Figures of pictures that arrive one after another, as lines or JSON."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping

from pdcd.api.progress import tell_user
from pdcd.cli.output import say_json
from pdcd.cli.streams import write_stdout

_LINE_S = 1.0
"""Time between two lines of figures."""


class LiveFigures:
    """Prints figures as they come: a line a second, rewritten in place on a terminal, or JSON."""

    def __init__(self, seconds: float | None, *, as_json: bool, rewrite_s: float = _LINE_S) -> None:
        """Without `seconds` only Ctrl-C ends. A terminal's line is rewritten every `rewrite_s`."""
        self._seconds, self._json = seconds, as_json
        self._begun_s: float | None = None
        self._next_s = 0.0
        self._rewrites = not as_json and sys.stdout.isatty()
        self._wait_s = rewrite_s if self._rewrites else _LINE_S
        if not as_json:
            tell_user("Ctrl-C ends" if seconds is None else f"for {seconds:g} s")

    def show(
        self,
        fields: Callable[[], Mapping[str, object]],
        line: Callable[[], str],
        *,
        at_once: bool = False,
    ) -> bool:
        """Show the figures of a picture, `at_once` or when a line is due; returns whether the time
        is over."""
        now_s = time.monotonic()
        if self._begun_s is None:  # the time it took to begin does not count
            self._begun_s = now_s
        if self._json:
            say_json(fields())
        elif now_s >= self._next_s or at_once:
            self._next_s = now_s + self._wait_s
            write_stdout(f"\r{line()}\x1b[K" if self._rewrites else f"{line()}\n")
        return self._seconds is not None and now_s - self._begun_s >= self._seconds

    def end(self) -> None:
        """Finish the line of figures: no more will come."""
        if self._rewrites and self._begun_s is not None:
            write_stdout("\n")
