"""What the desk makes of a pilot, of dark photos and of test exposures; its parts are played."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pdcd.capture.worker import desk as module
from pdcd.capture.worker.desk import Desk, Facts
from pdcd.capture.worker.stray import Ambience
from pdcd.errors import PdcdError, RequestError
from pdcd.watch import Watch

WATCH = Watch()
SHOTS: Any = (SimpleNamespace(name="first"), SimpleNamespace(name="second"))


@dataclass(frozen=True)
class Plan:
    """A plan as far as the desk looks at it."""

    name: str
    unasked: bool = False
    reasons: tuple[str, ...] = ()
    recipe: Any = None
    look: Any = None
    patterns: str = "patterns"

    def outline(self) -> str:
        return f"outline of {self.name}"


@dataclass
class Room:
    """A darkroom that knows of shots, and what it was told."""

    learnt: Any = None
    told: list[Any] = field(default_factory=list)
    record: Any = field(
        default_factory=lambda: SimpleNamespace(shots=SHOTS[:1], cells="cells")
    )  # fmt: skip

    def add(self, shot: Any) -> None:
        self.record.shots += (shot,)

    def learned(self, watch: Watch) -> Any:
        return self.learnt

    def replan(self, record: Any) -> None:
        self.told.append(record)


CONFIG: Any = SimpleNamespace(limits=SimpleNamespace(max_exposure_s=60.0))
Made = Callable[..., Any]


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Made:
    """A desk amid a job by a plan; what it writes and records is noted in its darkroom."""

    def make(plan: Plan, learnt: Any = None, *, scouts: bool = False) -> Any:
        facts: Any = Facts(CONFIG, None, (3, 4), None)  # type: ignore[arg-type]
        desk: Any = Desk(facts)
        room = Room(learnt)
        request = SimpleNamespace(seed=7)
        desk._job = SimpleNamespace(
            plan=plan, request=request, camera="camera", darkroom=room, folder=Path("/run"),
            ratio=None, before=None,
        )  # fmt: skip
        desk.room = room
        desk._write_patterns = lambda job: room.told.append(f"codes of {job.plan.name}")
        monkeypatch.setattr(
            module, "record_of",
            lambda plan, request, config, camera, profile, shots, cells: (plan.name, shots, cells),
        )  # fmt: skip
        monkeypatch.setattr(module, "scouted", lambda plan, taken: scouts and taken == 2)
        monkeypatch.setattr(module, "Planned", lambda outline, figures: (outline, figures))
        monkeypatch.setattr(
            module, "summary", lambda plan, limit_s: (plan.name, plan.reasons, limit_s)
        )
        monkeypatch.setattr(
            module, "stopped", lambda plan, seed, limit_s: Plan(f"stopped {seed} {limit_s}", True)
        )
        monkeypatch.setattr(
            module, "with_links", lambda plan, links, seed, watch: Plan(f"{links} {seed}")
        )  # fmt: skip
        monkeypatch.setattr(module, "looked", lambda plan, learned, shots: f"saw {len(shots)}")
        return desk

    return make


def learned(*, promising: bool = False, pays: bool = False) -> Any:
    return SimpleNamespace(promising=promising, pays=pays, links="links")


@pytest.mark.parametrize(
    ("learnt", "scouts"), [(None, False), (None, True), (learned(promising=True), True)]
)
def test_a_pilot_that_may_still_pay_goes_on(made: Made, learnt: Any, scouts: bool) -> None:
    desk = made(Plan("asked"), learnt, scouts=scouts)
    found = desk.learn(WATCH, SHOTS)
    assert (found.outcome, found.planned, found.told) == ("go on", None, "")
    assert desk.room.record.shots == SHOTS and desk.room.told == []


def test_scouts_that_see_nothing_end_the_pilot(made: Made) -> None:
    desk = made(Plan("asked"), learned(pays=True), scouts=True)
    found = desk.learn(WATCH, SHOTS)
    name = "stopped 7 60.0"
    assert desk._job.before.name == "asked"
    assert (found.outcome, found.told) == ("stopped", "")
    assert found.planned == (f"outline of {name}", (name, (), 60.0))
    assert desk.room.told == [f"codes of {name}", (name, SHOTS, "cells")]
    assert desk._job.plan.name == name


def test_links_that_pay_guide_the_codes_that_follow(made: Made) -> None:
    desk = made(Plan("asked"), learned(promising=True, pays=True))
    found = desk.learn(WATCH, SHOTS)
    assert (found.outcome, found.planned[0]) == ("guided", "outline of links 7")
    assert desk.room.told == ["codes of links 7", ("links 7", SHOTS, "cells")]


@pytest.mark.parametrize("unasked", [True, False])
def test_a_pilot_that_was_of_no_use_changes_no_codes(made: Made, unasked: bool) -> None:
    desk = made(Plan("asked", unasked, ("why",)), learned(promising=True))
    found = desk.learn(WATCH, SHOTS)
    assert found.outcome == "no use" and desk.room.told == []
    reasons = ("why", "pilot: saw 2")
    if unasked:
        assert found.told == "saw 2"
        assert found.planned == ("outline of asked", ("asked", reasons, 60.0))
        assert desk._job.plan.reasons == reasons
    else:
        assert (found.told, found.planned) == ("", None) and desk._job.plan.reasons == ("why",)


@pytest.mark.parametrize(
    ("both", "darks", "refused", "outcome", "plan"),
    [
        (0.9, 1, False, "quiet", "quiet"),
        (1.0, 1, False, "quiet", "quiet"),
        (1.1, 1, False, "unsure", "asked"),
        (1.0, 2, False, "quiet", "quiet"),
        (1.1, 2, False, "added", "mended"),
        (1.1, 2, True, "warn", "quiet"),
    ],
)
def test_what_follows_from_dark_photos(
    made: Made, monkeypatch: pytest.MonkeyPatch,
    both: float, darks: int, refused: bool, outcome: str, plan: str,
) -> None:  # fmt: skip
    def blacks(plan: Plan, leaks: Any, config: Any, shots: Any) -> Plan:
        assert (plan.name, config, shots) == ("asked", CONFIG, SHOTS)
        if refused:
            raise RequestError("no room for more")
        return Plan("blacks", recipe=SimpleNamespace(shots=[SimpleNamespace(name="first")]))

    def after(self: Any, plan: Plan, photo: str, room: Room, replan: Any, watch: Watch) -> Any:
        assert (self.request.seed, self.config, self.camera) == (7, CONFIG, "camera")
        assert (self.before, self.average, photo, watch) == (None, True, "dark", WATCH)
        replan(plan)
        replan(replace(plan, name="mended", patterns="others"))
        return SimpleNamespace(told=("a map",), decided="more light")

    leaks = SimpleNamespace(both=both, limit=1.0)
    monkeypatch.setattr(Ambience, "after", after)
    monkeypatch.setattr(module, "leaks_in", lambda *_: leaks)
    monkeypatch.setattr(module, "quiet", lambda plan, leaks: Plan("quiet"))
    monkeypatch.setattr(module, "with_blacks", blacks)
    desk = made(Plan("asked", look=SimpleNamespace(average=True)))
    found = desk.stray(WATCH, SHOTS, ["dark"] * darks)
    assert (found.outcome, found.leaks) == (outcome, leaks)
    assert found.planned[0] == f"outline of {plan}"
    assert found.why == ("no room for more" if refused else "")
    assert desk._job.plan.name == plan
    added = outcome == "added"
    assert (found.told, found.decided) == ((("a map",), "more light") if added else ((), ""))
    # Shots that the plan knows stay; codes are written before the darkroom reads them.
    first = SHOTS[:1]
    told = [("blacks", first, "cells"), "codes of mended", ("mended", first, "cells")]
    left = [("quiet", SHOTS, "cells")]  # what is known of leaks, to be remembered
    assert desk.room.told == (left if outcome == "warn" else told * added)


def test_a_test_exposure_is_measured_after_its_pairs(
    made: Made, monkeypatch: pytest.MonkeyPatch
) -> None:
    shots = [SimpleNamespace(name="a"), SimpleNamespace(name="b")]
    desk = made(Plan("asked", recipe=SimpleNamespace(shots=shots)))
    monkeypatch.setattr(module, "metered_pairs", lambda plan, shot: (3, f"ratio of {shot.name}"))
    with pytest.raises(PdcdError, match="before its shot"):
        desk.metered(WATCH, "raw/a.dng", "0" * 64, 100.0)
    assert desk.meter_pairs(WATCH, "b") == 3 and desk._job.ratio == "ratio of b"
    desk._job.folder = None
    with pytest.raises(PdcdError, match="before its shot"):
        desk.metered(WATCH, "raw/a.dng", "0" * 64, 100.0)


def test_what_was_kept_of_a_job_is_forgotten(made: Made) -> None:
    desk = made(Plan("asked"))
    desk._finished = "a run"
    desk.forget(WATCH)
    assert desk.report(WATCH) is None
    with pytest.raises(PdcdError, match="no plan to work on"):
        desk.see(WATCH, SHOTS)


def test_a_job_without_a_folder_or_a_camera_has_no_pictures(made: Made) -> None:
    desk = made(Plan("asked"))
    desk._job.darkroom = desk._job.folder = None
    with pytest.raises(PdcdError, match="no run folder yet"):
        desk.see(WATCH, SHOTS)
    with pytest.raises(PdcdError, match="no run folder yet"):
        desk.look(WATCH, "raw/a.dng", "0")
    desk._job.camera = None
    with pytest.raises(PdcdError, match="need to know the camera"):
        desk.begin(WATCH, Path("/run"))


def test_the_page_of_a_run_is_made_once(made: Made, monkeypatch: pytest.MonkeyPatch) -> None:
    desk = made(Plan("asked"))
    monkeypatch.setattr(module, "gathered", lambda *run: run)
    monkeypatch.setattr(module, "read_manifest", lambda folder: f"manifest of {folder}")
    monkeypatch.setattr(
        module, "written",
        lambda folder, manifest, material: SimpleNamespace(name=f"{manifest} {material[1:]}"),
    )  # fmt: skip
    desk._finished = ("/run", "record", "decoded", None)
    assert desk.report(WATCH) == "manifest of /run ('record', 'decoded', None)"
    assert desk.report(WATCH) is None
