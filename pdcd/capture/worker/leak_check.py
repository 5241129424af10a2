"""Estimates the leaks of an answer from dark photos, and decides what to do about ambient light."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from pdcd.bench.devices import CameraInfo
from pdcd.bench.tables import Config
from pdcd.codes.pilot.codes import SCOUTS
from pdcd.errors import PdcdError, RequestError
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.leaks import make_leak_answers, predict_photo_variances
from pdcd.pictures.learn import PilotFindings
from pdcd.planning.guided import resume_pilot, with_links
from pdcd.planning.plan import Plan
from pdcd.protocol.plan_summary import LeakErrors
from pdcd.protocol.request import CaptureRequest
from pdcd.runs.record import DarkPhoto
from pdcd.watch import Watch


def estimate_leaks(
    plan: Plan,
    darkroom: Darkroom,
    darks: Sequence[DarkPhoto],
    watch: Watch,
    before: DarkPhoto | None = None,
) -> LeakErrors:
    """RMS errors that leaks make in the answer so far.

    darks : a dark photo; and where it may matter which panel leaks, one without the lit projector,
        too. A single one gives only an upper bound. before : one without the lit projector, taken
        before all shots. Raises DecodeError.
    """
    look = plan.look
    if look is None:
        raise PdcdError("this plan looks at no dark photo")
    recipe, means = darkroom.means(watch)
    lit = {shot.name: plan.sequence(shot).lit_s(plan.row_hz) for shot in recipe.shots}
    answers = make_leak_answers(recipe, means, lit, normalise=darkroom.record.normalise)
    found = [darkroom.dark_means(photo) for photo in darks]
    ambient = mask = None
    if len(found) == 1:
        both = max(answer.most(found[0]) for answer in answers)
    else:
        other = found[0].less(found[1])
        ambient = max(answer.ambient(found[1]) for answer in answers)
        mask = max(answer.mask(other) for answer in answers)
        both = max(answer.both(found[1], other) for answer in answers)
    changed = 0.0
    if before is not None:
        room = darkroom.dark_means(before)
        changed = max(answer.changed(room, found[-1]) for answer in answers)
    return LeakErrors(
        changed=changed,
        ambient=ambient,
        mask=mask,
        both=both,
        floor=max(answer.floor(*found) for answer in answers),
        limit=look.limit,
        raw=tuple(photo.raw for photo in darks),
    )


def estimate_room_change(
    darkroom: Darkroom, before: DarkPhoto, after: DarkPhoto, watch: Watch
) -> float:
    """RMS error of the answer if the room's light changed between two dark photos of the same kind,
    in the worst case: the whole answer has the light of one, and that of the other was subtracted.

    Raises DecodeError.
    """
    one, other = darkroom.dark_means(before), darkroom.dark_means(after)
    if not one.less(other).seen:
        return 0.0
    recipe, means = darkroom.means(watch)
    answers = make_leak_answers(recipe, means, {}, normalise=darkroom.record.normalise)
    return max(answer.changed(one, other) for answer in answers)


def choose_darker_photo(darkroom: Darkroom, one: DarkPhoto, other: DarkPhoto) -> DarkPhoto:
    """The one of two dark photos with less light: where the light changed, only that much was
    surely always there.

    Raises DecodeError.
    """
    return min(one, other, key=lambda photo: float(darkroom.dark_means(photo).light.sum()))


@dataclass(frozen=True)
class _Mended:
    """What the user must know, and what was decided about noise, in words."""

    told: tuple[str, ...] = ()
    decided: str = ""


@dataclass(frozen=True)
class AmbientResponse:
    """What is done about ambient light in addition to black exposures.

    request, config, camera : of the job. before : its plan before the scouts of a pilot ended the
        pilot; None where they did not. average : whether everything may be shown more often.
    """

    request: CaptureRequest
    config: Config
    camera: CameraInfo | None
    before: Plan | None
    average: bool

    def after(
        self,
        plan: Plan,
        photo: DarkPhoto,
        darkroom: Darkroom,
        replan: Callable[[Plan], None],
        watch: Watch,
    ) -> _Mended:
        """Let the run go on with a plan that accounts for ambient light.

        plan : with its black exposures. photo : a dark photo that shows this light alone. `replan`
            makes a plan the run's; shots that it does not contain are dropped. Raises DecodeError.
        """
        leaks = plan.leaks
        if leaks is None or leaks.ambient is None or leaks.ambient <= leaks.limit:
            replan(plan)
            return _Mended()
        recipe, means = darkroom.means(watch)
        taken, names, variances = plan, frozenset(means.panels), {}
        if self.average:
            light, normalise = darkroom.dark_means(photo), darkroom.record.normalise
            variances = predict_photo_variances(recipe, means, light, normalise=normalise)
        plan = replace(plan, dark=photo)
        replan(plan)
        learned = darkroom.learned(watch)
        plan, told = self._gone_on(plan, learned)
        decided, enough = "", True
        if variances:
            from pdcd.planning.average import (  # dark rooms need none of it
                extend_for_noise,
                predict_plan_noise,
            )

            noise = predict_plan_noise(plan, variances, taken, names)
            plan, decided, enough = extend_for_noise(
                plan, noise, self.request, self.config, self.camera, watch
            )
        if plan.how.pilot > SCOUTS and not plan.how.late and learned is not None and learned.pays:
            plan = self._guided(plan, learned, names, watch)
        replan(plan)
        return _Mended(told if enough else (*told, decided), decided)

    def _gone_on(self, plan: Plan, learned: PilotFindings | None) -> tuple[Plan, tuple[str, ...]]:
        """The same plan, or one with a pilot that is resumed after all."""
        before = self.before
        if before is None or learned is None or not learned.promising or not before.how.coded:
            return plan, ()
        try:
            plan = resume_pilot(before, plan, self.config, learned.sharpness)
        except RequestError:  # more than memory holds
            return plan, ()
        return plan, (plan.reasons[-1],)

    def _guided(
        self, plan: Plan, learned: PilotFindings, names: frozenset[str], watch: Watch
    ) -> Plan:
        """The same plan with codes by a map that is clearer without ambient light; codes that were
        already shown stay as they are."""
        guided = with_links(plan, learned.links, self.request.seed, watch).patterns
        shown = {shot.program for shot in plan.recipe.shots if shot.name in names}
        kept = {name: pair for name, pair in plan.patterns.items() if name in shown}
        return replace(plan, patterns=guided | kept)
