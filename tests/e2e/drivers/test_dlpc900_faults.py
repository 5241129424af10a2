"""Something goes wrong with a DMD at a moment chosen by chance: in an upload, armed, or while codes
are shown. Panels are black, the shutter is closed, the error is typed, and the next photo is right.
"""

from __future__ import annotations

from collections import Counter
from functools import cache
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.virtual_dlpc900 import (
    RefusalCode,
    VirtualDlpc900,
    VirtualDmdFault,
    VirtualDmdOptions,
    make_bench_bus,
)
from pdcd.bench.devices import CameraSettings
from pdcd.bench.tables import PanelConfig
from pdcd.capture.rig import Rig
from pdcd.errors import PdcdError
from pdcd.panels.frames import Frames
from pdcd.panels.patterns import pack_bits
from pdcd.panels.schedule import build_frames
from tests import bench_rig
from tests.dlpc900_pair import LEAST_US, list_lit, make_dmds, write_down
from tests.dlpc900_reports import join_reports

pytestmark = pytest.mark.whole

GRID = (6, 8)
KINDS = ("error", "deaf", "mute", "late", "busy", "unplug", "reset", "abort", "meddled")
Kind = Literal["error", "deaf", "mute", "late", "busy", "unplug", "reset", "abort", "meddled"]
Faults = tuple[list[VirtualDmdFault], list[VirtualDmdFault]]


@cache
def make_codes(seed: int) -> Frames:
    rng = np.random.default_rng(seed)
    sides = [pack_bits(rng.random((26, GRID[0] * GRID[1])) < 0.5) for _ in range(2)]
    return build_frames(
        (sides[0], sides[1]), GRID, window="whole", schedule="none", passes=1, dark_s=10e-6
    )


class PhotoBench:
    """A rig with two virtual DMDs that has taken a first photo, of other codes."""

    def __init__(self, folder: Path, faults: Faults = ([], [])) -> None:
        panel = PanelConfig(size_px=(96, 64), refresh_hz=1e6 / LEAST_US)
        folder.mkdir(exist_ok=True)
        config = bench_rig.config(
            folder, grid=GRID, display=make_dmds(), projector=panel, mask=panel
        )
        self.rig, self.folder = Rig(config), folder
        unit = VirtualDmdOptions()
        bus = make_bench_bus(self.rig.context, (unit, unit), faults)
        self.rig.context.shared.usb_backend = bus
        self.devices = bus.devices
        self.sent: list[list[bytes]] = [[], []]
        for device, reports in zip(self.devices, self.sent, strict=True):
            write_down(device, reports)
        self.bench = bench_rig.bench_of_rig(self.rig)
        self._light: list[NDArray[np.float64]] = []
        taken = self.bench.photo_taken

        def keep_light() -> None:
            self._light.append(self.bench.quads())
            taken()

        self.bench.photo_taken = keep_light  # type: ignore[method-assign]
        self.rig.connect()
        self.photograph(1)

    def photograph(self, seed: int, *, again: bool = False) -> NDArray[np.float64]:
        """Light of a photo of these codes."""
        self._light.clear()
        self.rig.expose(
            make_codes(seed), CameraSettings(100, 8.0), self.folder, "photo",
            notify=lambda _: None, progress=lambda *_: None, cancelled=lambda: False, again=again,
        )  # fmt: skip
        return self._light[-1]

    def find_light(self) -> list[str]:
        """Serial numbers of devices that show light, or will if they are left alone."""
        now_ns = self.rig.clock.now_ns()
        soon, later = (now_ns, now_ns + 10**8), (now_ns + 5 * 10**9, now_ns + 5 * 10**9 + 10**6)
        return [
            device.serial
            for device in self.devices
            if any(lit.plane.any() for span in (soon, later) for lit in list_lit(device, *span))
        ]


class CleanPhoto(NamedTuple):
    """A second photo without faults: its light, and reports and commands of each device, these as
    faults name them."""

    light: NDArray[np.float64]
    reports: int
    calls: list[list[tuple[int, int]]]


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> CleanPhoto:
    bench = PhotoBench(tmp_path_factory.mktemp("clean"))
    first = [len(list(join_reports(sent))) for sent in bench.sent]
    reports = bench.devices[0].reports
    light = bench.photograph(2)
    named = []
    for sent, begun in zip(bench.sent, first, strict=True):
        calls: Counter[int] = Counter()
        numbers = [command.number for command in join_reports(sent)]
        named.append([(one, calls[one]) for one in numbers if not calls.update([one])][begun:])
    return CleanPhoto(light, bench.devices[0].reports - reports, named)


class Moment:
    """What happens, to which of both devices, and when."""

    def __init__(self, seed: int, calls: list[list[tuple[int, int]]]) -> None:
        rng = np.random.default_rng(seed)
        self.kind: Kind = KINDS[seed % len(KINDS)]  # type: ignore[assignment]
        self.side = int(rng.integers(2))
        here = calls[self.side]
        if self.kind == "abort":
            here = [call for call in here if call[0] == 0x1A24]
        self.command, self.call = here[int(rng.integers(len(here)))]
        self.share = float(rng.random())
        self.fault = VirtualDmdFault(
            "mute" if self.kind == "meddled" else self.kind,
            self.command,
            first=self.call,
            times=1 if self.kind == "late" else int(rng.integers(1, 4)),
            code=RefusalCode(rng.choice([5, 6, 12, 14, 15, 16, 17, 255])),
            seconds=float(rng.uniform(0.05, 3.0)),
            patterns=int(rng.integers(1, 27)),
        )

    def begin(self, folder: Path, reports: int) -> PhotoBench:
        """A bench to which it will happen in its second photo, which has so many reports."""
        faults: Faults = ([], [])
        if self.kind not in ("unplug", "meddled"):
            faults[self.side].append(self.fault)
        bench = PhotoBench(folder, faults)
        device, at = bench.devices[self.side], 1 + int(self.share * reports)
        if self.kind == "unplug":
            device.unplug_at = device.reports + at
        elif self.kind == "meddled":
            stop_at(device, device.reports + at)
        return bench


def stop_at(device: VirtualDlpc900, report: int) -> None:
    """Have another program stop it at some report."""
    count = device.count_report

    def count_and_stop() -> None:
        count()
        if device.reports == report:
            device.count_report = count  # type: ignore[method-assign]
            device.sequencer.stop(device.clock.now_ns())

    device.count_report = count_and_stop  # type: ignore[method-assign]


def test_photos_of_the_same_codes_one_after_the_other(clean: CleanPhoto, tmp_path: Path) -> None:
    """As a stream takes them: each edge starts both, and next to nothing is sent for it."""
    bench = PhotoBench(tmp_path)
    bench.photograph(2)
    for _ in range(3):
        before = [device.reports for device in bench.devices]
        photo = bench.photograph(2, again=True)
        np.testing.assert_allclose(photo, clean.light, atol=1e-9 * clean.light.max())
        sent = [device.reports - n for device, n in zip(bench.devices, before, strict=True)]
        assert max(sent) < 50


@pytest.mark.parametrize(
    "seed",
    [*range(27), *(pytest.param(seed, marks=pytest.mark.long) for seed in range(27, 100))],
)
def test_a_fault_at_any_moment(seed: int, clean: CleanPhoto, tmp_path: Path) -> None:
    moment = Moment(seed, clean.calls)
    bench = moment.begin(tmp_path, clean.reports)
    device = bench.devices[moment.side]
    try:
        photo = bench.photograph(2)
    except PdcdError as err:
        assert err.hint and err.device, err
    else:
        np.testing.assert_allclose(photo, clean.light, atol=1e-9 * clean.light.max())
    safe = bench.rig.make_safe()
    assert not bench.bench.shutter_open
    light = bench.find_light()
    if moment.kind == "reset":  # it begins anew in seconds, with the picture of its flash
        assert not safe and light == [device.serial]
    else:
        assert not light
        assert safe or moment.kind in ("unplug", "late", "busy"), (
            "silent for longer than it is asked"
        )
    device.faults = ()
    bench.rig.clock.sleep_until_ns(bench.rig.clock.now_ns() + 5 * 10**9)
    if moment.kind == "unplug":
        device.replug()
    photo = bench.photograph(2)
    np.testing.assert_allclose(photo, clean.light, atol=1e-9 * clean.light.max())
    bench.rig.disconnect()
    assert not bench.find_light()
