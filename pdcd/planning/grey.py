"""Grey levels of a plan: what is said of those that its codes need, and whether masks of far light
have any."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from pdcd.bench.tables import Config, PanelConfig
from pdcd.panels.lattice import Lattice
from pdcd.planning.plan import PatternPair, is_long_range
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.recipe import Recipe

_PANELS = ("projector", "mask")


def find_grey_panels(pairs: Iterable[PatternPair]) -> tuple[str, ...]:
    """Which panels are sent anything but black and white."""
    grey = [[part.dtype != np.uint8 for part in pair] for pair in pairs]
    return tuple(name for n, name in enumerate(_PANELS) if any(pair[n] for pair in grey))


def explain_grey_levels(pairs: Iterable[PatternPair], config: Config) -> Iterator[str]:
    """How grey levels are sent, a line for each panel that shows any."""
    for name in find_grey_panels(pairs):
        panel: PanelConfig = getattr(config, name)
        if panel.lut is not None:
            yield f"grey levels of the {name}: 8 bits, by a table of {len(panel.lut)} lights"
        elif panel.gamma is not None:
            yield f"grey levels of the {name}: 8 bits, gamma {panel.gamma:g}"
        elif is_grey_light_unknown(panel, config):
            yield describe_unknown_response(name)


def list_grey_warnings(pairs: Iterable[PatternPair], config: Config) -> Iterator[str]:
    """What the user of a finished run must know about its grey levels."""
    return map(describe_unknown_response, find_unknown_grey_panels(pairs, config))


def find_unknown_grey_panels(pairs: Iterable[PatternPair], config: Config) -> tuple[str, ...]:
    """Which panels are sent grey levels whose light is not known."""
    return tuple(
        name
        for name in find_grey_panels(pairs)
        if is_grey_light_unknown(getattr(config, name), config)
    )


def is_grey_light_unknown(panel: PanelConfig, config: Config) -> bool:
    """Whether the light of a panel's grey levels was neither given nor measured, and may be any."""
    return panel.gamma is None and panel.lut is None and not is_mock_as_configured(config)


def is_mock_as_configured(config: Config) -> bool:
    """Whether the panels are those of a mock bench that matches its configuration."""
    return config.display.driver == "mock" and config.bench.truth is None


def describe_unknown_response(name: str) -> str:
    """Says that the light of a panel's grey levels is not known."""
    return (
        f"the {name} shows grey levels, and what light they give is not known: they are taken as "
        f"light, and a panel with gamma shows other weights than were asked for; run pdcd "
        f"calibrate response, or set {name}.gamma"
    )


def can_use_grey_masks(request: CaptureRequest, config: Config) -> bool:
    """Whether masks of far light may have grey levels: as asked for, else where the mask can show
    them and their light was measured."""
    return not _black_and_white(config) if request.grey_masks is None else request.grey_masks


def explain_long_range_masks(
    recipe: Recipe, request: CaptureRequest, config: Config, rig: Lattice
) -> Iterator[str]:
    """Why masks of far light have grey levels or none, where neither was asked for; and why they
    open whole cells where those of other codes do not."""
    if not any(is_long_range(program) for program in recipe.programs.values()):
        return
    if rig.window != "whole":
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
    # A typed gamma that is a little wrong costs more than grey levels gain.
    measured = config.mask.lut is not None or "mask.gamma" in config.calibration.typed
    if not measured and not is_mock_as_configured(config):
        return "nobody measured the light of the mask's grey levels: run pdcd calibrate response"
    return ""
