"""How masks of photos of far light are shown: with grey levels or without, and through which
windows."""

from __future__ import annotations

from collections.abc import Iterator

from pdcd.bench.tables import Config
from pdcd.panels.lattice import Lattice
from pdcd.planning.grey import unsaid
from pdcd.planning.plan import beyond, chosen_together
from pdcd.protocol.plan_summary import How
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.recipe import Recipe


def grey_masks(request: CaptureRequest, config: Config) -> bool:
    """Whether masks of far light may have grey levels: as asked for, else where the mask can show
    them and it is known what light they give."""
    return not _black_and_white(config) if request.grey_masks is None else request.grey_masks


def mask_reasons(
    recipe: Recipe, how: How, request: CaptureRequest, config: Config, rig: Lattice
) -> Iterator[str]:
    """Why masks of far light have grey levels or none, where nobody asked for either; and why they
    open whole cells where those of other codes do not."""
    far = [program for program in recipe.programs.values() if beyond(program)]
    if not far:
        return
    if rig.window != "whole":
        yield "masks of far light: whole cells, as no light from near them gets in"
    if request.grey_masks is None:
        why = _black_and_white(config)
        yield "masks of far light: " + (
            f"black and white, as {why}" if why else "grey levels, which count it more evenly"
        )
    if any(chosen_together(program, rig, how.coded, how.family) for program in far):
        yield "codes of far light: grey levels, chosen together with the masks"


def _black_and_white(config: Config) -> str:
    """Why masks of far light have no grey levels; "" where they may have some."""
    if config.display.planes_per_refresh > 1:
        return "bit planes show no grey levels"
    if unsaid(config.mask, config):
        return "it is not known what light the mask's grey levels give: run pdcd calibrate response"
    return ""
