"""Dark time and delays of single rows: carried where rows are, refused where they are not known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.devices import CameraSettings
from pdcd.bench.exposure_time import with_exposure_times
from pdcd.bench.tables import Config, PanelConfig
from pdcd.capture.rig import Rig
from pdcd.codes.make import make_codes
from pdcd.errors import ConfigError
from pdcd.panels.balance import count_lit_weights, join_logs
from pdcd.panels.frames import FrameLog, Frames, check_row_times
from pdcd.panels.schedule import build_frames
from pdcd.probing.realised import compute_bench_factors
from pdcd.runs.frame_table import append_frames
from pdcd.virtual.optics.bench import OpticalBench
from pdcd.virtual.optics.products import PanelExposure
from pdcd.virtual.scene.build import build_scene
from tests import bench_rig
from tests.frame_logs import make_log

GRID = bench_rig.GRID
PANEL = PanelConfig(size_px=(40, 30))
MS = 1_000_000


def plain() -> tuple[Frames, FrameLog]:
    codes = make_codes("balanced", GRID, 8, dual="complement")
    frames = build_frames(bench_rig.pairs(codes), GRID, window="whole", schedule="both", passes=1)
    return frames, make_log(len(frames), start_ns=0, refresh_ns=16 * MS)


def seconds(count: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.linspace(0.0, 1e-3, count)


def having(part: Frames | FrameLog, name: str, value: object) -> Any:
    """The same with one field changed."""
    changed: Any = {name: value}
    return replace(part, **changed)


@pytest.mark.parametrize("name", ["dark_s", "delay_s"])
def test_times_are_none_unless_somebody_gives_them(name: str) -> None:
    frames, log = plain()
    assert getattr(frames, name) is None and getattr(log, name) is None
    check_row_times(frames, log)
    for part in (frames, log):
        check_row_times(having(part, name, np.zeros(len(part))))
        with pytest.raises(ConfigError, match="of their own"):
            check_row_times(having(part, name, -seconds(len(part))))


def test_passes_that_are_joined_keep_them() -> None:
    _, log = plain()
    count = len(log)
    dark = replace(log, dark_s=seconds(count))
    whole = join_logs([log, dark, replace(log, delay_s=-seconds(count))])
    assert whole.dark_s is not None and whole.delay_s is not None
    none = np.zeros(count)
    gap = np.zeros(1)
    expected = [none, gap, seconds(count), gap, none]
    np.testing.assert_array_equal(whole.dark_s, np.concatenate(expected))
    expected = [none, gap, none, gap, -seconds(count)]
    np.testing.assert_array_equal(whole.delay_s, np.concatenate(expected))
    assert join_logs([log, log]).dark_s is None


def weights(frames: Frames, log: FrameLog, folder: Path) -> object:
    return count_lit_weights(frames, log, 60.0)


def table(frames: Frames, log: FrameLog, folder: Path) -> object:
    append_frames(folder / "frames.csv", "white", frames, log)
    return None


def matrix(frames: Frames, log: FrameLog, folder: Path) -> object:
    return list(compute_bench_factors(frames, log, PANEL, PANEL, open_ns=-MS, close_ns=10**9))


def optics(frames: Frames, log: FrameLog, folder: Path) -> object:
    config = bench_rig.config(folder, projector=PANEL, mask=PANEL)
    bench = OpticalBench(config, build_scene(config.scene), GRID)
    return bench.photo(PanelExposure(frames, log, -MS, 10**9))


Use = Callable[[Frames, FrameLog, Path], object]


@pytest.mark.parametrize("name", ["dark_s", "delay_s"])
@pytest.mark.parametrize("use", [weights, table, matrix, optics])
def test_nobody_passes_over_what_he_does_not_know(use: Use, name: str, tmp_path: Path) -> None:
    frames, log = plain()
    use(frames, log, tmp_path)
    for some in (having(frames, name, seconds(len(frames))), frames):
        other = log if some is not frames else having(log, name, seconds(len(log)))
        with pytest.raises(ConfigError, match="of their own"):
            use(some, other, tmp_path)


def test_a_display_that_does_not_know_them_is_never_given_them(tmp_path: Path) -> None:
    rig = Rig(bench_rig.config(tmp_path))
    rig.connect()
    frames = replace(plain()[0], dark_s=seconds(16))
    with pytest.raises(ConfigError, match="of their own"):
        rig.display.load(frames)
    given: list[Frames] = []
    rig.display.load = given.append  # type: ignore[method-assign,assignment]
    settings = CameraSettings(100, 8.0)

    def expose() -> None:
        rig.expose(
            frames, settings, tmp_path, "photo", notify=lambda _: None,
            progress=lambda *_: None, cancelled=lambda: False,
        )  # fmt: skip

    with pytest.raises(ConfigError, match="of their own"):
        expose()
    assert given == []
    assert rig.display_info is not None
    rig.display_info = replace(rig.display_info, row_times=True)
    with pytest.raises(ConfigError, match="no frames"):  # it goes on to play
        expose()
    assert given == [frames]
    rig.disconnect()


def test_dark_time_counts_in_the_planned_exposure() -> None:
    frames, _ = plain()
    config, settings = Config(), CameraSettings(100, 8.0)
    bare = with_exposure_times(settings, config, frames, 60.0).exposure_s
    dark = with_exposure_times(settings, config, replace(frames, dark_s=np.full(16, 0.25)), 60.0)
    assert bare is not None and dark.exposure_s == pytest.approx(bare + 4.0)
    slower = with_exposure_times(settings, config, frames, 30.0).exposure_s
    settle_s = 2.0 * config.rig.settle_s
    assert slower == pytest.approx(2.0 * (bare - settle_s) + settle_s)
    assert bare == pytest.approx(len(frames) / 60.0 + settle_s)


@pytest.mark.parametrize("refresh_hz", [0.0, -60.0, float("nan"), float("inf")])
def test_a_display_that_does_not_know_its_refresh_rate_is_taken_as_configured(
    refresh_hz: float,
) -> None:
    frames, _ = plain()
    config, settings = Config(), CameraSettings(100, 8.0)
    assert with_exposure_times(settings, config, frames, refresh_hz) == with_exposure_times(
        settings, config, frames, None
    )
