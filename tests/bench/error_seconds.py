"""Error of the indirect image over the seconds of exposure, by codes and by their rivals."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec

from pdcd.capture.engine import Engine
from pdcd.protocol.request import CaptureRequest
from pdcd.virtual.scene.presets import PRESETS
from pdcd.words import FamilyName
from tests.bench import plots
from tests.bench.captures import capture_with, config_for
from tests.bench.code_error import FAMILIES, FIRST, MATRICES
from tests.bench.tables import Section, Table, percent
from tests.taken import started

SCENES = (*MATRICES, *PRESETS)
RIVALS = ("multi-image", "nayar")
WAYS = (*FAMILIES, *RIVALS)
SECONDS = (0.8, 3.2, 12.8)
REFRESHES_PER_S = 60.0
MOST_PHOTOS = 64
"""Of the multi-image method: each is one more RAW file."""

Noise = Literal["none", "full"]
Found = dict[tuple[str, Noise, str, float], "Point"]
"""(scene, noise, way, wanted seconds) -> what one capture gave."""


@dataclass(frozen=True)
class Point:
    """One capture: RMS error over the RMS of the true image, seconds exposed, RAW files."""

    error: float
    exposure_s: float
    raw_files: int


def run(*, quick: bool, folder: Path) -> Section:
    """Take all captures, with the noise of the sensor and without."""
    scenes = SCENES[:1] if quick else SCENES
    found: Found = {}
    for scene in scenes:
        for way in WAYS:
            found.update(_captures(scene, way))
    _plot(found, folder / "error-seconds.png")
    longest = SECONDS[-1]
    gains = {
        way: [found[s, "full", way, longest].error for s in scenes] for way in ("hadamard", *RIVALS)
    }
    wins = {
        rival: sum(a < b for a, b in zip(gains["hadamard"], gains[rival], strict=True))
        for rival in RIVALS
    }
    photos = found[scenes[0], "full", "multi-image", longest].raw_files
    few = found[scenes[0], "full", "nayar", longest].raw_files
    return Section(
        title="Error of the indirect image over the exposure",
        text=(
            "Whole captures on the mock bench: RAW files, decoding, and all. Codes get three "
            "refreshes each (guards) and fill the time, so twice the time is twice the codes. The "
            "rivals need no guards, as the mask stays open: `multi-image` takes one RAW file for "
            f"each of up to {MOST_PHOTOS} Hadamard codes and masks them in software, `nayar` takes "
            "one for each place of a shifted checker. Each way has the aperture that fills the "
            f"sensor at {longest:g} s and keeps it for shorter times. Times are those for which "
            "the shutter was open, which opens and closes on black panels around each RAW file. "
            f"In this run, with full sensor noise at {longest:g} s, one photo of `hadamard` codes "
            f"was better than `multi-image` ({photos} RAW files) on {wins['multi-image']} and "
            f"better than `nayar` ({few} RAW files) on {wins['nayar']} of {len(scenes)} scenes. "
            "With light to spare, many RAW files fill the sensor many times over, which one photo "
            "cannot; where sharp paths or few codes set the error, they gain nothing."
        ),
        tables=[_table(found, "full", "With full sensor noise"), _table(found, "none", "Without")],
        plots=[
            ("error-seconds.png", "Solid: full sensor noise; dotted: none, the error of the way.")
        ],
    )


def _captures(scene: str, way: str) -> Iterator[tuple[tuple[str, Noise, str, float], Point]]:
    """The longest capture first: it finds the aperture that all others of its kind keep."""
    f_number: float | Literal["auto"] = "auto"
    levels: tuple[Noise, ...] = ("full", "none")
    for noise in levels:
        for seconds in reversed(SECONDS):
            config = config_for(scene)
            camera = msgspec.structs.replace(config.camera, noise=noise, f_number=f_number)
            with started(msgspec.structs.replace(config, camera=camera)) as engine:
                point, used = _point(engine, _request(way, seconds))
            f_number = used
            yield (scene, noise, way, seconds), point


def _request(way: str, seconds: float) -> CaptureRequest:
    refreshes = seconds * REFRESHES_PER_S
    if way not in RIVALS:
        codes = round(refreshes / 3)
        family = msgspec.convert(way, FamilyName)
        return CaptureRequest(
            goal="indirect", codes=codes, family=family, white=False, pilot=0, parts=1
        )
    asked = {"goal": "indirect", "method": way, "white": False, "guards": False}
    asked["codes"] = min(round(refreshes), MOST_PHOTOS)
    return msgspec.convert({**asked, "exposure_s": seconds}, CaptureRequest)


def _point(engine: Engine, request: CaptureRequest) -> tuple[Point, float]:
    """A capture in figures, and its aperture."""
    with tempfile.TemporaryDirectory() as folder:
        result = capture_with(engine, request, Path(folder), "job")
        manifest = json.loads((Path(str(result.folder)) / "capture.json").read_text())
    figures = (result.summary[key] for key in ("rms_error_quads", "exposure_s", "shots"))
    numbers = [msgspec.convert(figure, float) for figure in figures]
    f_number = float(manifest["run"]["shots"][0]["f_number"])
    return Point(numbers[0], numbers[1], round(numbers[2])), f_number


def _table(found: Found, noise: Noise, title: str) -> Table:
    table = Table(title, ("scene", "time of codes", *WAYS))
    for scene in dict.fromkeys(key[0] for key in found):
        for seconds in SECONDS:
            points = [found[scene, noise, way, seconds] for way in WAYS]
            table.add(scene, f"{seconds:g} s", *(percent(point.error) for point in points))
    return table


def _plot(found: Found, path: Path) -> None:
    scenes = list(dict.fromkeys(key[0] for key in found))
    figure, axes = plots.scene_panels(len(scenes))
    for scene, one in zip(scenes, axes, strict=False):
        for index, way in enumerate(WAYS):
            for noise, style in (("full", f"{plots.marker(index)}-"), ("none", ":")):
                points = [found[scene, noise, way, s] for s in SECONDS]  # type: ignore[index]
                times, errors = zip(*((p.exposure_s, 100.0 * p.error) for p in points), strict=True)
                label = way if noise == "full" else None
                one.plot(times, errors, style, color=plots.colour(index), label=label, markersize=4)
        plots.finish(one, scene, "shutter open in s", "RMS error in %", base=10)
    title = f"codes ({FIRST} as in the paper)"
    plots.legend(*plots.find_room(axes, len(scenes)), title)
    plots.save(figure, path)
