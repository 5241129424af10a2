"""Parts taken one after another until the picture is good enough.

After each part the pictures of what was taken so far are made; a preview and an event tell how far
they are. Only a spread of parts may end a run: with fewer than `FEWEST_PARTS` sigma is a guess.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdcd.capture.worker.answers import Seen
from pdcd.protocol.events import Converging
from pdcd.recipes.recipe import Recipe, Shot


@dataclass
class Convergence:
    """Where a run stands that may end early; `target` is RMS sigma over RMS image."""

    target: float
    reached: float = np.inf
    met: bool = False

    def after(self, recipe: Recipe, shot: Shot) -> bool:
        """Whether a shot completes a part, so that there is something new to look at."""
        # A shot beside another one comes with that.
        own = [s for s in recipe.shots if s.part == shot.part and not s.beside]
        return shot.part > 0 and shot is own[-1]

    def see(self, seen: Seen) -> Converging:
        """Take note of the pictures so far; returns the event that tells of them."""
        self.reached = seen.rms_sigma
        self.met = seen.sigma_kind == "measured" and self.reached <= self.target
        return Converging(
            part=seen.parts,
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
