"""Plain captures against the known truth at the camera's own quads: do error bars fit where frames
do not divide by the cells, and where devices are turned?

    python -m tests.bench.own_quads                        # all benches, all scenes, seed 0
    python -m tests.bench.own_quads --bench turned --scene corner --seeds 3

Each capture runs through the mock bench with full sensor noise, 24 x 32 cells, as `pdcd capture
indirect --seed N` would take it. The truth is seen through the same optics.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.bench.tables import CameraConfig, Config, PanelConfig
from pdcd.panels.placing import Placing
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.truth import read_known_answer
from pdcd.runs.verify import read_whole_manifest
from tests import world
from tests.bench.error_bars import SCENES as FEW
from tests.bench.error_bars import bench
from tests.bench.placed import anywhere
from tests.taken import take as take_photo

Bools = NDArray[np.bool_]

SCENES = (*FEW, "still-life", "glass-and-balls")
FRAME = (157, 115)
"""Width and height in quads, 4.9 x 4.8 to a cell."""


def _camera(**fields: Any) -> Callable[[Config], Config]:
    def changed(config: Config) -> Config:
        camera: CameraConfig = msgspec.structs.replace(config.camera, **fields)
        return msgspec.structs.replace(config, camera=camera)

    return changed


def _mask(**fields: Any) -> Callable[[Config], Config]:
    def changed(config: Config) -> Config:
        mask: PanelConfig = msgspec.structs.replace(config.mask, **fields)
        return msgspec.structs.replace(config, mask=mask)

    return changed


@dataclass(frozen=True)
class Bench:
    """How a bench differs from an upright one with `FRAME` quads, and what is asked of it."""

    change: Callable[[Config], Config] = lambda config: config
    fields: tuple[tuple[str, Any], ...] = ()


BENCHES = {
    "upright": Bench(),
    "8 parts of 128": Bench(fields=(("codes", 128), ("pilot", 0), ("parts", 8))),
    "quarter windows": Bench(fields=(("window", "quarter"),)),
    "turned": Bench(_camera(place=Placing(turn_deg=3.0, scale=1.1))),
    "much turned": Bench(
        _camera(frame_quads=(170, 110), place=Placing(turn_deg=35.0, flip="horizontal", scale=1.4))
    ),
    "all turned": Bench(lambda config: anywhere(config, 3)),
    "blurred": Bench(_camera(place=Placing(scale=1.15), blur_quads=0.7)),
    "real-sized": Bench(_camera(frame_quads=(534, 356))),
    "coarse": Bench(_camera(frame_quads=(80, 60), place=Placing(turn_deg=5.0, scale=1.2))),
    "one exposure": Bench(_camera(readout_s=1.0)),
    "mask turned, whole": Bench(
        _mask(place=Placing(turn_deg=2.0, scale=1.1)), (("window", "whole"),)
    ),
}


@dataclass(frozen=True)
class Found:
    """Squares summed over quads, and how many values there are, of which how many are covered."""

    error: float
    sigma: float
    truth: float
    count: int
    covered: int

    @property
    def ratio(self) -> float:
        """RMS sigma over RMS error."""
        return float(np.sqrt(self.sigma / self.error))

    def told(self, truth: float) -> str:
        """Columns of a table; `truth` is the mean square of the true picture."""
        error, sigma = (
            100.0 * float(np.sqrt(square / self.count / truth))
            for square in (self.error, self.sigma)
        )
        share = 100.0 * self.covered / self.count
        return f"{error:.2f} % | {sigma:.2f} % | {self.ratio:.2f} | {share:.1f}"


def take(config: Config, **fields: Any) -> tuple[Found, Found]:
    """Capture indirect light: all known quads, and those that see more than one cell. Raises
    AssertionError where it fails."""
    folder = take_photo(config, **fields).folder
    decoded = Darkroom(folder, read_whole_manifest(folder).run).decoded()
    truth, seen = read_known_answer(folder, decoded.cells).on_quads(decoded.cells)
    picture = decoded.answer
    known = seen & np.isfinite(picture.sigma).all(axis=-1)

    def over(quads: Bools) -> Found:
        sigma = picture.sigma[quads].astype(np.float64)
        error = picture.image[quads] - truth[quads]
        one, two, three = (
            float(np.sum(a.astype(np.float64) ** 2)) for a in (error, sigma, truth[quads])
        )
        covered = int(np.sum(np.abs(error) <= 1.96 * sigma))
        return Found(one, two, three, error.size, covered)

    return over(known), over(known & ~decoded.cells.single)


def judge(name: str, kind: str, seeds: range) -> str:
    """A row of the table."""
    found: list[tuple[Found, Found]] = []
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            config = bench(name, (24, 32), seed, Path(folder), frame_quads=FRAME)
            one = BENCHES[kind]
            found.append(take(one.change(config), **{"seed": seed, **dict(one.fields)}))
    whole, edges = (_added([pair[at] for pair in found]) for at in (0, 1))
    truth = whole.truth / whole.count
    told = edges.told(truth) if edges.count else "| | | "
    return f"| {kind} | {name} | {whole.told(truth)} | {told} |"


def _added(found: list[Found]) -> Found:
    sums = [sum(getattr(one, name) for one in found) for name in Found.__dataclass_fields__]
    return Found(*sums)


def main() -> None:
    """Print the table, row by row."""
    world.enter()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--bench", choices=BENCHES, action="append")
    parser.add_argument("--scene", choices=SCENES, action="append")
    args = parser.parse_args()
    say = sys.stdout.write
    say("| bench | scene | error | sigma | sigma / error | covered | error at edges | sigma |")
    say(" sigma / error | covered |\n|---|---|---|---|---|---|---|---|---|---|\n")
    for kind in args.bench or BENCHES:
        for name in args.scene or SCENES:
            seeds = range(args.first, args.first + args.seeds)
            say(judge(name, kind, seeds) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
