"""How masks of photos of far light are shown: with grey levels or without, and through which
windows."""

from __future__ import annotations

from collections.abc import Iterator

from pdcd.bench.tables import Config
from pdcd.planning.grey import unsaid
from pdcd.planning.plan import beyond
from pdcd.recipes.recipe import Recipe
from pdcd.request import CaptureRequest


def grey_masks(request: CaptureRequest, config: Config) -> bool:
    """Whether masks of far light may have grey levels: as asked for, else where the mask can show
    them and it is known what light they give."""
    return not _black_and_white(config) if request.grey_masks is None else request.grey_masks


def mask_reasons(
    recipe: Recipe, request: CaptureRequest, config: Config, window: str
) -> Iterator[str]:
    """Why masks of far light have grey levels or none, where nobody asked for either; and why they
    open whole cells where those of other codes do not."""
    if not any(beyond(program) for program in recipe.programs.values()):
        return
    if window != "whole":
        yield "masks of far light: whole cells, as no light from near them gets in"
    if request.grey_masks is None:
        why = _black_and_white(config)
        yield "masks of far light: " + (
            f"black and white, as {why}" if why else "grey levels, which count it more evenly"
        )


def _black_and_white(config: Config) -> str:
    """Why masks of far light have no grey levels; "" where they may have some."""
    if config.display.planes_per_refresh > 1:
        return "bit planes show no grey levels"
    if unsaid(config.mask, config):
        return "it is not known what light the mask's grey levels give: run pdcd calibrate response"
    return ""
