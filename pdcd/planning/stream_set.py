"""What a stream photographs: a capture, whose parts it takes in turn, over and over."""

from __future__ import annotations

import msgspec

from pdcd.errors import RequestError
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.stream import StreamRequest
from pdcd.recipes.parts import FEWEST_PARTS

_CODES = 32
"""Codes of each photo, where the request does not say."""
_MEANT_FOR_PHOTOS = ("error", "confidence", "seconds", "until_error", "keep_raw", "out")
"""Fields about how a single run is planned, or what becomes of it."""


def make_set_request(request: StreamRequest) -> CaptureRequest:
    """The capture that a stream begins with, and whose parts it then photographs one by one.

    There is no pilot unless asked for: a moving scene has no fixed paths to learn. Called by the
    engine, and by whoever may refuse a request before the rig is taken. Raises RequestError.
    """
    default = CaptureRequest(goal=request.goal)
    odd = [n for n in _MEANT_FOR_PHOTOS if getattr(request, n) != getattr(default, n)]
    if odd:
        raise RequestError(
            f"a stream takes no {', '.join(odd)}", hint="give codes, parts and over instead"
        )
    if request.method != "coded" or request.repeat != 1 or request.pilot == "auto":
        raise RequestError(
            "a stream takes coded photos, each once, after a pilot of a number of codes or none",
            hint="leave out method, repeat and pilot",
        )
    parts = request.parts if isinstance(request.parts, int) else FEWEST_PARTS
    if not max(FEWEST_PARTS, request.over) <= parts:
        raise RequestError(
            f"{parts} parts are too few for a stream whose pictures are made of {request.over}",
            hint=f"take at least {max(FEWEST_PARTS, request.over)} parts: their spread measures "
            "the error",
        )
    pilot = request.pilot or 0
    codes = None if request.codes_from is not None else (request.codes or _CODES) * parts + pilot
    exposure_s = None if request.exposure_s is None else request.exposure_s * parts
    same = {name: getattr(request, name) for name in CaptureRequest.__struct_fields__}
    asked = CaptureRequest(**same)
    return msgspec.structs.replace(
        asked, codes=codes, parts=parts, pilot=pilot, exposure_s=exposure_s, keep_raw="none"
    )
