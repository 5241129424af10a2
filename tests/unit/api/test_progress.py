"""Progress in a notebook: one line that changes, escaped, and is gone in the end."""

from __future__ import annotations

import sys
import types

import pytest

from pdcd.api.progress import bar, notebook, shown
from pdcd.runs.events import Attention, Progress


class Handle:
    def __init__(self) -> None:
        self.drawn: list[str] = []

    def update(self, what: object) -> None:
        self.drawn.append(what._repr_html_())  # type: ignore[attr-defined]


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> Handle:
    """A cell of a notebook."""
    handle = Handle()

    def display(what: object, *, display_id: bool) -> Handle:
        handle.update(what)
        return handle

    ipython, page = types.ModuleType("IPython"), types.ModuleType("IPython.display")
    vars(ipython).update(get_ipython=lambda: types.SimpleNamespace(kernel=1), display=page)
    vars(page).update(display=display)
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", page)
    return handle


def test_a_line_that_changes_and_is_gone(cell: Handle, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 100.0
    monkeypatch.setattr("pdcd.api.progress.time.monotonic", lambda: now_s)
    with bar() as on_event:
        for now_s in (100.0, 100.1, 100.2, 104.0):  # the second comes too soon
            on_event(Progress(shot="coded", frame=round(now_s * 10) - 1000, frames=160, missed=0))
        now_s = 105.0
        on_event(Attention(text="<b>cover</b> the lens"))
    assert cell.drawn == [
        '<progress max="1"></progress> ',
        '<progress max="1" value="0.000"></progress> coded: 0/160 refreshes',
        '<progress max="1" value="0.013"></progress> coded: 2/160 refreshes, 16 s left',
        '<progress max="1" value="0.250"></progress> coded: 40/160 refreshes, 12 s left',
        '<progress max="1"></progress> &lt;b&gt;cover&lt;/b&gt; the lens',
        "",
    ]


def test_after_an_error_it_stays(cell: Handle) -> None:
    with pytest.raises(ValueError, match="of the job"), shown(True) as on_event:
        assert on_event is not None
        on_event(Progress(shot="coded", frame=2, frames=160, missed=0))
        raise ValueError("of the job")
    assert "2/160" in cell.drawn[-1]


def test_who_does_not_want_it_sees_none(cell: Handle, monkeypatch: pytest.MonkeyPatch) -> None:
    with shown(False) as on_event:
        assert on_event is None
    with shown(print) as on_event:
        assert on_event is print
    assert not cell.drawn and notebook()
    monkeypatch.setattr(sys.modules["IPython"], "get_ipython", lambda: None)
    assert not notebook()
