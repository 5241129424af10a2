"""What a job makes of a pilot, of dark photos and of its parts; its surroundings are played."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.bench.devices import CameraSettings
from pdcd.capture.worker import plan_owner as module
from pdcd.capture.worker import worker as worker_module
from pdcd.capture.worker.answers import (
    AdoptedPlan,
    AuxiliaryPhoto,
    ConvergenceNote,
    PhotoOrder,
    RigFacts,
    SpoiltPhoto,
)
from pdcd.capture.worker.leak_check import AmbientResponse
from pdcd.capture.worker.plan_owner import Course, PlannedJob
from pdcd.capture.worker.worker import Worker
from pdcd.errors import PdcdError, RequestError
from pdcd.planning.guided import PilotOutcome
from pdcd.protocol import events
from pdcd.recipes.recipe import Shot
from pdcd.runs.record import DarkPhoto, MeterRecord
from pdcd.watch import Watch

WATCH = Watch()
SHA = "a" * 64
Made = Callable[..., Any]


def shot(name: str) -> Shot:
    return Shot(name, program="coded")


class Sequence:
    """What a shot shows."""

    window = "quarter"

    def __init__(self, name: str) -> None:
        self.name = name

    def frames(self) -> str:
        return f"frames of {self.name}"


@dataclass(frozen=True)
class Plan:
    """A plan as far as a job looks at it."""

    name: str
    shots: tuple[str, ...] = ("a", "b")
    patterns: str = "patterns"
    look: Any = None
    unasked: bool = False
    iso: Any = None
    white_slots: int = 1

    @property
    def how(self) -> Any:
        return SimpleNamespace(pilot=16, coded=32, black_level="both")

    @property
    def recipe(self) -> Any:
        return SimpleNamespace(shots=[shot(name) for name in self.shots])

    @property
    def last_exposed(self) -> Any:
        return SimpleNamespace(name=self.shots[-1])

    def sequence(self, one: Any) -> Sequence:
        return Sequence(one.name)

    def summary(self, limit_s: float) -> str:
        return f"summary of {self.name} within {limit_s:g} s"


@dataclass
class Room:
    """A darkroom that knows of shots, and what it was told."""

    learnt: Any = "learnt"
    answer: Any = None
    told: list[Any] = field(default_factory=list)
    record: Any = field(default_factory=lambda: SimpleNamespace(shots=(), cells="cells"))

    def add(self, shot: Any) -> None:
        self.record.shots += (shot,)

    def learned(self, watch: Watch) -> Any:
        self.told.append("learned")
        return self.learnt

    def replan(self, record: Any) -> None:
        self.told.append(record)
        self.record.shots = record[1]

    def decoded(self, watch: Watch) -> Any:
        self.told.append("decoded")
        return SimpleNamespace(
            answer=self.answer, recipe=SimpleNamespace(answer_name="it"), pictures={}, view=None
        )


CONFIG: Any = SimpleNamespace(
    limits=SimpleNamespace(max_exposure_s=60.0), camera=SimpleNamespace(f_number=8.0, stops=())
)
CAMERA: Any = SimpleNamespace(isos=(100,), f_numbers=(8.0,))


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Made:
    """A job by a plan that goes through these steps; what is stored is noted in its darkroom."""

    def make(plan: Plan, *steps: Any, until: float | None = None) -> Any:
        facts: Any = RigFacts(CONFIG, None, (3, 4), None, cells_meet=True)  # type: ignore[arg-type]
        request: Any = SimpleNamespace(seed=7, until_error=until)
        room, left = Room(), list(steps)
        monkeypatch.setattr(module, "Darkroom", lambda folder, record, shelf: room)
        monkeypatch.setattr(
            module, "make_run_record",
            lambda plan, request, config, camera, profile, shots, cells, **_: (
                plan.name, shots, cells,
            ),
        )  # fmt: skip
        monkeypatch.setattr(
            Course, "write_patterns", lambda self, _: room.told.append(f"codes of {self.plan.name}")
        )
        monkeypatch.setattr(
            module,
            "choose_next_step",
            lambda plan, taken, *, looked, fresh: left.pop(0) if left else None,
        )
        known: Any = plan
        course: Any = Course(facts, PlannedJob(request, CAMERA, known), Path("/run"))
        room.told.clear()
        return course

    return make


def run(course: Any, *photos: Any) -> list[Any]:
    """All that is ordered; what is exposed comes as is said."""
    left, orders, taken = list(photos), [], None
    while True:
        order = course.next_exposure(WATCH, taken)
        orders.append(order)
        if order.done:
            return orders
        taken = left.pop(0) if order.photo is not None else None


def notes(orders: list[Any]) -> list[Any]:
    return [note for order in orders for note in order.notes]


def adopted(name: str, shots: tuple[str, ...] = ("a", "b")) -> Any:
    record: Any = (name, (), None)
    summary: Any = f"summary of {name} within 60 s"
    return AdoptedPlan(summary, record, shots)


def test_a_shot_is_ordered_and_kept(made: Made) -> None:
    course = made(Plan("asked"), shot("b"))
    taken = SimpleNamespace(name="b")
    first, last = run(course, (taken,))
    frames: Any = "frames of b"
    assert vars(first.photo) == vars(
        PhotoOrder("shot", "b", frames, CameraSettings(100, 8.0), 8.0, "quarter")
    )
    assert course.darkroom.record.shots == (taken,)
    assert (first.notes, last.notes, first.done) == ((), (), False)


LEARNING = events.PilotLearning(photos=4)


@pytest.mark.parametrize("found", [None, PilotOutcome(Plan("x"), "no use", "")])  # type: ignore[arg-type]
def test_a_pilot_that_may_still_pay_goes_on(
    made: Made, monkeypatch: pytest.MonkeyPatch, found: Any
) -> None:
    course = made(Plan("asked"), "scouts")
    monkeypatch.setattr(module, "decide_after_pilot", lambda *_, **__: None)
    course.darkroom.learnt = found
    first, last = run(course)
    # It is told before the work that takes long.
    assert (first.notes, first.photo, last.notes) == ((LEARNING,), None, ())
    assert course.plan.name == "asked" and course.darkroom.told == ["learned"]


@pytest.mark.parametrize(
    ("outcome", "told", "words"),
    [
        (
            "stopped", "",
            ["the pilot ended after 4 photos, which show no sharp far paths; the coded photo took "
             "32 codes"],
        ),
        ("stopped", "no mirrors", []),
        ("guided", "", []),
        ("guided", "sharp paths", []),
    ],
)  # fmt: skip
def test_other_codes_follow_what_a_pilot_shows(
    made: Made, monkeypatch: pytest.MonkeyPatch, outcome: Any, told: str, words: list[str]
) -> None:
    course = made(Plan("asked"), "scouts" if outcome == "stopped" else "pilot")
    asked: list[Any] = []

    def after(plan: Plan, learned: str, shots: Any, **said: Any) -> PilotOutcome:
        asked.append((plan.name, learned, shots, said))
        other: Any = Plan("better", patterns="others")
        return PilotOutcome(other, outcome, told)

    monkeypatch.setattr(module, "decide_after_pilot", after)
    orders = run(course)
    said = {"scouts": outcome == "stopped", "seed": 7, "limit_s": 60.0, "watch": WATCH}
    assert asked == [("asked", "learnt", (), said)]
    photos = 4 if outcome == "stopped" else 16
    assert notes(orders) == [events.PilotLearning(photos=photos), adopted("better"), *words]
    assert course.darkroom.told == ["learned", "codes of better", ("better", (), "cells")]
    assert course.decided == ((told,) if told else ())
    assert (course._before is None) is (outcome == "guided")


@pytest.mark.parametrize("told", ["", "sharp light without a map"])
def test_a_pilot_that_was_of_no_use_changes_no_codes(
    made: Made, monkeypatch: pytest.MonkeyPatch, told: str
) -> None:
    course = made(Plan("asked"), "pilot")
    same: Any = Plan("asked")
    monkeypatch.setattr(
        module, "decide_after_pilot", lambda *_, **__: PilotOutcome(same, "no use", told)
    )
    orders = run(course)
    assert course.darkroom.told == ["learned"] and course.plan is same
    words = "the pilot found nothing that better codes could avoid"
    assert notes(orders)[1:] == ([adopted("asked")] if told else [words])


def dark(name: str) -> AuxiliaryPhoto:
    return AuxiliaryPhoto(((f"raw/{name}.dng", SHA),), 2.0)


def metered(name: str) -> MeterRecord:
    return MeterRecord(raw=f"raw/{name}.dng", f_number=8.0, peak=None)


class Due:
    """What a dark photo shows."""

    shot, phase_s = shot("b"), 0.25

    @classmethod
    def of(cls, plan: Plan) -> Due:
        return cls()

    def frames(self, *, lit: bool) -> str:
        return f"dark {lit}"


SHARE = "1.1 % of the picture (limit 1 %)"
ADDED = (
    f"ambient light and leaks would have made {SHARE}: black exposures were added (black level "
    "both)"
)
WARNED = f"ambient light and leaks make {SHARE}, and black exposures are not added: no room"


@pytest.mark.parametrize(
    ("both", "refused", "photos", "plan", "words"),
    [
        ((0.009,), False, 1, "quiet", []),
        ((0.01,), False, 1, "quiet", []),
        ((0.011, 0.01), False, 2, "quiet", []),
        ((0.011, 0.011), False, 2, "mended", [ADDED, "a map"]),
        ((0.011, 0.011), True, 2, "quiet", [WARNED]),
    ],
)
def test_what_follows_from_dark_photos(
    made: Made, monkeypatch: pytest.MonkeyPatch,
    both: tuple[float, ...], refused: bool, photos: int, plan: str, words: list[str],
) -> None:  # fmt: skip
    shots = (SimpleNamespace(name="a"), SimpleNamespace(name="b"))
    seen: list[Any] = []

    def leaks(
        plan: Plan, room: Room, darks: list[DarkPhoto], watch: Watch, before: DarkPhoto | None
    ) -> Any:
        assert before is None  # only benches whose panels are looked at take one
        seen.append([photo.raw for photo in darks])
        assert darks[-1] == DarkPhoto(
            raw=darks[-1].raw, sha256=SHA, iso=100, f_number=8.0, exposure_s=2.0, phase_s=0.25
        )
        return SimpleNamespace(both=both[len(darks) - 1], limit=0.01)

    def blacks(plan: Plan, leaks: Any, config: Any, taken: Any) -> Plan:
        assert (plan.name, config, taken) == ("asked", CONFIG, shots)
        if refused:
            raise RequestError("no room")
        return Plan("blacks", shots=("a",))

    def after(self: Any, plan: Plan, photo: DarkPhoto, room: Room, adopt: Any, watch: Watch) -> Any:
        assert (self.request.seed, self.config, self.camera) == (7, CONFIG, CAMERA)
        assert (self.before, self.average, watch) == (None, True, WATCH)
        assert photo.raw == "raw/look-ambient.dng"
        adopt(plan)
        adopt(replace(plan, name="mended", patterns="others"))
        return SimpleNamespace(told=("a map",), decided="more light")

    monkeypatch.setattr(AmbientResponse, "after", after)
    monkeypatch.setattr(module, "DarkFrames", Due)
    monkeypatch.setattr(module, "estimate_leaks", leaks)
    monkeypatch.setattr(module, "note_harmless_leaks", lambda plan, leaks: Plan("quiet"))
    monkeypatch.setattr(module, "with_black_exposures", blacks)
    course = made(Plan("asked", look=SimpleNamespace(average=True)), "dark")
    course.darkroom.record.shots = shots
    names = ["look-dark", "look-ambient"][:photos]
    orders = run(course, *map(dark, names))
    wanted = [order.photo for order in orders if order.photo is not None]
    assert [(one.kind, one.name, one.frames) for one in wanted] == [
        ("dark", "look-dark", "dark True"), ("dark", "look-ambient", "dark False"),
    ][:photos]  # fmt: skip
    raws = [f"raw/{name}.dng" for name in names]
    assert seen == [raws[: n + 1] for n in range(photos)]
    # A photo is kept before it is looked at; in the end it is said by what plan the run goes on.
    there = ("a",) if plan == "mended" else ("a", "b")
    assert notes(orders) == [*map(metered, names), *words, adopted(plan, there)]
    assert course.decided == (("more light",) if plan == "mended" else ())
    # Shots that the plan knows stay; codes are written before the darkroom reads them.
    first = shots[:1]
    told = [("blacks", first, "cells"), "codes of mended", ("mended", first, "cells")]
    left = [("quiet", shots, "cells")]  # what is known of leaks, to be remembered
    assert course.darkroom.told == (told if plan == "mended" else left)


@pytest.mark.parametrize("spoilt", [0, 1])
def test_a_dark_photo_that_was_spoilt_ends_the_look_and_not_the_run(
    made: Made, monkeypatch: pytest.MonkeyPatch, spoilt: int
) -> None:
    monkeypatch.setattr(module, "DarkFrames", Due)
    unsure = SimpleNamespace(both=2.0, limit=1.0)
    monkeypatch.setattr(module, "estimate_leaks", lambda *_: unsure)
    course = made(Plan("asked"), "dark")
    photos = [dark("look-dark")][:spoilt]
    orders = run(course, *photos, SpoiltPhoto("late"))
    words = "no look at ambient light and leaks: late"
    assert notes(orders) == [*[metered("look-dark")][:spoilt], words]
    assert course.plan.name == "asked" and course._looked


@pytest.mark.parametrize(
    ("kind", "sigma", "last", "enough", "ends"),
    [
        ("measured", 0.1, False, True, True), ("measured", 0.11, False, False, False),
        ("measured", 0.05, True, False, True), ("sensor", 0.05, False, False, False),
        ("sensor", 0.0432, True, False, False), ("measured", np.inf, True, False, False),
    ],
)  # fmt: skip
def test_only_a_spread_that_is_small_enough_ends_a_run(
    made: Made, monkeypatch: pytest.MonkeyPatch,
    kind: str, sigma: float, last: bool, enough: bool, ends: bool,
) -> None:  # fmt: skip
    plan = Plan("asked")
    one = shot("a")
    monkeypatch.setattr(Plan, "last_exposed", one if last else shot("z"))
    monkeypatch.setattr(module, "is_last_of_part", lambda plan, shot: True)
    monkeypatch.setattr(module, "compute_rms_sigma", lambda answer: sigma)
    monkeypatch.setattr(module, "list_parts", lambda recipe: (1, 2, 3))
    monkeypatch.setattr(module, "write_png", lambda path, picture: None)
    monkeypatch.setattr(module, "Previews", lambda *_: SimpleNamespace(drawn=lambda name: None))
    course = made(plan, one, shot("b"), until=0.1)
    course.darkroom.answer = SimpleNamespace(kind=kind)
    monkeypatch.setattr(module, "is_last_of_part", lambda plan, shot: shot is one)
    records = (SimpleNamespace(name="a"),)
    orders = run(course, records, records)
    told = notes(orders)
    known = None if np.isinf(sigma) else sigma
    assert told[0] == events.PartCompleted(part=3, rms_sigma=known, target=0.1)
    assert (ConvergenceNote() in told) is enough
    assert len([order for order in orders if order.photo is not None]) == 2 - ends
    missed = [note for note in told if isinstance(note, str)]
    words = f"sigma came down to {100.0 * sigma:.2g} %, not to the 10 % asked for"
    assert missed == [words] * (last and not ends)


def worker(**known: Any) -> Any:
    facts: Any = RigFacts(CONFIG, None, (3, 4), None, cells_meet=True)  # type: ignore[arg-type]
    one: Any = Worker(facts)
    for name, value in known.items():
        setattr(one, name, value)
    return one


def test_what_was_kept_of_a_job_is_forgotten() -> None:
    one = worker(_job="a job", _course="a course", _finished="a run")
    one.forget(WATCH)
    assert one.report(WATCH) is None
    with pytest.raises(PdcdError, match="no plan to work on"):
        one.next_exposure(WATCH, None)


def test_a_job_without_a_folder_or_a_camera_has_no_pictures() -> None:
    plan: Any = Plan("asked")
    request: Any = SimpleNamespace(seed=7, until_error=None)
    one = worker(_job=PlannedJob(request, None, plan))
    with pytest.raises(PdcdError, match="no run folder yet"):
        one.next_exposure(WATCH, None)
    with pytest.raises(PdcdError, match="no run folder yet"):
        one.look(WATCH, "raw/a.dng", "0")
    with pytest.raises(PdcdError, match="no run folder yet"):
        one.develop(WATCH)
    with pytest.raises(PdcdError, match="need to know the camera"):
        one.begin(WATCH, Path("/run"))


def test_the_page_of_a_run_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker_module, "gather_material", lambda *run: run)
    monkeypatch.setattr(worker_module, "read_manifest", lambda folder: f"manifest of {folder}")
    monkeypatch.setattr(
        worker_module, "write_gathered_report",
        lambda folder, manifest, material: SimpleNamespace(name=f"{manifest} {material[1:]}"),
    )  # fmt: skip
    one = worker(_finished=("/run", "record", "decoded", None, {}))
    assert one.report(WATCH) == "manifest of /run ('record', 'decoded', None, {})"
    assert one.report(WATCH) is None
