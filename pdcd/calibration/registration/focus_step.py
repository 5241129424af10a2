"""How sharp the picture is, photo by photo, while somebody turns the rings: first the relay,
between mask and camera, then the projector."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from pdcd.calibration.figures import MeasuredFigure, Verdict
from pdcd.calibration.geometry.panel_map import quads_across_px
from pdcd.calibration.registration.focus import StripeDepth, measure_stripe_depth
from pdcd.calibration.script import (
    CalibrationPhoto,
    CalibrationSession,
    PhotoRequest,
    StepOutcome,
    StepScript,
    UserPrompt,
    take_photo,
)
from pdcd.calibration.shown import PanelName, make_sole_sequence
from pdcd.panels.map import Map

_PHOTOS = 15
"""Photos of each panel, at most."""
_STILL = 3
"""Photos of equal depth after which the ring counts as left alone."""
_ALIKE = 0.02
"""Difference of depths, over the best, below which they count as equal."""
_LEAST_QUADS = 6.0
"""Quads of a period, at least."""
_NEAR_BEST, _SHARP = 0.9, 0.6
"""Depth over the best so far from which the focus is accepted; depth of stripes that are sharp
enough."""
_TILTED = 0.3
"""Change of the depth's logarithm over the field from which something is tilted."""
_RINGS: dict[PanelName, str] = {
    "mask": "the camera on the mask (the relay)",
    "projector": "the projector on the card",
}


def watch_focus(session: CalibrationSession) -> StepScript:
    """Photograph stripes and report their depth, again and again: up to 15 photos of each panel,
    fewer where nobody turns a ring.

    Raises CalibrationError where no stripes are seen at all.
    """
    depths: dict[PanelName, list[StripeDepth]] = {}
    for panel in _RINGS:
        depths[panel] = yield from _rounds(session, panel)
    figures, advice = [], []
    for panel, seen in depths.items():
        last, best = seen[-1].number, max(each.number for each in seen)
        good = last >= _NEAR_BEST * best and last >= _SHARP
        figures.append(
            MeasuredFigure(
                f"focus.{panel}", last, seen[-1].number_sigma, "",
                f"at least {_SHARP:g}, and {_NEAR_BEST:.0%} of the best, {best:.3f}",
                Verdict.GOOD if good else Verdict.DOUBTFUL,
            )
        )  # fmt: skip
        if not good:
            advice.append(f"focus {_RINGS[panel]}: {last:.2f}, the best so far was {best:.2f}")
        right, down = seen[-1].slope
        if max(abs(right), abs(down)) > _TILTED:
            advice.append(
                f"sharpness of the {panel}'s stripes changes over the field: by {right:+.1f} from "
                f"left to right and {down:+.1f} from top to bottom (logarithms): something is "
                "tilted"
            )
    return StepOutcome(figures=tuple(figures), advice=tuple(advice))


def _rounds(
    session: CalibrationSession, panel: PanelName
) -> Generator[PhotoRequest | UserPrompt, CalibrationPhoto | None, list[StripeDepth]]:
    """Depths of one panel's upright stripes, until the ring is left alone."""
    width, height = getattr(session.config, panel).size_px
    quads_a_px = _quads_a_px(session, panel)
    half = max(2, int(np.ceil(0.5 * _LEAST_QUADS / quads_a_px)))
    bits = np.broadcast_to(np.arange(width) % (2 * half) < half, (height, width)).copy()
    seen: list[StripeDepth] = []
    for number in range(1, _PHOTOS + 1):
        shown = make_sole_sequence(f"{panel}-{number}", session.full, panel, bits)
        taken = yield from take_photo(PhotoRequest(shown))
        found = measure_stripe_depth(session.photo(taken), 2 * half * quads_a_px)
        seen.append(found)
        recent = [each.number for each in seen[-_STILL:]]
        best = max(each.number for each in seen)
        if len(seen) >= _STILL and max(recent) - min(recent) < _ALIKE * best:
            break
        yield UserPrompt(
            f"focus {_RINGS[panel]}: now {found.number:.3f}, best so far {best:.3f} "
            f"({found.number / best:.0%}); leave the ring where it is best to go on",
            found.number,
            best,
        )
    return seen


def _quads_a_px(session: CalibrationSession, panel: str) -> float:
    """Quads of the photo per pixel of the panel: by the maps, or as if its picture filled the
    frame."""
    camera, map_ = session.config.camera.place.map, getattr(session.config, panel).place.map
    if isinstance(camera, Map) and isinstance(map_, Map):
        return quads_across_px(map_, camera)
    frame = session.camera.frame_quads
    return frame[0] / getattr(session.config, panel).size_px[0] if frame is not None else 2.0
