"""One panel's map by stripes: which panel pixel each quad sees, from photos of sines.

Periods are numbered by a map that is nearly right, or by XOR codes; a Gray code would fail where
light comes round corners.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence

import numpy as np

from pdcd.arrays import Floats
from pdcd.calibration.geometry import blocks
from pdcd.calibration.geometry.fit import FittedMap
from pdcd.calibration.geometry.lit import OFFSETS_QUADS
from pdcd.calibration.geometry.panel_map import fit_decoded_quads
from pdcd.calibration.geometry.phase import (
    PhaseCode,
    Placed,
    Sines,
    check_periods,
    join_axes,
    join_axes_on_panel,
)
from pdcd.calibration.geometry.xor import XorCode, XorPlanes
from pdcd.calibration.photo import pick_main
from pdcd.calibration.script import (
    CalibrationPhoto,
    CalibrationSession,
    PhotoRequest,
    UserPrompt,
    take_photo,
)

_BASES_PX = (4, 8, 16, 32)
_BASE_QUADS = 3.5
"""Base stripes of XOR codes: the narrowest of `_BASES_PX` that are so wide in a photo."""


def measure_stripes(
    session: CalibrationSession, code: PhaseCode, near_px: Sequence[Floats]
) -> Generator[PhotoRequest | UserPrompt, CalibrationPhoto | None, list[FittedMap]]:
    """Photograph sines along both axes, and random blocks; the maps from quads to the panel in each
    colour.

    Periods are numbered by the best of some priors, each (h, w, 2) pixels of the panel: the one on
    whose offset most quads agree, whatever that offset is. Raises CalibrationError where none is
    near enough.
    """
    axes, beliefs, half = [], [], np.zeros((0, 0))
    for axis in (0, 1):
        sines, pattern = yield from _sines(session, code, axis)
        tried = [(near[..., axis], *pick_main(sines).beside(near[..., axis])) for near in near_px]
        best, moved_px, _ = max(tried, key=lambda one: one[2])
        beliefs.append(best + moved_px)
        axes.append(_placed(sines, beliefs[axis]))
        half = pick_main(sines).mean
    seen = join_axes([pick_main(axis) for axis in axes], code)
    check_periods(seen, np.stack(beliefs, axis=-1), code)
    taken = yield from take_photo(
        PhotoRequest(blocks.make_block_sequence(code, code.levels * _repeats(session, code)))
    )
    off = blocks.find_period_error(session.photo(taken), half, seen, code)
    away_px = code.period_px * np.array(off)
    moved = [[(at + by, *rest) for at, *rest in a] for a, by in zip(axes, away_px, strict=True)]
    joined = [join_axes_on_panel(list(both), code) for both in zip(*moved, strict=True)]
    size, panel, subject = code.size_px, code.panel, session.subject
    return [
        fit_decoded_quads(seen, size, panel, offset_quads=offset_quads, subject=subject)
        for offset_quads, seen in zip(OFFSETS_QUADS[pattern], joined, strict=True)
    ]


def measure_xor_map(
    session: CalibrationSession, code: XorCode
) -> Generator[PhotoRequest | UserPrompt, CalibrationPhoto | None, FittedMap]:
    """Whole pixels, decoded without a prior: a map that is good enough to number sines by. Raises
    CalibrationError."""
    planes = yield from photograph_xor_code(session, code)
    return fit_decoded_quads(planes.decoded(), code.size_px, code.panel, subject=session.subject)


def photograph_xor_code(
    session: CalibrationSession, code: XorCode
) -> Generator[PhotoRequest | UserPrompt, CalibrationPhoto | None, XorPlanes]:
    """All photos of an XOR code."""
    planes = XorPlanes(code)
    for shown in code.shown(max(1, session.full)):
        taken = yield from take_photo(PhotoRequest(shown))
        planes.add(session.photo(taken))
    return planes


def base_px(quads_per_px: float) -> int:
    """Width of the narrowest base stripes that a camera resolves where a pixel spans so many quads;
    the widest where it resolves none."""
    return next((base for base in _BASES_PX if base * quads_per_px >= _BASE_QUADS), _BASES_PX[-1])


def _repeats(session: CalibrationSession, code: PhaseCode) -> int:
    """How often a picture of a sine is shown, so that all of them last as long as white does."""
    return max(1, session.full // code.levels)


def _sines(
    session: CalibrationSession, code: PhaseCode, axis: int
) -> Generator[PhotoRequest | UserPrompt, CalibrationPhoto | None, tuple[list[Sines], str]]:
    """The sums of an axis in each colour, and the camera's mosaic."""
    sums: list[Sines] = []
    pattern = ""
    for shown in code.shown(axis, _repeats(session, code)):
        taken = yield from take_photo(PhotoRequest(shown))
        photo, pattern = session.photo(taken), taken.raw.pattern
        sums = sums or [Sines(code, channel) for channel in range(photo.colours)]
        for of_colour in sums:
            of_colour.add(photo)
    pick_main(sums).refuse_flat()
    return sums, pattern


def _placed(sines: Sequence[Sines], near_px: Floats) -> list[Placed]:
    """Pixels along an axis in each colour; red and blue take their periods from green."""
    main = pick_main(sines)
    placed = main.place(near_px)
    return [placed if one is main else one.place(placed[0]) for one in sines]
