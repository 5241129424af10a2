"""Do two checkouts take the same pictures? A tool for changes that are to change no picture.

::

    python -m tests.same_pictures take  CHECKOUT FOLDER     # 24 captures by its .venv/bin/pdcd
    python -m tests.same_pictures compare BEFORE AFTER      # byte by byte, file by file

It speaks to the command line only, so that it runs on any version. Between them the requests use
every goal, every family, both windows, every schedule, parts, a pilot, an early end, every black
level, every method, 24 planes a refresh, missed refreshes, and a sensor with and without noise.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tests import world

GRID = (12, 16)
CELLS = GRID[0] * GRID[1]


@dataclass(frozen=True)
class Case:
    """One request: options of `pdcd capture`, and the tables of its configuration."""

    name: str
    options: str
    config: str = ""
    grid: tuple[int, int] = GRID
    arrays: tuple[str, ...] = field(default=())


NO_NOISE = '[camera]\nnoise = "none"\n'
SLOW = "[mask]\nrise_s = 0.002\nfall_s = 0.004\ncontrast = 300.0\nskew_s = 0.001\n"
MISSED = '[rig]\non_miss = "flag"\n[display.faults]\ndropped = [40, 41, 90]\nlate = {"60" = 1}\n'
BALANCED = '[rig]\non_miss = "balance"\n[display.faults]\ndropped = [40, 41, 90]\n'
PLANES = "[display]\nplanes_per_refresh = 24\n"

CASES = (
    Case("white", "white"),
    Case("indirect", "indirect --codes 64", grid=(48, 64)),
    Case("indirect-quarter", "indirect --codes 32 --window quarter", NO_NOISE),
    Case("indirect-bernoulli", "indirect --codes 32 --family bernoulli --seed 3"),
    Case("direct-rademacher", "direct --codes 32 --family rademacher", SLOW),
    Case("fraction-balanced", "fraction --p 0.25 --codes 64 --family balanced"),
    Case("fraction-singer", "fraction --p 0.25 --codes 78 --family singer"),
    Case("illuminated", "illuminated", arrays=("illumination",)),
    Case("indirect-lit", "indirect --codes 32", NO_NOISE, arrays=("illumination",)),
    Case("diagonal-parts", "diagonal --codes 64 --parts 4"),
    Case(
        "off-diagonal", "off-diagonal --shift 0 1 --codes 64", "[mask]\noffset_px = [3.0, -2.0]\n"
    ),
    Case("warped", "warped --codes 64 --schedule lag", arrays=("warp",)),
    Case("two-samples", "two-samples --mix 0.7 -0.3 --codes 64", arrays=("warp", "warp-b")),
    Case("relit", "relit --codes 64", NO_NOISE, arrays=("matrix",)),
    Case("long-range-black", "long-range --radius 1 --codes 64 --black-level both", SLOW),
    Case("short-range", "short-range --radius 1 --codes 64 --window quarter"),
    Case("blocked", "blocked", arrays=("region-a", "region-b")),
    Case("descattered", "descattered --shift 0 -1 --codes 64 --normalise row"),
    Case("filtered", "filtered --codes 64 --black-level mask", arrays=("kernel",)),
    Case("split-missed", "split --period 4 --codes 64", MISSED),
    Case("pilot", "indirect --pilot 32 --codes 96", '[scene]\nkind = "mirror-and-vase"\n'),
    Case(
        "until-error",
        "indirect --codes 128 --parts 16 --until-error 10% --schedule both",
        '[scene]\nkind = "disco-ball"\n',
    ),
    Case("nayar-planes", "direct --method nayar --schedule none", PLANES),
    Case("multi-balance", "indirect --method multi-image --codes 16 --black-level none", BALANCED),
    Case("isolation", "indirect --family confocal", NO_NOISE, grid=(3, 4)),
    Case("seconds", "indirect --seconds 8"),
    Case("planes", "indirect --codes 64 --repeat 2 --black-level ambient", PLANES),
)


def arrays(grid: tuple[int, int]) -> dict[str, np.ndarray]:
    """Every array that a case may name, seeded."""
    rng = np.random.default_rng(7)
    cells = grid[0] * grid[1]
    rows, cols = np.indices(grid)
    return {
        "illumination": np.round(0.2 + 0.8 * rng.random(grid), 3),
        "warp": rng.permutation(cells).reshape(grid),
        "warp-b": np.roll(np.arange(cells), 5).reshape(grid),
        "region-a": (rows < grid[0] // 2).astype(float),
        "region-b": (cols < grid[1] // 2).astype(float),
        "kernel": np.array([[0.0, -1.0, 0.0], [-1.0, 4.0, -1.0], [0.0, -1.0, 0.0]]),
        "matrix": rng.normal(size=(cells, cells)),
    }


def take(checkout: Path, out: Path) -> None:
    """Take all captures with the program of a checkout."""
    out.mkdir(parents=True, exist_ok=True)
    for case in CASES:
        with tempfile.TemporaryDirectory() as scratch:
            config = Path(scratch) / "bench.toml"
            grid = f"grid = [{case.grid[0]}, {case.grid[1]}]\n"
            text = case.config
            text = (
                text.replace("[scene]\n", "[scene]\n" + grid)
                if "[scene]" in text
                else f"{text}[scene]\n{grid}"
            )
            config.write_text(text)
            given = arrays(case.grid)
            options = case.options.split()
            for name in case.arrays:
                np.save(Path(scratch) / f"{name}.npy", given[name])
                options += [f"--{name}", f"{scratch}/{name}.npy"]
            command = [str(checkout / ".venv/bin/pdcd"), "capture", *options, "--local", "--json"]
            command += ["--config", str(config), "--out", str(out / case.name)]
            done = subprocess.run(command, capture_output=True, text=True, cwd=checkout)
        last = json.loads((done.stdout.strip().splitlines() or ["{}"])[-1])
        if last.get("state") != "done":
            raise SystemExit(f"{case.name}: {done.stderr.strip()[-2000:]}")
        sys.stdout.write(f"{case.name}\n")


def compare(before: Path, after: Path) -> bool:
    """Print what differs between the runs in two folders; whether nothing does."""
    alike = True
    for case in CASES:
        one, two = (next(path for path in (root / case.name).iterdir()) for root in (before, after))
        notes = [*_files(one, two, "linear/*.tif"), *_files(one, two, "frames.csv")]
        notes += [*_arrays(one, two, "codes.npz"), *_arrays(one, two, "probe.npz")]
        alike = alike and not notes
        sys.stdout.write(f"{case.name:20} {'; '.join(notes) or 'the same'}\n")
    return alike


def _files(one: Path, two: Path, pattern: str) -> list[str]:
    names = sorted({str(p.relative_to(root)) for root in (one, two) for p in root.glob(pattern)})
    return [n for n in names if not _same_bytes(one / n, two / n)]


def _same_bytes(one: Path, two: Path) -> bool:
    return one.is_file() and two.is_file() and one.read_bytes() == two.read_bytes()


def _arrays(one: Path, two: Path, name: str) -> list[str]:
    with np.load(one / name) as first, np.load(two / name) as second:
        notes = [f"{name} has other arrays"] if set(first.files) != set(second.files) else []
        for key in sorted(set(first.files) & set(second.files)):
            a, b = first[key], second[key]
            if a.dtype == b.dtype and a.tobytes() == b.tobytes() and a.shape == b.shape:
                continue
            far = ""
            if a.shape == b.shape and a.dtype.kind == "f":
                scale = float(np.sqrt(np.mean(np.where(np.isfinite(a), a, 0.0) ** 2))) or 1.0
                with np.errstate(invalid="ignore"):
                    far = f" by {np.nanmax(np.abs(a - b)) / scale:.1e} of its RMS"
            notes.append(f"{name}[{key}]{far}")
    return notes


def main() -> None:
    """Take, or compare."""
    world.enter()
    match sys.argv[1:]:
        case ["take", checkout, out]:
            take(Path(checkout).absolute(), Path(out).absolute())
        case ["compare", before, after]:
            sys.exit(not compare(Path(before), Path(after)))
        case _:
            sys.exit(__doc__)


if __name__ == "__main__":
    main()
