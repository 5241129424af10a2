"""Prediction of the error that codes and sensor leave in a photo, by closed-form variance formulas.

S is the indirect light of a cell, Q the sum of the squares of its paths, D its direct light. With N
cells and K codes, relative to the weight of the photo:

- indirect light, i.i.d. coins (`bernoulli`, the paper): variance ``(S^2 + 2 Q) / K``;
- every cell lit equally often (`balanced`): ``Q / (K - 1)``;
- Hadamard columns: each of K - 1 columns is used by ``N / (K - 1)`` cells, which keep about
  ``sqrt(K - 1)`` cells apart. Only light between these is wrong, and of it only what the correction
  for smooth light leaves: ``q (N / (K - 1) - 1)``, where q is the mean square of what is left of a
  path from so far.

A mask m = i keeps D + p S: the variance is ``(1 - p) (Q + (D + p S)^2 / p) / K`` for coins, and
``(1 - p)^2`` times the variances above for the others. The sensor's noise is that of a picture
whose brightest sample lies where metering puts it.

This is a plan's forecast, good to about a quarter where the scene is known (docs/planning.md). What
leaks through black panels is left to a look at it. The real error of a photo is measured, by its
parts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from pdcd.arrays import Floats
from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import Config
from pdcd.pictures.smooth import HALF_LIGHT_CELLS
from pdcd.planning.metering import TARGET
from pdcd.planning.plan import COINS
from pdcd.sensor.profile import SensorProfile, compute_variance_dn2, weigh_colours
from pdcd.virtual.scene.scene import Scene
from pdcd.words import FamilyName

PREDICTED_GOALS = ("white", "indirect", "direct", "fraction")
"""Goals whose errors the formulas predict."""
_APART = 0.8
"""Distance of the nearest cells of one column, over the root of the number of columns, as
`pdcd.codes.colouring` places them."""
_SMOOTH_LEFT = 0.4
"""Share that a single exposure leaves of the light that models of smooth light explain, as
measured; parts leave next to nothing of it."""
_UNSURE = 0.12
"""RMS relative difference between measured errors and these forecasts, with known scenes."""
_STOP_LIGHT = 0.89
"""Light at the stop that is set, over that wanted: stops come in thirds, and the next narrower one
is taken, ``(1 - 2^(-1/3)) / ln 2^(1/3)`` on average."""
_SAMPLED_CELLS = 256
"""Cells whose paths are evaluated one by one; more of them hardly change the mean."""


@dataclass(frozen=True)
class RigSetting:
    """The properties of a rig that the error depends on."""

    config: Config
    camera: CameraInfo
    profile: SensorProfile
    mask_lag_s: float | None = None
    """As the display measured it; None where it is not known."""


@dataclass(frozen=True, eq=False)
class SceneLight:
    """The scene in front of a rig, in the figures that errors follow from.

    name : what it is, for people. direct, indirect : (cells, 3) scene units, of all cells or of a
    sample of them. squares : Q of an average cell, of the mean of R, G, B. rough, smooth : (R,) for
    r = 0, 1, 2 ... the mean square of paths from r cells or farther: the part that models of smooth
    light (`pdcd.pictures.smooth`) leave at their best, and the part that they explain. weak : (N,),
    mean square of all paths to a cell except its r strongest. If these three are None, all paths
    are alike. measured : whether light is in the scene units of the camera's answer.
    """

    name: str
    direct: Floats
    indirect: Floats
    squares: float
    rough: Floats | None = None
    smooth: Floats | None = None
    weak: Floats | None = None
    measured: bool = False

    def shared_square(self, columns: int, cells: int, *, split: bool, guided: bool) -> float:
        """Mean square error of the paths between cells that share one of so many columns of a
        Hadamard matrix. These cells keep their distance, or are chosen by the strength of their
        paths (`guided`)."""
        if self.rough is None or self.smooth is None or self.weak is None:
            return self.squares / max(cells - 1, 1)
        if guided:
            return float(self.weak[min(columns, cells - 1)])
        ring = min(round(_APART * columns**0.5), self.rough.size - 1)
        smooth = 0.0 if split else _SMOOTH_LEFT**2 * self.smooth[ring]
        return float(self.rough[ring] + smooth)


def guess_scene_light() -> SceneLight:
    """The assumptions for an unknown scene: 50 paths to each cell, 30 % of the light indirect, and
    a brightest sample of 3 times the picture's RMS."""
    paths, indirect, contrast, cells = 50.0, 0.3, 3.0, 12
    # One bright cell in twelve; with the others the picture has an RMS of 1.
    rest = float(np.sqrt((cells - contrast**2) / (cells - 1)))
    picture = np.tile(np.array([[contrast], *[[rest]] * (cells - 1)]), (1, 3))
    told = f"guess: {paths:g} paths, {100.0 * indirect:g} % indirect, contrast {contrast:g}"
    light = (1.0 - indirect) * picture, indirect * picture
    return SceneLight(told, *light, squares=indirect**2 / paths)


def measure_scene_light(scene: Scene, name: str) -> SceneLight:
    """The figures of a known scene over the rig's cells, from the light of some of them."""
    cells, columns = scene.cells, scene.grid[1]
    direct, indirect = scene.split()
    chosen = np.random.default_rng(0).permutation(cells)[:_SAMPLED_CELLS]
    lit = np.zeros((chosen.size, cells))
    lit[np.arange(chosen.size), chosen] = 1.0
    paths = scene.apply(lit).mean(axis=-1)
    paths[np.arange(chosen.size), chosen] = 0.0
    row, column = np.divmod(np.arange(cells), columns)
    apart = np.hypot(row - row[chosen][:, None], column - column[chosen][:, None])
    grey = indirect.mean(axis=1)
    even = grey[chosen][:, None] * grey
    near = even / (1.0 + (apart / HALF_LIGHT_CELLS) ** 2)
    rings = np.rint(apart).astype(int).ravel()

    def beyond(values: Floats) -> Floats:
        """Means over all pairs of cells that are r or farther apart."""
        sums, counts = np.bincount(rings, values.ravel()), np.bincount(rings)
        return np.asarray(sums[::-1].cumsum()[::-1] / counts[::-1].cumsum()[::-1])

    whole = beyond(paths**2)
    models = np.moveaxis(
        np.array([[beyond(one * other) for other in (even, near)] for one in (even, near)]), 2, 0
    )
    told = np.stack([beyond(paths * one) for one in (even, near)], axis=1)
    best = np.linalg.pinv(models, rcond=1e-9, hermitian=True) @ told[..., None]
    smooth = np.clip((told * best[..., 0]).sum(axis=1), 0.0, whole)
    strength = np.sort(paths**2, axis=1).cumsum(axis=1).mean(axis=0)
    weak = strength[::-1] / np.arange(cells, 0, -1)
    squares = float((paths**2).sum()) / chosen.size
    return SceneLight(name, direct, indirect, squares, whole - smooth, smooth, weak)


@dataclass(frozen=True)
class PredictedError:
    """RMS errors of an answer over the RMS of the truth.

    code : by codes that are too few; no light lowers it. sensor : its noise. cells : of the answer.
    split : whether each exposure has codes of its own.
    """

    code: float
    sensor: float
    cells: int
    split: bool = False

    def repeated(self, exposures: int) -> PredictedError:
        """The error of so many such exposures together."""
        root = float(np.sqrt(exposures))
        code = self.code / root if self.split else self.code
        return replace(self, code=code, sensor=self.sensor / root)

    @property
    def error(self) -> float:
        """Both together."""
        return float(np.hypot(self.code, self.sensor))

    def bound(self, confidence: float) -> float:
        """RMS error that is not exceeded with this probability, by the normal distribution: of
        chance in the codes and the noise, and of the error of the formulas."""
        spread = float(np.hypot(_UNSURE, np.sqrt(0.5 / self.cells)))
        return self.error * max(0.0, 1.0 + NormalDist().inv_cdf(confidence) * spread)


@dataclass(frozen=True)
class PhotoCodes:
    """How a goal is to be photographed, as far as the error of one exposure depends on it.

    count : of codes. lit_s : time for which they are shown in all, without dark times and guards.
    split : whether each exposure has codes of its own. guided : whether a prior keeps cells apart.
    """

    goal: str
    family: FamilyName
    p: float
    grid: tuple[int, int]
    count: int
    exposure_s: float
    lit_s: float
    split: bool = False
    guided: bool = False


def predict_error(
    codes: PhotoCodes, light: SceneLight, setting: RigSetting, iso: int
) -> PredictedError:
    """The error of an answer from one exposure of its codes, by which the planner compares plans
    (`pdcd.planning.choose`).

    codes : of a goal of `PREDICTED_GOALS`. Metering is taken to reach the light it wants, as far as
    the widest aperture allows if the light of the scene is known.
    """
    direct, indirect = light.direct, light.indirect
    pictures = {"white": direct + indirect, "indirect": indirect, "direct": direct}
    truth = pictures.get(codes.goal, direct + codes.p * indirect)
    coded_s = codes.lit_s * (codes.p if codes.goal == "fraction" else codes.p * (1.0 - codes.p))
    most_s = coded_s if light.measured else np.inf
    photos = [(truth, np.inf if codes.goal == "white" else most_s)]
    if codes.goal == "direct":
        photos = [(pictures["white"], np.inf), (indirect, most_s)]
    noises = [_photo_noise(*photo, setting, iso, codes.exposure_s) for photo in photos]
    code = 0.0
    if codes.goal == "fraction":
        code = _kept_error(codes, light, _rms(truth))
    elif codes.goal != "white":
        code = _indirect_error(codes, light)
    total, cells = _rms(truth) or 1.0, codes.grid[0] * codes.grid[1]
    sensor = float(np.linalg.norm(noises))
    return PredictedError(code / total, sensor / total, cells, codes.split)


def _rms(picture: Floats) -> float:
    return float(np.sqrt(np.mean(picture**2)))


def _indirect_error(codes: PhotoCodes, light: SceneLight) -> float:
    """RMS error of the codes in indirect light, in scene units."""
    if codes.family in COINS:
        s2 = _rms(light.indirect) ** 2
        return float(np.sqrt((s2 + 2.0 * light.squares) / codes.count))
    return float(np.sqrt(_path_variance(codes, light)))


def _kept_error(codes: PhotoCodes, light: SceneLight, signal: float) -> float:
    """The same in direct light and a share p of the indirect light, whose RMS is `signal`."""
    p = codes.p
    if codes.family in COINS:
        variance = (1.0 - p) * (light.squares + signal**2 / p) / codes.count
        return float(np.sqrt(variance))
    return (1.0 - p) * float(np.sqrt(_path_variance(codes, light)))


def _path_variance(codes: PhotoCodes, light: SceneLight) -> float:
    """Variance of the paths to a cell in a picture of weight 1, by codes that light all alike."""
    cells, columns = codes.grid[0] * codes.grid[1], max(codes.count - 1, 1)
    if codes.family != "hadamard":
        return light.squares / columns
    sharing = max(cells / columns - 1.0, 0.0)
    return light.shared_square(columns, cells, split=codes.split, guided=codes.guided) * sharing


def _photo_noise(
    picture: Floats, most_s: float, setting: RigSetting, iso: int, exposure_s: float
) -> float:
    """RMS noise of one photo of a picture (cells, 3), with its brightest sample metered, in the
    unit of the picture. most_s : longest time for which the picture's light is gathered."""
    config, profile = setting.config, setting.profile
    picture = weigh_colours(picture, setting.camera.colours)
    light = picture * setting.camera.responsivity_e
    brightest_dn = _STOP_LIGHT * TARGET * profile.saturation_dn(iso)
    typed = config.camera.f_number
    widest = min(setting.camera.f_numbers, default=0.0) if typed == "auto" else typed
    if widest:
        most_e = float(light.max()) * most_s / widest**2
        brightest_dn = min(brightest_dn, most_e / profile.row(iso).gain_e_per_dn)
    dn_per_unit = brightest_dn / float(light.max()) * setting.camera.responsivity_e
    if config.camera.noise == "none":  # a mock camera still rounds
        variance_dn2 = np.full(picture.shape, 1.0 / 12.0)
    else:
        variance_dn2 = compute_variance_dn2(picture * dn_per_unit, profile, iso, exposure_s)
    samples = np.array([1.0, 2.0, 1.0] if light.shape[1] == 3 else [1.0])  # a quad has two green
    return float(np.sqrt(np.mean(variance_dn2 / samples / dn_per_unit**2)))
