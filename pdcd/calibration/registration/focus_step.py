"""How sharp it is, photo by photo, while somebody turns the rings: first the relay, between mask
and camera, then the projector."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

from pdcd.calibration.figures import Figure, Verdict
from pdcd.calibration.photo import Photo
from pdcd.calibration.registration.focus import LEAST_PERIODS, PARTS, Depth, depth
from pdcd.calibration.script import Ask, Outcome, Script, Session, Taken, Wanted, take
from pdcd.calibration.shown import still
from pdcd.errors import CalibrationError
from pdcd.panels.frames import WHITE
from pdcd.panels.map import Map, between

PHOTOS = 15
"""Photos of each panel, at most."""
STILL = 3
"""Photos alike after which nobody turns a ring."""
ALIKE = 0.02
"""Difference of depths that is none."""
LEAST_QUADS = 6.0
"""Quads of a period, at least."""
GUESSES = (1.0, 0.8, 1.25, 0.64, 1.56)
"""Scales that are tried where no map tells how large a pixel is in the photo."""
NEAR_BEST, SHARP = 0.9, 0.6
"""Depth over the best so far at which it may stay; depth of stripes that are sharp enough."""
TILTED = 0.3
"""Change of ln depth over the field from which something is tilted."""
RINGS = {
    "mask": "the camera on the mask (the relay)",
    "projector": "the projector on the card",
}


def focus(session: Session) -> Script:
    """A photo of stripes, its number, and again: up to 15 of each panel, less where nobody turns.

    Raises CalibrationError where no stripes are seen at all.
    """
    depths: dict[str, list[Depth]] = {}
    for panel in RINGS:
        depths[panel] = yield from _rounds(session, panel)
    figures, advice = [], []
    for panel, seen in depths.items():
        last, best = seen[-1].number, max(each.number for each in seen)
        good = last >= NEAR_BEST * best and last >= SHARP
        figures.append(
            Figure(
                f"focus.{panel}", last, seen[-1].number_sigma, "",
                f"at least {SHARP:g}, and {NEAR_BEST:.0%} of the best, {best:.3f}",
                Verdict.GOOD if good else Verdict.DOUBTFUL,
            )
        )  # fmt: skip
        if not good:
            advice.append(f"focus {RINGS[panel]}: {last:.2f}, the best so far was {best:.2f}")
        right, down = seen[-1].slope
        if max(abs(right), abs(down)) > TILTED:
            advice.append(
                f"sharpness of the {panel}'s stripes changes over the field: by {right:+.1f} from "
                f"left to right and {down:+.1f} from top to bottom (logarithms): something is "
                "tilted"
            )
    return Outcome(figures=tuple(figures), advice=tuple(advice))


def _rounds(session: Session, panel: str) -> Generator[Wanted | Ask, Taken | None, list[Depth]]:
    """Depths of one panel's stripes, until it is enough."""
    period_px, period_quads, axis = _period(session, panel)
    bits = _stripes(session, panel, period_px)
    seen: list[Depth] = []
    for number in range(1, PHOTOS + 1):
        sides = (bits, WHITE) if panel == "projector" else (WHITE, bits)
        taken = yield from take(Wanted(still(f"{panel}-{number}", session.full, *sides)))
        found, period_quads, axis = _measured(session.photo(taken), period_quads, axis)
        seen.append(found)
        recent = [each.number for each in seen[-STILL:]]
        best = max(each.number for each in seen)
        if len(seen) >= STILL and max(recent) - min(recent) < ALIKE * best:
            break
        yield Ask(
            f"focus {RINGS[panel]}: now {found.number:.3f}, best so far {best:.3f} "
            f"({found.number / best:.0%}); leave the ring where it is best to go on",
            found.number,
            best,
        )
    return seen


def _measured(photo: Photo, period_quads: float, axis: int | None) -> tuple[Depth, float, int]:
    """Depth of the stripes, their period in quads and their axis in the photo as they were found.

    axis : as `depth`; None where neither it nor the period is known.
    """
    best: tuple[Depth, float, int] | None = None
    failed = CalibrationError(
        "the photo has too few quads for stripes that the camera can tell apart", device="camera"
    )
    for way in (0, 1) if axis is None else (axis,):  # a camera may be turned by a quarter
        most = photo.frame[1 - way] // PARTS[1 - way] / LEAST_PERIODS
        for scale in GUESSES if axis is None else (1.0,):
            if scale * period_quads > most:
                continue
            try:
                found = depth(photo, way, scale * period_quads)
            except CalibrationError as err:
                failed = err
                continue
            if best is None or found.number > best[0].number:
                best = found, scale * period_quads, way
    if best is None:
        raise failed
    return best


def _period(session: Session, panel: str) -> tuple[int, float, int | None]:
    """Period of the stripes in pixels of the panel, and in quads; the axis in the photo along which
    they follow each other, None where a map tells neither."""
    camera, map_ = session.config.camera.place.map, getattr(session.config, panel).place.map
    width, _ = getattr(session.config, panel).size_px
    axis = None
    if isinstance(camera, Map) and isinstance(map_, Map):
        middle = 0.5 * np.array([map_.size_px], dtype=np.float64)
        ends = [between(map_, camera, middle + np.array([step, 0.0])) for step in (-0.5, 0.5)]
        right, down = (ends[1] - ends[0])[0].tolist()
        quads, axis = float(np.hypot(right, down)), int(abs(down) > abs(right))
    else:
        frame = session.camera.frame_quads
        quads = (frame[0] if frame is not None else 2.0 * width) / width
    half = max(2, int(np.ceil(0.5 * LEAST_QUADS / quads)))
    return 2 * half, 2 * half * quads, axis


def _stripes(session: Session, panel: str, period_px: int) -> NDArray[np.bool_]:
    """Upright stripes of a panel, (height, width) bool."""
    width, height = getattr(session.config, panel).size_px
    lit = np.arange(width) % period_px < period_px // 2
    return np.broadcast_to(lit, (height, width)).copy()
