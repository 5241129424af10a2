"""How a plan fits its bench: which window its codes need, how small cells may be, which cells have
no pixels, which plane depths are measured from, and why, in a line each."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache

import msgspec
import numpy as np

from pdcd.bench.placed import describe_oblong_cells, map_plane_to_field, panels_of, place_panels
from pdcd.bench.tables import Config, PanelConfig
from pdcd.errors import ConfigError, RequestError
from pdcd.panels.atoms import check_cells, find_shown_cells
from pdcd.panels.map_soundness import find_fewest_pixels
from pdcd.panels.windows import ATOMS, GUARDS, find_window_kind, is_on_whole_pixels
from pdcd.planning.plan import is_windowed
from pdcd.planning.schedule_fit import compute_schedule_leak, has_measured_times, scan_out_lags_s
from pdcd.probing.borders import (
    cell_mismatch_px,
    compute_cell_mismatch_share,
    find_nearest_grid,
)
from pdcd.probing.cell_size import (
    MaskAlignment,
    compute_bench_leak,
    find_cell_below_leak,
    find_largest_window,
)
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.goals import OFF_AXIS_GOALS
from pdcd.recipes.off_axis import KeyedProgram, KeyedRangeProgram, RowProgram
from pdcd.recipes.recipe import Recipe
from pdcd.words import ScheduleName

_WHOLE_CELL_LIMIT = 0.001
"""Misregistration in cells up to which whole cells are better than quarter windows: they let about
that share of the direct light into an indirect photo, whose own light is often ten times weaker."""


_MOST_APART = 0.05
"""Share of the field in which both panels may draw different cells with whole windows: so much was
measured (decision 0069)."""


_BLUR_LEAK = 1.6
"""Share of the direct light that blur brings into an indirect photo under whole cells, over its
standard deviation in cells (`pdcd.probing.cell_size`)."""


def choose_window(asked: str, misregistration_cells: float, blur_cells: float = 0.0) -> str:
    """The window that "auto" gives with that misregistration and blur, or the one asked for.

    Raises ConfigError when the window cannot cover the misregistration.
    """
    window = asked
    if asked == "auto":
        leak = misregistration_cells + _BLUR_LEAK * blur_cells
        window = "whole" if leak <= _WHOLE_CELL_LIMIT else "quarter"
    guard = find_window_kind(window).guard
    if guard and misregistration_cells > guard:
        raise ConfigError(
            f"misregistration of {misregistration_cells:.2f} cells is more than {window} windows "
            f"tolerate ({guard:g})",
            hint="use fewer, larger cells or align the panels"
            if window == "quarter"
            else "take a smaller window, or auto",
        )
    return window


MOST_LEAK = 0.005
"""Share of the direct light that "auto" cells let into an indirect photo at most."""
_LEAST_CELL_PX, _LEAST_MASK_PX = 2.0, 4.0
"""Least pixels of projector and mask along a cell."""
MOST_AUTO_CELLS = 256 * 192
"""Most "auto" cells: more take long to plan and decode, and few scenes have such detail."""


def with_grid(config: Config) -> Config:
    """The configuration with "auto" cells worked out: as small as quarter windows allow, with a
    leak below `MOST_LEAK`. Where nothing was measured, the scene's cells are taken, or the usual
    ones."""
    if config.schedule.grid != "auto":
        return config
    schedule = msgspec.structs.replace(config.schedule, grid=_auto_grid(config))
    return msgspec.structs.replace(config, schedule=schedule)


def find_meeting(config: Config) -> MaskAlignment | None:
    """How light and mask meet; None where it was not measured."""
    e95_px, blur_px = config.rig.misregistration_px, config.mask.blur_px
    if e95_px == 0.0 and blur_px == 0.0:
        return None
    across = find_fewest_pixels(panels_of(config).mask.map, config.projector.field_size_px[::-1])
    return MaskAlignment(e95_px, blur_px, 1.0 / across if across else 0.0)


def choose_grid_window(
    asked: str, config: Config, grid: tuple[int, int], *, taken_out: bool = False
) -> str:
    """Window of cells of a grid: as asked for; or whole cells where no light gets from one to the
    next, else the quarter. `taken_out`: light through borders that the panels' pixels draw in two
    places is photographed and subtracted; whole cells then may have such borders, up to
    `_MOST_APART` of the field.

    Larger windows must be asked for (`find_larger_window` tells which fits). They need a mask whose
    pixels end where the windows end: one pixel more or less is light that is not counted, and for
    how long each place in a cell was open is known no better than the camera's map. Raises
    ConfigError.
    """
    width_px, height_px = config.projector.field_size_px
    cell_px = min(width_px / grid[1], height_px / grid[0])
    misregistration = config.rig.misregistration_px / cell_px
    blur = config.mask.blur_px / cell_px
    panels = panels_of(config)
    if asked == "auto":
        apart_px = _apart_px(config.projector, config.mask, grid)
        # If the place of the mask was measured, and not its blur, this light is unknown.
        unknown = config.mask.place.map is not None and find_meeting(config) is None
        taken_out = taken_out and not unknown
        if apart_px and not (
            taken_out
            and compute_cell_mismatch_share(panels.projector, panels.mask, grid) <= _MOST_APART
        ):
            misregistration = max(misregistration, apart_px / cell_px)
    elif not is_on_whole_pixels(asked, panels.mask, grid):
        raise ConfigError(
            f"the edges of {asked} windows do not lie on those of the mask's pixels in {grid[0]} x "
            f"{grid[1]} cells",
            device="mask",
            hint="take quarter windows; or a mask that stands upright, and cells of a multiple of "
            f"{ATOMS // math.gcd(GUARDS[asked], ATOMS)} of its pixels",
        )
    return choose_window(asked, misregistration, blur)


@lru_cache(maxsize=8)
def _apart_px(projector: PanelConfig, mask: PanelConfig, grid: tuple[int, int]) -> float:
    """`cell_mismatch_px` of the panels of a bench; cached for the search of a plan."""
    panels = place_panels(projector, mask)
    return cell_mismatch_px(panels.projector, panels.mask, grid, projector.field_size_px)


def find_larger_window(config: Config, grid: tuple[int, int]) -> str | None:
    """The largest window beyond the quarter that keeps other cells' light out, as measured, and
    whose edges lie on those of the mask's pixels; None where none does, or nothing was measured."""
    meeting = find_meeting(config)
    if meeting is None:
        return None
    width_px, height_px = config.projector.field_size_px
    cell_px, mask = min(width_px / grid[1], height_px / grid[0]), panels_of(config).mask
    fitting = (
        name
        for name in reversed(GUARDS)
        if find_window_kind(name).kinds == 4
        and find_window_kind(name).side <= find_largest_window(meeting, cell_px)
        and float(compute_bench_leak(meeting, cell_px, find_window_kind(name).side))
        <= _WHOLE_CELL_LIMIT
        and is_on_whole_pixels(name, mask, grid)
    )
    return next(fitting, None)


def explain_bench_fit(
    config: Config,
    grid: tuple[int, int],
    window: str,
    schedule: ScheduleName,
    mask_lag_s: float | None,
) -> tuple[str, ...]:
    """Why cells, window and schedule are what they are; nothing if the bench was not measured."""
    told = [*_field_reasons(config, grid), *_blind_reasons(config, grid)]
    meeting = find_meeting(config)
    if meeting is not None:
        width, height = config.projector.field_size_px
        cell_px = min(width / grid[1], height / grid[0])
        leak = float(compute_bench_leak(meeting, cell_px, find_window_kind(window).side))
        told.append(
            f"cells of {cell_px:.3g} projector pixels: the panels meet within "
            f"{meeting.e95_px:.2g} px (95 % of the field), blur is {meeting.blur_px:.2g} px"
        )
        told.append(
            f"window {window}: {100.0 * leak:.2g} % of the direct light leaks into an indirect "
            "photo"
        )
        larger = find_larger_window(config, grid)
        if larger is not None and window == "quarter":
            gain = find_window_kind(larger).area / find_window_kind(window).area
            told.append(
                f"window {larger} has {gain:.3g} times the light, and fits how the panels meet"
            )
    told += _border_reasons(config, grid, window)
    if has_measured_times(config) and mask_lag_s is not None and schedule != "none":
        leak = compute_schedule_leak(config, schedule, mask_lag_s)
        low_s, high_s = scan_out_lags_s(config)
        told.append(
            f"schedule {schedule}: the mask follows by {1e3 * (mask_lag_s + low_s):.2g} to "
            f"{1e3 * (mask_lag_s + high_s):.2g} ms; {100.0 * leak:.2g} % of a code's light "
            "gets into its neighbours"
        )
    return tuple(told)


def _border_reasons(config: Config, grid: tuple[int, int], window: str) -> Iterator[str]:
    """Lines about cells that do not end with the pixels of both panels."""
    panels = panels_of(config)
    apart = compute_cell_mismatch_share(panels.projector, panels.mask, grid)
    if apart <= _WHOLE_CELL_LIMIT:
        return
    if window == "whole":
        yield (
            f"window whole: the panels draw different cells in {100.0 * apart:.2g} % of the field, "
            "and as much of the direct light gets into an indirect photo; beside a white photo "
            "another is taken, of these places alone, and their light is subtracted"
        )
    better = find_nearest_grid(panels.projector, panels.mask, grid)
    if better is not None and better != grid:
        yield (
            f"cells of {grid[0]} x {grid[1]} do not end on the pixels of both panels; "
            f"{better[0]} x {better[1]} do"
        )


def explain_wandering_light(recipe: Recipe, window: str) -> Iterator[str]:
    """What small windows do with light that wanders within a cell, where codes separate photos
    (decision 0055)."""
    if window != "whole" and any(is_windowed(program) for program in recipe.programs.values()):
        yield (
            f"window {window}: of light that wanders half a cell or more within its own cell, a "
            "part counts as indirect; where much does, as in wax or glass, take smaller cells"
        )


def explain_bit_planes(config: Config) -> tuple[str, ...]:
    """How long the bit planes of a refresh are; nothing where panels show one row a refresh."""
    display = config.display
    if display.planes_per_refresh == 1:
        return ()
    refresh_ms = 1e3 * display.planes_per_refresh / config.row_hz
    low, high = (f(display.plane_shares) * refresh_ms for f in (min, max))
    lasts = f"{low:.3g} to {high:.3g} ms, as measured" if display.plane_starts else f"{low:.3g} ms"
    return (
        f"{display.planes_per_refresh} planes a refresh, of {lasts}: {config.row_hz:.4g} a second",
    )


def _auto_grid(config: Config) -> tuple[int, int] | None:
    meeting = find_meeting(config)
    if meeting is None:
        return None
    width, height = config.projector.field_size_px
    # A cell of the projector's own pixels; the mask may have fewer of them.
    across = find_fewest_pixels(panels_of(config).mask.map, (height, width)) or 1.0
    least_px = max(
        find_cell_below_leak(meeting, MOST_LEAK),
        _LEAST_CELL_PX,
        _LEAST_MASK_PX / across,
        math.sqrt(width * height / MOST_AUTO_CELLS),
    )
    if not np.isfinite(least_px):
        return None
    return max(1, int(height / least_px)), max(1, int(width / least_px))


def resolve_window(request: CaptureRequest, config: Config, grid: tuple[int, int]) -> str:
    """Part of a mask cell that opens. Raises ConfigError for cells that the panels cannot show."""
    width_px, height_px = config.projector.field_size_px
    cell_px = min(height_px / grid[0], width_px / grid[1])
    if cell_px < 1.0:
        raise ConfigError(
            f"a grid of {grid[0]} x {grid[1]} cells is finer than the projector's pixels",
            device="projector",
            hint="use a coarser scene grid",
        )
    _refuse_blind(config, grid)
    asked = request.window or config.schedule.window
    return choose_grid_window(asked, config, grid, taken_out=_takes_out(request))


def _takes_out(request: CaptureRequest) -> bool:
    """Whether direct light along borders is subtracted from the photo that is asked for: one of all
    indirect light, with a white photo."""
    own = request.shift is None and request.warp is None
    return request.goal in ("indirect", "direct") and request.white is not False and own


def add_bench_plane(request: CaptureRequest, config: Config) -> CaptureRequest:
    """The request with the bench's own plane, where it asks for depths and names none.

    Raises RequestError for depths on a coaxial bench, which has none.
    """
    if request.goal not in OFF_AXIS_GOALS:
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
    return msgspec.structs.replace(request, plane=map_plane_to_field(rig.plane, config.projector))


def explain_depth_codes(recipe: Recipe, codes: int, window: str) -> Iterator[str]:
    """Why the codes for depths are what they are, a line for each kind; `codes` of a part."""
    rows, columns = recipe.target.grid
    programs = {type(program): program for program in recipe.programs.values()}
    if KeyedProgram in programs:
        shared = "none" if codes > columns + 1 else f"none nearer than {codes - 1} cells"
        yield f"codes: of the cells of a row {shared} share a code: other depths stay as they are"
    comb = programs.get(KeyedRangeProgram)
    if isinstance(comb, KeyedRangeProgram):
        closed = comb.high - comb.low + 1
        text = f"codes: a comb of period {comb.period}, closed for {closed} disparities"
        if comb.period < columns + 1 + closed:
            text += f"; depths that are {comb.period} cells apart are blocked together"
        yield text + f"; {100.0 / comb.period:.2g} % of the light, and a photo of other rows"
    elif RowProgram in programs:
        exact = "exact" if codes >= rows else f"{codes} codes for {rows} rows are not exact"
        beside = "" if window == "whole" else "; windows see half of the next rows with each row"
        yield f"codes: one for each row, {exact}{beside}"


def _field_reasons(config: Config, grid: tuple[int, int]) -> Iterator[str]:
    """Where the field lies in the projector's picture; nothing where it was not measured."""
    if config.projector.field_px is None:
        return
    (left, top, wide, high), (width, height) = config.projector.field_px, config.projector.size_px
    across, down = wide / grid[1], high / grid[0]
    oblong = ", oblong" if describe_oblong_cells(config, grid) else ""
    yield (
        f"field of {wide} x {high} of the projector's {width} x {height} pixels, from ({left}, "
        f"{top}) on, which projector, mask and camera share; cells of {across:.4g} x {down:.4g} "
        f"pixels{oblong}"
    )


def _blind_reasons(config: Config, grid: tuple[int, int]) -> Iterator[str]:
    """Cells that have no pixel on a panel, of each panel with such cells."""
    panels = panels_of(config)
    for view in (panels.projector, panels.mask):
        blind = 1.0 - float(find_shown_cells(view, grid).mean())
        if blind > 0.0:
            yield (
                f"{100.0 * blind:.2g} % of the cells have no pixel on the {view.role}: nothing is "
                "known there (infinite sigma)"
            )


def _refuse_blind(config: Config, grid: tuple[int, int]) -> None:
    """Raise ConfigError for cells that the panels cannot show, or none of which has pixels on both.
    This is checked before any light, not only when a display is to show them."""
    panels = panels_of(config)
    for view in (panels.projector, panels.mask):
        check_cells(view, grid)
    if not (find_shown_cells(panels.projector, grid) & find_shown_cells(panels.mask, grid)).any():
        raise ConfigError(
            f"none of {grid[0]} x {grid[1]} cells has pixels on both panels",
            device="mask",
            hint="mend [projector.place] and [mask.place], or calibrate the geometry",
        )
