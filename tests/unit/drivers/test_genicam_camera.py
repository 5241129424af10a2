"""A machine-vision camera over GigE Vision on this machine: frames sample by sample, and faults."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.genicam.aravis import RawBuffer
from drivers.genicam.camera import GenicamCamera
from drivers.genicam.doctor import examine_genicam
from drivers.genicam.frames import FrameReceiver
from drivers.genicam.pixels import BY_NAME
from drivers.virtual_genicam.camera import CameraFaults, VirtualExposure, VirtualGenicamCamera
from pdcd.bench.clock import RealClock, VirtualClock
from pdcd.bench.tables import CameraConfig, Config, RigConfig, TriggerConfig
from pdcd.driver import (
    CameraSettings,
    Cancelled,
    ConfigError,
    DeviceLost,
    DriverContext,
    ExposureError,
    Patience,
    PhotoError,
)
from tests.genicam_rig import (
    BLACK_DN,
    SETTINGS,
    Sheets,
    blacks,
    client,
    hosted,
    needs_aravis,
    needs_stock,
    shoot,
    stock,
    turn,
)

pytestmark = needs_aravis

FORMATS = (
    "Mono8", "Mono10", "Mono10p", "Mono12Packed", "Mono12p", "Mono16",
    "BayerRG8", "BayerGR12p", "BayerGB16", "BayerBG10Packed",
)  # fmt: skip


@contextlib.contextmanager
def taking(
    name: str = "Mono8",
    size: tuple[int, int] = (64, 48),
    longest_s: float = 60.0,
    *,
    ready: bool = True,
    **options: object,
) -> Iterator[tuple[VirtualGenicamCamera, GenicamCamera, Sheets, VirtualClock]]:
    """A camera of this format, its client, what it sees, and their clock; `ready` after a photo."""
    film, clock = Sheets(), VirtualClock()
    with hosted(name, film=film, size=size, clock=clock, longest_s=longest_s) as virtual:
        camera = client(clock, **options)
        if ready:
            shoot(camera)
        yield virtual, camera, film, clock
        camera.close("readout")


def await_true(what: Callable[[], bool]) -> None:
    """Wait for another thread; a hang is seen by the test's own timeout."""
    while not what():
        time.sleep(0.001)


@pytest.mark.parametrize("name", FORMATS)
def test_every_sample_of_every_format_arrives(name: str) -> None:
    with taking(name, ready=False) as (virtual, camera, film, _):
        for iso in (100, 400):
            photo = shoot(camera, CameraSettings(iso, 5.6, exposure_s=0.02))
            known = BY_NAME[name]
            assert np.array_equal(photo.samples, film.last)
            assert photo.samples.dtype == np.uint16 and photo.cfa == known.cfa
            assert len(blacks(photo)) == (1 if known.cfa is None else 4)
            assert all(abs(level - BLACK_DN) <= 1 for level in blacks(photo))
            assert (photo.white, photo.iso, photo.f_number) == ((1 << known.bits) - 1, iso, 5.6)
            taken = film.exposures[-1]
            assert photo.exposure_s == pytest.approx(taken.exposure_s, abs=1e-6)
            assert taken.exposure_s > 0.02
            assert 100.0 * 10.0 ** (taken.gain_db / 20.0) == pytest.approx(iso, rel=1e-3)
        record = photo.record
        assert record["PixelFormat"] == name and float(record["DeviceTemperature"]) == 41.5
        assert float(record["ExposureTime"]) == pytest.approx(1e6 * photo.exposure_s)
        assert {"Gain", "BlackLevel", "FrameID", "Timestamp"} <= set(record)
        # Black was looked for once at each gain, and nothing else was exposed.
        assert virtual.exposures == len(film.exposures) == 4


@pytest.mark.parametrize("lost", [0.0, 0.001, 0.01, 0.05])
def test_a_lost_packet_costs_one_exposure_and_no_wrong_frame_comes(lost: float) -> None:
    with taking("BayerRG12p", wait_s=1.0) as (virtual, camera, film, _):
        virtual.faults.lost = lost
        right = failed = 0
        while right < (100 if not lost else 15):
            try:
                photo = shoot(camera)
            except PhotoError:
                failed += 1
                continue
            assert np.array_equal(photo.samples, film.last)
            right += 1
        assert lost or not failed


def test_packets_that_are_lost_are_seen() -> None:
    with taking("Mono16", size=(320, 240)) as (virtual, camera, film, _):
        virtual.faults.lost = 0.5
        with pytest.raises(PhotoError):
            for _ in range(3):  # of 111 packets each
                shoot(camera)
        virtual.faults.lost = 0.0
        await_true(lambda: not virtual.exposing)
        time.sleep(0.05)
        assert np.array_equal(shoot(camera).samples, film.last)


def test_a_camera_that_dies_in_an_exposure_is_lost_and_found_again() -> None:
    with taking("Mono12p") as (virtual, camera, film, _):
        camera.arm(SETTINGS)
        virtual.faults.killed_after_s = 0.01
        begun_ns, started_s = camera.begin(), time.monotonic()
        assert camera.end() >= begun_ns  # its clock ends it, wherever it is
        with pytest.raises(DeviceLost):
            camera.fetch(60.0)
        assert time.monotonic() - started_s < 10.0
        virtual.start()  # the old connection would seem to work
        assert np.array_equal(shoot(camera).samples, film.last)


def test_a_camera_that_was_restarted_is_opened_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.genicam.camera._BACK_S", 0.0)
    with taking("Mono12p") as (virtual, camera, film, _):
        virtual.stop()
        virtual.start()
        assert np.array_equal(shoot(camera).samples, film.last)
        camera.arm(SETTINGS)
        camera.begin()
        virtual.stop()
        virtual.start()
        camera.end()
        with pytest.raises(PhotoError, match="restarted"):
            camera.fetch(60.0)
        assert np.array_equal(shoot(camera).samples, film.last)
        # A setting that it forgot meanwhile is not taken for one that it does not have.
        camera.arm(SETTINGS)
        virtual.stop()
        virtual.start()
        with pytest.raises(PhotoError, match="restarted"):
            camera.expect(100.0)
        virtual.stop()
        virtual.description = replace(virtual.description, serial="V2")
        virtual.start()
        with pytest.raises(DeviceLost, match=r"another camera answers.* V2"):
            shoot(camera)
        camera.close("readout")  # and whoever starts again knows of no other
        assert np.array_equal(shoot(camera).samples, film.last)


def test_nobody_listens() -> None:
    with turn(), pytest.raises(DeviceLost):
        client(VirtualClock()).open("readout")


def test_a_trigger_in_an_exposure_makes_no_second_frame() -> None:
    with taking() as (virtual, camera, film, clock):
        camera.arm(SETTINGS)
        camera.begin()
        camera.device.trigger()
        await_true(lambda: virtual.missed == 1)
        clock.sleep_until_ns(clock.now_ns() + 20_000_000)
        camera.end()
        assert np.array_equal(camera.fetch(60.0).samples, film.last)
        assert np.array_equal(shoot(camera).samples, film.last)


def test_a_frame_of_an_earlier_exposure_is_never_taken_for_the_next() -> None:
    with taking() as (virtual, camera, film, clock):
        camera.arm(SETTINGS)
        camera.begin()
        clock.sleep_until_ns(clock.now_ns() + 20_000_000)
        camera.end()  # and nobody fetches it
        await_true(lambda: not virtual.exposing)
        time.sleep(0.1)
        assert np.array_equal(shoot(camera).samples, film.last)


@pytest.mark.parametrize(("last", "came", "right"), [
    (None, 7, True), (7, 8, True), (7, 9, False), (7, 7, False),
    (65535, 1, True), (65535, 0, True), (65535, 65536, True), (65534, 1, False),
])  # fmt: skip
def test_frames_are_counted(last: int | None, came: int, right: bool) -> None:
    frames = FrameReceiver(None, Patience(VirtualClock()))  # type: ignore[arg-type]
    frames._last_id = last
    buffer = RawBuffer(0, came, 0, 1, 1, 0, b"")
    if right:
        assert frames.check(buffer) is buffer
    else:
        with pytest.raises(PhotoError, match=f"frame {came}"):
            frames.check(buffer)
    with pytest.raises(PhotoError, match="not whole"):
        frames.check(RawBuffer(3, 0, 0, 0, 0, 0, b""))
    assert frames.check(buffer) is buffer  # and nobody knows which is due


def test_a_camera_that_goes_on_by_itself_is_not_waited_for() -> None:
    """It never is quiet; who cancels is heard all the same."""
    asked: list[float] = []

    def pop(wait_s: float) -> RawBuffer:
        asked.append(wait_s)
        return RawBuffer(0, len(asked), 0, 1, 1, 0, b"")

    device: Any = SimpleNamespace(pop=pop)
    with pytest.raises(ExposureError, match="frames keep coming without a request"):
        FrameReceiver(device, Patience(VirtualClock())).forget(0.3)
    assert len(asked) == 100
    asked.clear()
    heard = Patience(VirtualClock(), cancelled=lambda: len(asked) > 1)
    with pytest.raises(Cancelled):
        FrameReceiver(device, heard).forget(0.3)
    assert len(asked) == 2


def test_panels_that_outlast_the_exposure_make_it_a_lost_one() -> None:
    with taking(margin_s=0.05, margin=0.0) as (_, camera, film, clock):
        for late_s, fits in ((0.04, True), (0.06, False), (0.0, True)):
            camera.arm(SETTINGS)
            open_ns = camera.begin()
            clock.sleep_until_ns(open_ns + round((0.02 + late_s) * 1e9))
            camera.end()
            if fits:
                assert np.array_equal(camera.fetch(60.0).samples, film.last)
            else:
                with pytest.raises(PhotoError, match="panels"):
                    camera.fetch(60.0)


def test_a_cancel_is_heard_while_a_frame_is_waited_for() -> None:
    with taking(ready=False) as (virtual, camera, film, clock):
        cancelled: list[bool] = []
        camera._patience = Patience(clock, cancelled=lambda: bool(cancelled))
        shoot(camera)
        virtual.faults.silent = True
        camera.arm(SETTINGS)
        camera.begin()
        clock.sleep_until_ns(clock.now_ns() + 20_000_000)
        camera.end()
        cancelled.append(True)
        with pytest.raises(Cancelled):
            camera.fetch(60.0)
        cancelled.clear()
        virtual.faults.silent = False
        assert np.array_equal(shoot(camera).samples, film.last)


def test_an_exposure_amid_light_is_as_long_as_planned() -> None:
    with taking(ready=False) as (_, camera, film, _):
        camera._moves = lambda: True
        for planned_s in (0.5, 0.25):
            photo = shoot(camera, CameraSettings(100, None, exposure_s=planned_s))
            # It is believed to begin a millisecond later than it may: `trigger` says so.
            assert film.exposures[-1].exposure_s == pytest.approx(planned_s + 0.001, abs=1e-6)
            assert np.array_equal(photo.samples, film.last)


def test_an_exposure_that_is_closed_early_is_given_up() -> None:
    with taking() as (virtual, camera, film, clock):
        camera.arm(CameraSettings(100, None, exposure_s=30.0))
        open_ns = camera.begin()
        clock.sleep_until_ns(open_ns + 1_000_000_000)
        assert camera.end() < open_ns + 2_000_000_000
        with pytest.raises(PhotoError):
            camera.fetch(60.0)
        await_true(lambda: not virtual.exposing)
        assert np.array_equal(shoot(camera).samples, film.last)


def test_what_the_camera_does_not_offer_is_refused_before_there_is_light() -> None:
    with taking(longest_s=10.0) as (_, camera, film, clock):
        taken = len(film.exposures)
        with pytest.raises(ConfigError, match="10 s"):
            camera.arm(CameraSettings(100, None, exposure_s=9.9))
        with pytest.raises(ConfigError, match="ISO 77"):
            camera.arm(CameraSettings(77, None, exposure_s=0.1))
        with pytest.raises(ExposureError, match="armed"):
            camera.fetch(1.0)
        camera.arm(SETTINGS)
        with pytest.raises(ExposureError, match="nothing was exposed"):
            camera.fetch(1.0)
        assert len(film.exposures) == taken
        camera.close("readout")
        for wrong in ({"pixel_format": "Mono12p"}, {"exposure": "width", "line": "Line7"}):
            with pytest.raises(ConfigError):
                client(clock, **wrong).open("readout")


def smooth(exposure: VirtualExposure) -> NDArray[np.uint16]:
    """Light of a 12-bit converter, whatever the format."""
    rng = np.random.default_rng(exposure.open_ns % 1000)
    level = 40.0 if exposure.exposure_s < 1e-3 else np.linspace(100.0, 3000.0, exposure.width)
    noise = rng.normal(0.0, 3.0, (exposure.height, exposure.width))
    return np.asarray(np.rint(level + noise), np.uint16)


@pytest.mark.parametrize("faults", [CameraFaults(swapped=True), CameraFaults(left=4)])
def test_alignment_and_byte_order_are_found(faults: CameraFaults) -> None:
    clock = VirtualClock()
    with hosted("Mono16", film=smooth, clock=clock) as virtual:
        virtual.faults = faults
        camera = client(clock)
        photo = shoot(camera)
        scale = 1 << faults.left
        assert photo.samples.max() < 3100 * scale and photo.black == pytest.approx(40 * scale, 9)
        assert photo.white == (65520 if faults.left else 65535)
        assert photo.record.get("ByteOrder") == ("swapped" if faults.swapped else None)
        camera.close("readout")


@pytest.mark.parametrize("active_low", [False, True])
def test_a_line_holds_the_exposure(active_low: bool) -> None:
    film, clock = Sheets(), VirtualClock()
    with hosted("Mono8", film=film, clock=clock) as virtual:
        virtual.hold_line(active_low)
        camera = client(clock, exposure="width", active_low=active_low)
        for seconds in (0.5, 0.25):
            camera.arm(SETTINGS)
            virtual.hold_line(not active_low)
            await_true(lambda: virtual.exposing)
            clock.sleep_until_ns(clock.now_ns() + round(seconds * 1e9))
            virtual.hold_line(active_low)
            photo = camera.fetch(60.0)
            assert np.array_equal(photo.samples, film.last)
            assert film.exposures[-1].exposure_s == pytest.approx(seconds)
            assert abs(blacks(photo)[0] - BLACK_DN) <= 1
        camera.close("readout")


def test_an_edge_starts_the_exposure() -> None:
    film, clock = Sheets(), RealClock()
    with hosted("Mono8", film=film, clock=clock) as virtual:
        camera = client(clock, exposure="edge", margin_s=0.01, margin=0.0, wait_s=0.5)
        camera.arm(SETTINGS)
        armed_ns = camera.begin()
        virtual.hold_line(True)
        assert camera.end() > armed_ns
        assert np.array_equal(camera.fetch(60.0).samples, film.last)
        camera.arm(SETTINGS)
        camera.begin()
        camera.end()  # no edge came
        with pytest.raises(PhotoError, match="no frame"):
            camera.fetch(60.0)
        camera.arm(SETTINGS)
        camera.expect(30.0)
        begun_s = time.monotonic()
        camera.begin()
        virtual.hold_line(False)
        virtual.hold_line(True)
        camera.end()  # long before its time
        with pytest.raises(PhotoError, match="given up before its time"):
            camera.fetch(60.0)
        assert time.monotonic() - begun_s < 30.0
        camera.close("readout")


def test_the_doctor_says_what_was_found_and_exposes_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("drivers.genicam.doctor._RMEM", Path("/dev/null"))
    config = Config(
        rig=RigConfig(clock="real"),
        camera=CameraConfig(driver="genicam", options={"camera": "V1"}),
        trigger=TriggerConfig(driver="genicam"),
    )
    film, clock = Sheets(), VirtualClock()
    with hosted("BayerGB12p", film=film, clock=clock) as virtual:
        found = list(examine_genicam(DriverContext(config=config, clock=clock)))
        told = {finding.what: finding.found for finding in found}
        assert not [finding for finding in found if finding.state == "fault"]
        assert "virtual GenICam V1 at 127.0.0.1" in told["camera that answers"]
        assert told["picture"] == "64 x 48 pixels of BayerGB12p"
        assert told["ISO"] == "100, 200, 400, 800" and told["white level"] == "4095 DN"
        states = {finding.what: finding.state for finding in found}
        assert states["packets"] == "warning" and states["net.core.rmem_max"] == "unknown"
        assert virtual.exposures == 0
        camera = client(clock)
        camera.open("readout")
        (*_, last) = examine_genicam(DriverContext(config=config, clock=clock))
        assert last.state == "fault" and "held by another program" in last.found
        camera.close("readout")
    with turn():
        (*_, last) = examine_genicam(DriverContext(config=config, clock=clock))
        assert last.state == "fault" and "V1" in last.found


@needs_stock
@pytest.mark.parametrize("frames", [20, pytest.param(100, marks=pytest.mark.long)])
def test_every_frame_of_somebody_elses_camera_is_whole_or_taken_again(frames: int) -> None:
    with stock():
        # It makes its frames when it likes; on a clock of ours no exposure is ever late.
        camera = client(VirtualClock(), region=(0, 0, 64, 48), wait_s=1.0)
        settings = CameraSettings(100, None, exposure_s=0.001)
        right = failed = 0
        numbers = []
        while right < frames:
            try:
                photo = shoot(camera, settings)
            except PhotoError:
                failed += 1
                assert failed < 20
                continue
            right += 1
            numbers.append(int(photo.record["FrameID"]))
            assert photo.samples.shape == (48, 64) and photo.cfa == "BGGR"
        assert len(set(numbers)) == frames
        assert camera.device.identity["vendor"] == "Aravis"
        camera.close("readout")
