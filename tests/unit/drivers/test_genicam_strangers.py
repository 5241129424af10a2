"""Cameras that name, count and offer things otherwise than ours: by the same simulator, with its
description changed as such cameras have it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element, SubElement, fromstring, register_namespace, tostring

import numpy as np
import pytest

from drivers.genicam.aravis import RawBuffer
from drivers.genicam.camera import GenicamCamera
from drivers.genicam.frames import FrameReceiver
from drivers.genicam.pixels import BY_NAME
from drivers.virtual_genicam import camera as virtual_camera
from drivers.virtual_genicam.camera import VirtualGenicamCamera
from drivers.virtual_genicam.description import CameraDescription, write_description
from pdcd.bench.clock import RealClock, VirtualClock
from pdcd.driver import CameraSettings, Clock, ExposureError, Patience
from tests.genicam_rig import Sheets, client, hosted, needs_aravis, shoot

pytestmark = needs_aravis

SCHEMA = "http://www.genicam.org/GenApi/Version_1_1"
Change = Callable[[Element], object]


def node(root: Element, name: str) -> Element:
    return next(found for found in root if found.get("Name") == name)


def part(found: Element, tag: str) -> Element:
    inside = found.find(f"{{{SCHEMA}}}{tag}")
    return SubElement(found, f"{{{SCHEMA}}}{tag}") if inside is None else inside


def drop(root: Element, *names: str) -> None:
    """Such a camera has no such features."""
    for name in names:
        root.remove(node(root, name))
        for parent in list(root):
            for inside in list(parent):
                if inside.tag.endswith("pFeature") and inside.text == name:
                    parent.remove(inside)


def rename(root: Element, name: str, other: str) -> None:
    node(root, name).set("Name", other)
    for inside in root.iter(f"{{{SCHEMA}}}pFeature"):
        if inside.text == name:
            inside.text = other


def make_whole(root: Element, name: str, low: int, high: int) -> None:
    """A float becomes a whole number, as its register has it."""
    found = node(root, name)
    found.tag = f"{{{SCHEMA}}}Integer"
    part(found, "pValue").text = f"{name}Register"
    part(found, "Min").text, part(found, "Max").text = str(low), str(high)


def lock(root: Element, name: str) -> None:
    """Only to be read."""
    part(node(root, f"{name}Register"), "AccessMode").text = "RO"


def say_selected(root: Element, name: str, *entries: str) -> None:
    """An enumeration has these entries, and no others."""
    found = node(root, name)
    for inside in list(found):
        if inside.tag.endswith("EnumEntry"):
            found.remove(inside)
    for number, entry in enumerate(entries):
        inside = Element(f"{{{SCHEMA}}}EnumEntry", {"Name": entry, "NameSpace": "Standard"})
        SubElement(inside, f"{{{SCHEMA}}}Value").text = str(number)
        found.insert(number, inside)


def old_names(root: Element) -> None:
    rename(root, "ExposureTime", "ExposureTimeAbs")
    make_whole(root, "Gain", 0, 2400)
    rename(root, "Gain", "GainRaw")
    drop(root, "BlackLevel", "AcquisitionStatus", "AcquisitionStatusSelector", "DeviceTemperature")


def whole_numbers(root: Element) -> None:
    make_whole(root, "ExposureTime", 19, 10_000_000)
    make_whole(root, "BlackLevel", 0, 255)


def locked(root: Element) -> None:
    lock(root, "GainAuto")
    lock(root, "ExposureAuto")


def gain_as_factor(root: Element) -> None:
    part(node(root, "Gain"), "Min").text, part(node(root, "Gain"), "Max").text = "1.0", "8.0"


def gain_as_factor_in_db(root: Element) -> None:
    """A camera that begins at 3 dB says so."""
    part(node(root, "Gain"), "Min").text, part(node(root, "Gain"), "Max").text = "3.0", "14.0"
    node(root, "Gain").append(Element(f"{{{SCHEMA}}}Unit"))
    part(node(root, "Gain"), "Unit").text = "dB"


@contextmanager
def changed(
    change: Change, monkeypatch: pytest.MonkeyPatch, name: str, film: Sheets, clock: Clock
) -> Iterator[tuple[VirtualGenicamCamera, GenicamCamera]]:
    """Such a camera, and the driver's."""
    register_namespace("", SCHEMA)

    def write(description: CameraDescription) -> bytes:
        root = fromstring(write_description(description))
        change(root)
        return b"<?xml version='1.0'?>" + tostring(root)

    monkeypatch.setattr(virtual_camera, "write_description", write)
    with hosted(name, film=film, clock=clock, white=4095) as virtual:
        camera = client(clock)
        yield virtual, camera
        camera.close("readout")


@dataclass
class Stranger:
    """change : of the description. isos : that it offers. gains_db : that the simulator is set to
    for each, in hundredths. record : what its photos tell. silent : it does not tell that it waits
    for a trigger, so that its exposures need a clock that goes by itself."""

    change: Change
    isos: tuple[int, ...] = (100, 200, 400, 800)
    gains_cdb: tuple[int, ...] = (0, 602, 1204, 1806)
    record: set[str] = field(default_factory=lambda: {"ExposureTime", "Gain", "BlackLevel"})
    silent: bool = False


STRANGERS = {
    "old names, and gain in steps": Stranger(
        old_names, (100,), (0,), record={"ExposureTimeAbs"}, silent=True
    ),
    "gain in steps by its new name": Stranger(
        lambda root: make_whole(root, "Gain", 48, 512), (100,), (48,),
        record={"ExposureTime", "BlackLevel"},
    ),
    "gain as a factor": Stranger(gain_as_factor, gains_cdb=(100, 200, 400, 800)),
    "gain that begins above nothing": Stranger(gain_as_factor_in_db, (200, 400), (602, 1204)),
    "no gain": Stranger(
        lambda root: drop(root, "Gain"), (100,), (0,), record={"ExposureTime", "BlackLevel"}
    ),
    "times and black in whole numbers": Stranger(
        whole_numbers
    ),
    "a shortest exposure that is no round number of seconds": Stranger(
        lambda root: setattr(part(node(root, "ExposureTime"), "Min"), "text", "19.0")
    ),
    "automatics that may not be written, and are off": Stranger(
        locked
    ),
    "another trigger's name": Stranger(
        lambda root: say_selected(root, "TriggerSelector", "AcquisitionStart")
    ),
    "no selector of triggers": Stranger(lambda root: drop(root, "TriggerSelector")),
    "it tells of another wait": Stranger(
        lambda root: say_selected(root, "AcquisitionStatusSelector", "AcquisitionActive"),
        silent=True,
    ),
    "no mode of exposures": Stranger(lambda root: drop(root, "ExposureMode")),
}  # fmt: skip


@pytest.mark.parametrize("name", STRANGERS)
def test_a_stranger_takes_photos(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    stranger, film = STRANGERS[name], Sheets()
    clock = RealClock() if stranger.silent else VirtualClock()
    with changed(stranger.change, monkeypatch, "BayerRG12Packed", film, clock) as (_, camera):
        device = camera.open("readout")
        assert device.isos == stranger.isos
        assert not device.unset
        for iso, gain_cdb in zip(stranger.isos, stranger.gains_cdb, strict=True):
            photo = shoot(camera, CameraSettings(iso, None, exposure_s=0.02))
            assert np.array_equal(photo.samples, film.last) and photo.iso == iso
            assert round(100.0 * film.exposures[-1].gain_db) == gain_cdb
            assert film.exposures[-1].exposure_s == pytest.approx(photo.exposure_s, abs=1e-6)
            assert stranger.record <= set(photo.record)


def test_automatics_that_stay_on_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def locked_on(root: Element) -> None:
        lock(root, "GainAuto")
        say_selected(root, "GainAuto", "Continuous", "Off")

    with changed(locked_on, monkeypatch, "Mono8", Sheets(), VirtualClock()) as (_, camera):
        (told,) = camera.open("readout").unset
        assert told.startswith("GainAuto: ")


@pytest.mark.parametrize(("told", "white"), [(255, 4095), (4000, 4095), (0, 4095), (4095, 4095)])
def test_a_white_level_that_is_told_wrong_is_not_believed(
    told: int, white: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    film, clock = Sheets(), VirtualClock()
    with changed(lambda root: None, monkeypatch, "Mono12p", film, clock) as (virtual, camera):
        virtual.description = CameraDescription(64, 48, virtual.description.formats, told)
        virtual.stop()
        virtual.start()
        assert camera.open("readout").levels.white_dn == (told or 4095)
        assert shoot(camera).white == white


def test_frames_with_more_than_their_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Chunks behind the picture are left out; bytes between its lines are not taken for samples."""
    film, clock = Sheets(), VirtualClock()
    with changed(lambda root: None, monkeypatch, "Mono8", film, clock) as (_, camera):
        shoot(camera)
        frames = FrameReceiver(camera.device, Patience(clock))
        code = BY_NAME["Mono8"].code
        data = film.last.astype(np.uint8).tobytes()

        def frame(more: int, *, chunks: bool) -> RawBuffer:
            return RawBuffer(0, 1, 0, 64, 48, code, data + bytes(more), chunks)

        for buffer in (frame(0, chunks=False), frame(3, chunks=False), frame(900, chunks=True)):
            assert np.array_equal(frames.unpack(buffer), film.last)
        with pytest.raises(ExposureError, match=f"{48 * 2} bytes too many"):
            frames.unpack(frame(48 * 2, chunks=False))
