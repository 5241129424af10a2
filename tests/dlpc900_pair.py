"""The driver of DMDs on two virtual ones, with every report between them written down."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.dlpc900.display import Dlpc900Display
from drivers.mock import MockBench
from drivers.virtual_dlpc900 import (
    MASK_SERIAL,
    PROJECTOR_SERIAL,
    DmdPanels,
    VirtualDlpc900,
    VirtualDmdOptions,
    make_bench_bus,
)
from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import DriverContext
from pdcd.bench.tables import Config, DisplayConfig, PanelConfig, SceneConfig
from pdcd.panels.frames import FrameLog, Frames
from tests.dlpc900_reports import Start, read_starts

LEAST_US = 105


class Lit(NamedTuple):
    """A plane as it stood on mirrors from a time on."""

    at_ns: int
    plane: NDArray[np.bool_]


def make_dmds(**options: Any) -> DisplayConfig:
    """[display] with two virtual DMDs."""
    named = {"projector": PROJECTOR_SERIAL, "mask": MASK_SERIAL, "usb": "virtual-dlpc900"}
    return DisplayConfig(driver="dlpc900", row_times=True, options={**named, **options})


def write_down(device: VirtualDlpc900, reports: list[bytes]) -> None:
    """Append each report that a device is sent."""
    take = device.write_report

    def take_and_keep(report: bytes) -> None:
        reports.append(report)
        take(report)

    device.write_report = take_and_keep  # type: ignore[method-assign]


class DmdPair:
    """Both devices and their driver, black; a shutter that starts them."""

    def __init__(
        self,
        size_px: tuple[int, int],
        grid: tuple[int, int],
        *,
        row_us: int = LEAST_US,
        unit: VirtualDmdOptions | None = None,
        **options: Any,
    ) -> None:
        panel = PanelConfig(size_px=size_px, refresh_hz=1e6 / row_us)
        self.config = Config(
            projector=panel,
            mask=panel,
            display=make_dmds(**options),
            scene=SceneConfig(kind="wax-disk", grid=grid),
        )
        self.clock = VirtualClock()
        context = DriverContext(self.config, self.clock)
        units = None if unit is None else (unit, unit)
        context.shared.usb_backend = usb = make_bench_bus(context, units)
        self.devices = usb.devices
        self.bench = MockBench.of(context)
        self.reports: list[list[bytes]] = [[], []]
        for device, reports in zip(self.devices, self.reports, strict=True):
            write_down(device, reports)
        if options.get("start") == "chain":
            self._wire()
        self.display = Dlpc900Display.create(context)
        self.display.connect()

    def _wire(self) -> None:
        """TRIG_OUT_1 of the projector to TRIG_IN_1 of the mask, and the camera's line to none."""
        assert isinstance(self.bench.panels, DmdPanels)
        self.bench.panels.expose = lambda **_: None  # type: ignore[method-assign]
        projector, mask = self.devices
        seen_ns = [0]

        def tell_pulses() -> None:
            """Each pattern has one, those that follow each other as well."""
            now_ns = self.clock.now_ns()
            for up_ns, down_ns in projector.list_pulses(1, now_ns, now_ns + 1):
                if up_ns > seen_ns[0]:
                    seen_ns[0] = up_ns
                    mask.drive_line(1, True, up_ns)
                    mask.drive_line(1, False, down_ns)

        def watch(device: VirtualDlpc900) -> None:
            take = device.write_report

            def take_and_tell(report: bytes) -> None:
                tell_pulses()
                take(report)
                tell_pulses()

            device.write_report = take_and_tell  # type: ignore[method-assign]

        watch(projector)
        watch(mask)

    def play(self, frames: Frames) -> tuple[FrameLog, list[list[Start]], list[list[Lit]]]:
        """Show frames in an exposure: the driver's log, and of each device the starts of finite
        sequences that its reports were, and what stood from the opening of the shutter on."""
        begun = [len(read_starts(sent)) for sent in self.reports]
        self.display.load(frames)
        self.display.black()
        open_ns = self.clock.now_ns()
        self.bench.open_shutter(open_ns)
        log = self.display.play(lambda *_: None, lambda: False)
        self.display.black()
        close_ns = self.clock.now_ns()
        self.bench.close_shutter(close_ns)
        starts = [read_starts(sent) for sent in self.reports]
        new = [
            [one for one in all_[n:] if one.shown] for all_, n in zip(starts, begun, strict=True)
        ]
        return log, new, [list_lit(device, open_ns, close_ns) for device in self.devices]

    @property
    def dark(self) -> bool:
        """Whether neither device shows light, now or as long as nobody does anything."""
        now_ns = self.clock.now_ns()
        return not any(
            lit.plane.any() for device in self.devices
            for lit in list_lit(device, now_ns, now_ns + 2_000_000)
        )  # fmt: skip


def list_lit(device: VirtualDlpc900, low_ns: int, high_ns: int) -> list[Lit]:
    """Planes that stood on its mirrors, and from when on."""
    known: dict[tuple[int, int], NDArray[np.bool_]] = {}
    found = []
    for at_ns, plane in device.list_changes(low_ns, high_ns):
        if plane is not None:
            key = id(plane.words), plane.bit
            if key not in known:
                known[key] = (plane.words >> np.uint32(plane.bit) & 1) == 1
            found.append(Lit(at_ns, known[key]))
    return found
