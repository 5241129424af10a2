"""Every row of Tables 1 and 2 through the whole chain, against dense matrices written out here.

With more codes than cells, Hadamard codes are exact (A3): what is left is the quantisation of the
RAW file. The wanted matrices are built in the tests by loops, from the rows of the tables.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig
from pdcd.pictures.decode import decode_folder
from pdcd.runs.folder import read_manifest
from tests import bench_rig
from tests.taken import NO_FILES, attempt, started, take, take_with

pytestmark = pytest.mark.whole

GRID = bench_rig.GRID
ROWS, COLS = GRID
N = ROWS * COLS
RNG = np.random.default_rng(12)
LIGHT = np.round(RNG.random(GRID), 3)
WARP = RNG.permutation(N).reshape(GRID)
WARP_B = np.where(RNG.random(GRID) < 0.2, -1, RNG.integers(0, N, GRID))
REGION_A = (RNG.random(GRID) < 0.4).astype(float)
REGION_B = (RNG.random(GRID) < 0.4).astype(float)
KERNEL = np.round(RNG.normal(size=(3, 3)), 2)
FULL = np.round(RNG.normal(size=(N, N)), 3)
LOW_RANK = np.round(RNG.normal(size=(N, 2)), 2) @ np.round(RNG.normal(size=(2, N)), 2)


def where(n: int) -> tuple[int, int]:
    return n // COLS, n % COLS


def matrix(entry: Any) -> np.ndarray:
    return np.array([[float(entry(n, m)) for m in range(N)] for n in range(N)])


def far(n: int, m: int) -> int:
    (r, c), (s, t) = where(n), where(m)
    return max(abs(r - s), abs(c - t))


def step(n: int, down: int, right: int) -> int | None:
    """m = n + w, or None beyond the border."""
    r, c = where(n)
    r, c = r + down, c + right
    return r * COLS + c if 0 <= r < ROWS and 0 <= c < COLS else None


def filter_weight(n: int, m: int) -> float:
    """Table 2, row 7: n = m + w carries f_w."""
    (r, c), (s, t) = where(n), where(m)
    down, right = r - s, c - t
    return float(KERNEL[down + 1, right + 1]) if max(abs(down), abs(right)) <= 1 else 0.0


CASES: dict[str, tuple[dict[str, Any], np.ndarray]] = {
    "Table 1 row 1: lit scene": (
        {"goal": "illuminated", "illumination": LIGHT.tolist()},
        matrix(lambda n, m: LIGHT.flat[m]),
    ),
    "Table 1 row 2: its probing twin": (
        {"goal": "relit", "matrix": np.tile(LIGHT.ravel(), (N, 1)).tolist()},
        matrix(lambda n, m: LIGHT.flat[m]),
    ),
    "Table 1 row 3: diagonal": ({"goal": "diagonal"}, matrix(lambda n, m: n == m)),
    "Table 1 row 4: off-diagonal": (
        {"goal": "off-diagonal", "shift": [1, -2]},
        matrix(lambda n, m: step(n, 1, -2) == m),
    ),
    "Table 1 row 5: one sample a row": (
        {"goal": "warped", "warp": WARP.tolist()},
        matrix(lambda n, m: WARP.flat[n] == m),
    ),
    "Table 1 row 6: two samples": (
        {"goal": "two-samples", "warp": WARP.tolist(), "warp_b": WARP_B.tolist(),
         "mix": [0.75, -0.5]},
        matrix(lambda n, m: 0.75 * (WARP.flat[n] == m) - 0.5 * (WARP_B.flat[n] == m)),
    ),
    "Table 1 row 7: relit, any matrix": (
        {"goal": "relit", "matrix": FULL.tolist(), "illumination": LIGHT.tolist()},
        matrix(lambda n, m: FULL[n, m] * LIGHT.flat[m]),
    ),
    "Table 1 row 7: relit, low rank": (
        {"goal": "relit", "matrix": LOW_RANK.tolist()},
        LOW_RANK,
    ),
    "Table 1 row 7: indirect under a pattern": (
        {"goal": "indirect", "illumination": LIGHT.tolist()},
        matrix(lambda n, m: (n != m) * LIGHT.flat[m]),
    ),
    "Figure 11: all but one cell each": (
        {"goal": "indirect", "warp": WARP.tolist()},
        matrix(lambda n, m: WARP.flat[n] != m),
    ),
    "Figure 11: the same as a matrix": (
        {"goal": "relit", "matrix": matrix(lambda n, m: WARP.flat[n] != m).tolist()},
        matrix(lambda n, m: WARP.flat[n] != m),
    ),
    "Figure 11: what it leaves of white": (
        {"goal": "direct", "warp": WARP_B.tolist()},
        matrix(lambda n, m: WARP_B.flat[n] == m),
    ),
    "Figure 9 (d): a neighbour, and a share of the rest": (
        {"goal": "off-diagonal", "shift": [0, 1], "p": 0.25},
        matrix(lambda n, m: (step(n, 0, 1) is not None) * (1.0 if step(n, 0, 1) == m else 0.25)),
    ),
    "Table 2 row 1: direct": ({"goal": "direct"}, matrix(lambda n, m: n == m)),
    "Table 2 row 2: all other indirect": ({"goal": "indirect"}, matrix(lambda n, m: n != m)),
    "Table 2 row 5: transport masking": (
        {"goal": "blocked", "region_a": REGION_A.tolist(), "region_b": REGION_B.tolist()},
        matrix(lambda n, m: 1.0 - REGION_A.flat[n] * REGION_B.flat[m]),
    ),
    "Table 2 row 6: local de-scattering": (
        {"goal": "descattered", "shift": [0, -1]},
        matrix(
            lambda n, m: (step(n, 0, -1) is not None) * ((n == m) - 1.0 * (step(n, 0, -1) == m))
        ),
    ),
    "Table 2 row 7: filter": (
        {"goal": "filtered", "kernel": KERNEL.tolist()},
        matrix(filter_weight),
    ),
}  # fmt: skip


def run(
    folder: Path, files: Mapping[str, Path] = NO_FILES, **fields: Any
) -> tuple[np.ndarray, dict[str, Any], Path]:
    made = take(bench_rig.config(folder), files, **fields)
    return made.image, made.summary, made.folder


ROWS_OF_TABLES = [(row, 3) for row in CASES] + [
    pytest.param(row, 1, marks=[pytest.mark.long] * (n % 4 > 0)) for n, row in enumerate(CASES)
]


@pytest.mark.parametrize(("row", "colours"), ROWS_OF_TABLES)
def test_row_is_exact_with_more_codes_than_cells(row: str, colours: int, tmp_path: Path) -> None:
    fields, pi = CASES[row]
    profile = bench_rig.write_grey_profile(tmp_path) if colours == 1 else "modern"
    camera = CameraConfig(profile=profile, noise="none")
    made = take(bench_rig.config(tmp_path, camera=camera), codes=64, **fields)
    image, summary, folder = made.image, made.summary, made.folder
    assert image.shape == (*GRID, colours)
    assert made.quality.verdict == "good" and np.isfinite(made.probe["sigma"]).all()
    truth = (pi * bench_rig.transport()).sum(axis=1).reshape(*GRID, 1)
    scale = np.sqrt(np.mean((np.abs(pi) * bench_rig.transport()).sum(axis=1) ** 2))
    error = float(np.sqrt(np.mean((image - truth) ** 2)) / scale)
    assert error < 2e-3
    # The program's own idea of the truth agrees with the loops above.
    own = summary["rms_error_quads"] * np.sqrt(np.mean(truth**2))
    assert own == pytest.approx(np.sqrt(np.mean((image - truth) ** 2)), rel=1e-6)
    assert decode_folder(folder).identical
    for deviation in read_manifest(folder).realised.values():
        assert deviation["off_rms"] < 1e-6  # grey levels are stored in single precision


@pytest.mark.long
@pytest.mark.parametrize("radius", [1, 2])
@pytest.mark.parametrize("goal", ["long-range", "short-range"])
def test_range_goals(goal: str, radius: int, tmp_path: Path) -> None:
    """Table 2 rows 3 and 4: within the radius the one-shot code is exactly 0; the rest averages."""
    image, _, folder = run(tmp_path, goal=goal, radius=radius, codes=2048)
    t = bench_rig.transport()
    keep = matrix(
        lambda n, m: far(n, m) > radius if goal == "long-range" else 0 < far(n, m) <= radius
    )
    truth = (keep * t).sum(axis=1).reshape(*GRID, 1) * np.ones(3)
    seen = truth > 0
    error = np.sqrt(np.mean((image - truth)[seen] ** 2)) / np.sqrt(np.mean(truth[seen] ** 2))
    assert error < 0.15
    stored = np.load(folder / "codes.npz")
    lit = np.unpackbits(stored["far.primal"], axis=1)[:, :N].astype(int)
    opened = np.unpackbits(stored["far.dual"], axis=1)[:, :N].astype(int)
    meets = opened.T @ lit
    near = matrix(lambda n, m: far(n, m) <= radius) > 0
    assert meets[near].max() == 0 and meets[~near].min() > 0


def test_transport_masking_takes_two_codes(tmp_path: Path) -> None:
    fields, _ = CASES["Table 2 row 5: transport masking"]
    _, _, folder = run(tmp_path, codes=64, **fields)
    assert np.load(folder / "codes.npz")["blocked.primal"].shape[0] == 2


def test_a_blocking_matrix_is_found_to_need_two_codes(tmp_path: Path) -> None:
    """The same goal given as a bare matrix: few distinct rows are noticed (E11, footnote 4)."""
    pi = 1.0 - np.outer(REGION_A.ravel(), REGION_B.ravel())
    _, _, folder = run(tmp_path, goal="relit", matrix=pi.tolist(), codes=64)
    assert np.load(folder / "codes.npz")["relit.primal"].shape[0] == 2


@pytest.mark.long
@pytest.mark.parametrize("window", ["whole", "quarter"])
@pytest.mark.parametrize("goal", ["diagonal", "off-diagonal", "filtered"])
def test_signed_goals_have_no_bias_with_few_codes(goal: str, window: str, tmp_path: Path) -> None:
    """E6, E9: the mean over seeds of an unbiased estimator; quarter windows clump (R4)."""
    fields: dict[str, Any] = {"goal": goal, "family": "bernoulli", "window": window}
    if goal == "off-diagonal":
        fields["shift"] = [0, 1]
    if goal == "filtered":
        fields["kernel"] = KERNEL.tolist()
    pi = {
        "diagonal": matrix(lambda n, m: n == m),
        "off-diagonal": matrix(lambda n, m: step(n, 0, 1) == m),
        "filtered": matrix(filter_weight),
    }[goal]
    seeds = range(8 if window == "whole" else 4)
    with started(bench_rig.config(tmp_path)) as engine:
        images = [
            take_with(engine, f"job{seed}", **fields, codes=16, seed=seed).image for seed in seeds
        ]
    truth = (pi * bench_rig.transport()).sum(axis=1).reshape(*GRID, 1)
    error = np.std(images, axis=0, ddof=1) / np.sqrt(len(images))
    off = np.abs(np.mean(images, axis=0) - truth)
    if window == "whole":
        assert np.mean(off < 3.0 * error + 1e-3) > 0.9
        # 1.4 by chance; a bias of half of one capture's error in all cells makes it 3.4.
        assert np.mean((off / (error + 3e-4)) ** 2) < 3.0
    else:
        assert np.sqrt(np.mean(off**2)) < 0.25


@pytest.mark.parametrize(
    ("fields", "what"),
    [
        ({"goal": "off-diagonal", "shift": [3, 0]}, "leaves the grid"),
        ({"goal": "illuminated", "illumination": "/nowhere.npy"}, "not read"),
        ({"goal": "illuminated", "illumination": [[1.0, 0.0], [1.0]]}, "unequal length"),
        ({"goal": "filtered", "kernel": np.ones((7, 1)).tolist()}, "reaches further"),
        ({"goal": "long-range", "radius": 40}, "larger than anything"),
    ],
)
def test_bad_parameters_say_what_to_change(
    fields: dict[str, Any], what: str, tmp_path: Path
) -> None:
    result = attempt(bench_rig.config(tmp_path), **fields)
    assert result.state == "failed" and result.error is not None
    assert result.error["kind"] == "request"
    assert what in f"{result.error['message']} {result.error['hint']}"


def test_planes_come_from_images_and_npy_files(tmp_path: Path) -> None:
    levels = (LIGHT * 255).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "light.png"), levels)
    np.save(tmp_path / "light.npy", levels / 255.0)
    images = []
    for name in ("light.png", "light.npy"):
        folder = tmp_path / name.replace(".", "-")
        folder.mkdir()
        files = {"illumination": tmp_path / name}
        image, _, kept = run(folder, files=files, goal="illuminated", codes=8)
        images.append(image)
        manifest = read_manifest(kept)
        assert decode_folder(kept).identical
        digest = hashlib.sha256(files["illumination"].read_bytes()).hexdigest()
        assert manifest.request["illumination"] == {"file": name, "sha256": digest}
    np.testing.assert_array_equal(images[0], images[1])
