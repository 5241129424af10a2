"""What comes next in a run, by its plan and the shots that it has."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from pdcd.bench.tables import Config
from pdcd.planning.make import plan_with_prior
from pdcd.planning.next_step import choose_next_step, is_last_of_part
from pdcd.protocol.request import CaptureRequest


def shot(name: str, part: int = 0, beside: str = "") -> Any:
    return SimpleNamespace(name=name, part=part, beside=beside)


def plan(*shots: Any, look: object = None) -> Any:
    return SimpleNamespace(
        recipe=SimpleNamespace(shots=shots), look=look, how=SimpleNamespace(pilot=0, late=False)
    )


def test_the_next_shot_is_the_first_that_was_not_taken_and_that_does_not_come_along() -> None:
    one = plan(shot("a"), shot("a2", beside="a"), shot("b"), shot("c"))
    taken: list[str] = []
    while (found := choose_next_step(one, taken, looked=True, fresh=True)) is not None:
        taken.append(found.name)  # type: ignore[union-attr]
    assert taken == ["a", "b", "c"]
    assert choose_next_step(one, ["b"], looked=True, fresh=True).name == "a"  # type: ignore[union-attr]


def test_a_part_is_complete_with_its_last_shot() -> None:
    shots = [shot("white"), shot("a", 1), shot("b", 1), shot("c", 2), shot("d", 2)]
    shots.append(shot("d2", 2, beside="d"))
    complete = [one.name for one in shots if is_last_of_part(plan(*shots), one)]
    assert complete == ["b", "d"]


def test_a_dark_photo_follows_the_first_part_and_is_taken_once() -> None:
    one = plan(shot("white"), shot("a", 1), shot("b", 2), look="a look")
    assert choose_next_step(one, ["a"], looked=False, fresh=True).name == "white"  # type: ignore[union-attr]
    assert choose_next_step(one, ["white", "a"], looked=False, fresh=True) == "dark"
    after = choose_next_step(one, ["white", "a"], looked=True, fresh=False)
    assert after.name == "b"  # type: ignore[union-attr]


def test_a_pilot_is_looked_at_after_its_scouts_and_at_its_end_once_each() -> None:
    request = CaptureRequest(goal="indirect", codes=48, pilot=16, window="whole", white=False)
    piloted = plan_with_prior(request, Config(), (3, 4))
    names = [one.name for one in piloted.recipe.shots]
    steps = {n: choose_next_step(piloted, names[:n], looked=False, fresh=True) for n in range(17)}
    assert [n for n, step in steps.items() if step == "scouts"] == [4]
    assert steps[16] == "pilot"
    after = choose_next_step(piloted, names[:4], looked=False, fresh=False)
    assert after.name == "pilot-0005"  # type: ignore[union-attr]
    # A look at ambient light comes after all that a pilot may change.
    assert choose_next_step(piloted, names[:4], looked=True, fresh=True) is piloted.recipe.shots[4]


def test_a_pilot_that_goes_on_late_is_looked_at_as_a_whole() -> None:
    request = CaptureRequest(goal="indirect", codes=48, pilot=16, window="whole", white=False)
    piloted: Any = plan_with_prior(request, Config(), (3, 4))
    names = [one.name for one in piloted.recipe.shots]
    how = SimpleNamespace(pilot=16, coded=32, late=True)
    late: Any = SimpleNamespace(recipe=piloted.recipe, look=None, how=how)
    assert choose_next_step(late, names[:4], looked=True, fresh=True) is piloted.recipe.shots[4]
    assert choose_next_step(late, names[:16], looked=True, fresh=True) == "pilot"
