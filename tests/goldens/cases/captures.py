"""A capture as a case: what it will do, how it ends, and its run folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.goldens.case import Bench, Case
from tests.goldens.keep import keep_run

GRID = (12, 16)


@dataclass(frozen=True)
class Capture:
    """One request. options : of `pdcd capture`; of arrays only their fields, such as "warp".
    tables : TOML of the bench but for its [scene]. page : keep the text of report.html."""

    name: str
    options: str
    tables: str = ""
    scene: str = "open-book"
    grid: tuple[int, int] = GRID
    arrays: tuple[str, ...] = ()
    page: bool = False
    weight: float = 1.0
    scene_options: str = ""
    scene_path: str = ""
    ambient: float = 0.0

    def case(self, before: Callable[[Bench], object] = lambda bench: None) -> Case:
        """The case that takes it. before : writes what else it needs."""

        def take(bench: Bench) -> None:
            before(bench)
            take_capture(bench, self)

        return Case(self.name, take, self.weight)


def take_capture(bench: Bench, wanted: Capture) -> None:
    """Plan, take and keep one capture."""
    config = bench.write("bench.toml", bench_text(wanted))
    words = [*wanted.options.split(), "--config", config, *array_options(bench, wanted)]
    bench.keep_said("plan", bench.pdcd("plan", *words, "--local", "--json"))
    said = bench.pdcd("capture", *words, "--local", "--json", "--out", "runs")
    bench.keep_said("capture", said)
    if said.folder is not None:
        keep_run(bench, said.folder, page=wanted.page)


def bench_text(wanted: Capture) -> str:
    """The configuration of the bench of a capture."""
    rows, cols = wanted.grid
    scene = f'[scene]\nkind = "{wanted.scene}"\n'
    if wanted.scene_path:
        scene += f'path = "{wanted.scene_path}"\n'
    else:
        scene += f"grid = [{rows}, {cols}]\n"
    if wanted.ambient:
        scene += f"ambient = {wanted.ambient}\n"
    if wanted.scene_options:
        scene += f"[scene.options]\n{wanted.scene_options}\n"
    return f"{wanted.tables}\n{scene}"


def array_options(bench: Bench, wanted: Capture) -> list[str]:
    """Write the arrays that a capture names; options that hand them over."""
    given = arrays(wanted.grid)
    options = []
    for name in wanted.arrays:
        field = name.partition(":")[0]
        options += [f"--{field}", bench.write_array(f"{field}.npy", given[name])]
    return options


def arrays(grid: tuple[int, int]) -> dict[str, Any]:
    """Every array that a capture may name, seeded; after a colon, which of a field."""
    rng = np.random.default_rng(7)
    cells = grid[0] * grid[1]
    rows, cols = np.indices(grid)
    shifted = np.where(cols > 0, rows * grid[1] + cols - 1, -1)
    far = np.abs(np.subtract.outer(np.arange(cells), np.arange(cells)))
    return {
        "illumination": np.round(0.2 + 0.8 * rng.random(grid), 3),
        "warp": rng.permutation(cells).reshape(grid),
        "warp:shifted": shifted,
        "warp-b": np.roll(np.arange(cells), 5).reshape(grid),
        "region-a": (rows < grid[0] // 2).astype(float),
        "region-b": (cols < grid[1] // 2).astype(float),
        "kernel": np.array([[0.0, -1.0, 0.0], [-1.0, 4.0, -1.0], [0.0, -1.0, 0.0]]),
        "matrix": rng.normal(size=(cells, cells)),
        "matrix:even": np.where(far < 3, 0.25, 1.0),
        "matrix:few": np.where(rng.random((cells, cells)) < 0.01, 1.0, 0.0),
        "matrix:low-rank": np.outer(rng.random(cells), rng.random(cells)),
        "disparities": np.round(-2.0 * cols / grid[1]),
    }
