"""Parts taken one after another until the picture is good enough.

After each part the pictures of what was taken so far are made; a preview and an event tell how far
they are. Only a spread of parts may end a run: with fewer than `FEWEST_PARTS` sigma is a guess.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pdcd.errors import disk_errors
from pdcd.pictures.combine import Picture
from pdcd.pictures.darkroom import Decoded
from pdcd.pictures.develop import preview, write_png
from pdcd.recipes.parts import part_numbers
from pdcd.recipes.recipe import Recipe, Shot
from pdcd.runs.events import Converging

PREVIEW = "preview/running.png"


def rms_sigma(picture: Picture) -> float:
    """RMS sigma over RMS image, where sigma is finite; infinite where that is nowhere or dark."""
    known = np.isfinite(picture.sigma)
    light = float(np.sum(picture.image[known] ** 2))
    return float(np.sqrt(np.sum(picture.sigma[known] ** 2) / light)) if light > 0.0 else np.inf


@dataclass
class Convergence:
    """Where a run stands that may end early; `target` is RMS sigma over RMS image."""

    target: float
    reached: float = np.inf
    met: bool = False

    def after(self, recipe: Recipe, shot: Shot) -> bool:
        """Whether a shot completes a part, so that there is something new to look at."""
        last = next(s for s in reversed(recipe.shots) if s.part == shot.part)
        return shot.part > 0 and shot is last

    def see(self, folder: Path, decoded: Decoded) -> Converging:
        """Look at the pictures so far, write the preview, return the event that tells of it."""
        answer = decoded.answer
        self.reached = rms_sigma(answer)
        self.met = answer.kind == "measured" and self.reached <= self.target
        with disk_errors(str(folder)):
            write_png(folder / PREVIEW, preview(answer.image))
        return Converging(
            part=len(part_numbers(decoded.recipe)),
            rms_sigma=self.reached if np.isfinite(self.reached) else None,
            target=self.target,
        )

    @property
    def warning(self) -> str:
        """What to say when all parts were not enough."""
        return (
            f"sigma came down to {100.0 * self.reached:.2g} %, not to the {100.0 * self.target:g} %"
            " asked for"
        )
