"""Goals of real-valued patterns on panels with gamma: what is believed decides, and what is true.

The bench is one of pixels, whose panels get bytes. Wanted matrices are written out here by loops.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import BenchConfig, Config, PanelConfig
from tests import bench_rig
from tests.sampled import sampled
from tests.taken import Taken, take

ROWS, COLS = GRID = bench_rig.GRID
N = ROWS * COLS
RNG = np.random.default_rng(21)
LIGHT = np.round(0.1 + 0.9 * RNG.random(GRID), 3)
KERNEL = np.round(RNG.normal(size=(3, 3)), 2)
ANY = np.round(RNG.normal(size=(N, N)), 3)
LOW = RNG.random((N, 2)) @ RNG.random((2, N))
WARPS = [RNG.permutation(N).reshape(GRID) for _ in range(2)]
SIZES = {"projector": (96, 72), "mask": (120, 90)}
BENT = tuple(float(v) for v in np.linspace(0.0, 1.0, 33) ** 1.7 * np.linspace(0.7, 1.0, 33))


def of_kernel(n: int, m: int) -> float:
    down, right = n // COLS - m // COLS, n % COLS - m % COLS
    return float(KERNEL[down + 1, right + 1]) if max(abs(down), abs(right)) <= 1 else 0.0


def less_its_left(n: int, m: int) -> float:
    return (n % COLS > 0) * (float(n == m) - float(m == n - 1))


def matrix(entry: Any) -> np.ndarray:
    return np.array([[float(entry(n, m)) for m in range(N)] for n in range(N)])


GOALS: dict[str, tuple[dict[str, Any], np.ndarray]] = {
    "filtered": ({"kernel": KERNEL.tolist()}, matrix(of_kernel)),
    "relit": ({"matrix": ANY.tolist(), "illumination": LIGHT.tolist()}, ANY * LIGHT.ravel()),
    "relit, low rank": ({"matrix": LOW.tolist()}, LOW),
    "illuminated": ({"illumination": LIGHT.tolist()}, np.tile(LIGHT.ravel(), (N, 1))),
    "descattered": (
        {"shift": [0, -1], "illumination": LIGHT.tolist()},
        matrix(less_its_left) * LIGHT.ravel(),
    ),
    "two-samples": (
        {"warp": WARPS[0].tolist(), "warp_b": WARPS[1].tolist(), "mix": [1.0, -0.5],
         "illumination": LIGHT.tolist()},
        matrix(lambda n, m: (WARPS[0].flat[n] == m) - 0.5 * (WARPS[1].flat[n] == m))
        * LIGHT.ravel(),
    ),
}  # fmt: skip


def config_of(folder: Path, true: str, **believed: Any) -> Config:
    truth = folder / "truth.toml"
    truth.write_text("".join(f"[{name}]\n{true}\n" for name in SIZES))
    panels: dict[str, Any] = {n: PanelConfig(size_px=s, **believed) for n, s in SIZES.items()}
    return bench_rig.config(folder, bench=BenchConfig(truth=str(truth)), **panels)


def photographed(config: Config, goal: str) -> tuple[float, Taken]:
    """RMS error over the scale of the wanted picture, all weights taken without their signs."""
    fields, wanted = GOALS[goal]
    made = take(config, **{"goal": goal.partition(",")[0], "codes": 64, **fields})
    transport = bench_rig.transport()
    truth = (wanted * transport).sum(axis=1).reshape(*GRID, 1)
    scale = np.sqrt(np.mean((np.abs(wanted) * transport).sum(axis=1) ** 2))
    return float(np.sqrt(np.mean((made.image - truth) ** 2)) / scale), made


@pytest.mark.parametrize("goal", sampled(list(GOALS), 2))
def test_goals_hold_their_bound_with_gamma_in_both_panels(goal: str, tmp_path: Path) -> None:
    """The bound is that of panels without gamma and without rounding (`test_tables.py`)."""
    error, made = photographed(config_of(tmp_path, "gamma = 2.2", gamma=2.2), goal)
    assert error < 2e-3
    assert not any("grey" in text for text in made.warnings)
    assert made.decodes_the_same()


def test_a_table_of_lights_does_as_well(tmp_path: Path) -> None:
    error, _ = photographed(config_of(tmp_path, f"lut = {list(BENT)}", lut=BENT), "relit")
    assert error < 2e-3


def test_gamma_that_nobody_knows_spoils_the_photo_and_is_warned_of(tmp_path: Path) -> None:
    error, made = photographed(config_of(tmp_path, "gamma = 2.2"), "relit")
    assert error > 0.2
    told = [text for text in made.warnings if "grey levels, and what light they give" in text]
    assert {text.split()[1] for text in told} == {"projector", "mask"}
    assert any("projector.gamma" in text for text in told)
    assert made.quality.verdict != "good"
    assert any("not known what light they give" in text for text in made.quality.reasons)


def test_codes_of_black_and_white_need_no_curve(tmp_path: Path) -> None:
    made = take(config_of(tmp_path, "gamma = 2.2"), codes=64)
    assert made.error < 2e-3
    assert not any("grey" in text for text in made.warnings)
