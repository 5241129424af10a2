"""The daemon that a command asks: one that is coming is waited for; another bench is refused."""

from __future__ import annotations

import time
from argparse import Namespace
from pathlib import Path
from typing import Any

import pytest

from pdcd.bench.tables import Config, SceneConfig
from pdcd.cli import daemon as module
from pdcd.cli.main import main
from pdcd.protocol.line_talk import UnreachableError
from tests.unit.cli.cli_stubs import StubClient


class Coming:
    """A socket that nobody listens on yet, on a clock of its own."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, at_s: float, cause: OSError) -> None:
        self.now_s, self.at_s, self.cause = 0.0, at_s, cause
        monkeypatch.setattr(module, "Client", self)
        monkeypatch.setattr(time, "monotonic", lambda: self.now_s)
        monkeypatch.setattr(time, "sleep", self.sleep)

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds

    def __call__(self, path: Path) -> Any:
        if self.now_s < self.at_s:
            raise UnreachableError("nobody") from self.cause
        return path


@pytest.mark.parametrize(
    ("at_s", "cause", "ends_s"),
    [
        (0.0, FileNotFoundError(), 0.0),
        (2.5, FileNotFoundError(), 2.5),
        (2.5, ConnectionRefusedError(), 2.5),
        (9.0, FileNotFoundError(), None),
        (0.1, PermissionError(), None),
    ],
)
def test_a_socket_that_is_coming_is_waited_for(
    monkeypatch: pytest.MonkeyPatch, at_s: float, cause: OSError, ends_s: float | None
) -> None:
    coming = Coming(monkeypatch, at_s, cause)
    if ends_s is not None:
        assert str(module._connect(Path("s"), 3.0)) == "s"
        assert coming.now_s == pytest.approx(ends_s, abs=0.051)
        return
    with pytest.raises(UnreachableError):
        module._connect(Path("s"), 3.0)
    assert coming.now_s == pytest.approx(
        0.0 if isinstance(cause, PermissionError) else 3.0, abs=0.1
    )


FILES = {
    "same.toml": ("[scene]\ngrid = [12, 16]\n[server]\nstate_dir = 'elsewhere'\n", None),
    "grid.toml": ("[scene]\ngrid = [12, 17]\n", "scene.grid"),
    "options.toml": ("[scene]\ngrid = [12, 16]\n[camera.options]\nx = 1\n", "camera.options.x"),
}
"""Configurations, and by which key each differs from that of the daemon."""


@pytest.mark.parametrize(
    "line", ["capture white", "calibrate --yes", "show white --seconds 0", "web --port 0"]
)
@pytest.mark.parametrize("name", FILES)
def test_a_daemon_of_another_configuration_is_not_driven(
    daemon: type[StubClient],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    line: str,
    name: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    text, differs = FILES[name]
    Path(name).write_text(text)
    daemon.config = Config(scene=SceneConfig(grid=(12, 16)))
    if differs is None:
        args = Namespace(socket=Path("s"), config=Path(name))
        assert module.connect_daemon(args, drives=True)
        return
    assert main([*line.split(), "--config", name]) == 2
    (told,) = capsys.readouterr().err.splitlines()
    assert f"does not run --config {name}: {differs} differs" in told
    assert f"pdcd serve --config {name}" in told
    assert not [asked for asked in daemon.asked if isinstance(asked, tuple)]
    assert daemon.asked[-1] == "closed"
    assert main(["status", "--config", name]) == 0  # which only looks
