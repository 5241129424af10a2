"""Every promise of `pdcd.testing` is noticed when it is broken, and none of a good driver is.

The good drivers are those of the stranger's bench; each row breaks one thing of one of them.
"""

from __future__ import annotations

import importlib
import inspect
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from pdcd.bench import registry
from pdcd.bench.devices import CameraSettings, DriverContext
from pdcd.bench.tables import (
    CameraConfig,
    Config,
    DisplayConfig,
    PanelConfig,
    ScheduleConfig,
    TriggerConfig,
)
from pdcd.capture.rig import Rig
from pdcd.errors import ExposureError
from pdcd.panels.frames import Frames
from pdcd.testing import (
    BrokenPromise,
    DisplayContract,
    PreviewContract,
    Promise,
    ReadoutContract,
    ShutterContract,
    display,
    preview,
    readout,
    rigs,
    shutter,
)
from tests import bench_rig
from tests.places import ROOT

PACKAGES = [str(ROOT / "tests" / "data" / name) for name in ("stranger_driver", "stranger_samples")]
sys.path[:0] = PACKAGES
stranger: Any = importlib.import_module("stranger_bench")
more: Any = importlib.import_module("stranger_bench.samples")

for package in PACKAGES:
    sys.path.remove(package)


class Panels(stranger.Panels):  # type: ignore[misc]
    """Black but while they show something."""

    lit = False

    def connect(self) -> Any:
        self.lit = False
        return super().connect()

    def black(self) -> None:
        self.lit = False

    def show(self, frames: Frames) -> None:
        super().show(frames)
        self.lit = True

    def play(self, progress: Any, cancelled: Any) -> Any:
        self.lit = True
        try:
            return super().play(progress, cancelled)
        finally:
            self.lit = False

    def disconnect(self) -> None:
        super().disconnect()
        self.lit = False


class Camera(more.SampleCamera):  # type: ignore[misc]
    """Offers two stops, and looks again at what it has sent."""

    def connect(self) -> Any:
        return replace(super().connect(), f_numbers=(8.0, 16.0), isos=(100,))

    def arm(self, settings: CameraSettings) -> None:
        if settings.iso != 100 or settings.f_number not in (None, 8.0, 16.0):
            raise stranger.ConfigError("not offered", device="camera", hint="100; f/8, f/16")
        self._bench.open_ns = None
        super().arm(settings)

    def fetch(self, folder: Path, name: str, timeout_s: float) -> Any:
        if not self.armed:
            raise ExposureError("not armed", device="camera", hint="call arm first")
        photo = super().fetch(folder, name, timeout_s)
        self.armed.clear()
        return photo

    def recheck(self, photos: Any) -> None:
        """Nobody has touched them."""


Blades = more.TimedBlades
GOOD = {"display": Panels, "shutter": Blades, "readout": Camera, "preview": more.Finder}
Broken = tuple[str, type]
"""A role, and a driver of it."""


def is_open(rig: Rig) -> bool:
    bench = stranger.Bench.of(rig._context)
    return bench.open_ns is not None and bench.closed_ns is None


class LookedAt(DisplayContract, ShutterContract, ReadoutContract):
    """What the probes see of that bench."""

    def find_lit(self, rig: Rig) -> bool:
        return bool(rig.display.lit)  # type: ignore[attr-defined]

    def find_open(self, rig: Rig) -> bool:
        return is_open(rig)


def answering(role: str, **methods: Any) -> Broken:
    """A good driver, some methods of which do something else; `answer(driver, *args)`."""
    return role, type("Broken", (GOOD[role],), methods)


def changed(role: str, method: str, change: Callable[[Any], Any]) -> Broken:
    """A good driver, what one method returns being another thing."""

    def answer(driver: Any, *args: Any) -> Any:
        return change(getattr(GOOD[role], method)(driver, *args))

    return answering(role, **{method: answer})


def differing(role: str, method: str, **fields: Any) -> Broken:
    """A good driver, what one method returns having other fields."""
    return changed(role, method, lambda found: replace(found, **fields))


def stacking(count: int) -> Broken:
    """A good finder whose pictures have so many colours."""
    return changed("preview", "grab", lambda picture: np.stack([picture] * count, -1))


def once(role: str, method: str) -> Broken:
    """A good driver, one method of which fails the second time."""

    def answer(driver: Any, *args: Any) -> Any:
        if getattr(driver, "had", False):
            raise RuntimeError("twice")
        driver.had = True
        return getattr(GOOD[role], method)(driver, *args)

    return answering(role, **{method: answer})


def _only_of_its_thread(driver: Any) -> Any:
    if threading.current_thread() is not threading.main_thread():
        raise RuntimeError("of another thread")
    return 0


def _late(driver: Any) -> int:
    return int(driver._clock.now_ns()) + 10**9


def _plays(driver: Any, progress: Any, cancelled: Any) -> Any:
    return Panels.play(driver, lambda *_: None, cancelled)


def _deaf(driver: Any, progress: Any, cancelled: Any) -> Any:
    return Panels.play(driver, progress, lambda: False)


def _plays_once(driver: Any, progress: Any, cancelled: Any) -> Any:
    log = Panels.play(driver, progress, cancelled)
    driver._frames = None
    return log


def _takes_all(driver: Any, frames: Frames) -> None:
    driver._frames = replace(frames, dark_s=None)


def _takes_times(driver: Any, frames: Frames) -> None:
    Panels.load(driver, replace(frames, dark_s=None))


def _plays_nothing(driver: Any, progress: Any, cancelled: Any) -> Any:
    return None if driver._frames is None else Panels.play(driver, progress, cancelled)


def _stays_lit(driver: Any) -> None:
    """Goes black later, perhaps."""


def _forgets_to_close(driver: Any) -> None:
    """Lets the shutter be."""


def _same_photo(driver: Any, folder: Path, name: str, timeout_s: float) -> Any:
    if not driver.armed:
        raise ExposureError("not armed", device="camera", hint="call arm first")
    if driver._bench.open_ns is not None:
        driver.last = Camera.fetch(driver, folder, name, timeout_s)
        driver.armed.append(CameraSettings(100, None))
    if not hasattr(driver, "last"):
        raise ExposureError("no photo", device="camera", hint="open and close")
    return driver.last


def _unarmed(driver: Any, folder: Path, name: str, timeout_s: float) -> Any:
    driver.armed.append(CameraSettings(100, None))
    return Camera.fetch(driver, folder, name, timeout_s)


def _invents(driver: Any, folder: Path, name: str, timeout_s: float) -> Any:
    bench = driver._bench
    if driver.armed and bench.open_ns is None:
        bench.open_ns, bench.closed_ns = 0, 10**9
    return Camera.fetch(driver, folder, name, timeout_s)


def _keeps_first(driver: Any, settings: CameraSettings) -> None:
    more.SampleCamera.arm(driver, settings)
    driver.first = driver._bench.open_ns, driver._bench.closed_ns


def _first(driver: Any, folder: Path, name: str, timeout_s: float) -> Any:
    if driver.armed and driver.first[0] is not None:
        driver._bench.open_ns, driver._bench.closed_ns = driver.first
    return Camera.fetch(driver, folder, name, timeout_s)


def _any_iso(driver: Any, settings: CameraSettings) -> None:
    Camera.arm(driver, replace(settings, iso=100))


def _any_stop(driver: Any, settings: CameraSettings) -> None:
    Camera.arm(driver, replace(settings, f_number=None))


def _cannot_be_asked(driver: Any, photos: Any) -> None:
    raise ExposureError("changed", device="camera", hint="take it again")


def _cut_short(log: Any) -> Any:
    return replace(log, primal_shown=log.primal_shown[:-1], primal_asked=log.primal_asked[:-1])


def _opens(driver: Any, *_: float) -> None:
    driver.open()


def connected(role: str, method: str) -> Broken:
    """A good driver, one method of which fails before `connect`."""
    kind: Any = GOOD[role]

    def connect(driver: Any) -> Any:
        driver.there = True
        return kind.connect(driver)

    def answer(driver: Any, *args: Any) -> Any:
        if not getattr(driver, "there", False):
            raise AttributeError("no device")
        return getattr(kind, method)(driver, *args)

    return answering(role, connect=connect, **{method: answer})


TABLE: list[tuple[Promise, Broken]] = [
    (rigs.CREATE, answering("shutter", maturity="new")),
    (display.DISPLAY_SAYS, differing("display", "connect", refresh_hz=0.0)),
    (display.DISPLAY_FIT, answering("display", load=_takes_all)),
    (display.DISPLAY_ROW_TIMES, answering("display", load=_takes_times)),
    (display.DISPLAY_LOG, changed("display", "play", _cut_short)),
    (
        display.DISPLAY_LOG,
        changed("display", "play", lambda log: replace(log, dual_ns=np.zeros_like(log.dual_ns))),
    ),
    (
        display.DISPLAY_LOG,
        changed("display", "play", lambda log: replace(log, end_ns=log.end_ns + 10**9)),
    ),
    (display.DISPLAY_AGAIN, answering("display", play=_plays_once)),
    (display.DISPLAY_PROGRESS, answering("display", play=_plays)),
    (display.DISPLAY_CANCEL, answering("display", play=_deaf)),
    (display.DISPLAY_NOT_LOADED, answering("display", play=_plays_nothing)),
    (display.DISPLAY_BLACK_SAFE, connected("display", "black")),
    (display.DISPLAY_BESIDE, answering("display", black=_only_of_its_thread)),
    (display.DISPLAY_DISCONNECT, once("display", "disconnect")),
    (display.DISPLAY_BLACK, answering("display", black=_stays_lit)),
    (display.DISPLAY_SHOWS, answering("display", show=lambda driver, frames: driver.load(frames))),
    (shutter.SHUTTER_SAYS, changed("shutter", "connect", lambda said: [*said])),
    (shutter.SHUTTER_OPEN_TIME, changed("shutter", "open", float)),
    (shutter.SHUTTER_OPEN_TIME, changed("shutter", "open", lambda at_ns: at_ns - 10**9)),
    (shutter.SHUTTER_CLOSE_TIME, answering("shutter", close=_late)),
    (shutter.SHUTTER_CLOSE_SAFE, connected("shutter", "close")),
    (shutter.SHUTTER_BESIDE, answering("shutter", close=_only_of_its_thread)),
    (shutter.SHUTTER_DISCONNECT, once("shutter", "disconnect")),
    (shutter.SHUTTER_CLOSED, answering("shutter", disconnect=_forgets_to_close)),
    (shutter.SHUTTER_OPENS, answering("shutter", open=lambda driver: driver._clock.now_ns())),
    (shutter.SHUTTER_EXPECT, answering("shutter", expect_exposure=_opens)),
    (readout.READOUT_SAYS, differing("readout", "connect", model="")),
    (readout.READOUT_ISO, answering("readout", arm=_any_iso)),
    (readout.READOUT_APERTURE, answering("readout", arm=_any_stop)),
    (readout.READOUT_PHOTO, differing("readout", "fetch", white=1)),
    (readout.READOUT_PHOTO, changed("readout", "fetch", lambda photo: photo.samples)),
    (readout.READOUT_TOLD, differing("readout", "fetch", cfa="RGGB")),
    (readout.READOUT_TOLD, differing("readout", "fetch", iso=200)),
    (readout.READOUT_TOLD, differing("readout", "fetch", exposure_s=0.01)),
    (
        readout.READOUT_TOLD,
        changed("readout", "fetch", lambda photo: replace(photo, samples=photo.samples[:, 4:])),
    ),
    (readout.READOUT_LATEST, answering("readout", arm=_keeps_first, fetch=_first)),
    (readout.READOUT_ONE, answering("readout", fetch=_same_photo)),
    (readout.READOUT_NOT_ARMED, answering("readout", fetch=_unarmed)),
    (readout.READOUT_NO_PHOTO, answering("readout", fetch=_invents)),
    (readout.READOUT_DISCONNECT, once("readout", "disconnect")),
    (readout.READOUT_RECHECK, answering("readout", recheck=_cannot_be_asked)),
    (preview.FINDER_SAYS, changed("preview", "connect", lambda _: None)),
    (preview.FINDER_PICTURES, changed("preview", "grab", lambda picture: picture / 255.0)),
    (preview.FINDER_PICTURES, stacking(4)),
    (preview.FINDER_DISCONNECT, once("preview", "disconnect")),
]
CONTRACTS = {
    "display": DisplayContract,
    "shutter": ShutterContract,
    "readout": ReadoutContract,
    "preview": PreviewContract,
}


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Config:
    """A bench of the drivers that `GOOD` names at this time."""
    here = ModuleType("drivers_under_test")
    monkeypatch.setitem(sys.modules, here.__name__, here)
    known = {(role, "tested"): f"{here.__name__}:{role}" for role in GOOD}
    monkeypatch.setattr(registry, "DRIVERS", {**registry.DRIVERS, **known})
    for role, kind in GOOD.items():
        setattr(here, role, kind)
    return bench_rig.config(
        tmp_path,
        projector=PanelConfig(size_px=(32, 24)),
        mask=PanelConfig(size_px=(32, 24)),
        display=DisplayConfig(driver="tested"),
        trigger=TriggerConfig(driver="tested"),
        camera=CameraConfig(driver="tested", f_number=16.0),
        schedule=ScheduleConfig(grid=(6, 8)),
    )


def find_broken(config: Config, role: str, kind: type, folder: Path) -> Iterator[Promise]:
    """Promises that a driver of a role breaks, as the tests of its contract find them."""
    setattr(sys.modules["drivers_under_test"], role, kind)
    contract = CONTRACTS[role]
    tests = LookedAt() if role != "preview" else PreviewContract()
    for number, name in enumerate(name for name in dir(contract) if name.startswith("test_")):
        rig = Rig(config)
        place = folder / f"{role}-{number}"
        place.mkdir()
        given: dict[str, Any] = {"rig": rig, "tmp_path": place}
        tests.roles = getattr(contract, "roles", ())  # type: ignore[misc, union-attr]
        for part in reversed(tests.roles):  # type: ignore[union-attr]
            getattr(rig, part).connect()
        test = getattr(contract, name)
        wanted = inspect.signature(test).parameters
        if "info" in wanted:
            given["info"] = rig.readout.connect()
        if "preview" in wanted:
            context = DriverContext(config, rig.clock)
            given["preview"] = registry.load_driver("preview", "tested").create(context)
        try:
            test(tests, **{key: value for key, value in given.items() if key in wanted})
        except BrokenPromise as err:
            of_role = [*vars(MODULES[role]).values(), rigs.CREATE]
            known = [one for one in of_role if isinstance(one, Promise)]
            yield next(one for one in known if str(err).startswith(one.says))
        except pytest.skip.Exception:
            pytest.fail(f"{name} was skipped")


MODULES = {"display": display, "shutter": shutter, "readout": readout, "preview": preview}


@pytest.mark.parametrize(("role", "kind"), [*GOOD.items(), stacking(3)])
def test_a_good_driver_breaks_no_promise(
    role: str, kind: type, config: Config, tmp_path: Path
) -> None:
    assert not list(find_broken(config, role, kind, tmp_path))


@pytest.mark.parametrize(
    ("promise", "broken"), TABLE, ids=[f"{role}: {promise.says}" for promise, (role, _) in TABLE]
)
def test_a_broken_promise_is_named(
    promise: Promise, broken: Broken, config: Config, tmp_path: Path
) -> None:
    assert promise in find_broken(config, *broken, tmp_path)


def test_every_promise_is_in_the_table() -> None:
    modules = *MODULES.values(), rigs
    known = [one for module in modules for one in vars(module).values()]
    promises = {id(one) for one in known if isinstance(one, Promise)}
    assert promises == {id(promise) for promise, _ in TABLE}
