"""A frame that cannot show the cells ends the run before its first exposure, or after it; so does
a photo that is unlike the first."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from drivers.ptp.eos import EosCamera
from drivers.virtual_camera import BULB_BODY, CameraBody, VirtualUsb
from pdcd.bench.tables import CameraConfig, Config, TriggerConfig
from pdcd.capture.engine import Engine
from pdcd.errors import ConfigError
from pdcd.panels.map import Map
from pdcd.panels.placing import Placing
from pdcd.protocol.events import Event, ShutterOpen
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from tests import bench_rig
from tests.placed_film import PlacedFilm, Shot, masked_dng

FAR = Placing(offset_px=(5000.0, 0.0))
PART = Placing(scale=0.5)
TURNED = Placing(turn_deg=20.0)


def ptp(folder: Path, place: Placing) -> Config:
    camera = CameraConfig(
        driver="ptp", noise="none", f_number=8.0, place=place, options={"usb": "virtual"}
    )
    return bench_rig.config(folder, camera=camera, trigger=TriggerConfig(driver="ptp"))


def take(
    config: Config, film: dict[str, Any] | None = None, **fields: Any
) -> tuple[CaptureResult, int]:
    """The result, and how often the shutter opened."""
    engine, opened = Engine.from_config(config), []
    if film is not None:
        context = engine._rig._context
        placed = PlacedFilm(context, Map.filling(film.pop("size", (4, 3))), **film)
        body = CameraBody(context.clock, placed, replace(BULB_BODY, apertures=()))
        EosCamera.of(context).session._backend = VirtualUsb(body)

    def emit(event: Event) -> None:
        if isinstance(event, ShutterOpen):
            opened.append(event.shot)

    request = msgspec.convert({"goal": "indirect", "codes": 8, **fields}, CaptureRequest)
    engine.start()
    try:
        result = engine.capture(request, job="job", emit=emit, cancelled=lambda: False)
    finally:
        engine.stop()
    return result, len(opened)


CASES = [
    (PART, {"size": (40, 30)}, "% of the cells, less than 50 %"),
    (TURNED, {"size": (6, 4)}, "does not resolve its quarter windows"),
    (Placing(), {"size": (3, 3)}, "does not resolve single cells"),
]


@pytest.mark.parametrize(("place", "film", "words"), CASES)
def test_a_frame_that_does_not_fit_ends_the_run_after_one_shot(
    tmp_path: Path, place: Placing, film: dict[str, Any], words: str
) -> None:
    result, opened = take(ptp(tmp_path, place), dict(film), window="quarter")
    assert result.error is not None and words in str(result.error["message"])
    assert (result.error["kind"], result.error["device"]) == ("config", "camera")
    assert opened == 1


def test_a_camera_that_looks_elsewhere_is_no_rig(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="beside the field"):
        Engine.from_config(ptp(tmp_path, FAR))


@pytest.mark.parametrize("place", [PART, TURNED])
def test_a_frame_that_is_known_is_refused_before_any_light(tmp_path: Path, place: Placing) -> None:
    camera = CameraConfig(noise="none", f_number=8.0, place=place)
    result, opened = take(bench_rig.config(tmp_path, camera=camera), window="quarter")
    assert result.error is not None and result.error["kind"] == "config"
    assert opened == 0 and result.folder is None


def resized(number: int, shot: Shot) -> Shot:
    return shot if number < 2 else replace(shot, samples=shot.samples[:-2])


def turned(number: int, shot: Shot) -> Shot:
    return shot if number < 2 else replace(shot, orientation=6)


def swapped(number: int, shot: Shot) -> Shot:
    return shot if number < 2 else replace(shot, model="another camera")


@pytest.mark.parametrize(
    ("change", "words", "encode"),
    [
        (resized, "its size is 32 x 23 quads, not 32 x 24 quads", masked_dng),
        (turned, "its orientation is turned by 90 right, not upright", masked_dng),
        (swapped, "its camera is another camera, not test camera", None),
    ],
)
def test_a_photo_unlike_the_first_ends_the_run_at_once(
    tmp_path: Path, change: Any, words: str, encode: Any
) -> None:
    film = {"size": (32, 24), "change": change, **({} if encode is None else {"encode": encode})}
    result, opened = take(ptp(tmp_path, Placing()), film, black_level="both")
    assert result.error is not None and result.error["kind"] == "exposure"
    assert words in str(result.error["message"]) and "raw/white" in str(result.error["message"])
    assert opened == 2
    assert str(result.summary["taken"]).startswith("1 of 8 shots, missing: ")
