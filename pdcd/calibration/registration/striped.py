"""One panel's map by stripes: what each quad sees, in photos of sines that time adds up.

Which period it is, a Gray code tells (on a card), or a map that is nearly right, or XOR codes: on a
scene, where light comes round corners, only these two are of use.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pdcd.calibration.geometry import blocks
from pdcd.calibration.geometry.fit import Fitted
from pdcd.calibration.geometry.lit import BLUE, GREEN, OFFSETS_QUADS, RED
from pdcd.calibration.geometry.panel_map import fit_decoded
from pdcd.calibration.geometry.phase import (
    Decoded,
    HalfPeriods,
    PhaseCode,
    Placed,
    Sines,
    both,
    joined,
    refuse_wrapped,
)
from pdcd.calibration.geometry.xor import XorCode, XorPlanes
from pdcd.calibration.script import Ask, Session, Taken, Wanted, take
from pdcd.calibration.shown import Shown

Floats = NDArray[np.float64]

COLOURS = (RED, GREEN, BLUE)
BASES_PX = (4, 8, 16, 32)
BASE_QUADS = 3.5
"""Base stripes of XOR codes: the narrowest that are so wide in a photo."""


@dataclass(frozen=True, eq=False)
class Striped:
    """What stripes told of a panel in red, green and blue."""

    seen: tuple[Decoded, ...]
    pattern: str

    def fitted(self, session: Session, code: PhaseCode) -> list[Fitted]:
        """The maps from quads to the panel. Raises CalibrationError."""
        offsets = OFFSETS_QUADS[self.pattern]
        return [
            fit_decoded(
                seen,
                code.size_px,
                code.panel,
                offset_quads=offsets[channel],
                subject=session.subject,
            )
            for channel, seen in zip(COLOURS, self.seen, strict=True)
        ]


def by_gray(session: Session, code: PhaseCode) -> Generator[Wanted | Ask, Taken | None, Striped]:
    """Sines and a Gray code of half periods for either axis. Raises CalibrationError."""
    axes = []
    for shown in _by_axis(session, code, numbered=True):
        sines, pattern = yield from _sines(session, code, shown[: code.steps])
        halves = HalfPeriods(code, sines[GREEN])
        for one in shown[code.steps :]:
            taken = yield from take(Wanted(one))
            halves.add(session.photo(taken))
        axes.append(_placed(sines, halves.near_px))
    return Striped(_joined(axes, code), pattern)


def by_maps(
    session: Session, code: PhaseCode, near_px: Sequence[Floats]
) -> Generator[Wanted | Ask, Taken | None, Striped]:
    """Sines alone, and random blocks. They are numbered by the best of some beliefs, each (h, w, 2)
    pixels of the panel: those that most quads agree on, wherever all of them have moved to. Raises
    CalibrationError where none is near enough."""
    axes, beliefs, half = [], [], np.zeros((0, 0))
    for axis, shown in enumerate(_by_axis(session, code, numbered=False)):
        sines, pattern = yield from _sines(session, code, shown)
        tried = [(near[..., axis], *sines[GREEN].beside(near[..., axis])) for near in near_px]
        best, moved_px, _ = max(tried, key=lambda one: one[2])
        beliefs.append(best + moved_px)
        axes.append(_placed(sines, beliefs[axis]))
        half = sines[GREEN].mean
    seen = both([axis[GREEN] for axis in axes], code)
    refuse_wrapped(seen, np.stack(beliefs, axis=-1), code)
    taken = yield from take(Wanted(blocks.shown(code, code.levels * _repeats(session, code))))
    off = blocks.periods_off(session.photo(taken), half, seen, code, GREEN)
    away_px = code.period_px * np.array(off)
    moved = [[(at + by, *rest) for at, *rest in a] for a, by in zip(axes, away_px, strict=True)]
    return Striped(_joined(moved, code), pattern)


def by_xor(session: Session, code: XorCode) -> Generator[Wanted | Ask, Taken | None, Fitted]:
    """Whole pixels without any belief: a map that is near enough to number sines by. Raises
    CalibrationError."""
    planes = yield from planes_of(session, code)
    return fit_decoded(planes.decoded(), code.size_px, code.panel, subject=session.subject)


def planes_of(session: Session, code: XorCode) -> Generator[Wanted | Ask, Taken | None, XorPlanes]:
    """All photos of an XOR code."""
    planes = XorPlanes(code)
    for shown in code.shown(max(1, session.full)):
        taken = yield from take(Wanted(shown))
        planes.add(session.photo(taken))
    return planes


def base_px(quads_per_px: float) -> int:
    """Width of the base stripes that a camera resolves of which a pixel has so many quads."""
    return next((base for base in BASES_PX if base * quads_per_px >= BASE_QUADS), BASES_PX[-1])


def _repeats(session: Session, code: PhaseCode) -> int:
    """How often a picture of a sine is shown, so that all of them last as long as white does."""
    return max(1, session.full // code.levels)


def _by_axis(
    session: Session, code: PhaseCode, *, numbered: bool
) -> tuple[tuple[Shown, ...], tuple[Shown, ...]]:
    """The photos of either axis."""
    shown = code.shown(_repeats(session, code), numbered=numbered)
    first = code.steps + (code.bits(0) if numbered else 0)
    return shown[:first], shown[first:]


def _sines(
    session: Session, code: PhaseCode, shown: Sequence[Shown]
) -> Generator[Wanted | Ask, Taken | None, tuple[list[Sines], str]]:
    """The sums of an axis in the three colours, and the camera's mosaic."""
    sums, pattern = [Sines(code, channel) for channel in COLOURS], ""
    for one in shown:
        taken = yield from take(Wanted(one))
        photo, pattern = session.photo(taken), taken.raw.pattern
        for of_colour in sums:
            of_colour.add(photo)
    sums[GREEN].refuse_flat()
    return sums, pattern


def _placed(sines: Sequence[Sines], near_px: Floats) -> list[Placed]:
    """Pixels along an axis in the three colours: red and blue are where green is."""
    green = sines[GREEN].place(near_px)
    return [green if c == GREEN else sines[c].place(green[0]) for c in COLOURS]


def _joined(axes: Sequence[Sequence[Placed]], code: PhaseCode) -> tuple[Decoded, ...]:
    return tuple(joined([axis[channel] for axis in axes], code) for channel in COLOURS)
