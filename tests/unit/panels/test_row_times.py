"""Dark time and delays of single rows: what they do to the realised matrix and to photos, that they
come back from a run's table, and that no display is given them which does not know them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
import pytest

from pdcd.bench.devices import CameraSettings
from pdcd.bench.exposure_time import with_exposure_times
from pdcd.bench.tables import Config, DisplayConfig, PanelConfig, RigConfig, ScheduleConfig
from pdcd.capture.rig import Rig
from pdcd.codes.make import make_codes
from pdcd.errors import ConfigError, RequestError
from pdcd.panels.balance import catch_up, join_logs
from pdcd.panels.frames import FrameLog, Frames, check_row_times, split_dark_times
from pdcd.panels.lattice import Lattice
from pdcd.panels.schedule import build_frames
from pdcd.planning.make import make_plan
from pdcd.probing.panel import PanelOptics
from pdcd.probing.realised import collect_factors, compute_factors
from pdcd.runs.frame_table import append_frames, read_frame_columns
from tests import bench_rig, oracles
from tests.frame_logs import make_log
from tests.taken import request_of, take

GRID = bench_rig.GRID
MS, US = 1_000_000, 1_000
ROW_HZ = 1.0 / 105e-6
"""Of two DMDs with the shortest planes that their makers allow."""


def plain(window: str = "whole", grid: tuple[int, int] = GRID) -> tuple[Frames, FrameLog]:
    codes = make_codes("balanced", Lattice(grid, window).shape, 8, dual="complement")
    frames = build_frames(bench_rig.pairs(codes), grid, window=window, schedule="none", passes=1)
    return frames, make_log(len(frames), start_ns=MS, refresh_ns=105 * US)


def with_gaps(count: int, gap_us: int, late_us: int = 0) -> FrameLog:
    """Rows with one dark time between any two of them."""
    gap = gap_us * US
    log = make_log(count, start_ns=MS, refresh_ns=105 * US + gap, late_ns=late_us * US)
    return replace(log, dark_s=np.full(count, gap_us * 1e-6), end_ns=log.end_ns - gap)


def seconds(count: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.linspace(0.0, 50e-6, count)


def having(part: Frames | FrameLog, name: str, value: object) -> Any:
    """The same with one field changed."""
    changed: Any = {name: value}
    return replace(part, **changed)


@pytest.mark.parametrize("skew_us", [-10, 0, 2, 10])
@pytest.mark.parametrize("dark", ["none", "each its own", "longer than a row"])
@pytest.mark.parametrize("window", ["whole", "quarter"])
def test_the_matrix_of_dark_times_equals_the_dense_evaluation(
    window: str, dark: str, skew_us: int
) -> None:
    frames, log = plain(window, (2, 3))
    count = len(log)
    times = {"none": np.zeros(count), "each its own": seconds(count)}
    log = replace(log, dark_s=times.get(dark, np.full(count, 50e-6)))
    if dark == "longer than a row":
        assert log.dark_s is not None
        log.dark_s[3] = 105e-6
    primal, dual = PanelOptics(2e-6, 3e-6, 1 / 2000), PanelOptics(3e-6, 4e-6, 1 / 800, skew_us * US)
    close_ns = int(log.end_ns[0]) + MS
    got = collect_factors(compute_factors(frames, log, primal, dual, open_ns=0, close_ns=close_ns))
    fine = 4 if window == "quarter" else 1
    lit = oracles.timeline(frames, log, primal, 0, True, fine)
    seen = oracles.timeline(frames, log, dual, 0, False, fine)
    pairs = oracles.pair_integrals(lit, seen, primal, dual, close_ns * 1e-9)
    want, coaxial = oracles.to_cells(pairs, (2, 3), fine)
    assert np.abs(got.dense() - want).max() <= 1e-12 * want.max()
    assert np.abs(got.coaxial - coaxial).max() <= 1e-12 * want.max()


@pytest.mark.parametrize("skew_us", [0, 2, 10])
@pytest.mark.parametrize("dark_us", [0, 2, 50])
@pytest.mark.parametrize(("rise_us", "jitter_us"), [(0.0, 0.0), (4.0, 0.5)])
def test_photos_of_two_dmds_equal_the_dense_evaluation(
    rise_us: float, jitter_us: float, dark_us: int, skew_us: int, tmp_path: Path
) -> None:
    """Of the mock's panels as two DMDs whose rows begin unevenly: the photo of a scene."""
    optics: dict[str, Any] = {
        "rise_s": 1e-6 * rise_us,
        "fall_s": 1.5e-6 * rise_us,
        "contrast": 1500.0,
    }
    sides = {
        name: PanelConfig(
            (96, 64), refresh_hz=ROW_HZ, jitter_s=1e-6 * jitter_us, skew_s=1e-6 * late_us, **optics
        )
        for name, late_us in (("projector", 0), ("mask", skew_us))
    }
    config = bench_rig.config(tmp_path, grid=(2, 3), display=DisplayConfig(row_times=True), **sides)
    frames = replace(plain(grid=(2, 3))[0], dark_s=np.full(8, 1e-6 * dark_us))
    rig = Rig(config)
    rig.connect()
    rig.display.load(frames)
    rig.readout.arm(CameraSettings(100, 8.0))
    rig.clock.sleep_until_ns(rig.shutter.open() + 50 * MS)
    rig.display.play(lambda *_: None, lambda: False)
    rig.clock.sleep_until_ns(rig.clock.now_ns() + 50 * MS)
    rig.shutter.close()
    bench = bench_rig.bench_of_rig(rig)
    assert bench.log is not None and bench.open_ns is not None and bench.close_ns is not None
    uneven = np.ptp(np.diff(bench.log.dual_ns)) > 0
    assert uneven == (jitter_us > 0.0)
    primal, dual = (PanelOptics.from_config(sides[name]) for name in ("projector", "mask"))
    lit = oracles.timeline(frames, bench.log, primal, bench.open_ns, True, 1)
    seen = oracles.timeline(frames, bench.log, dual, bench.open_ns, False, 1)
    exposure_s = (bench.close_ns - bench.open_ns) * 1e-9
    cells, coaxial = oracles.to_cells(
        oracles.pair_integrals(lit, seen, primal, dual, exposure_s), frames.grid, 1
    )
    scene = bench_rig.transport(frames.grid)
    off = scene - np.diag(np.diag(scene))
    want = (cells * off).sum(axis=1) + coaxial * np.diag(scene)
    assert np.abs(bench.photo()[:, 0] - want).max() <= 1e-12 * want.max()


def test_a_dark_time_as_long_as_the_mask_is_late_keeps_all_direct_light_out() -> None:
    frames, _ = plain()
    for late_us, dark_us, kept_out in ((0, 0, True), (2, 0, False), (2, 2, True), (10, 9, False)):
        log = with_gaps(len(frames), dark_us, late_us)
        close_ns = int(log.end_ns[1]) + MS
        optics = PanelOptics()
        chunks = compute_factors(frames, log, optics, optics, open_ns=0, close_ns=close_ns)
        assert bool(collect_factors(chunks).coaxial.max() == 0.0) is kept_out


def test_dark_times_become_black_rows_that_nobody_asked_for() -> None:
    _, log = plain()
    dark = np.zeros(len(log))
    dark[2] = dark[5] = 20e-6
    split = split_dark_times(having(log, "dark_s", dark))
    assert len(split) == len(log) + 2 and split.dark_s is None
    assert split.primal_shown.tolist() == [0, 1, 2, -1, 3, 4, 5, -1, 6, 7]
    assert split.asked[1].tolist() == split.primal_shown.tolist()
    assert (np.diff(split.dual_ns)[[2, 3]] == [85 * US, 20 * US]).all()
    assert split_dark_times(log).primal_ns is log.primal_ns


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


@pytest.mark.parametrize("dark_us", [0, 20, 90])
def test_a_row_that_was_shown_twice_is_made_up_for_whatever_the_dark_time(dark_us: int) -> None:
    frames, _ = plain()
    log = with_gaps(len(frames), dark_us)
    assert catch_up(frames, log, ROW_HZ) is None
    late = np.where(np.arange(len(log)) > 3, 105 * US, 0)
    stretched = replace(
        log,
        primal_ns=log.primal_ns + late,
        dual_ns=log.dual_ns + late,
        end_ns=log.end_ns + 105 * US,
    )
    rows = catch_up(frames, stretched, ROW_HZ)
    assert rows is not None and rows.tolist() == [0, 1, 2, 4, 5, 6, 7]


def test_they_come_back_from_the_table_of_a_run(tmp_path: Path) -> None:
    frames, log = plain()
    table = tmp_path / "frames.csv"
    append_frames(table, "white", frames, having(log, "dark_s", seconds(len(log))))
    append_frames(table, "coded", frames, having(log, "dark_s", np.zeros(len(log))))
    dark_ns = read_frame_columns(table)["dark_ns"]
    expected = [*np.rint(1e9 * seconds(len(log))), *np.zeros(len(log))]
    assert dark_ns.tolist() == expected
    without = tmp_path / "without.csv"
    append_frames(without, "white", frames, log)
    assert "dark" not in without.read_text()


@pytest.mark.parametrize("name", ["dark_s", "delay_s"])
def test_a_display_that_does_not_know_them_is_never_given_them(tmp_path: Path, name: str) -> None:
    rig = Rig(bench_rig.config(tmp_path))
    rig.connect()
    frames = having(plain()[0], name, seconds(8))
    for part in plain():
        assert getattr(part, name) is None
        check_row_times(part)
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


def dmds(folder: Path, *, late_us: float, guards: str, rise_us: float = 0.0) -> Config:
    """Two DMDs that show loaded patterns, the mask's so much later."""
    fitting = bench_rig.fitting(GRID)
    projector, mask = (
        PanelConfig(
            fitting[side].size_px,
            refresh_hz=ROW_HZ,
            rise_s=1e-6 * rise_us,
            fall_s=1e-6 * rise_us,
            skew_s=1e-6 * skew_us,
        )
        for side, skew_us in (("projector", 0.0), ("mask", late_us))
    )
    return bench_rig.config(
        folder,
        projector=projector,
        mask=mask,
        display=DisplayConfig(row_times=True),
        schedule=ScheduleConfig(codes=8, guards=guards),  # type: ignore[arg-type]
        rig=RigConfig(settle_s=0.001),
    )


def test_a_plan_takes_a_dark_time_as_long_as_the_mask_is_late(tmp_path: Path) -> None:
    def planned(guards: str, late_us: float, rise_us: float = 0.0, lag: bool = True) -> Any:
        config = dmds(tmp_path, late_us=late_us, guards=guards, rise_us=rise_us)
        return make_plan(request_of(), config, GRID, 1e-6 * late_us if lag else None)

    assert planned("auto", 10.0).dark_s == pytest.approx(10e-6)
    assert planned("auto", -10.0).dark_s == pytest.approx(10e-6)
    slow = planned("auto", 10.0, 5.0)
    tail_s = 5e-6 * np.log(5e-6 / (0.005 * 105e-6))
    assert slow.dark_s == pytest.approx(10e-6 + 2 * tail_s)
    assert slow.schedule == "none"
    coded = next(shot for shot in slow.recipe.shots if not shot.white)
    rows = slow.refreshes(coded)
    assert slow.exposure_s(coded) == pytest.approx(rows * (105e-6 + slow.dark_s) + 0.002)
    assert planned("auto", 10.0, lag=False).dark_s == 0.0  # nobody knows how long: refreshes do
    assert planned("dark", 10.0, lag=False).dark_s == pytest.approx(105e-6)
    far = planned("auto", 104.0, 30.0)  # a dark time longer than a row costs more than a row
    assert far.dark_s == 0.0 and far.schedule == "wide"
    config = msgspec.structs.replace(
        dmds(tmp_path, late_us=0.0, guards="dark"), display=DisplayConfig()
    )
    with pytest.raises(RequestError, match="no dark time"):
        make_plan(request_of(), config, GRID, 0.0)


@pytest.mark.parametrize(
    ("late_us", "guards", "worst"),
    [(0.0, "none", 1e-9), (2.0, "auto", 1e-9), (10.0, "auto", 1e-9), (-10.0, "auto", 1e-9)],
)
def test_a_photo_of_two_dmds_is_right_by_the_dark_time_that_was_planned(
    tmp_path: Path, late_us: float, guards: str, worst: float
) -> None:
    """Without noise, and of a mask that leaks nothing: what is left of direct light is none."""
    config = dmds(tmp_path, late_us=late_us, guards=guards)
    photo = take(config, codes=8, pilot=0, parts=1)
    table = read_frame_columns(photo.folder / "frames.csv")
    assert set(table["dark_ns"].tolist()) <= {0, round(abs(late_us) * 1000)}
    assert photo.manifest.realised["coded"]["diagonal_max"] <= worst
    assert photo.decodes_the_same()


def test_dark_time_counts_in_the_planned_exposure() -> None:
    frames, _ = plain()
    config, settings = Config(), CameraSettings(100, 8.0)
    bare = with_exposure_times(settings, config, frames, 60.0).exposure_s
    dark = with_exposure_times(settings, config, replace(frames, dark_s=np.full(8, 0.25)), 60.0)
    assert bare is not None and dark.exposure_s == pytest.approx(bare + 2.0)
    slower = with_exposure_times(settings, config, frames, 30.0).exposure_s
    settle_s = 2.0 * config.rig.settle_s
    assert slower == pytest.approx(2.0 * (bare - settle_s) + settle_s)
    assert bare == pytest.approx(len(frames) / 60.0 + settle_s)


def test_an_exposure_that_is_balanced_may_last_as_long_as_its_retries() -> None:
    """Its guardian must not end it while codes that were missed are shown again."""
    frames, _ = plain()
    cases: tuple[tuple[Literal["balance", "abort"], int], ...] = (("balance", 3), ("abort", 1))
    for on_miss, passes in cases:
        config = Config(rig=RigConfig(on_miss=on_miss, retries=2))
        settings = with_exposure_times(CameraSettings(100, 8.0), config, frames, 60.0)
        assert settings.exposure_s is not None and settings.longest_s is not None
        shown_s = settings.exposure_s - 2.0 * config.rig.settle_s
        assert settings.longest_s > settings.exposure_s + (passes - 1) * shown_s
        assert settings.longest_s - (settings.exposure_s + (passes - 1) * shown_s) < 40.0


@pytest.mark.parametrize("refresh_hz", [0.0, -60.0, float("nan"), float("inf")])
def test_a_display_that_does_not_know_its_refresh_rate_is_taken_as_configured(
    refresh_hz: float,
) -> None:
    frames, _ = plain()
    config, settings = Config(), CameraSettings(100, 8.0)
    assert with_exposure_times(settings, config, frames, refresh_hz) == with_exposure_times(
        settings, config, frames, None
    )
