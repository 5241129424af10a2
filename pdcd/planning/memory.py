"""Whether a capture fits into the memory of the process that decodes it, before any light."""

from __future__ import annotations

from pdcd.bench.placed import compute_mock_frame
from pdcd.bench.tables import Config
from pdcd.errors import RequestError
from pdcd.panels.map import Map
from pdcd.protocol.plan_summary import CaptureScheme
from pdcd.recipes.parts import count_part_codes
from pdcd.recipes.recipe import Recipe

_FACTOR_BYTES = 16
"""Bytes of what both panels showed in a code at a cell, float64 each."""
_SAMPLE_BYTES = 9
"""Bytes of the four samples of a quad in a RAW file, and of whether it is saturated."""
_REAL_QUADS = 3_100_000
"""Bayer quads of the largest frame of a supported camera; the real size is known only from the
first photo on."""


class MemoryLimitError(RequestError):
    """A job would take more memory than the rig allows it."""


def check_memory(recipe: Recipe, how: CaptureScheme, config: Config, share: float = 1.0) -> None:
    """Refuse a capture that cannot be decoded within a `share` of `limits.work_bytes`.

    Planners call it before codes are made. It counts what decoding needs in any case: cells times
    codes of every shot (no more of them than cells) for both panels, and the samples of every RAW
    file. If the rest exceeds the limit, the process that plans and decodes ends with a typed error
    when it happens. Raises MemoryLimitError.
    """
    rows, cols = recipe.target.grid
    cells = rows * cols
    part_codes = count_part_codes(how.coded, how.parts)
    shown = sum(
        min(part_codes, cells)
        if not shot.white and shot.only is None and recipe.programs[shot.program].coded
        else 1
        for shot in recipe.shots
    )
    samples = len(recipe.shots) * count_frame_quads(config, recipe.target.grid)
    needed = _FACTOR_BYTES * shown * cells + _SAMPLE_BYTES * samples
    if needed > share * config.limits.work_bytes:
        raise MemoryLimitError(
            f"decoding {len(recipe.shots)} RAW files on a grid of {rows} x {cols} cells takes more "
            f"than {needed / 2**20:.0f} MiB of memory; the limit is "
            f"{config.limits.work_bytes / 2**20:.0f} MiB",
            hint="ask for fewer codes, photos or cells, or raise limits.work_bytes",
        )


def count_frame_quads(config: Config, grid: tuple[int, int]) -> int:
    """Quads of the camera's frame; if that is not known, as many as a real one may have."""
    given = config.camera.place.map
    if isinstance(given, Map):
        return given.size_px[0] * given.size_px[1]
    if config.camera.driver != "mock":
        return _REAL_QUADS
    rows, cols = compute_mock_frame(config, grid)
    return rows * cols
