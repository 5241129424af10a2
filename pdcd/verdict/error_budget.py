"""What each cause contributes to the error of a photo: scale, stops, maps, timing, codes, noise.

Nothing new is estimated. The error bars have their own causes, the verdict has the direct light
that is left, and the record the precision of scale and stops. Unknown parts are said to be unknown.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.arrays import Floats
from pdcd.pictures.decoded_run import DecodedRun
from pdcd.pictures.picture import ErrorCause
from pdcd.printable import to_percent
from pdcd.probing.deviation import Deviation
from pdcd.runs.record import RunRecord
from pdcd.verdict.evidence import Evidence, compute_rms
from pdcd.verdict.matrices import find_direct_left

ALL_CAUSES = "all"
"""Name of the last row: the root of the sum of squares of those that are known."""
_LEAST = 1e-6
"""Weight of direct light below which it counts as none."""


class ErrorRow(msgspec.Struct, frozen=True):
    """One cause of error of a photo's answer.

    name : "scale", "stops", "maps", "timing", "codes", "noise", "leaks" where there are any, and
    "all". share : standard deviation over the RMS of the answer, on the camera's quads; None where
    it is not known. rms : the same in scene units. source : where the figure comes from, or why
    there is none.
    """

    name: str
    share: float | None
    rms: float | None
    source: str


def make_error_budget(
    record: RunRecord, decoded: DecodedRun, deviations: Mapping[str, Deviation] | None = None
) -> tuple[ErrorRow, ...]:
    """The budget of a run that was decoded: a row for each cause and one for all. For the report
    and `Run.error_budget`. deviations : of its photos; if None they are computed."""
    if record.cells is None:
        return ()
    if deviations is None:
        deviations = decoded.deviations()
    seen = Evidence(record, decoded.cells, decoded, deviations)
    light = compute_rms(_known(seen, decoded.answer.image))
    rows = [
        ErrorRow(name, share, None if share is None else share * light, source)
        for name, share, source in _list_causes(seen, light)
    ]
    known = [row.share for row in rows if row.share is not None]
    lacking = [row.name for row in rows if row.share is None]
    total = math.hypot(*known)
    source = "root of the sum of squares"
    if lacking:
        source += f"; without {', '.join(lacking)}"
    return (*rows, ErrorRow(ALL_CAUSES, total, total * light, source))


def _list_causes(seen: Evidence, light: float) -> Iterator[tuple[str, float | None, str]]:
    """Name of each cause, its share of the answer's RMS `light`, and the source of that."""
    record = seen.record
    if record.scale is None:
        yield "scale", None, "it is not known how bright a unit is"
    else:
        known = "common to all pixels" if record.scale.sigma is not None else "never measured"
        yield "scale", record.scale.sigma, f"{known}; {record.scale.source}"
    yield "stops", *_stops(seen, light)
    yield "maps", *_maps(seen, light)
    yield "timing", *_timing(seen, light)
    yield "codes", *_codes(seen, light)
    # Squares of quads have less noise than the quads they are means of.
    noise = seen.decoded.side * compute_rms(_known(seen, seen.decoded.answer.sensor))
    yield (
        "noise",
        _over(noise, light),
        (
            f"photons and read noise by sensor profile {record.profile.name}"
            + (", an estimate" if record.profile.estimated else "")
        ),
    )
    leaks = math.hypot(record.leak, record.room_changed)
    if record.leaks_unseen != "no":
        yield "leaks", None, "no dark photo shows them all"
    elif leaks:
        yield "leaks", leaks, "light in the dark photos that was not subtracted, or that changed"


def _stops(seen: Evidence, light: float) -> tuple[float | None, str]:
    numbers = sorted({shot.f_number for shot in seen.records})
    share = _of_cause(seen, "stops", light)
    if len(numbers) <= 1 and not share:
        return 0.0, "all photos of the answer were taken at one stop"
    if not seen.record.stops:
        return None, f"stops {', '.join(f'f/{n:g}' for n in numbers)} were never compared"
    return share, "by the photos that compared the stops' light"


def _maps(seen: Evidence, light: float) -> tuple[float | None, str]:
    look = seen.record.panels
    if look is None or look.mask is None:
        why = "no photos of blocks" if look is None or not look.why else look.why
        return _of_part(seen, "maps", light, f"the places of the panels were not checked: {why}")
    source = f"photos of blocks, which place the mask to {look.sigma_px:.2g} projector pixels"
    return _of_cause(seen, "maps", light), source


def _timing(seen: Evidence, light: float) -> tuple[float | None, str]:
    if any(not shot.verified for shot in seen.records):
        return _of_part(seen, "timing", light, "presentation times are not verified")
    if seen.decoded.answer.kind == "whole":
        return 0.0, "no codes were shown"
    left = find_direct_left(seen)
    if left is None:
        why = "no picture tells how much direct light gets through as the panels switch"
        return _of_part(seen, "timing", light, why)
    if left.weight < _LEAST:
        return 0.0, "by the frame log the panels let no direct light through"
    through = f"{to_percent(left.weight)} of the direct light gets through, by the frame log"
    if left.taken_out is not None:
        share = _of_cause(seen, "timing", light)
        return share, f"{through}; it was subtracted, but not exactly"
    return left.share, f"{through}; it is in the picture"


def _codes(seen: Evidence, light: float) -> tuple[float | None, str]:
    made = seen.decoded.answer
    if made.kind == "whole":
        return 0.0, "such a photo has no error of codes"
    if made.kind == "sensor":
        return None, "fewer than four parts were taken"
    return _of_cause(seen, "codes", light), "by the differences between the parts of the photo"


def _of_part(seen: Evidence, cause: ErrorCause, light: float, why: str) -> tuple[float | None, str]:
    """The part of a cause that error bars contain, and why its whole is not known."""
    share = _of_cause(seen, cause, light)
    return (share, f"the part that error bars contain; {why}") if share else (None, why)


def _of_cause(seen: Evidence, cause: ErrorCause, light: float) -> float:
    return _over(math.sqrt(seen.decoded.answer.causes.get(cause, 0.0)), light)


def _known(seen: Evidence, image: NDArray[np.floating]) -> Floats:
    """Values inside the field, NaN where the answer is not known."""
    values, sigma = seen.inside(image), seen.inside(seen.decoded.answer.sigma)
    return np.where(np.isfinite(sigma), values, np.nan)


def _over(error: float, light: float) -> float:
    return error / light if light > 0.0 else math.inf
