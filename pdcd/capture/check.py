"""What `pdcd config check` tries of a configuration; no device is touched.

It tries the three drivers, by name and by their options; the scene; the sensor profile and its ISO;
both refresh rates; a plan of a default capture; and whether the camera's frame, where it is known,
shows the cells. Whether the devices are there is checked by the doctors.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial

import msgspec

from pdcd.bench.checks import find_rate_fault
from pdcd.bench.clock import RealClock, VirtualClock
from pdcd.bench.devices import DriverContext
from pdcd.bench.placed import compute_mock_frame, find_dark_places
from pdcd.bench.registry import DriverRole, load_driver
from pdcd.bench.tables import CameraConfig, Config, SceneConfig
from pdcd.capture.bench_check import check_frame
from pdcd.errors import PdcdError
from pdcd.planning.make import plan_with_prior
from pdcd.protocol.request import CaptureRequest
from pdcd.sensor.profile import load_profile
from pdcd.virtual.scene.build import build_scene

_TABLES: dict[DriverRole, str] = {"display": "display", "shutter": "trigger", "readout": "camera"}
"""Table of the file that names the driver of each role."""


def try_config(config: Config, known: Collection[str] = ()) -> list[str]:
    """Every fault that trying reveals, each on a line that begins with what it is about.

    `known` are dotted keys that are known to be wrong and have been set to their defaults: what
    depends on one of them is not tried.
    """
    return _Check(config, known).all()


class _Check:
    def __init__(self, config: Config, known: Collection[str]) -> None:
        self._known = [key for key in known if _stands_at_default(config, key)]
        self._config = _with_defaults(config, self._known)
        self._lines: list[str] = []
        self._grid: tuple[int, int] | None = None
        self._profile_read = False

    def all(self) -> list[str]:
        """Try everything once."""
        config = self._config
        self._try("scene.kind", self._scene, "scene")
        self._try("camera.profile", self._profile, "camera.profile")
        context = self._context()
        for role, table in _TABLES.items():
            create = partial(_create, role, getattr(config, table).driver, context)
            self._try(f"{table}.driver", create, f"{table}.driver", f"{table}.options")
        rates = ("projector.refresh_hz", "mask.refresh_hz")
        if self._sound(rates) and (fault := find_rate_fault(config)) is not None:
            more = "; the mock bench runs all the same, and shows what comes of it"
            self._say(fault.message + more * (config.display.driver == "mock"))
        self._coverage()
        self._try("schedule", self._plan, "schedule", "rig", "limits")
        return self._lines

    def _try(self, key: str, action: Callable[[], object], *rests_on: str) -> None:
        """Run something that may fail; its fault begins with the key unless it names one itself."""
        if not self._sound(rests_on):
            return
        try:
            action()
        except PdcdError as err:
            lines = [line.strip() for line in err.message.splitlines()]
            if err.hint:
                lines[-1] += f" ({err.hint})"
            for line in lines:
                self._say(line if line.startswith("[") else f"{key}: {line}")
        # The driver of another package may fail in any way: a fault of the file that names it.
        except Exception as err:
            self._say(f"{key}: {type(err).__name__}: {err}")

    def _sound(self, rests_on: Collection[str]) -> bool:
        """Whether nothing is known to be wrong with these keys, or below these tables."""
        return not any(
            key == rest or key.startswith((f"{rest}.", f"{rest}["))
            for key in self._known
            for rest in rests_on
        )

    def _say(self, line: str) -> None:
        if line not in self._lines:
            self._lines.append(line)

    def _scene(self) -> None:
        self._grid = build_scene(self._config.scene).grid

    def _context(self) -> DriverContext:
        """The context in which drivers are created. A wrong scene or profile is replaced by the
        default, so that drivers do not report it again."""
        config = self._config
        if self._grid is None:
            config = msgspec.structs.replace(config, scene=SceneConfig())
        if not self._profile_read:
            camera = msgspec.structs.replace(config.camera, profile=CameraConfig().profile)
            config = msgspec.structs.replace(config, camera=camera)
        if not self._sound(("rig.clock",)):
            rig = msgspec.structs.replace(config.rig, clock="real")
            config = msgspec.structs.replace(config, rig=rig)
        virtual = config.rig.clock == "virtual"
        return DriverContext(config=config, clock=VirtualClock() if virtual else RealClock())

    def _profile(self) -> None:
        camera = self._config.camera
        profile = load_profile(camera.profile)
        self._profile_read = True
        if camera.iso is not None:
            self._try("camera.iso", partial(profile.row, camera.iso), "camera.iso")

    def _coverage(self) -> None:
        """Report panels that do not cover all of the field. Codes are shown all the same where no
        cell is lost."""
        grid = self._code_grid()
        if grid is None or not self._sound(("scene.grid",)):
            return
        for role, what in find_dark_places(self._config, grid):
            if self._sound((f"{role}.place", f"{role}.size_px")):
                self._say(f"{role}.place: {what}: place it so that it covers the field")

    def _code_grid(self) -> tuple[int, int] | None:
        """Rows and columns of code cells; None where they are in a file that cannot be read."""
        if self._grid is None and self._config.scene.kind == "matrix":
            return None
        return self._config.code_grid(self._grid)

    def _plan(self) -> None:
        grid = self._code_grid()
        if grid is None:
            return
        plan = plan_with_prior(CaptureRequest(goal="indirect"), self._config, grid)
        frame = self._frame(grid)
        if frame is not None:
            check = partial(check_frame, self._config, frame, grid, cut=plan.cut)
            self._try("camera.place", check, "camera")

    def _frame(self, grid: tuple[int, int]) -> tuple[int, int] | None:
        """Rows and columns of quads of the camera's photos, where they are known."""
        camera = self._config.camera
        if camera.driver == "mock":
            return compute_mock_frame(self._config, grid)
        told = load_profile(camera.profile).frame_quads if self._profile_read else None
        return None if told is None else (told[1], told[0])


def _stands_at_default(config: Config, key: str) -> bool:
    """Whether a faulty key is one of the tables; one that is merely unknown changes nothing."""
    found: object = config
    for name in key.split("[")[0].split("."):
        if isinstance(found, dict):
            return True
        if not hasattr(found, name):
            return False
        found = getattr(found, name)
    return True


def _with_defaults(config: Config, keys: Collection[str]) -> Config:
    """The configuration with defaults for the faulty keys: a value that was reported should reach
    neither a driver nor a plan."""
    for key in keys:
        table, _, name = key.split("[")[0].partition(".")
        name = name.partition(".")[0]
        if name:
            mended = {name: getattr(getattr(Config(), table), name)}
            replaced = msgspec.structs.replace(getattr(config, table), **mended)
            config = msgspec.structs.replace(config, **{table: replaced})
    return config


def _create(role: DriverRole, name: str, context: DriverContext) -> None:
    """What the rig does at its start, up to the point where devices are opened."""
    load_driver(role, name).create(context)
