"""Goals of grey patterns on panels of 8 bits: gamma of 2.2 in both, known, against none.

    python -m tests.bench.grey_levels

Captures without noise of 128 codes on 12 x 16 cells, held against a dense evaluation of the scene.
"""

from __future__ import annotations

import sys
import tempfile
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.bench.tables import CameraConfig, Config, LimitsConfig, SceneConfig, ServerConfig
from pdcd.virtual.scene.build import build_scene
from tests import world
from tests.taken import relative_rms, take

GRID = (12, 16)
N = GRID[0] * GRID[1]
SCENES = ("open-book", "wax-disk")
SEEDS = 2
Floats = NDArray[np.float64]

ROW, COL = np.divmod(np.arange(N), GRID[1])


def convolution(kernel: Floats) -> Floats:
    """Tap w of a 3 x 3 kernel pairs cell n with cell n - w, (N, N)."""
    out = np.zeros((N, N))
    for n in range(N):
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                row, col = ROW[n] - down, COL[n] - right
                if 0 <= row < GRID[0] and 0 <= col < GRID[1]:
                    out[n, row * GRID[1] + col] += kernel[down + 1, right + 1]
    return out


def jobs() -> dict[str, tuple[dict[str, Any], Floats]]:
    """What is asked for, and the matrix that it means."""
    rng = np.random.default_rng(1)
    away = np.hypot(ROW[:, None] - ROW, COL[:, None] - COL)
    blur = np.outer([1.0, 2.0, 1.0], [1.0, 2.0, 1.0]) / 16.0
    edges = np.array([[0.0, -1.0, 0.0], [-1.0, 4.0, -1.0], [0.0, -1.0, 0.0]])
    matrices = {
        "a band": np.where(away <= 3.0, 1.0, 0.2 * np.exp(-away / 6.0)),
        "rank 3": rng.random((N, 3)) @ rng.random((3, N)),
        "rank 3 of both signs": rng.standard_normal((N, 3)) @ rng.standard_normal((3, N)),
        "16 different rows": rng.random((16, N))[rng.integers(16, size=N)],
        "3 different rows": rng.random((3, N))[rng.integers(3, size=N)],
    }
    light = 0.1 + 0.9 * rng.random(N)
    lit = {"illumination": light.reshape(GRID).tolist()}
    return {
        "`filtered`, blur": ({"goal": "filtered", "kernel": blur.tolist()}, convolution(blur)),
        "`filtered`, edges": ({"goal": "filtered", "kernel": edges.tolist()}, convolution(edges)),
        **{
            f"`relit`, {name}": ({"goal": "relit", "matrix": wanted.tolist()}, wanted)
            for name, wanted in matrices.items()
        },
        "`illuminated`": ({"goal": "illuminated", **lit}, np.tile(light, (N, 1))),
        "`indirect`, illuminated": ({"goal": "indirect", **lit}, (1.0 - np.eye(N)) * light),
    }


def error(fields: dict[str, Any], wanted: Floats, scene: str, gamma: float, seed: int) -> float:
    """RMS error over the RMS of the true picture. Raises AssertionError where a capture fails."""
    with tempfile.TemporaryDirectory() as folder:
        plain = Config()
        config = Config(
            scene=SceneConfig(kind=scene, grid=GRID),
            camera=CameraConfig(noise="none"),
            limits=LimitsConfig(min_free_bytes=0),
            server=ServerConfig(state_dir=folder),
            projector=msgspec.structs.replace(plain.projector, gamma=gamma),
            mask=msgspec.structs.replace(plain.mask, gamma=gamma),
        )
        request = {"codes": 128, "window": "whole", "seed": seed, **fields}
        image = take(config, **request).image
    transport = build_scene(config.scene).dense()
    return relative_rms(image, np.einsum("nm,cnm->nc", wanted, transport).reshape(image.shape))


def main() -> None:
    """Print the table, row by row."""
    world.enter()
    say = sys.stdout.write
    heads = [f"{scene}: {panels}" for scene in SCENES for panels in ("gamma 1", "gamma 2.2")]
    say(f"| goal | {' | '.join(heads)} |\n|{'---|' * (1 + len(heads))}\n")
    for name, (fields, wanted) in jobs().items():
        cells = []
        for scene in SCENES:
            for gamma in (1.0, 2.2):
                found = [error(fields, wanted, scene, gamma, seed) for seed in range(SEEDS)]
                cells.append(f"{100.0 * np.sqrt(np.mean(np.square(found))):.2g} %")
        say(f"| {name} | {' | '.join(cells)} |\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
