"""Plain captures against the known truth: do error bars fit, with no option but the seed?

    python -m tests.bench.error_bars --seeds 10
    python -m tests.bench.error_bars --seeds 3 --ambient 0.3 --noise none
    python -m tests.bench.error_bars --seeds 5 --asked '{"codes": 128, "pilot": 16, "parts": 7}'

Each capture runs through the mock bench with full sensor noise, default panels and a frame of one
quad a cell, as `pdcd capture indirect --seed N` would take it; in ambient light, or with other
options of a request, where they are named.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from pdcd.bench.tables import CameraConfig, Config, LimitsConfig, ServerConfig
from tests import world
from tests.bench_rig import scene_of
from tests.taken import take as take_photo

MATRICES = ("corner", "mirror")
SCENES = (
    *MATRICES, "open-book", "wax-disk", "disco-ball", "milky-bottle", "mirror-and-vase",
)  # fmt: skip


@dataclass(frozen=True)
class Found:
    """One capture: RMS of error, sigma and sensor noise over the RMS of the true picture, and the
    share of values whose truth lies within 1.96 sigma."""

    error: float
    sigma: float
    sensor: float
    covered: float
    kind: str
    summary: dict[str, Any]


def bench(name: str, grid: tuple[int, int], seed: int, folder: Path, **camera: Any) -> Config:
    """The default mock bench before a scene; a path-traced one has its own 24 x 32 cells."""
    return Config(
        scene=scene_of(f"{name}_32x24" if name in MATRICES else name, grid),
        camera=CameraConfig(seed=seed, **camera),
        limits=LimitsConfig(min_free_bytes=0),
        server=ServerConfig(state_dir=str(folder / "state")),
    )


def take(config: Config, **fields: Any) -> Found:
    """Capture indirect light and hold it against the truth; AssertionError where it fails."""
    photo = take_photo(config, **fields)
    image, sigma, sensor = (photo.probe[k] for k in ("image", "sigma", "sigma_sensor"))
    scene = photo.engine._rig.scene
    assert scene is not None, "the bench has no scene to compare with"
    truth = scene.split()[1].reshape(image.shape)
    known = np.isfinite(sigma)
    total = float(np.sqrt(np.mean(truth[known] ** 2)))
    rms = [float(np.sqrt(np.mean(a[known] ** 2))) / total for a in (image - truth, sigma, sensor)]
    covered = float(np.mean(np.abs(image - truth)[known] <= 1.96 * sigma[known]))
    return Found(rms[0], rms[1], rms[2], covered, str(photo.probe["sigma_kind"]), photo.summary)


def judge(found: list[Found]) -> str:
    """Columns of the table: means over the seeds."""
    error, sigma, sensor = (
        float(np.sqrt(np.mean([getattr(f, k) ** 2 for f in found])))
        for k in ("error", "sigma", "sensor")
    )
    ratios = [f.sigma / f.error for f in found]
    covered = 100.0 * float(np.mean([f.covered for f in found]))
    parts = "/".join(str(p) for p in sorted({f.summary["parts"] for f in found}))
    kinds = "/".join(sorted({f.kind for f in found}))
    exposed = float(np.mean([f.summary["exposure_s"] for f in found]))
    return (
        f"{100 * error:.2f} % | {100 * sensor:.2f} % | {100 * sigma:.2f} % | "
        f"{sigma / error:.2f} ({min(ratios):.2f} to {max(ratios):.2f}) | {covered:.1f} | "
        f"{parts} | {kinds} | {exposed:.0f} s"
    )


def main() -> None:
    """Print the table, row by row."""
    world.enter()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--cells", default="32x24", help="columns x rows of the presets")
    parser.add_argument("--readout", type=float, help="seconds that a RAW file costs")
    parser.add_argument("--noise", choices=("full", "none"), default="full")
    parser.add_argument("--ambient", type=float, default=0.0, help="of a white card's light")
    parser.add_argument("--asked", type=json.loads, default={}, help="fields of the request, JSON")
    parser.add_argument("--scene", choices=SCENES, action="append")
    args = parser.parse_args()
    cols, rows = (int(n) for n in args.cells.split("x"))
    camera = {"readout_s": args.readout, "noise": args.noise}
    say = sys.stdout.write
    say(
        "| scene | error | noise | sigma | sigma / error | covered | parts | error bars | exposed |"
    )
    say(f"\n{'|---' * 9}|\n")
    for name in args.scene or SCENES:
        found = []
        for seed in range(args.seeds):
            with tempfile.TemporaryDirectory() as folder:
                config = bench(name, (rows, cols), seed, Path(folder), **camera)
                scene = msgspec.structs.replace(config.scene, ambient=args.ambient)
                config = msgspec.structs.replace(config, scene=scene)
                found.append(take(config, seed=seed, **args.asked))
        say(f"| {name} | {judge(found)} |\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
