"""Shots out of their files: times, units and matrices; and files that do not belong together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig
from pdcd.errors import DecodeError
from pdcd.panels.map import Map
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.exposed import AmbientLight, ComputedShot
from pdcd.pictures.learn import scale_code_photos
from pdcd.pictures.to_cells import unmix_cells
from pdcd.probing.realised import Factors
from pdcd.protocol.plan_summary import CaptureScheme, Goal
from pdcd.recipes.goals import Target
from pdcd.recipes.make import make_recipe
from pdcd.runs.folder import read_manifest
from pdcd.runs.record import DarkPhoto, RunRecord
from pdcd.sensor import shelf
from pdcd.sensor.cells import CellMap
from pdcd.sensor.raw import RawFrame, read_raw
from pdcd.watch import Watch
from tests import bench_rig
from tests.taken import take


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two photos, of two by two quads a cell."""
    camera = CameraConfig(quads_per_cell=2)
    return take(bench_rig.config(tmp_path_factory.mktemp("run"), camera=camera), codes=8).folder


def record_of(run: Path, **changed: Any) -> RunRecord:
    """What a run remembers, with other values in each of its shots."""
    record = read_manifest(run).run
    shots = tuple(msgspec.structs.replace(shot, **changed) for shot in record.shots)
    return msgspec.structs.replace(record, shots=shots)


def frame_of(run: Path, record: RunRecord, name: str) -> RawFrame:
    (shot,) = (one for one in record.shots if one.name == name)
    return read_raw(
        run / shot.raw, sha256=shot.sha256, saturation_dn=record.profile.saturation_dn(shot.iso)
    )


@pytest.mark.parametrize("level", [1.0, 2.0, None])
def test_light_is_in_scene_units_times_seconds(run: Path, level: float | None) -> None:
    """DN times gain are electrons; over the responsivity, which falls with the square of f; and
    over the level of a shot of which codes were shown more than once."""
    record = record_of(run, level=level, missed=3)
    _, shots = Darkroom(run, record).exposed(Watch())
    assert list(shots) == [shot.name for shot in record.shots]
    for shot in record.shots:
        planes = frame_of(run, record, shot.name).planes.astype(np.float64)
        true = 2.0 ** (round(6.0 * np.log2(shot.f_number)) / 6.0)  # what is engraved stands for it
        gain = record.profile.row(shot.iso).gain_e_per_dn * true**2 / (level or 1.0)
        green = 0.5 * (planes[1] + planes[2])
        colours = np.stack([planes[0], green, planes[3]], axis=-1)
        wanted = gain * colours / np.array(record.responsivity_e)
        found = shots[shot.name]
        np.testing.assert_allclose(found.light, wanted, rtol=1e-5, atol=1e-9)
        # Refreshes that were missed matter where light became unequal.
        assert found.missed == (3 if level is None else 0)


@pytest.mark.parametrize("side", [1, 2])
def test_a_dark_photo_holds_the_light_of_a_second(run: Path, side: int) -> None:
    """As a shot of the same file, over the time of each of its states; by squares of quads where
    pictures are."""
    record = record_of(run)
    shot = record.shots[-1]
    room = Darkroom(run, record)
    room.coarsen(side)
    dark = DarkPhoto(
        raw=shot.raw, sha256=shot.sha256, iso=shot.iso, f_number=shot.f_number,
        exposure_s=(shot.close_ns - shot.open_ns) * 1e-9, phase_s=0.25,
    )  # fmt: skip
    found = room.ambient(dark)
    like = room.exposed(Watch())[1][shot.name]
    np.testing.assert_allclose(found.light, 4.0 * like.light, rtol=1e-6)
    np.testing.assert_allclose(found.variance, 16.0 * like.variance, rtol=1e-6)
    with pytest.raises(DecodeError):
        room.ambient(msgspec.structs.replace(dark, sha256="0" * 64))


def test_ambient_light_is_taken_off_the_photos_of_a_pilot() -> None:
    """For the time for which the mask was open, as far as quads see a cell: what is left is what
    the codes made. Quads that do not divide the cells evenly see two of them."""
    grid, frame = (3, 4), (8, 11)
    cells = CellMap(grid=grid, frame=frame, map=Map.filling((11, 8)))
    rng = np.random.default_rng(5)
    recipe = make_recipe(
        Target(Goal(name="indirect"), grid), CaptureScheme(codes=64, pilot=16, white=False)
    )
    around, none = rng.uniform(1.0, 2.0, (12, 3)), np.zeros(frame, np.bool_)
    bits, clean, shots = rng.random((4, 12)) < 0.5, {}, {}
    for k, name in enumerate(recipe.stack[:4]):
        seconds = 0.5 + 0.1 * k
        factors = Factors(
            np.full((1, 12), seconds),
            bits[k : k + 1].astype(np.float64),
            np.zeros(12),
            np.full(12, seconds),
        )
        own = cells.spread(rng.random((12, 3)))
        one = ComputedShot(own, np.ones((*frame, 3)), none, factors, {})
        clean[name] = one
        shots[name] = replace(one, light=own + seconds * cells.spread(around))
    dark = AmbientLight(cells.spread(around), np.full((*frame, 3), 4.0))
    panels = [shot.realised for shot in clean.values()]
    clear, seen, off = (
        unmix_cells(taken, cells) for taken in (list(clean.values()), list(shots.values()), [dark])
    )
    wanted = scale_code_photos(panels, bits, clear)
    found = scale_code_photos(panels, bits, seen, off)
    np.testing.assert_allclose(found[0], wanted[0], atol=1e-12)
    np.testing.assert_array_equal(found[1], wanted[1])
    # Its noise is that of a second, which is the same in all photos.
    assert wanted[2] is None and found[2] is not None
    np.testing.assert_allclose(found[2], (2.0 * wanted[1][0] * 0.5) ** 2, rtol=1e-9)
    assert not np.allclose(scale_code_photos(panels, bits, seen)[0], wanted[0])


def test_matrices_are_over_the_level_too(run: Path) -> None:
    one = Darkroom(run, record_of(run, level=1.0)).matrices()[1]
    two = Darkroom(run, record_of(run, level=2.0)).matrices()[1]
    for name, shot in one.items():
        ratio = shot.realised.total_s / two[name].realised.total_s
        assert ratio == pytest.approx(2.0)
        np.testing.assert_allclose(shot.realised.open_s, 2.0 * two[name].realised.open_s)


def test_light_past_late_and_slow_panels_is_over_the_level_too(run: Path) -> None:
    def coded_of(level: float) -> Any:
        record = record_of(run, level=level)
        slow = msgspec.structs.replace(record.mask, rise_s=2e-3, fall_s=4e-3)
        return Darkroom(run, msgspec.structs.replace(record, mask=slow)).matrices()[1]["coded"]

    one, two = coded_of(1.0), coded_of(2.0)
    for name in ("crossed", "slow"):
        found = np.array(getattr(one, name))
        assert found.any(), name
        np.testing.assert_allclose(found, 2.0 * np.array(getattr(two, name)))


def test_a_coarse_room_sees_squares_of_quads(run: Path) -> None:
    record = record_of(run)
    fine, coarse = Darkroom(run, record), Darkroom(run, record)
    coarse.coarsen(2)
    one, two = (room.exposed(Watch()) for room in (fine, coarse))
    rows, cols = record.grid
    assert fine.decoded().cells.frame == (2 * rows, 2 * cols)
    assert coarse.decoded().cells.frame == (rows, cols)
    for name, shot in one[1].items():
        means = shot.light.reshape(rows, 2, cols, 2, 3).mean(axis=(1, 3))
        np.testing.assert_allclose(two[1][name].light, means, rtol=1e-4, atol=1e-6)
    assert coarse.decoded().side == 2 and fine.decoded().side == 1


def changed_second(monkeypatch: pytest.MonkeyPatch, change: Callable[[RawFrame], RawFrame]) -> None:
    """The second file that is read is another than it was."""
    seen: list[Path] = []

    def read(path: Path, **how: Any) -> RawFrame:
        seen.append(path)
        frame = read_raw(path, **how)
        return frame if "white" in path.name else change(frame)

    monkeypatch.setattr(shelf, "read_raw", read)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda f: replace(f, model="other"), "is of other with orientation 0"),
        (lambda f: replace(f, model=""), "is of no camera with orientation 0"),
        (lambda f: replace(f, flip=3), "with orientation 3"),
        (
            lambda f: replace(f, samples=f.samples[:, 1:], saturated=f.saturated[1:]),
            r"pixels, other shots of the run",
        ),
    ],
)
def test_files_of_another_camera_are_refused(
    run: Path,
    monkeypatch: pytest.MonkeyPatch,
    change: Callable[[RawFrame], RawFrame],
    says: str,
) -> None:
    record = msgspec.structs.replace(record_of(run), cells=None)
    changed_second(monkeypatch, change)
    with pytest.raises(DecodeError, match=says) as caught:
        Darkroom(run, record).decoded()
    assert caught.value.hint and "raw/coded" in caught.value.message


def test_the_first_photo_tells_where_quads_lie(run: Path) -> None:
    record = read_manifest(run).run
    room = Darkroom(run, msgspec.structs.replace(record, cells=None))
    with pytest.raises(DecodeError, match="no photo was taken yet"):
        Darkroom(run, msgspec.structs.replace(record, cells=None, shots=())).decoded()
    room.decoded()
    assert room.record.cells == record.cells


def test_nothing_can_be_made_of_too_little(run: Path) -> None:
    record = read_manifest(run).run
    white = tuple(shot for shot in record.shots if shot.name.startswith("white"))
    some = msgspec.structs.replace(record, shots=white)
    assert list(Darkroom(run, some).decoded(partly=True).pictures) == ["white"]
    bare = msgspec.structs.replace(record, shots=tuple(s for s in white if "black" in s.name))
    if bare.shots:
        with pytest.raises(DecodeError, match="no picture can be made"):
            Darkroom(run, bare).decoded(partly=True)


def test_work_is_told_of_to_its_end(run: Path) -> None:
    told: list[tuple[float, float]] = []
    watch = Watch(step=lambda done, total: told.append((done, total)))
    Darkroom(run, record_of(run)).decoded(watch)
    assert told == sorted(told) and told[-1][0] == told[-1][1] > 0.0


def test_a_shot_that_was_added_is_read_with_the_others(run: Path) -> None:
    record = read_manifest(run).run
    room = Darkroom(run, msgspec.structs.replace(record, shots=record.shots[:1]))
    assert len(room.exposed(Watch())[1]) == 1
    for shot in record.shots[1:]:
        room.add(shot)
    assert list(room.exposed(Watch())[1]) == [shot.name for shot in record.shots]
    assert room.record.shots == record.shots
