"""The error a plan will have before an unknown scene: variance formulas and a stated guess.

S is the indirect light of a cell, Q the sum of the squares of its paths, D its direct light, so
that N_eff = S^2 / Q paths bring it. For K codes, relative to the weight of the photo:

- indirect light, i.i.d. coins (`bernoulli`, the paper): variance ``(S^2 + 2 Q) / K``;
- every cell lit equally often (`balanced`): ``Q / (K - 1)``;
- Hadamard columns: only pairs of cells with the same column count, which gives
  ``Q (N / (K - 1) - 1) / (N - 1)`` for paths that have nothing to do with where columns are
  reused; smooth light does far better.

The same with m = i keeps D + p S: ``(1 - p) (Q + (D + p S)^2 / p) / K`` for coins, and
``(1 - p)^2`` times the variances above for the others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdcd.planning.metering import TARGET
from pdcd.planning.outlook import ErrorEstimate, RigSetting
from pdcd.planning.plan import COINS, Plan
from pdcd.planning.rehearse import predict_probing_matrix
from pdcd.probing.deviation import weight_s

GUESSABLE_GOALS = ("white", "indirect", "direct", "fraction")
"""Goals whose errors a guess can tell."""


@dataclass(frozen=True)
class ScenePrior:
    """What is assumed of an unknown scene.

    paths : N_eff, cells that the indirect light of one cell comes from, in effect.
    indirect : share of the light that is indirect, 0..1.
    contrast : brightest sample of a picture over its RMS.
    """

    paths: float = 50.0
    indirect: float = 0.3
    contrast: float = 3.0

    def __str__(self) -> str:
        return (
            f"guess: {self.paths:g} paths, {100.0 * self.indirect:g} % indirect, "
            f"contrast {self.contrast:g}"
        )


@dataclass(frozen=True)
class PlanGuess:
    """A plan before a scene of which only a `ScenePrior` is known; see the module for the formulas.

    leak : direct light that gets into a photo of indirect light, as a share of the direct light,
        by the panels' own timing and contrast.
    """

    plan: Plan
    setting: RigSetting
    prior: ScenePrior
    leak: float

    def judge(self, iso: int, passes: int) -> ErrorEstimate:
        """Errors at that ISO. The light is taken to suffice: metering is taken to find it."""
        cells = self.plan.grid[0] * self.plan.grid[1]
        signal, code, sensor = self._parts(self._relative_noise(iso, passes))
        code, sensor = code / signal, sensor / signal
        return ErrorEstimate(
            code=code,
            sensor=sensor,
            code_var=2.0 * code**4 / cells,
            cross_var=4.0 * code**2 * sensor**2 / (3 * cells),
            sensor_var=2.0 * sensor**4 / (3 * cells),
            headroom=1.0,
        )

    def _parts(self, noise: float) -> tuple[float, float, float]:
        """Signal, error of the codes and of the sensor, as shares of all light.

        `noise` is the sensor's error of one photo relative to that photo.
        """
        direct, indirect = 1.0 - self.prior.indirect, self.prior.indirect
        goal = self.plan.recipe.target.goal
        if goal.name == "white":
            return 1.0, 0.0, noise
        if goal.name == "fraction":
            p = self.plan.p
            signal = direct + p * indirect
            return signal, self._kept_error(p, signal), noise * signal
        code = float(np.hypot(self._indirect_error(), self.leak * direct))
        if goal.name == "indirect":
            return indirect, code, noise * indirect
        # White minus indirect: both photos are metered on their own and add their noise.
        return direct, code, noise * float(np.hypot(1.0, indirect))

    def _indirect_error(self) -> float:
        """RMS error of the codes in indirect light, as a share of all light."""
        s2 = self.prior.indirect**2
        if self.plan.family in COINS:
            return float(np.sqrt((s2 + 2.0 * s2 / self.prior.paths) / self.plan.how.coded))
        return float(np.sqrt(s2 / self.prior.paths * self._share()))

    def _kept_error(self, p: float, signal: float) -> float:
        """The same in ``direct + p indirect`` light."""
        q = self.prior.indirect**2 / self.prior.paths
        if self.plan.family in COINS:
            return float(np.sqrt((1.0 - p) * (q + signal**2 / p) / self.plan.how.coded))
        return (1.0 - p) * float(np.sqrt(q * self._share()))

    def _share(self) -> float:
        """Variance that one path of strength 1 brings into a picture of weight 1."""
        count, cells = self.plan.how.coded, self.plan.grid[0] * self.plan.grid[1]
        if self.plan.family != "hadamard":
            return 1.0 / max(count - 1, 1)
        return max(cells / max(count - 1, 1) - 1.0, 0.0) / max(cells - 1, 1)

    def _relative_noise(self, iso: int, passes: int) -> float:
        """RMS of the sensor's error over that of one photo, its brightest sample metered."""
        responsivity = self.setting.camera.responsivity_e
        brightest_dn = TARGET * self.setting.profile.saturation_dn(iso)
        signal_dn = brightest_dn / self.prior.contrast * responsivity / responsivity.max()
        exposure_s = passes * max(self.plan.exposure_s(shot) for shot in self.plan.recipe.shots)
        variance = self.setting.variance_dn2(signal_dn, iso, exposure_s)
        samples = np.array([1.0, 2.0, 1.0])
        return float(np.sqrt(np.mean(variance / samples / signal_dn**2)))


def guess_plan(plan: Plan, setting: RigSetting, prior: ScenePrior) -> PlanGuess:
    """Foresee a plan by a prior; its goal must be one of `GUESSABLE_GOALS`."""
    leak = 0.0
    photo = plan.recipe.coded
    if photo is not None and plan.recipe.target.goal.name in ("indirect", "direct"):
        shot = next(s for s in plan.recipe.shots if s.name == photo.shots[0][1])
        matrix = predict_probing_matrix(plan, shot, setting.config)
        left = matrix.coaxial.copy()
        signs = {name: sign for sign, name in photo.shots}
        for black in plan.recipe.shots:
            dark = black.primal_black or black.dual_black
            if dark and black.program == shot.program and not black.copy_of:
                left += (
                    signs[black.name] * predict_probing_matrix(plan, black, setting.config).coaxial
                )
        leak = float(np.sqrt(np.mean(left**2))) / weight_s(matrix, photo.wanted)
    return PlanGuess(plan, setting, prior, leak)
