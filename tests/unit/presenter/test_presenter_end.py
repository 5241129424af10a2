"""The end of the display process: black before all else, and nothing left open."""

from __future__ import annotations

import pytest

from pdcd.errors import ConfigError
from pdcd.presenter.process import Presenter


class Part:
    """Something that is opened by the process; notes what becomes of it."""

    def __init__(self, name: str, happened: list[str]) -> None:
        self._name, self._happened = name, happened

    def black(self) -> None:
        self._happened.append("black")

    def close(self) -> None:
        self._happened.append(self._name)


@pytest.mark.parametrize("counted", [True, False])
def test_everything_is_closed_whether_or_not_the_kernel_counts_vblanks(
    monkeypatch: pytest.MonkeyPatch, counted: bool
) -> None:
    happened: list[str] = []
    parts = {name: Part(name, happened) for name in ("windows", "events", "projector's", "mask's")}
    presenter = Presenter.__new__(Presenter)
    counters = (parts["projector's"], parts["mask's"]) if counted else ConfigError("no card")
    for name, part in (
        ("_windows", parts["windows"]), ("_events", parts["events"]), ("_counters", counters),
    ):  # fmt: skip
        setattr(presenter, name, part)
    monkeypatch.setattr("glfw.terminate", lambda: happened.append("library"))
    presenter.close()
    assert happened[0] == "black" and happened[-2:] == ["windows", "library"]
    assert sorted(happened[1:-2]) == sorted(["events", *["projector's", "mask's"] * counted])
