"""The example of a real rig on a machine without one: what the daemon says, and how it ends."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
import usb.core

from pdcd.bench import config
from pdcd.bench.tables import Config, DisplayConfig
from pdcd.capture.engine import Engine
from pdcd.errors import DeviceLost, PdcdError
from pdcd.server.daemon import run_daemon
from tests.places import ROOT

BENCH_TOML = ROOT / "config" / "bench.toml"
NOWHERE = ":4242"


def bench(folder: Path, **changes: object) -> Config:
    """The example, but for an X server that is there for sure not, and its own state."""
    found = config.load_config(BENCH_TOML)
    display = msgspec.structs.replace(
        found.display, options={**found.display.options, "display": NOWHERE}
    )
    server = msgspec.structs.replace(found.server, state_dir=str(folder / "state"))
    return msgspec.structs.replace(found, **{"display": display, "server": server, **changes})


def test_the_daemon_names_the_first_device_that_is_missing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    code = run_daemon(bench(tmp_path), socket=tmp_path / "s", engine_factory=Engine.from_config)
    assert code == 5
    (said,) = [r.getMessage() for r in caplog.records if "cannot serve" in r.getMessage()]
    assert f"the X server {NOWHERE} does not answer" in said and "pdcd-x" in said
    assert not (tmp_path / "s").exists()


def test_without_the_trigger_and_without_the_camera(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next two, with panels that work."""
    monkeypatch.setattr(usb.core, "find", lambda **_: [])  # whatever is plugged in here
    engine = Engine.from_config(bench(tmp_path, display=DisplayConfig()))
    with pytest.raises(DeviceLost, match="pdcd-trigger"):
        engine.start()
    engine.stop()
    found = bench(tmp_path, display=DisplayConfig(), trigger=Config().trigger)
    engine = Engine.from_config(found)
    with pytest.raises(PdcdError) as caught:
        engine.start()
    engine.stop()
    assert caught.value.device == "camera" and caught.value.hint
