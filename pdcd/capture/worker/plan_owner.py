"""One job on its way: its plan, the shots it has, and what it wants next.

This is the only owner of a plan. `Course.next_exposure` says what to expose, is given what was
taken and decides what follows: an aperture, better codes after a pilot, a dark photo, black
exposures after that, no more parts. The owner of the devices only does what it is told, and keeps
what it is told to keep.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import msgspec
import numpy as np
from numpy.typing import NDArray

from pdcd.bench.devices import CameraInfo
from pdcd.capture.worker.answers import (
    AdoptedPlan,
    ConvergenceNote,
    Order,
    PhotoOrder,
    PhotoOutcome,
    RigFacts,
    SpoiltPhoto,
    compute_rms_sigma,
    make_run_record,
)
from pdcd.capture.worker.exposing import Exposer, Orders, make_dark_photo
from pdcd.capture.worker.leak_check import (
    AmbientResponse,
    choose_darker_photo,
    estimate_leaks,
    estimate_room_change,
)
from pdcd.codes.pilot.codes import SCOUTS
from pdcd.errors import PdcdError, RequestError, disk_errors
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.written.picture_files import write_png
from pdcd.pictures.written.previews import Previews
from pdcd.planning.guided import decide_after_pilot
from pdcd.planning.look import DarkFrames, note_harmless_leaks, with_black_exposures
from pdcd.planning.next_step import choose_next_step, is_last_of_part
from pdcd.planning.plan import Plan
from pdcd.protocol import events
from pdcd.protocol.plan_summary import LeakErrors
from pdcd.protocol.request import CaptureRequest
from pdcd.recipes.parts import list_parts
from pdcd.recipes.recipe import Shot
from pdcd.runs.folder import write_patterns
from pdcd.runs.record import BorderPhoto, DarkPhoto, MeterRecord, PanelLook, RunRecord, ShotRecord
from pdcd.sensor.cells import CellMap
from pdcd.sensor.shelf import PhotoShelf
from pdcd.watch import Watch

_RUNNING = "preview/running.png"
"""What is known of the answer while a run with `until_error` goes on."""
_DARK_NAMES = ("look-dark", "look-ambient")
"""Names of the RAW files of dark photos."""
_ROOM_NAME, _AGAIN_NAME = "look-room", "look-again"
"""Names of a dark photo before all shots, and of one after the shots that came after the others."""

_Steps = Generator[Order, PhotoOutcome, None]


@dataclass(frozen=True)
class PlannedJob:
    """What is wanted, and the plan for it. `camera` may be None where nothing will be exposed."""

    request: CaptureRequest
    camera: CameraInfo | None
    plan: Plan


class Course:
    """The state of one job whose photos lie in `folder`; its codes are stored there at once.

    Raises NoSpaceError, or DiskError for any other refusal of the disk.
    """

    def __init__(self, facts: RigFacts, job: PlannedJob, folder: Path) -> None:
        if job.camera is None:
            raise PdcdError("pictures need to know the camera")
        self.plan, self.folder, self.shelf = job.plan, folder, PhotoShelf(folder)
        self._facts, self._request, self._camera = facts, job.request, job.camera
        self._before: Plan | None = None
        """The plan before the scouts of a pilot ended the pilot."""
        self._looked = False
        self._room: DarkPhoto | None = None
        self._taken_off: DarkPhoto | None = None
        """The dark photo before all shots; and the one that is subtracted from shots without black
        exposures."""
        self._last_dark: tuple[DarkPhoto, DarkFrames, bool, int] | None = None
        """The last dark photo, what the panels showed in it, whether with a lit projector, and how
        many shots there were then."""
        self._panels: PanelLook | None = None
        self._borders: BorderPhoto | None = None
        self._panels_due = self._borders_due = not facts.cells_meet
        self._of_pilot = self._of_noise = ""
        self._orders = Orders()
        self._exposer = Exposer(facts, job.camera, job.plan.iso, self.shelf, self._orders)
        self._watch = Watch()
        self._steps: _Steps = self._run()
        self.write_patterns(self.folder)
        self.darkroom = Darkroom(folder, self._record(()), self.shelf)

    @property
    def decided(self) -> tuple[str, ...]:
        """What was decided about a pilot that nobody had asked for, and about noise, in words."""
        return tuple(text for text in (self._of_pilot, self._of_noise) if text)

    def next_exposure(self, watch: Watch, taken: PhotoOutcome) -> Order:
        """What to do next, after `taken` was taken; None before the first exposure, and after an
        order without a photo. Raises DecodeError, and ConfigError where the camera cannot do it."""
        self._watch = watch
        try:
            return self._steps.send(taken)
        except StopIteration:
            return self._orders.end()

    def _run(self) -> _Steps:
        """All photos of the job."""
        if self._panels_due and self.plan.look is not None:
            self._room = yield from self._dark(_ROOM_NAME, DarkFrames.of(self.plan), lit=False)
            self._taken_off = self._room
            self._adopt(self.plan)
            self._orders.note(self.adopted())
        yield from self._shoot()
        yield from self._look_again()

    def _shoot(self) -> _Steps:
        """Shot after shot, as far as needed."""
        until, fresh = self._request.until_error, True
        while True:
            taken = self._names()
            if self._panels_due and (yield from self._look_at_panels(taken)):
                continue
            if self._borders_due and (yield from self._photograph_borders(taken)):
                continue
            step = choose_next_step(self.plan, taken, looked=self._looked, fresh=fresh)
            fresh = False
            if step is None:
                return
            if step == "dark":
                yield from self._look()
            elif isinstance(step, str):
                yield from self._learn(scouts=step == "scouts")
            else:
                yield from self._take(step)
                fresh = True
                if until is not None and self._is_good_enough(until, step):
                    return

    def _take(self, shot: Shot) -> _Steps:
        """Meter if needed, and expose. With two buckets, the shot of the second comes with it."""
        f_number = yield from self._aperture(shot)
        taken = yield from self._orders.expose(self._ordered(shot, f_number))
        for record in cast(tuple[ShotRecord, ...], taken):
            self.darkroom.add(record)

    def order(self, shot: Shot) -> PhotoOrder:
        """The order to take a shot of the plan again."""
        return self._ordered(shot, self._exposer.find_aperture(shot))

    def _ordered(self, shot: Shot, f_number: float) -> PhotoOrder:
        plan, shots = self.plan, self.plan.recipe.shots
        sequence = plan.sequence(shot)
        return PhotoOrder(
            kind="shot",
            name=shot.name,
            frames=sequence.frames(),
            settings=self._exposer.settings(f_number),
            f_number=f_number,
            window=sequence.window,
            # What leaks through black depends on the time of an exposure, not on its codes: photos
            # that are subtracted from each other must have shown their codes equally often.
            even=any(s.of_leaks for s in shots),
            beside=tuple((s.name, plan.frames(s)) for s in shots if s.beside == shot.name),
        )

    def _aperture(self, shot: Shot) -> Generator[Order, PhotoOutcome, float]:
        """The f-number of a shot; test exposures may change how long white is shown, and measure
        how much light a stop lets through."""
        exposer, known = self._exposer, len(self._exposer.stops)
        f_number = yield from exposer.aperture(shot, self.plan.recipe.shots, self.plan.sequence)
        slots = self.plan.white_slots
        if shot.all_light:
            slots = exposer.white_slots(slots)
        if slots != self.plan.white_slots or len(exposer.stops) != known:
            self.plan = replace(self.plan, white_slots=slots)
            self.darkroom.set_stops(exposer.stops)
            self._orders.note(self.adopted())
        return f_number

    def _learn(self, *, scouts: bool) -> _Steps:
        """After the scouts of a pilot, end it where it cannot pay; after its last photo, keep
        linked cells apart in the codes that follow."""
        before, darkroom = self.plan, self.darkroom
        yield self._orders.tell(events.PilotLearning(photos=SCOUTS if scouts else before.how.pilot))
        learned = darkroom.learned(self._watch)
        if learned is None:
            return
        found = decide_after_pilot(
            before,
            learned,
            darkroom.record.shots,
            scouts=scouts,
            seed=self._request.seed,
            limit_s=self._facts.config.limits.max_exposure_s,
            watch=self._watch,
        )
        if found is None:
            return
        if found.outcome == "no use":
            self.plan = found.plan
        else:
            self._adopt(found.plan)
        if found.outcome == "stopped":
            self._before = before
        if found.told or found.outcome != "no use":
            self._orders.note(self.adopted())
        if found.told:
            self._of_pilot = found.told
        elif found.outcome == "stopped":
            self._orders.note(
                f"the pilot ended after {SCOUTS} photos, which show no sharp far paths; the coded "
                f"photo took {found.plan.how.coded} codes"
            )
        elif found.outcome == "no use":
            self._orders.note("the pilot found nothing that better codes could avoid")

    def _look_at_panels(self, taken: frozenset[str]) -> Generator[Order, PhotoOutcome, bool]:
        """Check whether both panels lie where they should, once the white shot is there. Returns
        whether anything was photographed."""
        from pdcd.capture.worker.panel_check import PanelCheck  # no bench of cells needs it
        from pdcd.planning.panel_look import is_panel_check_due, is_panel_check_needed
        from pdcd.verdict.misplaced import list_placement_warnings

        config = self._facts.config
        self._panels_due = is_panel_check_needed(self.plan, config)
        if not self._panels_due or not is_panel_check_due(self.plan, taken):
            return False
        self._panels_due = False
        check = PanelCheck(self._facts, self._exposer, self._orders)
        shots = self.darkroom.record.shots
        self._panels = yield from check.run(self.plan, shots)
        self._adopt(self.plan)
        self._orders.note(
            self.adopted(), *list_placement_warnings(self.darkroom.record, self.plan.window)
        )
        return True

    def _photograph_borders(self, taken: frozenset[str]) -> Generator[Order, PhotoOutcome, bool]:
        """Photograph what gets through along the borders of whole cells that do not coincide, once
        the white shot is there. Returns whether anything was photographed."""
        from pdcd.planning.border_photo import (  # no bench of cells needs it
            is_border_photo_due,
            is_border_photo_needed,
        )

        config = self._facts.config
        self._borders_due = is_border_photo_needed(self.plan, config)
        if not self._borders_due or not is_border_photo_due(self.plan, taken):
            return False
        self._borders_due = False
        from pdcd.capture.worker.border_check import photograph_borders

        widest = self.darkroom.widest_strip(self._watch)
        self._borders = yield from photograph_borders(
            self.plan, config, widest, self._exposer, self._orders
        )
        if self._borders is not None:
            self._adopt(self.plan)
            self._orders.note(self.adopted())
        return self._borders is not None

    def _look(self) -> _Steps:
        """Take dark photos, and add black exposures where these call for them."""
        self._looked = True
        plan, darks = self.plan, list[DarkPhoto]()
        due = DarkFrames.of(plan)
        for name in _DARK_NAMES:
            dark = yield from self._dark(name, due, lit=not darks)
            if dark is None:
                return
            self._last_dark = dark, due, not darks, len(self.darkroom.record.shots)
            darks.append(dark)
            leaks = estimate_leaks(plan, self.darkroom, darks, self._watch, self._room)
            if self._room is not None and leaks.changed:
                self._taken_off = choose_darker_photo(self.darkroom, self._room, dark)
            if leaks.both <= leaks.limit:
                self._adopt(note_harmless_leaks(plan, leaks))  # for the verdict
                break
        else:
            self._stop_leaks(leaks, darks[-1])
        self._orders.note(self.adopted())

    def _look_again(self) -> _Steps:
        """After shots that came later than the dark photos, check whether the room's light is
        unchanged: parts and black exposures do not show by themselves that it was switched."""
        if self._last_dark is None:
            return
        before, due, lit, shots = self._last_dark
        if len(self.darkroom.record.shots) <= shots:
            return
        after = yield from self._dark(_AGAIN_NAME, due, lit=lit)
        if after is None:
            return
        changed = estimate_room_change(self.darkroom, before, after, self._watch)
        leaks = self.plan.leaks
        if leaks is not None and changed > leaks.changed:
            self._adopt(replace(self.plan, leaks=msgspec.structs.replace(leaks, changed=changed)))
            self._orders.note(self.adopted())

    def _dark(
        self, name: str, due: DarkFrames, *, lit: bool
    ) -> Generator[Order, PhotoOutcome, DarkPhoto | None]:
        """Take a dark photo at the aperture of the answer's light; None where it was spoilt."""
        f_number = yield from self._aperture(due.shot)
        settings = self._exposer.settings(f_number)
        wanted = PhotoOrder("dark", name, due.frames(lit=lit), settings, f_number)
        taken = yield from self._orders.look(wanted)
        if isinstance(taken, SpoiltPhoto):
            self._orders.note(f"no look at ambient light and leaks: {taken.message}")
            return None
        yield self._orders.tell(MeterRecord(raw=taken.raw, f_number=f_number, peak=None))
        return make_dark_photo(taken, wanted, due.phase_s)

    def _stop_leaks(self, leaks: LeakErrors, dark: DarkPhoto) -> None:
        """Go on with black exposures and what else ambient light requires, or say why not."""
        plan, config = self.plan, self._facts.config
        share = f"{100.0 * leaks.both:.2g} % of the picture (limit {100.0 * leaks.limit:.3g} %)"
        try:
            more = with_black_exposures(plan, leaks, config, self.darkroom.record.shots)
        except RequestError as err:
            self._adopt(note_harmless_leaks(plan, leaks))  # what is known of leaks must be recorded
            self._orders.note(
                f"ambient light and leaks make {share}, and black exposures are not added: "
                f"{err.message}"
            )
            return
        average = plan.look is not None and plan.look.average
        response = AmbientResponse(self._request, config, self._camera, self._before, average)
        found = response.after(more, dark, self.darkroom, self._adopt, self._watch)
        self._orders.note(
            f"ambient light and leaks would have made {share}: black exposures were added "
            f"(black level {self.plan.how.black_level})",
            *found.told,
        )
        self._of_noise = found.decided

    def _is_good_enough(self, target: float, shot: Shot) -> bool:
        """Whether the parts taken so far reach the wanted error; reports how far they are.

        Only the spread of parts may end a run: with fewer than `FEWEST_PARTS` sigma is a guess.
        """
        if not is_last_of_part(self.plan, shot):
            return False
        decoded = self.darkroom.decoded(self._watch)
        path = self.folder / _RUNNING
        with disk_errors(str(path.parent)):
            previews = Previews(decoded.pictures, decoded.view)
            write_png(path, previews.drawn(decoded.recipe.answer_name))
        reached = compute_rms_sigma(decoded.answer)
        met = decoded.answer.kind == "measured" and reached <= target
        last = shot is self.plan.last_exposed
        self._orders.note(
            events.PartCompleted(
                part=len(list_parts(decoded.recipe)),
                rms_sigma=reached if np.isfinite(reached) else None,
                target=target,
            )
        )
        if met and not last:
            self._orders.note(ConvergenceNote())
        if not met and last:
            self._orders.note(
                f"sigma came down to {100.0 * reached:.2g} %, not to the {100.0 * target:g} % "
                "asked for"
            )
        return met

    def _adopt(self, plan: Plan) -> None:
        """Go on with another plan; shots that it does not contain are dropped."""
        other = plan.patterns is not self.plan.patterns
        self.plan = plan
        if other:
            self.write_patterns(self.folder)
        record, planned = self.darkroom.record, {shot.name for shot in plan.recipe.shots}
        kept = tuple(shot for shot in record.shots if shot.name in planned)
        self.darkroom.replan(self._record(kept, record.cells))

    def adopted(self) -> AdoptedPlan:
        """The current plan, as it has to be kept."""
        plan = self.plan
        return AdoptedPlan(
            summary=plan.summary(self._facts.config.limits.max_exposure_s),
            record=self._record(()),
            shots=tuple(shot.name for shot in plan.recipe.shots),
        )

    def _names(self) -> frozenset[str]:
        """The shots that were taken."""
        return frozenset(shot.name for shot in self.darkroom.record.shots)

    def _record(self, shots: Sequence[ShotRecord], cells: CellMap | None = None) -> RunRecord:
        facts = self._facts
        return make_run_record(
            self.plan, self._request, facts.config, self._camera, facts.profile, shots, cells,
            stops=self._exposer.stops, panels=self._panels, borders=self._borders,
            room=self._taken_off,
        )  # fmt: skip

    def write_patterns(self, folder: Path) -> None:
        """Store the codes of the plan in a run folder. Raises NoSpaceError and DiskError."""
        target = self.plan.recipe.target
        given: Mapping[str, NDArray[np.float64]] = {**target.planes, **target.matrices}
        write_patterns(
            folder,
            self.plan.patterns,
            given,
            family=self.plan.how.family or "none",
            codes=self.plan.how.coded,
            seed=self._request.seed,
        )
