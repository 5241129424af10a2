"""Takes the photos of the light along the borders of cells."""

from __future__ import annotations

from collections.abc import Generator

import msgspec

from pdcd.bench.tables import Config
from pdcd.capture.worker.answers import Order, PhotoOrder, PhotoOutcome, SpoiltPhoto
from pdcd.capture.worker.exposing import Exposer, Orders, make_dark_photo
from pdcd.errors import PdcdError
from pdcd.planning.border_photo import DARK, INNER, LIT, BorderFrames
from pdcd.planning.panel_look import find_white_shot
from pdcd.planning.plan import Plan
from pdcd.runs.record import BorderPhoto, DarkPhoto, MeterRecord


def photograph_borders(
    plan: Plan, config: Config, widest: float, exposer: Exposer, orders: Orders
) -> Generator[Order, PhotoOutcome, BorderPhoto | None]:
    """Take the photos at the aperture of the plan's white shot, which they belong to
    (`pdcd.planning.border_photo`). Returns None where one was spoilt.

    widest : largest share of a quad that strips take.
    """
    white = find_white_shot(plan)
    if white is None:
        raise PdcdError("a photo of the light along borders goes with a white shot")
    shown, photos = BorderFrames.of(plan, config, widest), list[DarkPhoto]()
    f_number = yield from exposer.aperture(white, plan.recipe.shots, plan.sequence)
    settings = exposer.settings(f_number)
    for name in (LIT, INNER, DARK):
        wanted = PhotoOrder("look", name, shown.frames(name), settings, f_number)
        taken = yield from orders.look(wanted)
        if isinstance(taken, SpoiltPhoto):
            orders.note(
                "there is no photo of the light along the borders of cells: it is worked out from "
                f"the pixels around, with a larger error ({taken.message})"
            )
            return None
        orders.note(MeterRecord(raw=taken.raw, f_number=f_number, peak=None))
        photos.append(make_dark_photo(taken, wanted, shown.phase_s(name)))
    lit, inner, dark = photos
    return BorderPhoto(
        **msgspec.structs.asdict(lit),
        reach=shown.pixels.reach,
        inner=inner,
        dark=dark,
    )
