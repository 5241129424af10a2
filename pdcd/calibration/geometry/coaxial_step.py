"""Do mask and projector look from one point? A card at two distances tells."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np
from numpy.typing import NDArray

from pdcd.calibration.arrows import arrows
from pdcd.calibration.charts import sheet
from pdcd.calibration.figures import Figure, Verdict
from pdcd.calibration.geometry.coaxial import Parallax, parallax
from pdcd.calibration.geometry.compose import compose, one_field
from pdcd.calibration.geometry.geometry_step import both_by_dots
from pdcd.calibration.script import Ask, Outcome, Script, Session, Taken, Wanted
from pdcd.errors import CalibrationError
from pdcd.panels.map import Map, between

FAR = 1.1
"""Distance of the second card over that of the first one, from the projector."""
DIMMER = 0.70, 0.92
"""Light of the far card over that of the near one, by the square of the distance 0.83; the card's
angle counts, too."""
BUDGET_PX = 0.3
"""Offset that a scene may have from front to back."""
SIGMA_PX = 0.02
"""Error of the maps of a card, at the least."""


def coaxial(session: Session) -> Script:
    """Dots of both panels on a card at a distance, then a tenth further away: 12 photos.

    Lengths are told in projector pixels and in distances of the near card, so nothing has to be
    measured in metres. Raises CalibrationError where the card did not move, as when nobody was
    there to move it.
    """
    yield Ask("put the card where the nearest point of a scene will be, square to the axis")
    near = yield from _card(session, "near-")
    yield Ask("move the card a tenth of its distance from the projector further away, still square")
    far = yield from _card(session, "far-")
    dimmer = far[3] / near[3]
    if not DIMMER[0] < dimmer < DIMMER[1]:
        raise CalibrationError(
            f"the second card is {dimmer:.0%} as bright as the first one; a card a tenth further "
            f"away is {DIMMER[0]:.0%} to {DIMMER[1]:.0%}",
            hint="run the step attended, and move the card a tenth of its distance from the "
            "projector further away when asked",
        )
    error = max(SIGMA_PX, near[2], far[2])
    found = parallax((near[0], far[0]), (near[1], far[1]), (1.0, FAR), 1.0, error)
    moved = found.offset_px(1.0, FAR)
    sigma = found.sideways_sigma_m * (1.0 - 1.0 / FAR)
    deepest = found.deepest_m(1.0, BUDGET_PX)
    good = moved <= BUDGET_PX
    advice = () if good else (_advice(found, moved, deepest),)
    return Outcome(
        figures=(
            Figure(
                "coaxial.offset_px", moved, sigma, "px", f"at most {BUDGET_PX:g} px over a tenth "
                "of the distance", Verdict.GOOD if good else Verdict.DOUBTFUL,
            ),
            Figure("coaxial.left_px", found.left_px, 0.0, "px"),
            Figure("coaxial.deepest", deepest, 0.0, "distances of the near card"),
        ),
        advice=advice,
        picture=_picture(near[:2], far[:2]),
    )  # fmt: skip


def _card(
    session: Session, prefix: str
) -> Generator[Wanted | Ask, Taken | None, tuple[Map, Map, float, float]]:
    """Maps of mask and projector on one card, the error of the former in projector pixels, and how
    bright the card was."""
    projector, mask, bright = yield from both_by_dots(session, prefix)
    composed = compose(projector.green, mask.green)
    field = one_field(composed)
    width, height = field.mask.size_px
    middle = np.array([[0.5 * width, 0.5 * height]])
    return field.mask, field.projector, float(composed.sigma_px(middle).max()), bright


def _advice(found: Parallax, moved: float, deepest: float) -> str:
    right, down = found.apart_m[:2].tolist()
    ways = [
        word
        for way, words in ((right, ("left", "right")), (down, ("up", "down")))
        if abs(way) > 0.3 * np.hypot(right, down)
        for word in (words[int(way > 0.0)],)
    ]
    return (
        f"registration moves by {moved:.2f} px over a tenth of the distance: the mask's centre of "
        f"projection lies beside the projector's ({' and '.join(ways)}); shift one of them until "
        f"it does not, or keep the scene within {deepest:.2f} distances of its nearest point"
    )


def _picture(near: tuple[Map, Map], far: tuple[Map, Map]) -> NDArray[np.uint8]:
    """By how much the mask's pixels moved over the projector."""
    width, height = near[0].size_px
    x, y = ((np.arange(n) + 0.5) / n for n in (16, 12))
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    points = places * (width, height)
    one, two = (between(mask, projector, points) for mask, projector in (near, far))
    picture = sheet()
    title = "how the mask's pixels move over the projector, from the near card to the far one"
    arrows(picture, (20, 40, 680, min(510, round(680 * height / width))), places, two - one,
                  title)  # fmt: skip
    return picture
