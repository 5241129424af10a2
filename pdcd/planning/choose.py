"""From a wanted error, or the time there is, to a plan.

Candidates are numbers of codes on a ladder, each shown in up to `MOST_REPEATS` exposures: with
codes of their own where those are enough for parts, which measure their error, else with the same
ones again. Formulas predict the error of each (`pdcd.planning.predict`) before any codes are made.
A wanted error is met in the shortest time, files included; a given time is used for the smallest
error. All else is as for a request that names its codes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import msgspec

from pdcd.errors import RequestError
from pdcd.planning.code_counts import (
    MOST_REPEATS,
    count_parts,
    find_code_family,
    list_code_counts,
)
from pdcd.planning.defaults import can_split_codes, readout_s
from pdcd.planning.guided import can_be_guided, follow_prior
from pdcd.planning.look import resolve_black_level, with_leak_probe
from pdcd.planning.make import make_plan
from pdcd.planning.plan import Plan
from pdcd.planning.predict import (
    PREDICTED_GOALS,
    PhotoCodes,
    PredictedError,
    RigSetting,
    SceneLight,
    guess_scene_light,
    measure_scene_light,
    predict_error,
)
from pdcd.planning.prior import GivenPrior, load_prior
from pdcd.protocol.plan_summary import Prediction
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.arrays import NO_ARRAYS, Given
from pdcd.recipes.parts import FEWEST_PARTS
from pdcd.recipes.recipe import Shot
from pdcd.virtual.scene.scene import Scene
from pdcd.watch import Watch

_CONFIDENCE = 0.95
"""Probability with which a wanted error is kept, unless the request names one."""
_SPLIT = ("indirect", "fraction")
"""Goals whose answers are all of codes, so that parts lower all of their noise."""


@dataclass(frozen=True)
class _Candidate:
    """One way to spend light: codes of each exposure, number of exposures, whether each has codes
    of its own; the predicted error; seconds of all exposures, and number of files."""

    count: int
    exposures: int
    split: bool
    predicted: PredictedError
    seconds: float
    files: int

    @property
    def parts(self) -> int:
        """Exposures with codes of their own."""
        return self.exposures if self.split else 1

    @property
    def codes(self) -> int:
        """Codes of the whole plan."""
        return self.count * self.parts


def choose_plan(
    request: CaptureRequest,
    setting: RigSetting,
    grid: tuple[int, int],
    scene: Scene | None,
    given: Given = NO_ARRAYS,
    watch: Watch | None = None,
) -> Plan:
    """The plan for a request with a wanted error or a time, with its prediction.

    Parameters
    ----------
    request : one for which `is_search_needed` holds.
    setting : the rig.
    grid : rows and columns of cells.
    scene : what stands in front of the rig, where that is known; `request.prior` has precedence.
    given : the request's arrays.
    watch : gets the progress of making codes, and may end the work.

    Raises
    ------
    RequestError
        The error cannot be reached within the limits, the time is too short for any plan, or no
        formula predicts the error of the goal.
    """
    elsewhere = request.shift is not None or request.warp is not None
    if request.goal not in PREDICTED_GOALS or elsewhere:
        raise RequestError(
            f"the error of the goal {request.goal}{' of other cells' * elsewhere} cannot be "
            "foreseen",
            hint="give the number of codes",
        )
    prior = None if request.prior is None else load_prior(request.prior, grid, given)
    if prior is not None and prior.scene is not None:
        light = measure_scene_light(prior.scene, prior.name)
    elif scene is not None:
        light = replace(measure_scene_light(scene, f"scene {scene.name}"), measured=True)
    else:
        light = guess_scene_light()
    return _Search(request, given, setting, grid, light, prior, watch or Watch()).run()


class _Search:
    """One search through all candidates."""

    def __init__(
        self,
        request: CaptureRequest,
        arrays: Given,
        setting: RigSetting,
        grid: tuple[int, int],
        light: SceneLight,
        prior: GivenPrior | None,
        watch: Watch,
    ) -> None:
        self.request, self.arrays, self.setting, self.grid = request, arrays, setting, grid
        self.light, self.prior, self.watch = light, prior, watch
        self.confidence = request.confidence or _CONFIDENCE
        typed = setting.config.camera.iso
        self.iso = setting.camera.isos[0] if typed is None else typed
        self.family, _ = find_code_family(request)

    def run(self) -> Plan:
        """The best plan, with its prediction. Raises RequestError when none will do."""
        self.watch.stage = "codes"
        found = list(self._candidates())
        most = self.request.seconds
        refused: RequestError | None = None
        fewest = None
        for one in self._best_first(found):
            if fewest is not None and one.codes >= fewest:
                continue  # more codes take more
            try:
                plan = self._made(one.codes, one.parts)
            except RequestError as err:
                refused, fewest = err, one.codes
                continue
            plan = plan if one.split else plan.repeated(one.exposures)
            if most is None or _seconds(plan) <= most:
                return self._told(plan, one)
        raise self._refusal(found, refused)

    def _candidates(self) -> Iterator[_Candidate]:
        """All that the rig's limits allow."""
        config, request = self.setting.config, self.request
        counts = list(list_code_counts(request))
        if not counts:
            raise RequestError(
                f"there are no {self.family} codes that light a cell in a share p = {request.p:g}",
                hint="name another family, or none",
            )
        draft = _Draft(self._made(counts[0]), counts[0])
        plan = draft.plan
        guided = self.prior is not None and can_be_guided(plan)
        for count in counts:
            longest_s = draft.longest_s(count)
            if longest_s > config.limits.max_exposure_s:
                return
            codes = PhotoCodes(
                request.goal,
                self.family,
                plan.p,
                self.grid,
                count,
                longest_s,
                lit_s=count / config.row_hz,
                guided=guided,
            )
            same, own = (
                predict_error(replace(codes, split=split), self.light, self.setting, self.iso)
                for split in (False, True)
            )
            for exposures, split in self._ways(count):
                seconds, files = draft.cost(count, exposures, split=split)
                predicted = (own if split else same).repeated(exposures)
                yield _Candidate(count, exposures, split, predicted, seconds, files)

    def _ways(self, count: int) -> Iterator[tuple[int, bool]]:
        """In how many exposures that many codes may be shown, and whether each has its own."""
        named = count_parts(self.request)
        if named > 1:
            yield named, True
            return
        own = self.request.goal in _SPLIT and can_split_codes(self.family, count)
        for exposures in range(1, MOST_REPEATS + 1):
            split = own and exposures >= FEWEST_PARTS
            if split or self.request.until_error is None:  # only parts measure their error
                yield exposures, split

    def _best_first(self, found: Sequence[_Candidate]) -> list[_Candidate]:
        """Candidates that will do, the best of them first."""
        config, camera = self.setting.config, self.setting.camera
        file_s = readout_s(config, camera) + config.trigger.lag_s
        error, most = self.request.error, self.request.seconds
        if error is not None:
            fits = [one for one in found if one.predicted.bound(self.confidence) <= error]
            return sorted(fits, key=lambda one: (one.seconds + one.files * file_s, one.files))
        fits = [one for one in found if one.seconds <= (most or 0.0)]
        return sorted(fits, key=lambda one: (one.predicted.error, one.files))

    def _made(self, codes: int, parts: int = 1) -> Plan:
        """A plan of that many codes, each part in one exposure. Raises RequestError where the rig
        does not allow it."""
        asked = msgspec.structs.replace(
            self.request,
            error=None,
            seconds=None,
            confidence=None,
            prior=None,
            until_error=None if parts == 1 else self.request.until_error,
            codes=codes,
            parts=parts,
            pilot=0,
            family=self.family,
        )
        config, lag_s = self.setting.config, self.setting.mask_lag_s
        return make_plan(asked, config, self.grid, lag_s, self.arrays, self.watch)

    def _told(self, plan: Plan, one: _Candidate) -> Plan:
        """A plan that follows the prior, with its prediction."""
        if self.prior is not None and can_be_guided(plan):
            plan = follow_prior(plan, self.prior, self.request.seed)
        predicted = one.predicted
        prediction = Prediction(
            error=predicted.error,
            code=predicted.code,
            sensor=predicted.sensor,
            bound=predicted.bound(self.confidence),
            confidence=self.confidence,
            iso=self.iso,
            prior=self.light.name,
        )
        plan = replace(plan, iso=self.iso, prediction=prediction)
        # The plan was made without the error, which says how much may leak.
        return with_leak_probe(plan, resolve_black_level(self.request, self.setting.config).look)

    def _refusal(self, found: Sequence[_Candidate], refused: RequestError | None) -> RequestError:
        """Why no candidate will do, and what would."""
        limit_s = self.setting.config.limits.max_exposure_s
        why = f"no exposure may be longer than {limit_s:g} s"
        hint = "raise limits.max_exposure_s"
        if refused is not None:
            why, hint = refused.message, refused.hint or hint
        elif found and self.request.seconds is not None:
            why = f"the shortest plan takes {min(one.seconds for one in found):.3g} s"
            hint = "give more time, or leave the white shot out"
        if self.request.error is None:
            return RequestError(f"no plan fits into {self.request.seconds:g} s: {why}", hint=hint)
        asked = f"an RMS error of {100.0 * self.request.error:.3g} % cannot be had"
        if not found or refused is not None:
            return RequestError(f"{asked}: {why}", hint=hint)
        closest = min(found, key=lambda one: one.predicted.error)
        predicted, within = closest.predicted, closest.predicted.bound(self.confidence)
        return RequestError(
            f"{asked}: {closest.codes} codes in {closest.exposures} exposures leave "
            f"{100.0 * within:.2g} % ({100.0 * predicted.code:.2g} % by the codes, "
            f"{100.0 * predicted.sensor:.2g} % by the sensor), within {limit_s:g} s an exposure",
            hint=f"ask for {105.0 * within:.2g} % or more, or raise limits.max_exposure_s",
        )


@dataclass(frozen=True)
class _Draft:
    """What plans with any number of codes cost, scaled from a plan of `count` of them."""

    plan: Plan
    count: int

    def longest_s(self, count: int) -> float:
        """Seconds of the longest exposure of so many codes."""
        return max(self._seconds(shot, count) for shot in self.plan.recipe.shots)

    def cost(self, count: int, exposures: int, *, split: bool) -> tuple[float, int]:
        """Seconds of all exposures, and files."""
        seconds, files = 0.0, 0
        for shot in self.plan.recipe.shots:
            times = exposures if self._is_repeated(shot, split=split) else 1
            seconds += times * self._seconds(shot, count)
            files += times
        return seconds, files

    def _seconds(self, shot: Shot, count: int) -> float:
        shown_s = self.plan.refreshes(shot) * self.plan.row_s
        return self.plan.exposure_s(shot) + shown_s * (count / self.count - 1.0)

    def _is_repeated(self, shot: Shot, *, split: bool) -> bool:
        """Whether a shot is taken in each of the exposures."""
        recipe = self.plan.recipe
        if split:
            return not shot.white
        photos = recipe.answer_photos
        return any(shot.name == name for photo in photos for _, name in photo.shots)


def _seconds(plan: Plan) -> float:
    """Time of all exposures."""
    return sum(plan.exposure_s(shot) for shot in plan.recipe.shots)
