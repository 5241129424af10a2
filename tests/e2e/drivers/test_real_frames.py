"""Photos of real cameras' sizes, shapes and files, of a known scene, by every readout driver.

The film is placed on the field by a map, and the configuration says the same. The same codes are
photographed by the mock camera, a quad a cell; every quad that lies within one cell must then show
what the mock's quad of that cell does.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest

pytest.importorskip("gphoto2", reason="gphoto2 IS MISSING: see .venv/gphoto2.log")

from numpy.typing import NDArray

from drivers.ptp.eos import EosCamera
from drivers.virtual_camera import BULB_BODY, CameraBody, CameraExposure, VirtualUsb
from pdcd.bench.clock import VirtualClock
from pdcd.bench.tables import CameraConfig, Config, PanelConfig, RigConfig, TriggerConfig
from pdcd.capture.engine import Engine
from pdcd.panels.map import Map
from pdcd.panels.placing import Placing, make_placed_map
from pdcd.protocol.events import Event, ShutterClosed
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.folder import read_manifest
from pdcd.runs.verify import verify_run
from tests import bench_rig
from tests.fake_gphoto import FakeCamera, Setting
from tests.placed_film import SIDE, Encode, PlacedFilm, cr2, dng, masked_dng

Floats = NDArray[np.float64]

GRID = (6, 8)
PROJECTOR = (64, 48)
SLOW = PanelConfig(size_px=(80, 60), rise_s=0.003, fall_s=0.005)
"""A mask whose quarter windows are not open equally long."""
REQUEST = {"goal": "indirect", "codes": 16, "window": "whole", "smooth": False}


@dataclass(frozen=True)
class Case:
    """A camera as it stands: frame in quads (width, height), place, files and driver."""

    driver: str
    size: tuple[int, int]
    place: Placing
    encode: Encode
    orientation: int = 1
    profile: str = "modern"
    side: int = SIDE
    windows: bool = False

    @property
    def map(self) -> Map:
        return make_placed_map(self.place, self.size, PROJECTOR, "camera")


LANDSCAPE = Placing(offset_px=(1.3, -0.7), scale=1.1, turn_deg=2.0)
PORTRAIT = Placing(turn_deg=90.0, scale=1.6)
MIRROR = Placing(flip="horizontal", turn_deg=-5.0, scale=1.2, radial=(0.02, 0.0))

CASES = [
    Case("ptp", (107, 71), LANDSCAPE, masked_dng),
    Case("ptp", (107, 71), PORTRAIT, masked_dng, orientation=6),
    Case("folder", (61, 97), MIRROR, dng),
    Case("gphoto2", (107, 71), MIRROR, masked_dng, orientation=3),
]


def config(folder: Path, case: Case | None) -> Config:
    """The rig of a case; None is the mock camera, a quad a cell."""
    tables: dict[str, Any] = {"projector": PanelConfig(size_px=PROJECTOR)}
    given: dict[str, Any] = {"noise": "none", "f_number": 8.0}
    if case is not None:
        tether = {"folder": str(folder / "tether"), "poll_s": 0.01, "looks": 2}
        options = {"ptp": {"usb": "virtual"}, "folder": tether}.get(case.driver, {})
        given |= {"driver": case.driver, "place": case.place, "options": options}
        given["profile"] = case.profile
        if case.windows:
            given["frame_quads"] = case.size
            tables["mask"] = SLOW
        if case.driver not in ("folder", "mock"):
            tables["trigger"] = TriggerConfig(driver=case.driver)
        if case.driver == "gphoto2":
            tables["rig"] = RigConfig(clock="real")
    return bench_rig.config(folder, grid=GRID, camera=CameraConfig(**given), **tables)


class Gphoto(FakeCamera):
    """A camera of libgphoto2 with a film in it; waits take the time of a virtual clock."""

    clock: VirtualClock
    film: PlacedFilm
    open_ns = 0

    def set_single_config(self, name: str, widget: Setting) -> None:
        super().set_single_config(name, widget)
        if name != "bulb":
            return
        if widget.value:
            self.open_ns = self.film.open(self.clock.now_ns())
        elif self.open_ns:
            exposure = CameraExposure(self.open_ns, self.film.close(self.clock.now_ns()), 100, 8.0)
            self.open_ns = 0
            self.add(f"capt{self.film.count:04d}.dng", self.film.make_raw(exposure))

    def wait_for_event(self, timeout_ms: int) -> tuple[int, Any]:
        if not self.events:
            self.clock.sleep_until_ns(self.clock.now_ns() + timeout_ms * 1_000_000)
        return super().wait_for_event(timeout_ms)


SETTINGS = {
    "cameramodel": Setting("a camera"),
    "iso": Setting("100", ("100", "200")),
    "aperture": Setting("8", ("5.6", "8", "11")),
    "bulb": Setting(0),
}


def take(
    folder: Path, case: Case | None, patch: pytest.MonkeyPatch, **fields: Any
) -> CaptureResult:
    """Photograph with the camera of a case, in its folder."""
    tether = folder / "tether"
    tether.mkdir(parents=True)
    clock = VirtualClock()
    patch.setattr("pdcd.capture.rig.RealClock", lambda: clock)  # libgphoto2's only
    engine = Engine.from_config(config(folder, case))
    context = engine._rig._context
    emit: Callable[[Event], None] = lambda _: None  # noqa: E731
    if case is not None and case.driver != "mock":
        film = PlacedFilm(
            context,
            case.map,
            case.encode,
            case.orientation,
            side=case.side,
            windows=case.windows,
        )
        if case.driver == "ptp":
            body = CameraBody(context.clock, film, replace(BULB_BODY, apertures=()))
            EosCamera.of(context).session._backend = VirtualUsb(body)
        elif case.driver == "gphoto2":
            camera = Gphoto(dict(SETTINGS))
            camera.clock, camera.film = clock, film
            patch.setattr("gphoto2.Camera", lambda: camera)
        else:
            emit = _tethered(film, tether)
    engine.start()
    request = msgspec.convert({**REQUEST, **fields}, CaptureRequest)
    result = engine.capture(request, job="job", emit=emit, cancelled=lambda: False)
    engine.stop()
    assert result.error is None and result.folder is not None, result.error
    assert verify_run(Path(result.folder)).whole
    return result


def _tethered(film: PlacedFilm, tether: Path) -> Callable[[Event], None]:
    """The second program: it saves a file when the shutter has closed."""

    def emit(event: Event) -> None:
        if isinstance(event, ShutterClosed):
            exposure = CameraExposure(0, 1, 100, 8.0)  # the bench knows its own times
            (tether / f"IMG_{film.count:04d}.dng").write_bytes(film.make_raw(exposure))

    return emit


def picture(result: CaptureResult, name: str) -> Floats:
    """(h, w, 3), R, G, B."""
    path = Path(str(result.folder)) / "linear" / f"{name}.tif"
    read = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert read is not None
    return np.asarray(read[..., ::-1], dtype=np.float64)


def cell_of(map_: Map) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """(h, w): whether a quad lies within one cell, and in which."""
    width, height = map_.size_px
    x, y = np.meshgrid(np.arange(width + 1.0), np.arange(height + 1.0))
    u, v = np.moveaxis(map_.to_field(np.stack([x, y], axis=-1)), -1, 0)
    rows, cols = GRID
    inside = (u > 0.0) & (u < 1.0) & (v > 0.0) & (v < 1.0)
    number = np.floor(v * rows) * cols + np.floor(u * cols)
    corners = [number[a : a + height, b : b + width] for a in (0, 1) for b in (0, 1)]
    within = np.logical_and.reduce(
        [inside[a : a + height, b : b + width] for a in (0, 1) for b in (0, 1)]
    )
    same = within & np.logical_and.reduce([corner == corners[0] for corner in corners])
    return same, np.where(same, corners[0], 0.0).astype(np.int64)


@pytest.fixture(scope="module")
def wanted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Floats]:
    """What the mock camera sees in each cell, (N, 3), by the name of the picture."""
    with pytest.MonkeyPatch.context() as patch:
        result = take(tmp_path_factory.mktemp("mock"), None, patch)
    return {name: picture(result, name).reshape(-1, 3) for name in ("white", "direct", "indirect")}


FULL_CR2, FULL_DNG = (2145, 1428), (2136, 1424)
LARGE = [
    Case("ptp", FULL_CR2, PORTRAIT, cr2, orientation=6, profile="450d", side=1),
    Case("folder", FULL_DNG, LANDSCAPE, masked_dng, profile="450d", side=1),
    Case("gphoto2", FULL_DNG, MIRROR, dng, side=1),
]
slow = pytest.mark.skipif(
    not os.environ.get("PDCD_TEST_SLOW"), reason="takes minutes: make test-slow"
)


@pytest.mark.parametrize(
    "case",
    [*CASES, *(pytest.param(case, marks=slow) for case in LARGE)],
    ids=lambda case: f"{case.driver}-{case.size[0]}x{case.size[1]}-{case.orientation}",
)
def test_every_quad_shows_its_cell(
    tmp_path: Path, case: Case, wanted: dict[str, Floats], monkeypatch: pytest.MonkeyPatch
) -> None:
    result = take(tmp_path, case, monkeypatch)
    within, cell = cell_of(case.map)
    assert within.mean() > 0.25
    for name, cells in wanted.items():
        seen = picture(result, name)
        assert seen.shape == (case.size[1], case.size[0], 3)
        error = np.abs(seen - cells[cell])[within]
        assert error.max() < 4e-3 * cells.max(), name
    manifest = read_manifest(Path(str(result.folder)))
    assert manifest.exif["white"]["flip"] == {1: 0, 3: 3, 6: 6}[case.orientation]
    assert manifest.exif["white"]["black_from"] == (
        "LibRaw" if case.encode is dng else "masked border"
    )
    assert manifest.run.cells is not None and manifest.run.cells.frame == case.size[::-1]
    if case.driver != "ptp":  # nobody says that these photograph the mock scene
        assert result.summary["rms_error_quads"] is None


def test_a_wrong_place_is_seen_in_the_picture(
    tmp_path: Path, wanted: dict[str, Floats], monkeypatch: pytest.MonkeyPatch
) -> None:
    """So the test above can fail: the film is mirrored, and the configuration does not say so."""
    told = CASES[2]
    film = replace(told, place=msgspec.structs.replace(told.place, flip="none"))
    monkeypatch.setattr(Case, "map", film.map)
    result = take(tmp_path, told, monkeypatch)
    monkeypatch.undo()
    within, cell = cell_of(told.map)
    error = np.abs(picture(result, "white") - wanted["white"][cell])[within]
    assert error.max() > 0.1 * wanted["white"].max()


@pytest.mark.parametrize("case", CASES[:2], ids=["landscape", "portrait"])
def test_quarter_windows_are_as_right_as_with_the_mock_camera(
    tmp_path: Path, case: Case, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A turned camera on USB, whose RAW files have a masked border, before a slow mask."""
    case = replace(case, windows=True)
    mock, found = (
        take(tmp_path / driver, replace(case, driver=driver), monkeypatch, window="quarter")
        for driver in ("mock", "ptp")
    )
    for name in ("white", "direct", "indirect"):
        seen, expected = picture(found, name), picture(mock, name)
        assert np.abs(seen - expected).max() < 1e-3 * picture(mock, "white").max(), name
    error, expected_error = (result.summary["rms_error_quads"] for result in (found, mock))
    assert isinstance(error, float)
    assert error == pytest.approx(expected_error, rel=1e-2)
    assert 0.0 < error < 0.018  # 0.0195 where decoding takes all windows for alike
