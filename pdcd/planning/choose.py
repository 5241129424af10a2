"""From a wanted error, or the time there is, to a plan.

Candidates are numbers of codes on a ladder, few first, under each schedule of one to three
refreshes a code that keeps codes apart at the mask's measured lag. Each is looked at once
(`pdcd.planning.rehearse` for a known scene, `pdcd.planning.guess` for any other); ISO,
passes and the number of equal exposures then follow by arithmetic. The wanted error is met in the
shortest total time; a given time is spent on the smallest error.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import msgspec
import numpy as np

from pdcd.codes.pilot.codes import choose_pilot_count
from pdcd.codes.pilot.matching import MOST_MATCHING_CELLS
from pdcd.errors import RequestError
from pdcd.pictures.learn import PilotFindings
from pdcd.planning.code_counts import (
    LADDER,
    count_parts,
    find_code_family,
    find_most_repeats,
    list_code_counts,
)
from pdcd.planning.guess import GUESSABLE_GOALS, ScenePrior, guess_plan
from pdcd.planning.guided import can_be_guided, follow_prior
from pdcd.planning.look import resolve_black_level, with_leak_probe
from pdcd.planning.make import ExposureLimitError, make_plan
from pdcd.planning.memory import MemoryLimitError
from pdcd.planning.outlook import Alive, ErrorEstimate, PlanForecast, RigSetting
from pdcd.planning.plan import Plan
from pdcd.planning.prior import GivenPrior, load_prior
from pdcd.planning.rehearse import simulate_plan
from pdcd.planning.schedule_fit import choose_schedule, convert_lag_to_rows, list_tolerant_schedules
from pdcd.protocol.plan_summary import Prediction
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.arrays import NO_ARRAYS, Given
from pdcd.recipes.off_axis import FewCodesError
from pdcd.virtual.scene.scene import Scene
from pdcd.watch import Watch
from pdcd.words import BlackLevel, ScheduleName

_CONFIDENCE = 0.95
"""With which probability a wanted error is kept unless the request says otherwise."""

_STALLED = 0.8
"""Least error of the codes on the last rungs of the ladder, over that before, from which more codes
do not help: what is left comes from the panels."""

_PATIENCE = 6
"""Rungs that are given to lower the error: eight times as many codes."""

_PILOT_PAYS = 0.5
"""Error with a pilot, over that without, from which its many RAW files are worth taking."""

_NEGLIGIBLE = 0.1
"""Error of the codes, over the least error of the sensor, below which more codes do not matter."""

_PILOTED = ("indirect", "direct", "short-range")
"""Goals that a pilot helps."""


@dataclass(frozen=True)
class PlanChoice:
    """A plan in all its parts, what is foreseen of one exposure of it, and its total time."""

    plan: Plan
    estimate: ErrorEstimate
    iso: int
    seconds: float


def choose_plan(
    request: CaptureRequest,
    setting: RigSetting,
    grid: tuple[int, int],
    scene: Scene | None,
    given: Given = NO_ARRAYS,
    watch: Watch | None = None,
) -> PlanChoice:
    """The plan that a request with a wanted error or a time comes to, its prediction included.

    Parameters
    ----------
    request : one for which `is_search_needed` holds.
    setting : the rig.
    grid : rows and columns of cells.
    scene : what stands before the rig, where that is known; `request.prior` goes before it.
    given : the request's arrays.
    watch : hears of every shot that is thought through and of every candidate, and may end the
        work. What there is to do grows where pilots turn out to be worth a look.

    Raises
    ------
    RequestError
        The error cannot be had within the limits, or the time is too short for any plan.
    """
    prior = None if request.prior is None else load_prior(request.prior, grid, given)
    known = _known(request, prior, scene)
    search = _Search(request, given, setting, grid, known, prior, watch or Watch())
    best = search.run()
    confidence = request.confidence or _CONFIDENCE
    prediction = Prediction(
        error=best.estimate.error(best.plan.how.repeat),
        code=best.estimate.code,
        sensor=best.estimate.sensor / best.plan.how.repeat**0.5,
        bound=best.estimate.bound(confidence, best.plan.how.repeat),
        confidence=confidence,
        iso=best.iso,
        prior=search.prior_name,
    )
    plan = replace(best.plan, iso=best.iso, prediction=prediction)
    if plan.how.black_level == "none":
        plan = with_leak_probe(plan, resolve_black_level(request, setting.config).look)
    return replace(best, plan=plan)


def _known(
    request: CaptureRequest, given: GivenPrior | None, scene: Scene | None
) -> Scene | ScenePrior:
    """What the scene is taken to be. Raises RequestError."""
    if given is not None and given.scene is not None:
        return given.scene
    if scene is not None:
        return scene
    if request.goal not in GUESSABLE_GOALS or _elsewhere(request):
        raise RequestError(
            f"the error of the goal {request.goal} cannot be foreseen for an unknown scene",
            hint="give a transport matrix as prior, or the number of codes",
        )
    return ScenePrior()


def _elsewhere(request: CaptureRequest) -> bool:
    """Whether cells are matched with others than themselves."""
    return request.shift is not None or request.warp is not None


class _Search:
    """One walk over all candidates."""

    def __init__(
        self,
        request: CaptureRequest,
        arrays: Given,
        setting: RigSetting,
        grid: tuple[int, int],
        prior: Scene | ScenePrior,
        given: GivenPrior | None,
        watch: Watch,
    ) -> None:
        self.request, self.arrays, self.setting, self.grid = request, arrays, setting, grid
        self.prior, self.given, self.watch = prior, given, watch
        self.confidence = request.confidence or _CONFIDENCE
        self.most = find_most_repeats(request)
        self.best: PlanChoice | None = None
        self.refused: RequestError | None = None
        self.closest: PlanChoice | None = None
        self.learned: dict[tuple[int, str], PilotFindings] = {}

    @property
    def prior_name(self) -> str:
        """What the scene is taken to be, for people."""
        if self.given is not None and self.given.scene is not None:
            return self.given.name
        return f"scene {self.prior.name}" if isinstance(self.prior, Scene) else str(self.prior)

    def run(self) -> PlanChoice:
        """The best candidate. Raises RequestError when none will do."""
        self._climb_all("codes", list(product((None,), self._blacks(), self._schedules())))
        plain = self.best
        if self._takes_pilot() and (plain is None or self.request.seconds is not None):
            coarse = self.grid[0] * self.grid[1] <= MOST_MATCHING_CELLS
            kinds = (True, False) if coarse else (False,)
            blacks = self._blacks() if plain is None else (plain.plan.how.black_level,)
            self._climb_all("pilots", list(product(kinds, blacks, self._schedules())))
        if self.best is None:
            raise self._refusal()
        if plain is not None and self.best.plan.how.pilot:
            kept = self._bound(self.best) / self._bound(plain)
            return self.best if kept < _PILOT_PAYS else plain
        return self.best

    def _climb_all(
        self, stage: str, ladders: Sequence[tuple[bool | None, BlackLevel, ScheduleName]]
    ) -> None:
        """Look at each of these: (kind of pilot, leaks to measure, schedule)."""
        self.watch.stage = stage
        self.watch.expect(float(len(ladders)))
        for by_map, black, schedule in ladders:
            with self.watch.piece(1.0, len(LADDER)) as rung:
                self._climb(schedule, black, by_map, rung)

    def _schedules(self) -> tuple[ScheduleName, ...]:
        """Schedules to look at: the one asked for, or all that keep codes apart at the mask's
        measured lag, with few refreshes first."""
        config = self.setting.config
        lag, jitter = convert_lag_to_rows(config, self.setting.mask_lag_s)
        if self.request.guards is not None:
            return (choose_schedule(self.request.guards, lag, jitter),)
        found = list_tolerant_schedules(lag, jitter)
        instant = not any(p.rise_s or p.fall_s for p in (config.projector, config.mask))
        # Nothing is left to keep apart where panels in step switch at once.
        return found[:1] if instant and found[0] == "none" else found

    def _blacks(self) -> tuple[BlackLevel, ...]:
        """Which leaks to measure: what is asked for, or all choices that the panels may call for.
        Before a scene that is not known the leak's error is not known, either."""
        config = self.setting.config
        blacks = resolve_black_level(self.request, config)
        if blacks.look is None or isinstance(self.prior, ScenePrior):
            return (blacks.level,)
        ambient = config.projector.contrast is not None or self.prior.ambient is not None
        if config.mask.contrast is None:
            return ("none", "ambient") if ambient else ("none",)
        return ("none", "mask", "both") if ambient else ("none", "mask")

    def _climb(
        self, schedule: ScheduleName, black: BlackLevel, by_map: bool | None, rung: Alive
    ) -> None:
        """Look at all numbers of codes, until more cannot be better; with a pilot of either kind,
        or none. `rung` hears of each."""
        errors: list[float] = []
        sensor = 0.0
        for plan in self._plans(schedule, black, by_map):
            rung()
            least_s = _seconds(plan.scaled(1, 1))
            budget_s = self.request.seconds
            if budget_s is not None and least_s > budget_s:
                text = f"the shortest plan takes {least_s:.3g} s"
                hint = "give more time, or leave the white shot out"
                self.refused = self.refused or RequestError(text, hint=hint)
                return
            if budget_s is None and self.best is not None and least_s >= self.best.seconds:
                return
            # The sensor's error hardly depends on the codes, so that of fewer tells when to stop.
            floor = sensor / self._most_repeats(plan) ** 0.5
            goal = self.request.error or (self.best and self._bound(self.best)) or np.inf
            if floor > goal and errors[-1] < floor:
                return
            estimate = self._settle(plan)
            if estimate.saturates:  # and more codes bring more light
                return
            learned = self.learned.get((plan.how.pilot, plan.schedule))
            if learned is not None and not learned.promising:  # as every pilot's scouts will find
                return
            errors.append(estimate.code)
            sensor = estimate.sensor
            if estimate.code < _NEGLIGIBLE * estimate.sensor / self.most**0.5:
                return
            if len(errors) > _PATIENCE and min(errors[-_PATIENCE:]) > _STALLED * min(
                errors[:-_PATIENCE]
            ):
                return

    def _plans(
        self, schedule: ScheduleName, black: BlackLevel, by_map: bool | None
    ) -> Iterator[Plan]:
        """Plans of single exposures, fewest codes first, as long as the limits allow."""
        asked = msgspec.structs.replace(
            self.request,
            error=None,
            seconds=None,
            confidence=None,
            prior=None,
            guards=schedule,
            black_level=black,
        )
        (family, _), parts = find_code_family(self.request), count_parts(self.request)
        for count in list_code_counts(self.request):
            share = 0 if by_map is None else choose_pilot_count(count, by_map=by_map, parts=parts)
            if by_map is not None and not share:
                continue
            request = msgspec.structs.replace(asked, codes=count, pilot=share, family=family)
            try:
                plan = make_plan(
                    request, self.setting.config, self.grid, given=self.arrays, compared=True
                )
            except (MemoryLimitError, ExposureLimitError) as err:
                self.refused = self.refused or err
                return  # and more codes take more
            except FewCodesError:
                continue
            if self.given is not None and can_be_guided(plan):
                plan = follow_prior(plan, self.given, request.seed)
            yield plan

    def _takes_pilot(self) -> bool:
        """Whether a pilot may help: it guides Hadamard codes, before a scene that is known, unless
        a prior does so."""
        fits = self.request.goal in _PILOTED and find_code_family(self.request)[0] == "hadamard"
        own = not _elsewhere(self.request)
        return fits and own and isinstance(self.prior, Scene) and self.given is None

    def _outlook(self, plan: Plan) -> PlanForecast:
        if isinstance(self.prior, ScenePrior):
            return guess_plan(plan, self.setting, self.prior)
        normalise = self.request.normalise or self.setting.config.schedule.normalise
        return simulate_plan(
            plan,
            self.setting,
            self.prior,
            normalise=normalise,
            seed=self.request.seed,
            alive=self.watch,
            known=self.learned,
        )

    def _settle(self, plan: Plan) -> ErrorEstimate:
        """Try ISOs, passes and repetitions of one plan; returns its plainest estimate."""
        outlook = self._outlook(plan)
        limit_s = self.setting.config.limits.max_exposure_s
        plainest = None
        for iso in self.setting.isos:
            once = outlook.judge(iso, 1)
            plainest = plainest or once
            passes = 1
            while passes <= max(1.0, once.headroom) and _longest(plan) * passes <= limit_s:
                estimate = once if passes == 1 else outlook.judge(iso, passes)
                if estimate.saturates:
                    text = f"at f/{self.setting.config.camera.f_number} the light saturates"
                    self.refused = RequestError(text, hint="give less light")
                else:
                    self._consider(plan, estimate, iso, passes)
                passes *= 2
            if once.headroom < 2.0:  # gain only costs range where light suffices
                break
        return plainest or outlook.judge(self.setting.isos[0], 1)

    def _consider(self, plan: Plan, estimate: ErrorEstimate, iso: int, passes: int) -> None:
        """Keep this candidate if it is the best so far."""

        def choice(repeat: int) -> PlanChoice:
            whole = plan.scaled(passes, repeat)
            return PlanChoice(whole, estimate, iso, _seconds(whole))

        if self.request.error is not None:
            most = choice(self.most)
            if self.closest is None or self._bound(most) < self._bound(self.closest):
                self.closest = most
            for repeat in range(1, self.most + 1):
                if estimate.bound(self.confidence, repeat) <= self.request.error:
                    found = choice(repeat)
                    if self.best is None or found.seconds < self.best.seconds:
                        self.best = found
                    return
            return
        found = choice(self._most_repeats(plan.scaled(passes, 1)))
        fits = found.seconds <= (self.request.seconds or 0.0)
        if fits and (self.best is None or self._bound(found) < self._bound(self.best)):
            self.best = found

    def _bound(self, choice: PlanChoice) -> float:
        return choice.estimate.bound(self.confidence, choice.plan.how.repeat)

    def _most_repeats(self, plan: Plan) -> int:
        """How many exposures the time allows, at least 1."""
        if self.request.seconds is None:
            return self.most
        one_s, two_s = _seconds(plan), _seconds(plan.scaled(plan.passes, 2))
        extra = int((self.request.seconds - one_s) / (two_s - one_s) + 1e-9)
        return min(self.most, 1 + max(0, extra))

    def _refusal(self) -> RequestError:
        """Why no candidate will do, and what would."""
        why, hint = "no number of codes suits them", "name another family, or none"
        if self.refused is not None:
            why, hint = self.refused.message, self.refused.hint or hint
        if self.request.error is None:
            return RequestError(f"no plan fits into {self.request.seconds:g} s: {why}", hint=hint)
        asked = f"an RMS error of {100.0 * self.request.error:.3g} % cannot be had"
        if self.closest is None:
            return RequestError(f"{asked}: {why}", hint=hint)
        closest, estimate = self.closest, self.closest.estimate
        within = 100.0 * self._bound(closest)
        return RequestError(
            f"{asked}: {closest.plan.how.coded} codes, {_times(self.most)}, leave {within:.2g} % "
            f"({100.0 * estimate.code:.2g} % by the codes, "
            f"{100.0 * estimate.sensor / self.most**0.5:.2g} % by the sensor), within "
            f"{self.setting.config.limits.max_exposure_s:g} s an exposure",
            hint=f"ask for {1.05 * within:.2g} % or more, or raise limits.max_exposure_s",
        )


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _longest(plan: Plan) -> float:
    return max(plan.exposure_s(shot) for shot in plan.recipe.shots)


def _seconds(plan: Plan) -> float:
    """Time of all exposures."""
    return sum(plan.exposure_s(shot) for shot in plan.recipe.shots)
