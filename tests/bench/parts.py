"""Plain captures, and those of 128 named codes, against the known truth: how far they are off, and
whether error bars fit. The same at two commits shows what a change is worth.

    python -m tests.bench.parts --cells 16x12 32x24 --seeds 3 --save now.json
    python -m tests.bench.parts --cells 16x12 32x24 --seeds 3 --against before.json

Each capture of indirect light runs through the mock bench with full sensor noise and 3 x 3 quads a
cell. Figures are RMS over the camera's quads in the field; *covered* is the share of their values
whose truth lies within 1.96 sigma. With `--against` a row ends in the error over that of the file.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pdcd.bench.tables import Config
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.truth import read_known_answer
from pdcd.runs.verify import read_whole_manifest
from tests import world
from tests.bench.error_bars import MATRICES, bench
from tests.taken import take as take_photo

PRESETS = (
    "open-book", "wax-disk", "disco-ball", "milky-bottle", "mirror-and-vase", "still-life",
    "glass-and-balls",
)  # fmt: skip
SCENES = (*MATRICES, *PRESETS)
WAYS: dict[str, dict[str, Any]] = {
    "plain": {},
    "128 codes": {"codes": 128},
    "64 codes": {"codes": 64},
    "one exposure": {"codes": 128, "pilot": 0, "parts": 1},
}
"""How each scene is photographed. Of these the first two are looked at unless others are named."""
QUADS = 3
"""Quads a cell, across and down."""
MATRIX_CELLS = "32x24"
"""Cells of the path-traced scenes."""


@dataclass(frozen=True)
class Taken:
    """One capture; `error` and `sigma` over the RMS of the truth, `covered` in percent."""

    error: float
    sigma: float
    covered: float
    exposures: str
    kind: str
    verdict: str
    refreshes: int


def take(config: Config, **fields: Any) -> Taken:
    """Capture indirect light. Raises AssertionError where it fails."""
    photo = take_photo(config, **fields)
    record = read_whole_manifest(photo.folder).run
    decoded = Darkroom(photo.folder, record).decoded()
    truth, seen = read_known_answer(photo.folder, decoded.cells).on_quads(decoded.cells)
    made = decoded.answer
    known = seen & np.isfinite(made.sigma).all(axis=-1)
    off, sigma = made.image[known] - truth[known], made.sigma[known]
    light, error, bars = (
        float(np.sqrt(np.mean(values.astype(np.float64) ** 2)))
        for values in (truth[known], off, sigma)
    )
    said = photo.summary
    pilot = f" after {said['pilot']}" * (said["pilot"] > 0)
    return Taken(
        error=error / light,
        sigma=bars / light,
        covered=100.0 * float(np.mean(np.abs(off) <= 1.96 * sigma)),
        exposures=f"{said['parts']}{pilot}",
        kind=made.kind,
        verdict=said["quality"].verdict,
        refreshes=sum(shot.refreshes for shot in record.shots if shot.name != "white"),
    )


def taken(cells: str, scene: str, way: str, seed: int) -> Taken:
    """One capture on the default bench."""
    cols, rows = (int(n) for n in cells.split("x"))
    with tempfile.TemporaryDirectory() as folder:
        frame = QUADS * cols, QUADS * rows
        config = bench(scene, (rows, cols), seed, Path(folder), frame_quads=frame)
        return take(config, seed=seed, **WAYS[way])


def cases(args: argparse.Namespace) -> Iterator[tuple[str, str, str]]:
    """Cells, scene and way of each row."""
    for cells in args.cells:
        for scene in args.scene or SCENES:
            if scene in MATRICES and cells != MATRIX_CELLS:
                continue
            for way in args.way or list(WAYS)[:2]:
                yield cells, scene, way


def row(key: tuple[str, str, str], found: list[Taken], before: list[Taken]) -> str:
    """A row of the table: means of squares over the seeds."""
    error, sigma = (
        float(np.sqrt(np.mean([getattr(one, name) ** 2 for one in found])))
        for name in ("error", "sigma")
    )
    ratios = [one.sigma / one.error for one in found]
    covered = float(np.mean([one.covered for one in found]))
    said = [
        "/".join(sorted({getattr(one, name) for one in found}))
        for name in ("exposures", "kind", "verdict")
    ]
    columns = [
        *key,
        f"{100.0 * error:.2f} %",
        f"{sigma / error:.2f} ({min(ratios):.2f} to {max(ratios):.2f})",
        f"{covered:.1f}",
        *said,
    ]
    if before:
        was = float(np.sqrt(np.mean([one.error**2 for one in before])))
        time = found[0].refreshes / before[0].refreshes
        columns += [f"{error / was:.2f}", f"{time:.2f}"]
    return f"| {' | '.join(columns)} |"


def main() -> None:
    """Print the table, row by row."""
    world.enter()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", nargs="+", default=["16x12", "32x24"], help="columns x rows")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--scene", choices=SCENES, action="append")
    parser.add_argument("--way", choices=WAYS, action="append")
    parser.add_argument("--save", type=Path, help="keep all figures in this file")
    parser.add_argument("--against", type=Path, help="figures of another commit")
    args = parser.parse_args()
    before = json.loads(args.against.read_text()) if args.against else {}
    heads = ["cells", "scene", "way", "error", "sigma / error", "covered", "exposures", "bars"]
    heads += ["verdict", *(["error over before", "refreshes over before"] if before else [])]
    say, kept = sys.stdout.write, {}
    say(f"| {' | '.join(heads)} |\n{'|---' * len(heads)}|\n")
    for key in cases(args):
        found = [taken(*key, args.first + n) for n in range(args.seeds)]
        kept[" ".join(key)] = [asdict(one) for one in found]
        others = [Taken(**one) for one in before.get(" ".join(key), [])]
        say(row(key, found, others) + "\n")
        sys.stdout.flush()
        if args.save:
            args.save.write_text(json.dumps(kept, indent=1))


if __name__ == "__main__":
    main()
