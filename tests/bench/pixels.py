"""Photos at the camera's own pixels: what the mock takes, and what decoding makes of them."""

from __future__ import annotations

import statistics
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pdcd.bench.tables import CameraConfig, Config
from pdcd.panels.placing import Placing
from pdcd.pictures import decode
from pdcd.pictures.darkroom import Darkroom
from pdcd.protocol.request import CaptureRequest
from pdcd.runs.folder import REPORT_FILE, read_manifest
from pdcd.virtual.optics.bench import OpticalBench
from pdcd.virtual.optics.products import PanelExposure
from tests.bench.captures import PDCD, capture_with, config_for
from tests.bench.measure import REPEATS, alone, peak_mib, timed
from tests.bench.photo import SCENE
from tests.bench.tables import Aim, Section, Table, seconds
from tests.taken import started

COUNT, WINDOW = 128, "quarter"
FRAMES = ((480, 640), (1424, 2136))
"""Rows and columns of quads: a RAW file has twice as many samples each way."""
UPRIGHT, TURNED = Placing(), Placing(turn_deg=2.0, scale=1.05, radial=(0.02, 0.0))
PLACES = {"upright": UPRIGHT, "turned, bent": TURNED}
PHOTO_LIMITS_S = (1.0, 15.0)
DECODE_LIMIT_S, DECODE_LIMIT_MIB = 4.0, 1536.0
REPORT_LIMIT_S, REPORT_LIMIT_MB = 3.0, 12.0


def run(*, quick: bool, folder: Path) -> Section:
    """Take and decode captures, each in processes of their own."""
    frames = FRAMES[:1] if quick else FRAMES
    table = Table(
        f"White and indirect shot, {COUNT} codes, {WINDOW} windows",
        (
            "RAW",
            "camera",
            "first photo",
            "next photos",
            "to pictures",
            "peak memory",
            "`pdcd report`",
        ),
    )
    aims = []
    for frame, photo_s in zip(frames, PHOTO_LIMITS_S, strict=False):
        for name in PLACES:
            # The small one is quickly taken, and a first photo happens once in a process.
            found = _middle(
                [_measured(frame, name) for _ in range(REPEATS if frame == FRAMES[0] else 1)]
            )
            size = f"{2 * frame[1]}x{2 * frame[0]}"
            times = (seconds(found[key]) for key in ("first_s", "next_s", "decode_s"))
            page = f"{seconds(found['report_s'])}, {found['report_mb']:.1f} MB"
            table.add(size, name, *times, f"{found['peak_mib']:.0f} MiB", page)
            what = f"RAW {size}, {name}"
            aims.append(Aim(f"mock photo, the first, {what}", "s", found["first_s"], photo_s))
            if frame == FRAMES[-1]:
                aims += [
                    Aim(f"RAW files to pictures, {what}", "s", found["decode_s"], DECODE_LIMIT_S),
                    Aim(f"the same: memory, {what}", "MiB", found["peak_mib"], DECODE_LIMIT_MIB),
                    Aim(f"`pdcd report`, {what}", "s", found["report_s"], REPORT_LIMIT_S),
                    Aim(f"its page, {what}", "MB", found["report_mb"], REPORT_LIMIT_MB),
                ]
    return Section(
        title="The camera's own pixels",
        text=(
            f"The scene `{SCENE}` with all its detail in front of a camera whose pixels no cell of "
            "64x48 divides where it is turned by 2 degrees and bent. The first photo computes what "
            "every pixel sees; the next ones, driven in the same way, use it again. From RAW files "
            "to pictures is everything: read, decoded, error bars, linear files, previews. It is "
            "measured in a process of its own, whose peak memory is told. The report is the whole "
            "command, which decodes anew, with the size of its page. Of 1280x960 three captures "
            "are taken, and the median of each figure is shown."
        ),
        tables=[table],
        aims=aims,
    )


def _measured(frame: tuple[int, int], place: str) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as made:
        found: dict[str, Any] = alone("pixels:take", frame=frame, place=place, folder=made)
        run = found.pop("run")
        found |= alone("pixels:develop", folder=run)
        return found | _reported(run)


def _middle(found: list[dict[str, float]]) -> dict[str, float]:
    return {name: statistics.median(one[name] for one in found) for name in found[0]}


def _reported(folder: str) -> dict[str, float]:
    """Seconds of `pdcd report`, and the size of what it writes."""
    words = [str(PDCD), "report", folder]
    took_s, _ = timed(lambda: subprocess.run(words, capture_output=True, check=True), 1)
    return {"report_s": took_s, "report_mb": 1e-6 * (Path(folder) / REPORT_FILE).stat().st_size}


def config_of(frame: tuple[int, int], place: str) -> Config:
    """The mock bench with such a camera."""
    camera = CameraConfig(frame_quads=(frame[0], frame[1]), place=PLACES[place])
    return msgspec.structs.replace(config_for(SCENE), camera=camera)


def take(frame: tuple[int, int], place: str, folder: str) -> dict[str, Any]:
    """Take a capture; seconds of its first mock photo, the mean of the later coded and white ones
    that were driven like one before, and the folder of the run."""
    taken: dict[object, list[float]] = {}
    photo = OpticalBench.photo

    def timed_photo(self: OpticalBench, exposure: PanelExposure) -> Any:
        begun_s = time.perf_counter()
        found = photo(self, exposure)
        driven = bool(len(exposure.frames.primal_patterns))
        taken.setdefault(driven, []).append(time.perf_counter() - begun_s)
        return found

    request = CaptureRequest(
        goal="indirect", codes=COUNT, window="quarter", seed=1, pilot=0, parts=1
    )
    with pytest.MonkeyPatch.context() as patch, started(config_of(frame, place)) as engine:
        patch.setattr(OpticalBench, "photo", timed_photo)
        result = capture_with(engine, request, Path(folder), "pixels")
    later = [s for times in taken.values() for s in times[1:]]
    return {
        "first_s": max(times[0] for times in taken.values()),
        "next_s": sum(later) / len(later),
        "run": result.folder,
    }


def develop(folder: str) -> dict[str, float]:
    """Seconds and peak MiB from the RAW files of a run to its pictures."""
    begun_s = time.perf_counter()
    record = read_manifest(Path(folder)).run
    decoded = Darkroom(Path(folder), record).decoded()
    with tempfile.TemporaryDirectory() as made:
        for name in ("linear", "preview"):
            (Path(made) / name).mkdir()
        decode.write_pictures(Path(made), decoded)
    return {"decode_s": time.perf_counter() - begun_s, "peak_mib": peak_mib()}
