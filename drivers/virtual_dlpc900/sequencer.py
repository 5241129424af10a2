"""The sequencer of the virtual DLPC900: which pattern stood when, to the nanosecond.

Nothing is stepped through. A run of patterns is stored as its beginning and its entries, and what
was shown in any interval is computed on request. So a sequence may go on for hours, and all times
come from the caller.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Literal

import numpy as np

from .decode import DecodedWords
from .model import VirtualDmdOptions

_BLACK_US = 105
"""Length of the black pattern before a pattern that waits."""
_PULSE_NS = 20_000
_KEPT = 4096
"""Runs and stands that are remembered: enough for an exposure with a trigger for each pattern."""


@dataclass(frozen=True, eq=False)
class PlayedPlane:
    """One bit of an image as it stands in memory; `bit` counts from the least of its words."""

    words: DecodedWords = field(repr=False)
    bit: int


PlayedContent = PlayedPlane | None
"""What stands; None is black."""


@dataclass(frozen=True)
class PlayedEntry:
    """An entry of the LUT. `pulses`: whether it gives a pulse at TRIG_OUT_2."""

    exposure_us: int
    dark_us: int
    clear: bool
    waits: bool
    pulses: bool
    image: int
    bit: int


class PlayedProgram:
    """Entries in the order they are shown, what each shows, and how many patterns there are."""

    def __init__(
        self,
        entries: Sequence[PlayedEntry],
        order: Sequence[int],
        planes: Sequence[PlayedContent],
        most: int,
    ) -> None:
        """order : numbers of entries. planes : of all entries. most : patterns to show; 0: no end.

        An entry that is followed by one that waits, in the configured order, ends with a black
        pattern; it keeps that wherever `order` shows it.
        """
        last = len(entries)
        self.entries = tuple(entries[number] for number in order)
        self.planes = tuple(planes[number] for number in order)
        self.black_us = tuple(
            _BLACK_US if entries[(number + 1) % last].waits else 0 for number in order
        )
        self.most = most
        own = zip(self.entries, self.black_us, strict=True)
        lengths = (entry.exposure_us + entry.dark_us + black_us for entry, black_us in own)
        self._starts_us = list(accumulate(lengths, initial=0))

    def start_us(self, number: int) -> int:
        """When the pattern of that number begins, after the start of the program."""
        rounds, place = divmod(number, len(self.entries))
        return rounds * self._starts_us[-1] + self._starts_us[place]

    def number_at(self, us: float) -> int:
        """The number of the pattern that stands at that time."""
        rounds, rest = divmod(us, self._starts_us[-1])
        return int(rounds) * len(self.entries) + bisect_right(self._starts_us, rest) - 1

    def next_halt(self, first: int) -> int | None:
        """The number before which a run from `first` on ends: that of a pattern that waits, or
        the count of all patterns. None: it goes on for ever."""
        for number in range(first + 1, first + 1 + len(self.entries)):
            if self.most and number >= self.most:
                return self.most
            if self.entries[number % len(self.entries)].waits:
                return number
        return self.most or None

    def contents(self, number: int) -> list[tuple[int, PlayedContent]]:
        """What a pattern shows, each with the time after the pattern's beginning, in us."""
        place = number % len(self.entries)
        entry, plane, black_us = self.entries[place], self.planes[place], self.black_us[place]
        found: list[tuple[int, PlayedContent]] = [(0, plane)]
        # Without a trigger the mirrors are cleared by themselves.
        cleared = entry.clear or not entry.waits
        if cleared and entry.dark_us + black_us:
            found.append((entry.exposure_us, None))
        elif black_us:
            found.append((entry.exposure_us + entry.dark_us, None))
        return found


@dataclass(frozen=True)
class _Stand:
    """Something that stands until the next command."""

    begin_ns: int
    content: PlayedContent

    def changes(self, low_ns: int, _high_ns: int) -> Iterator[tuple[int, PlayedContent]]:
        yield low_ns, self.content


@dataclass(frozen=True)
class _Run:
    """Patterns timed by the crystal only, without triggers, from number `first` on."""

    begin_ns: int
    program: PlayedProgram
    first: int
    halt: int | None
    ns_per_us: float

    def time_ns(self, number: int, after_us: int = 0) -> int:
        """The time `after_us` after a pattern begins."""
        us = self.program.start_us(number) - self.program.start_us(self.first) + after_us
        return self.begin_ns + round(us * self.ns_per_us)

    def number_at(self, at_ns: int) -> int:
        """The number of the pattern that stands at that time."""
        us = (at_ns - self.begin_ns + 0.5) / self.ns_per_us + self.program.start_us(self.first)
        return max(self.first, self.program.number_at(us))

    def patterns(self, low_ns: int, high_ns: int) -> Iterator[int]:
        """Numbers of the patterns that stand in an interval."""
        number = self.number_at(low_ns)
        halt = math.inf if self.halt is None else self.halt
        while number < halt and self.time_ns(number) < high_ns:
            yield number
            number += 1

    def changes(self, low_ns: int, high_ns: int) -> Iterator[tuple[int, PlayedContent]]:
        for number in self.patterns(low_ns, high_ns):
            for after_us, content in self.program.contents(number):
                at_ns = self.time_ns(number, after_us)
                if at_ns < high_ns:
                    yield max(at_ns, low_ns), content


class DmdSequencer:
    """Shows a program, waits for triggers, and remembers what stood when.

    missed : triggers that came while it did not wait for one. aborted : it gave up.
    """

    def __init__(self, options: VirtualDmdOptions) -> None:
        self._options, timing = options, options.timing
        self._ns_per_us = 1000.0 / (1.0 + 1e-6 * timing.crystal_ppm)
        self._rng = np.random.default_rng(timing.seed)
        self._past: deque[_Stand | _Run] = deque([_Stand(-(2**62), None)], maxlen=_KEPT)
        self._state: Literal["stopped", "paused", "runs", "waits"] = "stopped"
        self._program: PlayedProgram | None = None
        self._number = 0
        self._armed_ns = 0
        self._abort_at: int | None = None
        self.missed = 0
        self.aborted = False

    @property
    def active(self) -> bool:
        """Whether a sequence runs or waits, as of the latest time given to a method."""
        return self._state in ("runs", "waits")

    @property
    def stopped(self) -> bool:
        """Whether there is no sequence, not even a paused one."""
        return self._state == "stopped"

    def darken(self, now_ns: int) -> None:
        """End whatever goes on. Nothing stands from now on, whatever option `after_stop` says."""
        self.settle(now_ns)
        self._state = "stopped"
        self._put(_Stand(now_ns, None))

    def start(self, now_ns: int, program: PlayedProgram, abort_after: int | None = None) -> None:
        """Begin a program, or go on with the pattern at which it was paused."""
        self.settle(now_ns)
        if self.active:
            return
        if self._state != "paused":
            self._program, self._number = program, 0
            self._abort_at = abort_after
        self.aborted = False
        self._enter(now_ns + self._options.timing.start_ns)

    def pause(self, now_ns: int) -> None:
        """Hold the pattern that stands."""
        self.settle(now_ns)
        if self.active:
            last = self._past[-1]
            if isinstance(last, _Run):
                self._number = last.number_at(max(now_ns, last.begin_ns))
            self._put(_Stand(now_ns, self.content_at(now_ns)))
            self._state = "paused"

    def stop(self, now_ns: int) -> None:
        """End the sequence; the next start begins it anew."""
        self.settle(now_ns)
        content = self.content_at(now_ns)
        self._state = "stopped"
        self._put(_Stand(now_ns, content if self._options.after_stop == "holds" else None))

    def trigger(self, at_ns: int, delay_us: int) -> None:
        """An edge at TRIG_IN_1."""
        self.settle(at_ns)
        if self._state != "waits" or at_ns < self._armed_ns:
            self.missed += 1
            return
        timing = self._options.timing
        late_ns = timing.latency_ns + round(timing.jitter_ns * self._rng.standard_normal())
        self._run(at_ns + max(0, round(delay_us * self._ns_per_us) + late_ns))

    def hold(self, at_ns: int, content: PlayedContent) -> None:
        """Show something until the next command: a picture of plain video."""
        self.settle(at_ns)
        self._state = "stopped"
        self._put(_Stand(at_ns, content))

    def show_picture(self, at_ns: int, program: PlayedProgram) -> None:
        """A picture begins on the signal: a waiting sequence shows its planes. A sequence that
        still runs when the next picture begins gives up."""
        self.settle(at_ns)
        if self._state == "waits":
            self._program = program
            self._run(at_ns + self._options.timing.latency_ns)
        elif self._state == "runs":
            self.lose_picture(at_ns)

    def lose_picture(self, at_ns: int) -> None:
        """Give up: the signal has ended, or its next picture came too early."""
        was_active = self.active
        self.stop(at_ns)
        self.aborted |= was_active

    def settle(self, now_ns: int) -> None:
        """Advance to that time."""
        while self._state == "runs":
            run = self._past[-1]
            assert isinstance(run, _Run)  # noqa: S101
            if run.halt is None or run.time_ns(run.halt) > now_ns:
                return
            self._halt(run, run.halt)

    def _halt(self, run: _Run, number: int) -> None:
        """End the run, after the last pattern or before one that waits."""
        end_ns, place = run.time_ns(number), (number - 1) % len(run.program.entries)
        last = run.program.contents(number - 1)[-1][1]
        self._number = number
        if number == self._abort_at:
            self._state, self.aborted = "stopped", True
            self._put(_Stand(end_ns, last))
        elif run.program.most and number >= run.program.most:
            self._state = "stopped"
            holds = self._options.after_last == "holds"
            self._put(_Stand(end_ns, last if holds else None))
        else:
            self._put(_Stand(end_ns, None if run.program.black_us[place] else last))
            self._state, self._armed_ns = "waits", end_ns

    def _enter(self, at_ns: int) -> None:
        """Show the next pattern, or wait for its trigger in the dark."""
        assert self._program is not None  # noqa: S101
        entries = self._program.entries
        if entries[self._number % len(entries)].waits:
            self._put(_Stand(at_ns, None))
            self._state, self._armed_ns = "waits", at_ns
        else:
            self._run(at_ns + self._options.timing.latency_ns)

    def _run(self, begin_ns: int) -> None:
        program = self._program
        assert program is not None  # noqa: S101
        halt, abort = program.next_halt(self._number), self._abort_at
        if abort is not None and self._number < abort and (halt is None or abort < halt):
            halt = abort
        self._put(_Run(begin_ns, program, self._number, halt, self._ns_per_us))
        self._state = "runs"

    def _put(self, piece: _Stand | _Run) -> None:
        """Add a piece; it replaces those that would begin later."""
        while len(self._past) > 1 and self._past[-1].begin_ns >= piece.begin_ns:
            self._past.pop()
        self._past.append(piece)

    # What was shown

    def content_at(self, at_ns: int) -> PlayedContent:
        """What stands at that time."""
        return self.list_changes(at_ns, at_ns + 1)[-1][1]

    def list_changes(self, low_ns: int, high_ns: int) -> list[tuple[int, PlayedContent]]:
        """What stood from `low_ns` on, and each change before `high_ns`."""
        self.settle(high_ns)
        return [
            change
            for piece, until_ns in self._pieces()
            if piece.begin_ns < high_ns and until_ns > low_ns
            for change in piece.changes(max(low_ns, piece.begin_ns), min(high_ns, until_ns))
        ]

    def list_pulses(
        self, line: Literal[1, 2], low_ns: int, high_ns: int, delays_us: tuple[int, int]
    ) -> list[tuple[int, int]]:
        """Rising and falling edges at a trigger output, of patterns that stood in an interval.
        Line 1 is up during each exposure, and stays up if the next follows at once."""
        self.settle(high_ns)
        found: list[tuple[int, int]] = []
        rise_us, fall_us = delays_us
        for run, until_ns in self._pieces():
            if not isinstance(run, _Run) or run.begin_ns >= high_ns or until_ns <= low_ns:
                continue
            high = min(high_ns, until_ns)
            for number in run.patterns(max(low_ns, run.begin_ns), high):
                entry = run.program.entries[number % len(run.program.entries)]
                up_ns = run.time_ns(number, rise_us)
                if line == 2:
                    found += [(up_ns, up_ns + _PULSE_NS)] if entry.pulses else []
                    continue
                down_ns = min(run.time_ns(number, entry.exposure_us + fall_us), until_ns)
                if found and up_ns <= found[-1][1]:
                    found[-1] = found[-1][0], down_ns
                else:
                    found.append((up_ns, down_ns))
        return found

    def _pieces(self) -> Iterator[tuple[_Stand | _Run, int]]:
        """All that stood, each with the time at which it ended."""
        pieces = list(self._past)
        ends = [piece.begin_ns for piece in pieces[1:]] + [2**62]
        yield from zip(pieces, ends, strict=True)
