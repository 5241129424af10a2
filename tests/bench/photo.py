"""The exposures of the closed form, as they are timed in a process of their own."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.probing.realised import Factors, collect_factors, compute_factors
from pdcd.virtual.scene.presets import PRESETS
from pdcd.virtual.scene.scene import Scene
from tests.bench.cases import Case, make_case
from tests.bench.measure import peak_mib, timed

SCENE = "open-book"


def exposure(case: Case) -> Iterator[Factors]:
    """The chunks of a case's realised probing matrix."""
    return compute_factors(
        case.frames,
        case.log,
        case.bench.primal,
        case.bench.dual,
        open_ns=0,
        close_ns=case.close_ns,
        offset_cells=case.bench.offset_cells,
    )


def streamed_photo(case: Case, scene: Scene) -> NDArray[np.float64]:
    """Photo (N, 3) of a scene, chunk by chunk, as the mock camera takes it."""
    photo = np.zeros((scene.cells, 3))
    for part in exposure(case):
        photo += scene.photo(part.left, part.right, part.coaxial, part.open_s)
    return photo


def kept_photo(case: Case, scene: Scene) -> NDArray[np.float64]:
    """The same from the whole matrix, as decoding keeps it for its report."""
    whole = collect_factors(exposure(case))
    return scene.photo(whole.left, whole.right, whole.coaxial, whole.open_s)


def measure_case(
    grid: tuple[int, int], count: int, window: str, panels: str, kept: bool
) -> dict[str, Any]:
    """Seconds and peak MiB of both routes; the streamed one goes first, its peak is lower."""
    case = make_case((grid[0], grid[1]), count, window, panels)
    scene = PRESETS[SCENE]((grid[0], grid[1]), {})
    found: dict[str, Any] = {"base_mib": peak_mib()}
    found["streamed_s"] = timed(lambda: streamed_photo(case, scene))[0]
    found["streamed_mib"] = peak_mib()
    if kept:
        found["kept_s"] = timed(lambda: kept_photo(case, scene))[0]
        found["kept_mib"] = peak_mib()
    return found
