"""Before and after a calibration, in one picture, of what `python -m tests.calibrated` kept.

``python -m tests.calibrated.picture FOLDER docs/plots/calibrate-before-after.png``: the indirect
photo of one bench as its user believed it to be, as it measured itself, and as it really is, all
equally bright, with their RMS errors against the known truth. All are shown by the true map of the
camera, so that they can be compared.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.upright import FieldSampler
from pdcd.runs.folder import read_manifest
from tests.bench import plots

WAYS = ("as believed", "as measured", "as it is")
TITLES = ("data sheets, hung by hand", "measured by pdcd calibrate", "what the bench really is")
SIZE_PX = (480, 360)
BRIGHT_PERCENT, GAMMA = 99.0, 2.2
"""Light of the true picture that is shown white."""


def entry_of(folder: Path) -> dict[str, Any]:
    """The first bench of which there are captures. Raises SystemExit."""
    for line in (folder / "found.jsonl").read_text(encoding="utf-8").splitlines():
        entry: dict[str, Any] = json.loads(line)
        if all(entry.get(f"folder {way}") for way in WAYS):
            return entry
    raise SystemExit(f"{folder} has no bench with captures: run python -m tests.calibrated first")


def shown(folders: list[Path]) -> list[NDArray[np.floating]]:
    """The answers of runs on the field, (H, W, 3) in scene units, by the map of the last."""
    decoded = [Darkroom(folder, read_manifest(folder).run).decoded() for folder in folders]
    sampler = FieldSampler(decoded[-1].view, SIZE_PX)
    found = []
    for one in decoded:
        known = np.asarray(np.isfinite(one.answer.sigma).all(axis=-1))
        image, seen = sampler(one.answer.image, known)
        found.append(np.where(seen[..., None], image, 0.0))
    return found


def draw(entry: dict[str, Any], path: Path) -> None:
    """Write the picture."""
    images = shown([Path(entry[f"folder {way}"]) for way in WAYS])
    white = float(np.percentile(images[-1], BRIGHT_PERCENT))
    figure, axes = plots.panels(len(WAYS), scale=0.72)
    for place, image, way, title in zip(axes, images, WAYS, TITLES, strict=True):
        place.imshow(np.clip(image / white, 0.0, 1.0) ** (1.0 / GAMMA))
        place.set_title(f"{title}\nerror {100.0 * entry[f'error {way}']:.3g} %", fontsize=8)
        place.set_axis_off()
    plots.save(figure, path, colours=256)


if __name__ == "__main__":
    draw(entry_of(Path(sys.argv[1])), Path(sys.argv[2]))
