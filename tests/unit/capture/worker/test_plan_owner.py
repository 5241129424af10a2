"""What a job says of its pilot, its dark photos and its parts; its surroundings are played."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from pdcd.bench.devices import CameraSettings
from pdcd.capture.worker import plan_owner as module
from pdcd.capture.worker.answers import (
    AdoptedPlan,
    AuxiliaryPhoto,
    ConvergenceNote,
    PhotoOrder,
    RigFacts,
    SpoiltPhoto,
)
from pdcd.capture.worker.plan_owner import Course, PlannedJob
from pdcd.planning.guided import PilotOutcome
from pdcd.protocol import events
from pdcd.recipes.recipe import Shot
from pdcd.runs.record import MeterRecord
from pdcd.watch import Watch

A, B = Shot("a", program="coded"), Shot("b", program="coded")
NOTHING: Any = None


@dataclass(frozen=True)
class Plan:
    """A plan as far as a job looks at it."""

    name: str = "asked"
    last_exposed: Shot = B
    look: Any = None
    iso: Any = None
    white_slots: int = 1
    patterns: str = "patterns"
    recipe: ClassVar[Any] = SimpleNamespace(shots=(A, B))
    how: ClassVar[Any] = SimpleNamespace(pilot=16, coded=32, black_level="both")

    def sequence(self, one: Shot) -> Any:
        return SimpleNamespace(window="quarter", frames=lambda: f"frames of {one.name}")

    def summary(self, limit_s: float) -> str:
        return f"summary of {self.name}"


def course(monkeypatch: pytest.MonkeyPatch, *steps: Any, until: float | None = None) -> Any:
    """A job that goes through these steps; one photo was taken for each of its shots."""
    config: Any = SimpleNamespace(
        limits=SimpleNamespace(max_exposure_s=60.0),
        camera=SimpleNamespace(f_number=8.0, stops=()),
    )
    camera: Any = SimpleNamespace(isos=(100,), f_numbers=(8.0,))
    facts = RigFacts(config, NOTHING, (3, 4), None, cells_meet=True)
    request, plan = SimpleNamespace(seed=7, until_error=until), Plan()
    room = SimpleNamespace(
        record=SimpleNamespace(shots=(), cells=None), learned=lambda watch: "learnt",
        add=lambda shot: None, replan=lambda record: None,
    )  # fmt: skip
    left = list(steps)
    monkeypatch.setattr(module, "Darkroom", lambda *_: room)
    monkeypatch.setattr(module, "make_run_record", lambda plan, *_, **__: f"record of {plan.name}")
    monkeypatch.setattr(Course, "write_patterns", lambda *_: None)
    monkeypatch.setattr(
        module, "choose_next_step", lambda *_, **__: left.pop(0) if left else None
    )  # fmt: skip
    known: Any = PlannedJob(request, camera, plan)  # type: ignore[arg-type]
    return Course(facts, known, Path("/run"))


def run(course: Any, *photos: Any) -> list[Any]:
    """All that is ordered; what is exposed comes as is said."""
    left, orders, taken = list(photos), list[Any](), None
    while not (orders and orders[-1].done):
        orders.append(course.next_exposure(Watch(), taken))
        taken = left.pop(0) if orders[-1].photo is not None else None
    return orders


def notes(orders: list[Any]) -> list[Any]:
    return [note for order in orders for note in order.notes]


def adopted(name: str) -> Any:
    summary: Any = f"summary of {name}"
    record: Any = f"record of {name}"
    return AdoptedPlan(summary, record, ("a", "b"))


@pytest.mark.parametrize(
    ("outcome", "told", "words"),
    [
        (None, "", []),
        ("stopped", "", [adopted("better"), "the pilot ended after 4 photos, which show no sharp "
                         "far paths; the coded photo took 32 codes"]),
        ("stopped", "no mirrors", [adopted("better")]),
        ("guided", "", [adopted("better")]),
        ("no use", "no map", [adopted("better")]),
        ("no use", "", ["the pilot found nothing that better codes could avoid"]),
    ],
)  # fmt: skip
def test_what_a_pilot_shows_is_said(
    monkeypatch: pytest.MonkeyPatch, outcome: Any, told: str, words: list[Any]
) -> None:
    better: Any = Plan("better")
    found = None if outcome is None else PilotOutcome(better, outcome, told)
    monkeypatch.setattr(module, "decide_after_pilot", lambda *_, **__: found)
    made = course(monkeypatch, "scouts" if outcome == "stopped" else "pilot")
    orders = run(made)
    # That it is looked at is told before the work that takes long.
    assert orders[0].notes == (events.PilotLearning(photos=4 if outcome == "stopped" else 16),)
    assert notes(orders)[1:] == words
    assert made.decided == ((told,) if told else ())


@pytest.mark.parametrize("spoilt", [0, 1])
def test_a_dark_photo_that_was_spoilt_ends_the_look_and_not_the_run(
    monkeypatch: pytest.MonkeyPatch, spoilt: int
) -> None:
    shown: Any = SimpleNamespace(shot=B, phase_s=0.25, frames=lambda lit: f"dark {lit}")
    monkeypatch.setattr(module, "DarkFrames", SimpleNamespace(of=lambda plan: shown))
    unsure = SimpleNamespace(both=2.0, limit=1.0)
    monkeypatch.setattr(module, "estimate_leaks", lambda *_: unsure)
    made = course(monkeypatch, "dark", B)
    photo = AuxiliaryPhoto((("raw/look-dark.dng", "a" * 64),), 2.0)
    orders = run(made, *[photo][:spoilt], SpoiltPhoto("late"), ())
    metered = MeterRecord(raw="raw/look-dark.dng", f_number=8.0, peak=None)
    words = "no look at ambient light and leaks: late"
    assert notes(orders) == [*[metered][:spoilt], words]
    last = [order.photo for order in orders if order.photo is not None][-1]
    frames: Any = "frames of b"
    wanted = PhotoOrder("shot", "b", frames, CameraSettings(100, 8.0), 8.0, "quarter")
    assert vars(last) == vars(wanted)


@pytest.mark.parametrize(
    ("kind", "sigma", "last", "enough", "ends"),
    [
        ("measured", 0.1, False, True, True), ("measured", 0.11, False, False, False),
        ("measured", 0.05, True, False, True), ("sensor", 0.05, False, False, False),
        ("sensor", 0.0432, True, False, False), ("measured", np.inf, True, False, False),
    ],
)  # fmt: skip
def test_only_a_spread_that_is_small_enough_ends_a_run(
    monkeypatch: pytest.MonkeyPatch, kind: str, sigma: float, last: bool, enough: bool, ends: bool
) -> None:
    monkeypatch.setattr(module, "is_last_of_part", lambda plan, shot: shot is A)
    monkeypatch.setattr(module, "compute_rms_sigma", lambda answer: sigma)
    monkeypatch.setattr(module, "list_parts", lambda recipe: (1, 2, 3))
    monkeypatch.setattr(module, "write_png", lambda path, picture: None)
    monkeypatch.setattr(module, "Previews", lambda *_: SimpleNamespace(drawn=lambda name: None))
    made = course(monkeypatch, A, B, until=0.1)
    made.plan = Plan(last_exposed=A if last else B)
    made.darkroom.decoded = lambda watch: SimpleNamespace(
        answer=SimpleNamespace(kind=kind), recipe=SimpleNamespace(answer_name="it"), pictures={},
        view=None,
    )  # fmt: skip
    orders = run(made, (), ())
    told = notes(orders)
    known = None if np.isinf(sigma) else sigma
    assert told[0] == events.PartCompleted(part=3, rms_sigma=known, target=0.1)
    assert (ConvergenceNote() in told) is enough
    assert len([order for order in orders if order.photo is not None]) == 2 - ends
    words = f"sigma came down to {100.0 * sigma:.2g} %, not to the 10 % asked for"
    assert [note for note in told if isinstance(note, str)] == [words] * (last and not ends)
