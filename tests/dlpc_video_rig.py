"""Two virtual DMDs, each a DLPC900 or a DLPC350, on the outputs of an X server, or on nothing, and
the display `dlpc-video` that drives them."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers import x11
from drivers.dlpc_video import DlpcVideoDisplay
from drivers.virtual_dlpc900 import (
    VirtualDlpc900,
    VirtualDmdBus,
    VirtualDmdFault,
    VirtualDmdOptions,
    choose_dmd_model,
)
from pdcd.bench.clock import RealClock, VirtualClock
from pdcd.bench.devices import Clock, DriverContext, SharedState
from pdcd.bench.placed import panels_of
from pdcd.bench.tables import Config, DisplayConfig, PanelConfig, RigConfig
from pdcd.panels.draw import draw_planes
from pdcd.panels.frames import Frames, split_dark_times
from pdcd.presenter.messages import LOG_COLUMNS, Column, Ready
from tests import bench_rig
from tests.panel_pixels import planned, random_frames
from tests.virtual_dlpc350 import VirtualDlpc350, VirtualDlpc350Options

SERIALS = "VIDEO-P", "VIDEO-M"
REFRESH_HZ = 60.0
DLPC = {"projector": SERIALS[0], "mask": SERIALS[1], "usb": "given"}

Words = NDArray[np.uint32]
Size = tuple[int, int]
Kind = Literal["dlpc900", "dlpc350"]
VideoDevice = VirtualDlpc900 | VirtualDlpc350
KINDS: tuple[Kind, Kind] = ("dlpc900", "dlpc900")
BOTH_350: tuple[Kind, Kind] = ("dlpc350", "dlpc350")
SIZES: dict[Kind, Size] = {"dlpc900": (256, 192), "dlpc350": (912, 1140)}
PERIOD_NS = round(1e9 / REFRESH_HZ)


def make_video_dmds(
    sizes_px: tuple[Size, Size],
    clock: Clock | None = None,
    *,
    kinds: tuple[Kind, Kind] = KINDS,
    faults: tuple[VirtualDmdFault, ...] = (),
    refresh_hz: float | None = REFRESH_HZ,
    **options: Any,
) -> tuple[VideoDevice, VideoDevice]:
    """Projector and mask; `faults` are the mask's. refresh_hz : None: without a signal. options :
    of each kind, where they differ from the worse of two unknown things."""
    given = {"after_stop": "holds", "report_s": 0.0, **options}
    clock = clock or RealClock()
    found: list[VideoDevice] = []
    for side, (kind, size, serial) in enumerate(zip(kinds, sizes_px, SERIALS, strict=True)):
        wrong = faults if side else ()
        if kind == "dlpc350":
            found.append(VirtualDlpc350(clock, serial, VirtualDlpc350Options(**given), wrong))
        else:
            model = choose_dmd_model(size)
            found.append(VirtualDlpc900(clock, model, serial, VirtualDmdOptions(**given), wrong))
        if refresh_hz is not None:
            found[-1].connect_video(refresh_hz)
    return found[0], found[1]


def make_video_display(
    config: Config,
    dmds: tuple[VideoDevice, VideoDevice],
    clock: Clock | None = None,
    **more: Any,
) -> DlpcVideoDisplay:
    """The driver, with these devices on its USB. more : of `DriverContext`."""
    shared = SharedState(usb_backend=VirtualDmdBus(*dmds))
    return DlpcVideoDisplay.create(DriverContext(config, clock or RealClock(), shared, **more))


def join_channels(rgb: NDArray[np.uint8]) -> Words:
    """Pixels, (H, W, 3) uint8, as 0xRRGGBB."""
    red, green, blue = (rgb[..., n].astype(np.uint32) for n in range(3))
    return np.asarray(red << 16 | green << 8 | blue, dtype=np.uint32)


def read_played(
    device: VideoDevice, low_ns: int, high_ns: int
) -> list[tuple[int, NDArray[np.bool_] | None]]:
    """What its mirrors showed, and from when on; None is black."""
    return [
        (at_ns, None if one is None else (one.words >> np.uint32(one.bit) & 1).astype(np.bool_))
        for at_ns, one in device.list_changes(low_ns, high_ns)
    ]


def is_dark(device: VideoDevice) -> bool:
    """Whether no mirror is on now."""
    one = device.find_content()
    return one is None or not bool((one.words >> np.uint32(one.bit) & 1).any())


def cut_rows(frames: Frames, first: int, count: int) -> Frames:
    """Some rows of the frames."""
    part = slice(first, first + count)
    return Frames(
        frames.primal_patterns,
        frames.dual_patterns,
        frames.primal_index[part],
        frames.dual_index[part],
        frames.shift[part],
        frames.code[part],
        frames.guard[part],
        frames.grid,
        frames.lattice,
        frames.window,
    )


class Presenter:
    """Stands in for the display process: its pictures come every 60th of a second."""

    ready = Ready("clock", 60.0, {}, 0.0)
    fault: Exception | None = None
    begin_ns = 0
    said: list[str]

    def __init__(self, *_: Any) -> None:
        self.alive = True
        self.said.append("start")

    def load(self, _: Any) -> None:
        self.said.append("load")

    def show(self, _: int) -> None:
        self.said.append("show")

    def black(self) -> None:
        self.said.append("black")
        if self.fault is not None:
            raise self.fault

    def close(self) -> None:
        self.alive = False
        self.said.append("close")

    def play(self, primal: Any, *_: Any, **__: Any) -> Any:
        log = np.zeros((len(primal) + 1, LOG_COLUMNS), dtype=np.int64)
        log[:, Column.MSC] = np.arange(len(log))
        log[:, Column.NS] = self.begin_ns + log[:, Column.MSC] * PERIOD_NS
        return log


@pytest.fixture
def presenter(monkeypatch: pytest.MonkeyPatch) -> type[Presenter]:
    monkeypatch.setattr(x11, "DisplayProcess", Presenter)
    Presenter.said, Presenter.fault, Presenter.begin_ns = [], None, 0
    return Presenter


def config(
    folder: Path,
    *,
    shown: dict[str, Any] | None = None,
    kinds: tuple[Kind, Kind] = KINDS,
    **dlpc: Any,
) -> Config:
    options = {"projector": "A", "mask": "B", "dlpc": {**DLPC, **dlpc}}
    given: dict[str, Any] = {"planes_per_refresh": 24, "options": options, **(shown or {})}
    return bench_rig.config(
        folder,
        rig=RigConfig(clock="real", on_miss="flag"),
        display=DisplayConfig(driver="dlpc-video", **given),
        projector=PanelConfig(size_px=SIZES[kinds[0]]),
        mask=PanelConfig(size_px=SIZES[kinds[1]]),
    )


class VideoBench:
    """Both devices, all commands they were sent, and the driver."""

    def __init__(
        self,
        folder: Path,
        *faults: VirtualDmdFault,
        dlpc: Any = None,
        kinds: tuple[Kind, Kind] = KINDS,
        **how: Any,
    ):
        self.clock = VirtualClock()
        sizes = SIZES[kinds[0]], SIZES[kinds[1]]
        self.dmds = make_video_dmds(sizes, self.clock, kinds=kinds, faults=faults, **how)
        self.sent = [listen(device) for device in self.dmds]
        self.cancelled = False
        self.display = make_video_display(
            config(folder, kinds=kinds, **(dlpc or {})),
            self.dmds,
            self.clock,
            cancelled=lambda: self.cancelled,
        )

    def stays_dark(self, device: VideoDevice) -> bool:
        """Whether it is dark, and no picture on its signal lights it."""
        now_ns = self.clock.now_ns()
        dark = is_dark(device)
        kind: Kind = "dlpc350" if isinstance(device, VirtualDlpc350) else "dlpc900"
        lit = np.full(SIZES[kind][::-1], 0xFFFFFF, np.uint32)
        device.drive_video(lit, now_ns)
        return dark and is_dark(device)


def listen(device: VideoDevice) -> list[tuple[int, bytes]]:
    """Writes that a device is sent, as they come."""
    found: list[tuple[int, bytes]] = []
    held, take = bytearray(), device.write_report

    def write_report(report: bytes) -> None:
        held.extend(report)
        flags, _, length, command = struct.unpack_from("<BBHH", held)
        if len(held) >= 4 + length:
            if not flags & 0x80:
                found.append((command, bytes(held[6 : 4 + length])))
            held.clear()
        take(report)

    device.write_report = write_report  # type: ignore[method-assign]
    return found


def play(display: DlpcVideoDisplay, rows: int) -> Any:
    display.load(random_frames((6, 8), "whole", rows))
    return display.play(lambda *_: None, lambda: False)


def assert_log_is_shown(bench: VideoBench, pictures: int = 2) -> None:
    """Pictures of 24 planes with dark times, as they are drawn, and fed to both devices when the
    log has them begin: mirrors show each row in its plane, 0 wrong pixels, times to 1 us."""
    Presenter.begin_ns = bench.clock.now_ns() + 5 * 10**9
    frames = random_frames((6, 8), "whole", 24 * pictures)
    bench.display.load(frames)
    log = bench.display.play(lambda *_: None, lambda: False)
    views, lit, wrong = panels_of(bench.display._config), split_dark_times(log), 0
    sides = (
        (bench.dmds[0], views.projector, lit.primal_shown, lit.primal_ns),
        (bench.dmds[1], views.mask, lit.dual_shown, lit.dual_ns),
    )
    for device, view, shown, starts_ns in sides:
        for first in range(0, 24 * pictures, 24):
            words = join_channels(draw_planes(frames, view, range(first, first + 24), "GRB"))
            device.drive_video(words, Presenter.begin_ns + PERIOD_NS * (first // 24))
        played = read_played(device, Presenter.begin_ns, int(log.end_ns[0]))
        # Mirrors are told twice to be dark: after the last plane, and until the next picture.
        twice = [plane is played[n - 1][1] is None for n, (_, plane) in enumerate(played)]
        played = [one for one, again in zip(played, twice, strict=True) if not again]
        assert len(played) == len(shown) == 48 * pictures - 1
        for (at_ns, plane), row, start_ns in zip(played, shown, starts_ns, strict=True):
            assert abs(at_ns - start_ns) <= 1000 and (plane is None) is bool(row < 0)
            if plane is not None:
                wrong += int(np.count_nonzero(plane != (planned(frames, int(row), view) > 0)))
    assert wrong == 0
