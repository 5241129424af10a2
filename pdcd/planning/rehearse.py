"""The error a plan will have before a known scene: its own codes, its panels, its sensor.

Nothing is drawn at random. Each shot's realised probing matrix follows from its frames and the
panels' optics (`pdcd.probing.realised`), the scene turns it into a photo without noise, and the
sensor model gives that photo its variance. Both go through the same sums as real photos
(`pdcd.pictures.combine`). What the picture then differs from the truth by is the error of the
codes; its sigma is that of the sensor. Not foreseen: missed refreshes, jitter, and noise in the
test exposures for the aperture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from pdcd.arrays import Floats
from pdcd.bench.tables import Config
from pdcd.codes.pilot.codes import SCOUTS
from pdcd.panels.balance import streams
from pdcd.panels.frames import FrameLog, Frames
from pdcd.panels.patterns import read_pattern_levels
from pdcd.pictures.combine import combine_shots, make_scaled_photos
from pdcd.pictures.exposed import ComputedShot, ExposedShot
from pdcd.pictures.learn import PilotFindings, learn_paths
from pdcd.pictures.photos import NO_SMOOTH_MODELS, fit_smooth_models, make_corrected_photos
from pdcd.pictures.to_cells import unmix_cells
from pdcd.pictures.truth import compute_true_answer
from pdcd.planning.guided import end_pilot, with_links
from pdcd.planning.metering import TARGET, choose_test_pairs
from pdcd.planning.outlook import Alive, ErrorEstimate, RigSetting
from pdcd.planning.plan import Plan
from pdcd.probing.panel import vblank_lag_s
from pdcd.probing.realised import Factors, collect_factors, compute_bench_factors
from pdcd.recipes.recipe import Extremes, Recipe, Shot
from pdcd.sensor.cells import CellMap
from pdcd.virtual.scene.scene import Scene
from pdcd.words import NormaliseName


@dataclass(frozen=True)
class PlanSimulation:
    """A plan before a known scene, every shot without noise and its codes shown once.

    recipe : what of the plan's recipe the answer needs, in single exposures.
    light : (rows, cols, 3) of each shot, scene units times seconds.
    metered_e : electrons at f/1 that metering expects of the brightest sample of each program. Its
        test exposure shows few of the codes, so that this is not quite what there will be.
    added : what a pilot and smooth light correct, as `combine_shots` takes it.
    truth : (rows, cols, 3), scene units.
    """

    plan: Plan
    recipe: Recipe
    setting: RigSetting
    normalise: NormaliseName
    light: dict[str, Floats]
    realised: dict[str, Factors]
    metered_e: dict[str, float]
    added: dict[str, Floats]
    truth: Floats

    def judge(self, iso: int, passes: int) -> ErrorEstimate:
        """Errors at that ISO, with the codes shown `passes` times in each exposure."""
        shots, headroom = {}, np.inf
        for shot in self.recipe.shots:
            f = self.setting.f_number(passes * self.metered_e[shot.program], iso)
            peak_e = passes * _peak_e(self.light[shot.name], self.setting)
            shots[shot.name] = self._exposed(shot, passes, iso, f)
            headroom = min(headroom, TARGET * self.setting.full_e(iso) * f**2 / max(peak_e, 1e-9))
        cells = CellMap.block(self.plan.grid, self.plan.grid)
        pictures = combine_shots(self.recipe, shots, cells, self.added, normalise=self.normalise)
        picture = pictures[self.recipe.answer_name]
        total = float(np.sum(self.truth**2)) or 1.0
        code2 = (picture.image - self.truth) ** 2
        # A cell whose windows never open for the wanted light has no sigma that says anything.
        sensor2 = np.where(np.isfinite(picture.sigma), picture.sigma, 0.0) ** 2
        return ErrorEstimate(
            code=float(np.sqrt(code2.sum() / total)),
            sensor=float(np.sqrt(sensor2.sum() / total)),
            code_var=0.0,
            cross_var=4.0 * float(np.sum(code2 * sensor2)) / total**2,
            sensor_var=2.0 * float(np.sum(sensor2**2)) / total**2,
            headroom=headroom,
        )

    def _exposed(self, shot: Shot, passes: int, iso: int, f_number: float) -> ExposedShot:
        light = passes * self.light[shot.name]
        exposure_s = passes * self.plan.exposure_s(shot)
        variance = _variance(light, self.setting, iso, f_number, exposure_s)
        once = self.realised[shot.name]
        many = Factors(passes * once.left, once.right, passes * once.coaxial, passes * once.open_s)
        return ComputedShot(light, variance, np.zeros(light.shape[:2], np.bool_), many, {})


def simulate_plan(
    plan: Plan,
    setting: RigSetting,
    scene: Scene,
    *,
    normalise: NormaliseName,
    seed: int,
    alive: Alive = lambda: None,
    known: dict[tuple[int, str], PilotFindings] | None = None,
) -> PlanSimulation:
    """Take all photos of a plan without noise.

    Parameters
    ----------
    plan : in single exposures and one pass.
    scene : what stands there, or something like it; of the plan's grid.
    seed : of the request; that of the codes, and here of the noise of the pilot's photos.
    alive : called before every shot, and may raise to end the work.
    known : what short pilots found when other plans were rehearsed that differ in their codes only;
        what this one finds is added.
    """
    rehearsed: dict[str, tuple[Floats, Factors]] = {}

    def take(shots: Iterable[Shot]) -> None:
        for shot in shots:
            alive()
            rehearsed[shot.name] = _photo(plan, shot, setting.config, scene)

    learned = None
    if plan.how.pilot:
        plan, learned = _by_pilot(plan, setting, rehearsed, take, seed, known)
    recipe = _bare(plan.recipe)
    take(recipe.shots)
    realised = {name: matrix for name, (_, matrix) in rehearsed.items()}
    metered_e: dict[str, float] = {}
    for shot in recipe.shots:
        if shot.program not in metered_e:
            metered_e[shot.program] = _metered_e(plan, shot, setting, scene)
    return PlanSimulation(
        plan=plan,
        recipe=recipe,
        setting=setting,
        normalise=normalise,
        light={name: light for name, (light, _) in rehearsed.items()},
        realised=realised,
        metered_e=metered_e,
        added=_added(plan, recipe, rehearsed, learned, normalise),
        truth=compute_true_answer(scene, plan.recipe, alive).reshape(*plan.grid, 3),
    )


def _by_pilot(
    plan: Plan,
    setting: RigSetting,
    rehearsed: dict[str, tuple[Floats, Factors]],
    take: Callable[[Iterable[Shot]], None],
    seed: int,
    known: dict[tuple[int, str], PilotFindings] | None,
) -> tuple[Plan, PilotFindings]:
    """What a plan becomes by its pilot, and what that finds; as a run does it."""
    key = plan.how.pilot, plan.schedule
    learned = None if known is None else known.get(key)
    if learned is None:
        pilot = [shot for shot in plan.recipe.shots if shot.name in plan.recipe.stack]
        take(pilot[:SCOUTS])
        learned = _learned(plan, setting, rehearsed, seed)
        if learned.promising:
            take(pilot[SCOUTS:])
            learned = _learned(plan, setting, rehearsed, seed)
        if known is not None and learned.worth is None:  # which goes by the number of codes
            known[key] = learned
    if not learned.promising:
        return end_pilot(plan, seed, setting.config.limits.max_exposure_s), learned
    return (with_links(plan, learned.links, seed) if learned.pays else plan), learned


def _bare(recipe: Recipe) -> Recipe:
    """What the answer rests on, and nothing else."""
    rule = recipe.answer
    names = rule.photos if isinstance(rule, Extremes) else tuple(name for _, name in rule)
    photos = tuple(photo for photo in recipe.photos if photo.name in names)
    used = {shot for photo in photos for _, shot in photo.shots}
    shots = tuple(shot for shot in recipe.shots if shot.name in used)
    return replace(recipe, photos=photos, shots=shots, pictures={recipe.answer_name: rule})


def predict_probing_matrix(
    plan: Plan,
    shot: Shot,
    config: Config,
    pairs: int | None = None,
    displacement: Floats | None = None,
) -> Factors:
    """Probing matrix of a shot on panels that behave as configured and miss nothing.

    `pairs` limits it to that many pairs of patterns, as in a test exposure; `displacement` is that
    of an off-axis scene.
    """
    frames = plan.frames(shot, pairs=pairs)
    settle_ns = round(plan.settle_s * 1e9)
    log = _on_time(frames, config, settle_ns)
    return collect_factors(
        compute_bench_factors(
            frames,
            log,
            config.projector,
            config.mask,
            open_ns=0,
            close_ns=int(log.end_ns.max()) + settle_ns,
            displacement=displacement,
        )
    )


def _photo(
    plan: Plan, shot: Shot, config: Config, scene: Scene, pairs: int | None = None
) -> tuple[Floats, Factors]:
    """Light of a shot, (rows, cols, 3) in scene units times seconds, and its probing matrix."""
    matrix = predict_probing_matrix(plan, shot, config, pairs, scene.displacement)
    light = scene.photo(matrix.left, matrix.right, matrix.coaxial, matrix.open_s, matrix.displaced)
    return light.reshape(*plan.grid, 3), matrix


def _on_time(frames: Frames, config: Config, start_ns: int) -> FrameLog:
    """The log of a display that misses nothing, both panels at the rate of the slower one."""
    period_ns = 1e9 / config.row_hz
    apart_ns = vblank_lag_s(config.projector, config.mask) * 1e9
    rows = np.arange(len(frames), dtype=np.int32)
    primal_rows, dual_rows = streams(rows, config.mask_delay_rows)
    count = primal_rows.size
    rows_due = np.arange(count + 1, dtype=np.float64)
    if config.display.plane_starts:
        planes = config.display.planes_per_refresh
        refresh, plane = np.divmod(np.arange(count + 1), planes)
        rows_due = (refresh + np.array(config.display.starts)[plane]) * planes
    flips = start_ns + np.rint(rows_due * period_ns).astype(np.int64)
    later = flips + max(0, round(apart_ns))
    sooner = flips + max(0, -round(apart_ns))
    return FrameLog(
        primal_shown=primal_rows,
        dual_shown=dual_rows,
        primal_ns=sooner[:-1],
        dual_ns=later[:-1],
        end_ns=np.array([sooner[-1], later[-1]]),
        missed=np.zeros(count, dtype=np.int32),
        source="foreseen",
        verified=False,
    )


def _learned(
    plan: Plan, setting: RigSetting, photos: dict[str, tuple[Floats, Factors]], seed: int
) -> PilotFindings:
    """What a pilot would find in its photos, with noise drawn from the sensor model."""
    rng = np.random.default_rng([seed, 2])
    iso = min(setting.isos)
    stack = [shot for shot in plan.recipe.shots if shot.only is not None and shot.name in photos]
    f_number = setting.f_number(_peak_e(photos[stack[0].name][0], setting), iso)
    shots = {}
    for shot in stack:
        light, matrix = photos[shot.name]
        variance = _variance(light, setting, iso, f_number, plan.exposure_s(shot))
        noisy = light + np.sqrt(variance) * rng.standard_normal(light.shape)
        shots[shot.name] = ComputedShot(noisy, variance, np.zeros(plan.grid, np.bool_), matrix, {})
    cells = plan.grid[0] * plan.grid[1]
    primal = plan.patterns["pilot"][0]
    bits = np.array([read_pattern_levels(primal, k, cells) > 0.5 for k in range(len(primal))])
    taken = [shots[name] for name in plan.recipe.stack if name in shots]
    seen = unmix_cells(taken, CellMap.block(plan.grid, plan.grid))
    panels = [shot.realised for shot in taken]
    return learn_paths(plan.grid, panels, bits, plan.how.codes, seen)


def _added(
    plan: Plan,
    recipe: Recipe,
    rehearsed: dict[str, tuple[Floats, Factors]],
    learned: PilotFindings | None,
    normalise: NormaliseName,
) -> dict[str, Floats]:
    """What decoding will add to coded photos: for a pilot's paths, and for smooth light."""
    names = [p.name for p in recipe.photos if p.name == "coded" or p.beyond]
    if not names or (learned is None and not plan.smooth):
        return {}
    cells = CellMap.block(plan.grid, plan.grid)
    dark = np.zeros((*plan.grid, 3))
    shots = {
        name: ComputedShot(light, dark, dark[..., 0] > 0.0, matrix, {})
        for name, (light, matrix) in rehearsed.items()
    }
    plain = make_scaled_photos(recipe, shots, cells, normalise=normalise)
    told = NO_SMOOTH_MODELS
    if plan.smooth:
        told = fit_smooth_models(recipe, shots, learned, cells, normalise=normalise)
    corrected = make_corrected_photos(
        recipe, shots, learned, cells, normalise=normalise, smooth=plan.smooth, told=told
    )
    return {name: corrected[name].image - plain[name].image for name in names}


def _metered_e(plan: Plan, shot: Shot, setting: RigSetting, scene: Scene) -> float:
    """Electrons at f/1 that metering expects of the brightest sample of a shot."""
    pairs, ratio = choose_test_pairs(plan.sequence(shot))
    light, _ = _photo(plan, shot, setting.config, scene, pairs)
    return _peak_e(light * ratio[..., None], setting)


def _peak_e(light: Floats, setting: RigSetting) -> float:
    """Electrons of the brightest sample at f/1."""
    return float((light * setting.camera.responsivity_e).max())


def _variance(
    light: Floats, setting: RigSetting, iso: int, f_number: float, exposure_s: float
) -> Floats:
    """Variance of developed light (rows, cols, 3), in its own unit squared."""
    gain = setting.profile.row(iso).gain_e_per_dn
    dn_per_unit = setting.camera.responsivity_e / (f_number**2 * gain)
    samples = setting.variance_dn2(light * dn_per_unit, iso, exposure_s)
    green_twice = np.array([1.0, 0.5, 1.0])  # a quad has two green samples
    variance: Floats = samples * green_twice / dn_per_unit**2
    return variance
