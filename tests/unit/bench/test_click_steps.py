"""One click of the shutter: the order of its steps, and that it is closed however it ends."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pdcd.bench import click
from pdcd.bench.click import examine_shutter
from pdcd.bench.devices import CameraInfo, Finding
from pdcd.bench.tables import CameraConfig, Config, RigConfig, TriggerConfig
from pdcd.errors import ConfigError, DeviceLost


class Bench:
    """A shutter and a camera that note what is done with them; `fails` names steps that do."""

    def __init__(self, *fails: str, apertures: tuple[float, ...] = (2.8, 8.0)) -> None:
        self.done: list[str] = []
        self.fails = fails
        self.apertures = apertures
        self.clock: Any = None
        self.open_s: list[float] = []

    def note(self, step: str) -> None:
        self.done.append(step)
        if step in self.fails:
            raise DeviceLost(f"{step} failed")

    def load(self, role: str, name: str) -> Any:
        def create(context: Any) -> Any:
            self.clock = context.clock
            return Shutter(self) if role == "shutter" else Readout(self)

        return SimpleNamespace(create=create, maturity="beta")


class Shutter:
    def __init__(self, bench: Bench) -> None:
        self.bench = bench

    def look(self) -> Iterator[Finding]:
        yield Finding("line", "good", "there")

    def connect(self) -> dict[str, str]:
        self.bench.note("connect shutter")
        return {"port": "/dev/x"}

    def open(self) -> int:
        self.bench.note("open")
        now = self.bench.clock.now_ns()
        self.bench.clock.sleep_until_ns(now + 20_000_000)
        return int(now + 20_000_000)

    def close(self) -> None:
        self.bench.open_s.append(self.bench.clock.now_ns() * 1e-9)
        self.bench.note("close")

    def disconnect(self) -> None:
        self.bench.note("disconnect shutter")


class Readout:
    def __init__(self, bench: Bench) -> None:
        self.bench = bench

    def connect(self) -> CameraInfo:
        self.bench.note("connect camera")
        return CameraInfo("Canon", "1", "modern", np.ones(3), (200, 100), self.bench.apertures)

    def arm(self, settings: Any) -> None:
        self.bench.note(f"arm {settings.iso} {settings.f_number}")

    def fetch(self, folder: Path, name: str, timeout_s: float) -> Any:
        assert folder.is_dir() and timeout_s == 60.0
        self.bench.note(f"fetch {name}")
        return SimpleNamespace(size_bytes=17)

    def disconnect(self) -> None:
        self.bench.note("disconnect camera")


BOTH = Config(trigger=TriggerConfig(driver="one"), camera=CameraConfig(driver="one"))
ALONE = Config(trigger=TriggerConfig(driver="one"), camera=CameraConfig(driver="other"))


def asked(
    monkeypatch: pytest.MonkeyPatch, bench: Bench, config: Config = BOTH, **how: Any
) -> list[Finding]:
    monkeypatch.setattr(click, "load_driver", bench.load)
    return list(examine_shutter(config, **{"click": True, **how}))


def test_the_camera_is_armed_before_and_its_photo_fetched_after(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = Bench()
    found = asked(monkeypatch, bench, seconds=0.5)
    assert bench.done == [
        "connect shutter", "connect camera", "arm 100 8.0", "open", "close", "fetch click",
        "disconnect shutter", "disconnect camera",
    ]  # fmt: skip
    assert [(one.what, one.state) for one in found] == [
        (what, "good") for what in (
            "driver", "line", "port", "camera", "made ready", "open", "close", "photo",
        )
    ]  # fmt: skip
    told = {one.what: one.found for one in found}
    assert told["driver"] == "one, beta" and told["camera"] == "Canon"
    assert told["open"] == "surely open 20.0 ms after the order"
    assert told["photo"] == "17 bytes, after 0.0 ms"
    assert bench.open_s == [pytest.approx(1.0 + 0.02 + 0.5)]  # the clock starts at 1 s


def test_a_shutter_of_its_own_needs_no_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    found = asked(monkeypatch, bench, ALONE)
    assert bench.done == ["connect shutter", "open", "close", "disconnect shutter"]
    assert [one.what for one in found][-1] == "close"
    assert bench.open_s == [pytest.approx(2.02)]


def test_nothing_moves_unless_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench()
    found = asked(monkeypatch, bench, click=False)
    assert bench.done == []
    assert [(one.what, one.state) for one in found] == [
        ("driver", "good"), ("line", "good"), ("click", "unknown"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    "step", ["connect shutter", "connect camera", "arm 100 8.0", "open", "close", "fetch click"]
)
def test_whatever_fails_both_are_let_go_of(monkeypatch: pytest.MonkeyPatch, step: str) -> None:
    bench = Bench(step)
    *_, last = asked(monkeypatch, bench)
    assert bench.done[-2:] == ["disconnect shutter", "disconnect camera"]
    assert (last.what, last.state) == ("trigger", "fault") and f"{step} failed" in last.found


def test_a_shutter_that_may_be_open_is_told_of_and_the_camera_let_go_of(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = Bench("disconnect shutter", "disconnect camera")
    *_, last = asked(monkeypatch, bench)
    assert bench.done[-2:] == ["disconnect shutter", "disconnect camera"]
    assert last.state == "fault" and "disconnect shutter failed" in last.found
    quiet = Bench("disconnect camera")
    assert asked(monkeypatch, quiet)[-1].what == "photo"


@pytest.mark.parametrize(
    ("camera", "apertures", "armed"),
    [
        (CameraConfig(driver="one"), (2.8, 8.0), "arm 100 8.0"),
        (CameraConfig(driver="one", iso=400, f_number=4.0), (2.8, 8.0), "arm 400 4.0"),
        (CameraConfig(driver="one", f_number=4.0), (), "arm 100 None"),
    ],
)
def test_settings_are_those_of_the_rig_or_gather_least_light(
    monkeypatch: pytest.MonkeyPatch,
    camera: CameraConfig,
    apertures: tuple[float, ...],
    armed: str,
) -> None:
    bench = Bench(apertures=apertures)
    asked(monkeypatch, bench, Config(trigger=TriggerConfig(driver="one"), camera=camera))
    assert armed in bench.done


def test_a_driver_that_cannot_be_had_is_the_only_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    def none(role: str, name: str) -> Any:
        raise ConfigError("no such driver", device="shutter", hint="another")

    monkeypatch.setattr(click, "load_driver", none)
    (only,) = examine_shutter(Config(rig=RigConfig(clock="real")), click=True)
    assert only == Finding("trigger", "fault", "no such driver", "another")
