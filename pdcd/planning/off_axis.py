"""What a bench's arrangement makes of a request."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from pdcd.bench.tables import Config
from pdcd.errors import RequestError
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.goals import OFF_AXIS
from pdcd.recipes.off_axis import Keyed, KeyedRange, Rows
from pdcd.recipes.recipe import Recipe


def on_bench(request: CaptureRequest, config: Config) -> CaptureRequest:
    """The request with the bench's own plane, where it asks for depths and names none.

    Raises RequestError for depths on a coaxial bench, which has none.
    """
    if request.goal not in OFF_AXIS:
        return request
    rig = config.rig
    if rig.arrangement != "off-axis":
        raise RequestError(
            f"goal {request.goal} needs a camera off the projector's axis",
            hint='on such a bench set arrangement = "off-axis" in [rig]',
        )
    own = request.plane is None and request.disparities is None and request.warp is None
    if request.goal == "epipolar" or not own or rig.plane is None:
        return request
    return msgspec.structs.replace(request, plane=rig.plane)


def depth_reasons(recipe: Recipe, codes: int, window: str) -> Iterator[str]:
    """Why the codes of depths are what they are, a line for each kind; `codes` of a part."""
    rows, columns = recipe.target.grid
    programs = {type(program): program for program in recipe.programs.values()}
    if Keyed in programs:
        shared = "none" if codes > columns + 1 else f"none nearer than {codes - 1} cells"
        yield f"codes: of the cells of a row {shared} share a code: other depths stay as they are"
    comb = programs.get(KeyedRange)
    if isinstance(comb, KeyedRange):
        closed = comb.high - comb.low + 1
        text = f"codes: a comb of period {comb.period}, closed for {closed} disparities"
        if comb.period < columns + 1 + closed:
            text += f"; depths that are {comb.period} cells apart are blocked together"
        yield text + f"; {100.0 / comb.period:.2g} % of the light, and a photo of other rows"
    elif Rows in programs:
        exact = "exact" if codes >= rows else f"{codes} codes for {rows} rows are not exact"
        beside = "" if window == "whole" else "; windows see half of the next rows with each row"
        yield f"codes: one for each row, {exact}{beside}"
