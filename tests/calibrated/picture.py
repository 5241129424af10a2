"""Before and after a calibration, in one picture, of what `python -m tests.calibrated` kept.

``python -m tests.calibrated.picture FOLDER docs/plots/calibrate-before-after.png``: the indirect
photo of one bench as its user believed it to be, as it measured itself, and as it really is; as the
camera saw them, all equally bright, with their RMS errors against the known truth.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdcd.pictures.darkroom import Darkroom
from pdcd.runs.folder import read_manifest
from tests.bench import plots

WAYS = ("as believed", "as measured", "as it is")
TITLES = ("data sheets, hung by hand", "measured by pdcd calibrate", "what the bench really is")
BRIGHT_PERCENT, GAMMA = 99.0, 2.2
"""Light of the true picture that is shown white."""


def entry_of(folder: Path) -> dict[str, Any]:
    """The first bench of which there are captures. Raises SystemExit."""
    for line in (folder / "found.jsonl").read_text(encoding="utf-8").splitlines():
        entry: dict[str, Any] = json.loads(line)
        if all(entry.get(f"folder {way}") for way in WAYS):
            return entry
    raise SystemExit(f"{folder} has no bench with captures: run python -m tests.calibrated first")


def shown(folder: Path) -> NDArray[np.float64]:
    """The answer of a run as the camera saw it, (h, w, 3) in scene units."""
    answer = Darkroom(folder, read_manifest(folder).run).decoded().answer
    known = np.isfinite(answer.sigma)
    return np.where(known, answer.image, 0.0)


def draw(entry: dict[str, Any], path: Path) -> None:
    """Write the picture."""
    images = [shown(Path(entry[f"folder {way}"])) for way in WAYS]
    white = float(np.percentile(images[-1], BRIGHT_PERCENT))
    figure, axes = plots.panels(len(WAYS), scale=0.72)
    for place, image, way, title in zip(axes, images, WAYS, TITLES, strict=True):
        place.imshow(np.clip(image / white, 0.0, 1.0) ** (1.0 / GAMMA))
        place.set_title(f"{title}\nerror {entry[f'error {way}']:.2%}", fontsize=9)
        place.set_axis_off()
    plots.save(figure, path)


if __name__ == "__main__":
    draw(entry_of(Path(sys.argv[1])), Path(sys.argv[2]))
