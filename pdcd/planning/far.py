"""How masks of photos of far light are shown: with grey levels or without, and through which
windows."""

from __future__ import annotations

from collections.abc import Iterator

from pdcd.bench.tables import Config
from pdcd.planning.grey import grey_panels, unsaid
from pdcd.planning.plan import Pair, beyond
from pdcd.recipes.parts import check_parts
from pdcd.recipes.recipe import Recipe
from pdcd.request import CaptureRequest


def grey_masks(request: CaptureRequest, config: Config) -> bool:
    """Whether masks of far light may have grey levels: as asked for, else where the mask can show
    them and it is known what light they give."""
    return not _black_and_white(config) if request.grey_masks is None else request.grey_masks


def woven(request: CaptureRequest, config: Config) -> bool:
    """Whether codes of far light may have grey levels, too: where it is known what light the
    projector's give, and not in parts, which would err alike."""
    known = not unsaid(config.projector, config)
    return known and grey_masks(request, config) and check_parts(request) == 1


def mask_reasons(
    recipe: Recipe,
    patterns: dict[str, Pair],
    request: CaptureRequest,
    config: Config,
    window: str,
) -> Iterator[str]:
    """Why masks of far light have grey levels or none, where nobody asked for either; and why they
    open whole cells where those of other codes do not."""
    far = [name for name, program in recipe.programs.items() if beyond(program)]
    if not far:
        return
    if window != "whole":
        yield "masks of far light: whole cells, as no light from near them gets in"
    if request.grey_masks is None:
        why = _black_and_white(config)
        yield "masks of far light: " + (
            f"black and white, as {why}" if why else "grey levels, which count it more evenly"
        )
    if any("projector" in grey_panels([patterns[name]]) for name in far):
        yield "codes of far light: grey levels, chosen together with the masks"


def _black_and_white(config: Config) -> str:
    """Why masks of far light have no grey levels; "" where they may have some."""
    if config.display.planes_per_refresh > 1:
        return "bit planes show no grey levels"
    if unsaid(config.mask, config):
        return "it is not known what light the mask's grey levels give: run pdcd calibrate response"
    return ""
