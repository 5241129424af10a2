"""Two virtual DLPC900s before the mock bench: its photos are of what they really showed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.mock import MockBench
from drivers.virtual_dlpc900 import (
    MASK_SERIAL,
    PLANES_BY_OTHERS,
    PLANES_BY_TI,
    PROJECTOR_SERIAL,
    VirtualDmdOptions,
    VirtualDmdTiming,
    make_bench_bus,
)
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import DriverContext
from pdcd.bench.placed import panels_of
from pdcd.bench.tables import (
    BenchConfig,
    CameraConfig,
    Config,
    PanelConfig,
    SceneConfig,
)
from pdcd.panels.draw import draw
from pdcd.panels.frames import FrameLog, Frames
from pdcd.panels.patterns import pack_bits
from pdcd.panels.pixels import WHITE_SUM, Recorder
from pdcd.panels.placing import Placing
from pdcd.panels.schedule import build_frames
from tests import bench_rig
from tests.dmd_client import START, STOP, DmdClient, entry_bytes

GRID, SIZE = (4, 6), (24, 16)
CODES, EXPOSURE_US, DARK_US = 30, 105, 20
ROW_NS, DELAY_NS = (EXPOSURE_US + DARK_US) * 1000, 105_000
EXPOSED_NS = DELAY_NS + CODES * ROW_NS + 500_000
Planes = NDArray[np.bool_]


def config_of(**changes: object) -> Config:
    panel = PanelConfig(size_px=SIZE, refresh_hz=1e6 / EXPOSURE_US)
    return msgspec.structs.replace(
        Config(projector=panel, mask=panel, scene=SceneConfig(kind="wax-disk", grid=GRID)),
        **changes,
    )


def random_frames(seed: int = 0, window: str = "whole") -> Frames:
    rng = np.random.default_rng(seed)
    cells = (GRID[0] + 1) * (GRID[1] + 1) if window == "quarter" else GRID[0] * GRID[1]
    sides = [pack_bits(rng.random((CODES, cells)) < 0.5) for _ in range(2)]
    return build_frames(
        (sides[0], sides[1]),
        GRID,
        window=window,
        schedule="none",
        passes=1,
        dark_s=DARK_US * 1e-6,
    )


class DmdBench:
    """Both devices with frames loaded, armed and waiting for the shutter."""

    def __init__(
        self,
        frames: Frames,
        config: Config | None = None,
        options: tuple[VirtualDmdOptions, VirtualDmdOptions] | None = None,
        order: Sequence[int] = PLANES_BY_TI,
    ) -> None:
        self.config = config or config_of()
        self.clock = VirtualClock()
        self.context = DriverContext(self.config, self.clock)
        self.usb = make_bench_bus(self.context, options)
        self.bench = MockBench.of(self.context)
        panels = panels_of(self.config)
        self.clients = [DmdClient(self.usb, serial) for serial in (PROJECTOR_SERIAL, MASK_SERIAL)]
        rows = range(len(frames))
        self.planes = [
            np.stack([draw(frames, panel, row) > 0 for row in rows])
            for panel in (panels.projector, panels.mask)
        ]
        for client, planes in zip(self.clients, self.planes, strict=True):
            load(client, planes, order)
            client.run(START)

    def expose(self, exposed_ns: int = EXPOSED_NS) -> NDArray[np.float64]:
        self.bench.open_shutter(self.clock.now_ns())
        self.clock.sleep_until_ns(self.clock.now_ns() + exposed_ns)
        self.bench.close_shutter(self.clock.now_ns())
        return self.bench.quads()

    def believed(self, frames: Frames, late_ns: Sequence[int] = (0, 0)) -> NDArray[np.float64]:
        """The photo of the mock's own panels with these frames at their times."""
        open_ns, close_ns = self.bench.exposed_ns()
        bench = MockBench(self.config, self.bench.scene)
        bench.open_shutter(open_ns)
        bench.frames = frames
        bench.log = log_of(len(frames), open_ns, frames.dark_s, late_ns)
        bench.close_shutter(close_ns)
        return bench.quads()


def load(client: DmdClient, planes: Planes, order: Sequence[int] = PLANES_BY_TI) -> None:
    entries = [
        entry_bytes(n, EXPOSURE_US, DARK_US, n // 24, n % 24, wait=n == 0)
        for n in range(len(planes))
    ]
    client.upload(planes, entries, order)


def log_of(
    count: int, open_ns: int, dark_s: NDArray[np.float64] | None, late_ns: Sequence[int] = (0, 0)
) -> FrameLog:
    rows = np.arange(count, dtype=np.int32)
    start_ns = open_ns + DELAY_NS + ROW_NS * np.arange(count)
    ends_ns = start_ns[-1] + 1000 * EXPOSURE_US + np.array(late_ns)
    return FrameLog(
        rows, rows, start_ns + late_ns[0], start_ns + late_ns[1], ends_ns,
        np.zeros(count, np.int32), "test", True, dark_s=dark_s,
    )  # fmt: skip


def differ(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    return float(np.abs(one - other).max() / np.abs(other).max())


def test_the_photo_is_that_of_the_mock_with_the_same_panels() -> None:
    frames = random_frames()
    rig = DmdBench(frames)
    photo = rig.expose()
    assert photo.max() > 0.0
    assert differ(photo, rig.believed(frames)) < 1e-12
    shown, _ = rig.bench.panels.show_between(*rig.bench.exposed_ns())  # type: ignore[union-attr]
    assert shown.window == "whole" and len(shown.primal_patterns) == CODES


@pytest.mark.parametrize("skew_s", [4e-6, -4e-6])
def test_panels_with_all_that_panels_have(skew_s: float) -> None:
    """Slow, leaking, apart in time and in space, and one of them upside down."""
    panel = PanelConfig(
        size_px=SIZE, refresh_hz=1e6 / EXPOSURE_US, rise_s=7e-6, fall_s=11e-6, contrast=300.0
    )
    turned = Placing(turn_deg=180.0, flip="horizontal")
    mask = msgspec.structs.replace(panel, skew_s=skew_s, offset_px=(0.5, -1.0), place=turned)
    frames = random_frames(3)
    rig = DmdBench(frames, config_of(projector=panel, mask=mask))
    assert differ(rig.expose(), rig.believed(frames)) < 1e-12
    # Closed amid a pattern, 2 us after it began on the projector.
    rig = DmdBench(frames, config_of(projector=panel, mask=mask))
    assert differ(rig.expose(DELAY_NS + 5 * ROW_NS + 2000), rig.believed(frames)) < 1e-12


@pytest.mark.parametrize("apart_ns", [2000, -3000, 130_000])
def test_skew_between_the_devices_is_in_the_photo(apart_ns: int) -> None:
    frames = random_frames()
    late = VirtualDmdOptions(timing=VirtualDmdTiming(latency_ns=apart_ns))
    rig = DmdBench(frames, options=(VirtualDmdOptions(), late))
    photo = rig.expose()
    assert differ(photo, rig.believed(frames, (0, apart_ns))) < 1e-12
    assert differ(photo, rig.believed(frames)) > 1e-3


def test_the_truth_of_a_bench_tells_when_they_answer(tmp_path: Path) -> None:
    truth = tmp_path / "truth.toml"
    truth.write_text("[mask]\nphase_s = 3e-6\n[projector]\nphase_s = 1e-6\njitter_s = 2e-7\n")
    rig = DmdBench(random_frames(), config_of(bench=BenchConfig(truth=str(truth))))
    projector, mask = (device.options.timing for device in rig.usb.devices)
    assert (projector.latency_ns, projector.jitter_ns) == (1000, 200)
    assert (mask.latency_ns, mask.jitter_ns) == (3000, 0)


@pytest.mark.parametrize(
    "wrong", ["order of planes", "one entry", "exchanged", "late", "one panel stopped"]
)
def test_what_is_wrong_on_the_way_is_wrong_in_the_photo(wrong: str) -> None:
    frames = random_frames()
    options = VirtualDmdOptions()
    if wrong == "order of planes":
        options = VirtualDmdOptions(plane_bytes=PLANES_BY_OTHERS)
    elif wrong == "late":
        options = VirtualDmdOptions(timing=VirtualDmdTiming(latency_ns=ROW_NS))
    rig = DmdBench(frames, options=(options, VirtualDmdOptions()))
    if wrong == "one entry":
        planes = rig.planes[0].copy()
        planes[[4, 5]] = planes[[5, 4]]
        load(rig.clients[0], planes)
        rig.clients[0].run(START)
    elif wrong == "exchanged":
        for client, planes in zip(rig.clients, reversed(rig.planes), strict=True):
            load(client, planes)
            client.run(START)
    elif wrong == "one panel stopped":
        rig.clients[1].run(STOP)
    photo = rig.expose()
    believed = rig.believed(frames)
    assert differ(photo, believed) > 1e-3
    if wrong == "one panel stopped":
        assert not photo.any()
    elif wrong == "one entry":
        index = frames.primal_index.copy()
        index[[4, 5]] = index[[5, 4]]
        assert differ(photo, rig.believed(replace(frames, primal_index=index))) < 1e-12


def test_a_photo_of_panels_that_were_lit_before() -> None:
    """A sequence without an end, of which the shutter sees a part."""
    frames = random_frames()
    slow = config_of(
        projector=PanelConfig(size_px=SIZE, rise_s=2e-5, fall_s=3e-5, refresh_hz=9523.8),
        mask=PanelConfig(size_px=SIZE, rise_s=3e-5, fall_s=2e-5, refresh_hz=9523.8),
    )
    rig = DmdBench(frames, slow)
    begun_ns = rig.clock.now_ns()
    for device in rig.usb.devices:
        device.drive_line(1, True, begun_ns)
    cuts_ns = begun_ns + np.array([0, 700_000, 1_234_567, EXPOSED_NS])
    photos = []
    for open_ns, close_ns in zip(cuts_ns[:-1].tolist(), cuts_ns[1:].tolist(), strict=True):
        rig.clock.sleep_until_ns(close_ns)
        rig.bench.open_ns, rig.bench.close_ns = open_ns, close_ns
        photos.append(rig.bench.quads())
    rig.bench.open_ns, rig.bench.close_ns = begun_ns, int(cuts_ns[-1])
    assert differ(sum(photos), rig.bench.quads()) < 1e-12  # type: ignore[arg-type]
    assert differ(rig.bench.quads(), rig.believed(frames)) < 1e-12


def plain_config(folder: Path) -> Config:
    """A scene of cells without detail in them, which pixels see as cells do."""
    path = folder / "scene.npz"
    np.savez(path, transport=bench_rig.transport(GRID), grid=np.array(GRID))
    return config_of(scene=SceneConfig(kind="matrix", path=str(path)))


def test_planes_that_are_no_cells_are_seen_pixel_by_pixel(tmp_path: Path) -> None:
    """Held against pictures of the panels' pixels, as a display that looks at them has them."""
    rng = np.random.default_rng(8)
    rig = DmdBench(random_frames(), plain_config(tmp_path))
    planes = [rng.random((CODES, *SIZE[::-1])) < 0.5 for _ in range(2)]
    for client, own in zip(rig.clients, planes, strict=True):
        load(client, own)
        client.run(START)
    photo = rig.expose()
    shown, _ = rig.bench.panels.show_between(*rig.bench.exposed_ns())  # type: ignore[union-attr]
    assert shown.of_pixels
    open_ns, close_ns = rig.bench.exposed_ns()
    bench = MockBench(rig.config, rig.bench.scene)
    bench.open_shutter(open_ns)
    recorder = Recorder(SIZE, SIZE)
    rows = np.repeat(np.arange(CODES), 2)
    for row, dark in zip(rows, np.tile([False, True], CODES), strict=True):
        if dark:
            recorder.black()
        else:
            recorder.add(*(np.uint16(WHITE_SUM) * own[row] for own in planes))
    bench.shared.pixels = recorder.shown()
    start_ns = open_ns + DELAY_NS + ROW_NS * rows
    start_ns[1::2] += 1000 * EXPOSURE_US
    count = np.arange(2 * CODES, dtype=np.int32)
    bench.frames = random_frames()
    bench.log = FrameLog(
        count, count, start_ns, start_ns, np.full(2, start_ns[-1]), 0 * count, "test", True
    )
    bench.close_shutter(close_ns)
    assert differ(photo, bench.quads()) < 1e-9


def test_quarter_windows_are_pixels_too(tmp_path: Path) -> None:
    frames = random_frames(window="quarter")
    rig = DmdBench(frames, plain_config(tmp_path))
    photo = rig.expose(DELAY_NS + len(frames) * ROW_NS + 500_000)
    shown, _ = rig.bench.panels.show_between(*rig.bench.exposed_ns())  # type: ignore[union-attr]
    assert shown.of_pixels
    assert differ(photo, rig.believed(frames)) < 1e-9


def test_a_finder_sees_what_stands() -> None:
    rig = DmdBench(random_frames())
    dark = rig.bench.held_light()
    assert not dark.any() and rig.bench.held_light() is dark
    rows, cols = GRID
    lit = np.zeros((1, *SIZE[::-1]), dtype=bool)
    lit[0, : SIZE[1] // 2] = True
    for client, planes in zip(rig.clients, (lit, np.ones_like(lit)), strict=True):
        client.upload(planes, [entry_bytes(0, 10_000)], PLANES_BY_TI, most=0)
        client.run(START)
    seen = rig.bench.held_light()
    assert rig.bench.held_light() is seen, "worked out once"
    direct = rig.bench.scene.white().reshape(rows, cols, 3)
    assert seen[: rows // 2].min() > 0.0 and np.all(seen <= direct + 1e-12)
    for client in rig.clients:
        client.run(STOP)
    assert not rig.bench.held_light().any()


def test_a_machine_vision_camera_drives_the_line() -> None:
    of_camera = pytest.importorskip("drivers.virtual_genicam.bench", reason="it needs Aravis")
    frames = random_frames()
    rig = DmdBench(frames, config_of(camera=CameraConfig(profile="mono")))
    film = of_camera.BenchLight(rig.context)
    now_ns = rig.clock.now_ns()
    film.open(now_ns, 0.02)
    rig.clock.sleep_until_ns(now_ns + 20_000_000)
    film.close(now_ns + 20_000_000)
    assert differ(rig.bench.quads(), rig.believed(frames)) < 1e-12
