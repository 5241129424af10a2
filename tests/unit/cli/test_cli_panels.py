"""`pdcd show` where no daemon answers: what this process does with the panels, and until when."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from pdcd.bench.clock import VirtualClock
from pdcd.bench.tables import Config
from pdcd.cli.main import main
from pdcd.errors import Cancelled, DeviceLost
from pdcd.panels.frames import Frames
from tests.unit.cli.cli_stubs import home_at

SIZE = "size_px = [128, 96]\n"
PASS_S = 4.0
"""How long the panels take to play what they have loaded."""
LAST_S = 100.0
"""When Ctrl-C is pressed."""


class Panels(VirtualClock):
    """Stands in for a rig: notes what its panels are told, on a clock of its own."""

    grid = (3, 4)
    calls: list[str]
    config: Config
    one: Panels

    def __init__(self, config: Config) -> None:
        super().__init__()
        self.began_ns = self.now_ns()
        type(self).config, type(self).one = config, self
        self.display = self.clock = self

    def connect(self) -> None:
        self.calls.append("connect")

    def show(self, frames: Frames) -> None:
        self.calls.append(f"show {len(frames)}")

    def load(self, frames: Frames) -> None:
        self.calls.append("load" if len(frames) > 1 else "load one")

    def play(self, progress: Callable[..., None], cancelled: Callable[[], bool]) -> None:
        self.calls.append("play")
        end_ns = self.now_ns() + round(PASS_S * 1e9)
        while self.now_ns() < end_ns:
            if cancelled():
                raise Cancelled("ended")
            self.sleep_until_ns(self.now_ns() + 50_000_000)

    def disconnect(self) -> None:
        self.calls.append("disconnect")

    def sleep_until_ns(self, deadline_ns: int) -> None:
        assert 0 < deadline_ns - self.now_ns() <= 100_000_000, "Ctrl-C would come late"
        super().sleep_until_ns(deadline_ns)
        if self.lit_s > LAST_S:
            raise KeyboardInterrupt

    @property
    def lit_s(self) -> float:
        """Since it was made."""
        return (self.now_ns() - self.began_ns) * 1e-9


@pytest.fixture
def panels(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> type[Panels]:
    """Small panels of a configuration that names others than the mock's."""
    home_at(monkeypatch, tmp_path)
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / ".config" / "pdcd"
    folder.mkdir(parents=True)
    text = f"[display]\ndriver = 'x11'\n[projector]\n{SIZE}[mask]\n{SIZE}"
    (folder / "pdcd.toml").write_text(text)

    class Fresh(Panels):
        calls: list[str] = []  # noqa: RUF012

    now = SimpleNamespace(monotonic=lambda: Fresh.one.now_ns() * 1e-9)
    monkeypatch.setattr("pdcd.capture.rig.Rig", Fresh)
    monkeypatch.setattr("pdcd.cli.panels.time", now)
    return Fresh


@pytest.mark.parametrize("words", [["grid"], ["code", "--index", "3"]])
@pytest.mark.parametrize("seconds", [0.0, 0.5, 9.0])
def test_a_picture_stays_for_the_time_asked(
    panels: type[Panels], capsys: pytest.CaptureFixture[str], words: list[str], seconds: float
) -> None:
    assert main(["show", *words, "--seconds", str(seconds)]) == 0
    assert panels.calls == ["connect", "show 1", "disconnect"]
    assert panels.one.lit_s == pytest.approx(seconds, abs=0.06)
    assert capsys.readouterr().err == f"for {seconds:g} s\n"
    assert panels.config.rig.on_miss == "flag"  # a lost refresh ends nothing


@pytest.mark.parametrize("words", [["--loop"], ["flash"]])
@pytest.mark.parametrize("seconds", [0.0, 0.5, 9.0])
def test_what_moves_is_played_over_and_over_for_the_time_asked(
    panels: type[Panels], words: list[str], seconds: float
) -> None:
    assert main(["show", *words, "--seconds", str(seconds)]) == 0
    passes = int(np.ceil(seconds / PASS_S))
    assert panels.calls == ["connect", "load", *["play"] * passes, "disconnect"]
    assert panels.one.lit_s == pytest.approx(seconds, abs=0.06)


@pytest.mark.parametrize("words", [["grid"], ["--loop"]])
def test_without_a_time_it_stays_until_ctrl_c(
    panels: type[Panels], capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    assert main(["show", *words]) == 130
    assert panels.one.lit_s == pytest.approx(LAST_S, abs=0.2)
    assert panels.calls[-1] == "disconnect"
    assert capsys.readouterr().err.startswith("Ctrl-C ends\n")


def test_black_makes_the_panels_black_and_ends_at_once(panels: type[Panels]) -> None:
    assert main(["show", "black"]) == 0
    assert panels.calls == ["connect", "disconnect"]


@pytest.mark.parametrize("words", [["grid"], ["--loop"]])
def test_panels_that_fail_are_let_go(panels: type[Panels], words: list[str]) -> None:
    def fail(self: Panels, *_: object) -> None:
        raise DeviceLost("a cable", device="display")

    panels.show = panels.play = fail  # type: ignore[assignment, method-assign]
    assert main(["show", *words, "--seconds", "9"]) == 5
    assert panels.calls[0] == "connect" and panels.calls[-1] == "disconnect"


def test_panels_that_end_a_picture_before_its_time_end_the_command(panels: type[Panels]) -> None:
    def end(self: Panels, *_: object) -> None:
        self.calls.append("play")
        raise Cancelled("a key was pressed")

    panels.play = end  # type: ignore[assignment, method-assign]
    assert main(["show", "--loop", "--seconds", "9"]) == 0
    assert panels.calls == ["connect", "load", "play", "disconnect"]


def test_the_mocks_panels_are_drawn_and_not_waited_for(
    panels: type[Panels], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mock, picture = tmp_path / "mock.toml", tmp_path / "a.png"
    mock.write_text(f"[projector]\n{SIZE}[mask]\n{SIZE}")
    words = ["--config", str(mock), "--out", str(picture)]
    assert main(["show", "grid", *words]) == 0
    said = capsys.readouterr()
    assert (said.out, panels.calls) == (f"{picture}\n", [])
    assert "would be on a projector of 128 x 96 px and a mask of 128 x 96 px" in said.err
    drawn = cv2.imread(str(picture))
    assert drawn is not None and drawn.shape[1] > 2 * 128
    picture.unlink()
    assert main(["show", "black", *words]) == 0
    assert "nothing to see" in capsys.readouterr().err and not picture.exists()
    assert main(["show", "star", *words[:2]]) == 0
    assert capsys.readouterr().out == "show-star.png\n"
    assert main(["show", "code", "--index", "999", *words]) == 2
    assert "0 to 127" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "told"),
    [(["grid"], {"pattern": "grid", "index": 0}),
     (["code", "--index", "2"], {"pattern": "code", "index": 2}),
     (["--loop"], {"pattern": "loop", "index": 0})],
)  # fmt: skip
def test_scripts_are_told_what_is_shown(
    panels: type[Panels],
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    told: dict[str, object],
) -> None:
    assert main(["show", *words, "--seconds", "0", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == told
