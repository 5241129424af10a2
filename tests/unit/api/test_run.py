"""A run as an object: what it reads is what lies on disk, and what the panels really did."""

from __future__ import annotations

import base64
import csv
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

import pdcd
from pdcd.bench.tables import CameraConfig, ScheduleConfig
from pdcd.errors import ConfigError, DecodeError, RequestError
from pdcd.protocol.result import Quality
from pdcd.runs.verify import verify_run
from tests.bench_rig import GRID, config, transport


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run on the smallest bench, all codes under whole windows."""
    place = tmp_path_factory.mktemp("run")
    rig = config(place, schedule=ScheduleConfig(codes=8, window="whole"))
    with pdcd.local(rig, folder=place / "runs") as bench:
        return bench.capture("indirect", parts=1, pilot=0, progress=False).folder


def test_it_tells_what_lies_on_disk(folder: Path) -> None:
    run = pdcd.open(folder)
    with np.load(folder / "probe.npz") as probe:
        assert np.array_equal(run.image, probe["image"]) and run.image.shape == (*GRID, 3)
        assert np.array_equal(run.sigma, probe["sigma"])
        assert run.sigma_kind == str(probe["sigma_kind"])
    assert (run.job, run.goal, run.grid) == (folder.name, "indirect", GRID)
    assert run.manifest.job == run.job and run.summary["codes"] == 8
    assert run.quality is not None and run.quality.verdict in ("good", "doubtful", "bad")
    assert [*run.pictures] == ["direct", "indirect", "white"]
    white = run.pictures["white"]
    assert np.allclose(white, run.pictures["direct"] + run.pictures["indirect"], atol=1e-6)
    assert run.job in repr(run) and "8 codes" in repr(run)
    with pytest.raises(KeyError):
        run.pictures["red"]


def test_frames_are_those_of_the_table(folder: Path) -> None:
    frames = pdcd.open(folder).frames
    with (folder / "frames.csv").open(newline="") as file:
        lines = [*csv.DictReader(file)]
    assert {*frames} == {*lines[0]} and all(len(column) == len(lines) for column in frames.values())
    for name, column in frames.items():
        assert [str(value) for value in column] == [line[name] for line in lines]


def test_raw_files_are_what_another_reader_has_of_them(folder: Path) -> None:
    rawpy, run = pytest.importorskip("rawpy"), pdcd.open(folder)
    for shot in ("coded", "white"):
        with rawpy.imread(str(folder / f"raw/{shot}.dng")) as other:
            inside = np.s_[: other.sizes.crop_height, : other.sizes.crop_width]
            mosaic = other.raw_image_visible[inside].astype(float)
            colours = other.raw_colors_visible
            for plane, (row, column) in zip(run.raw(shot), np.ndindex(2, 2), strict=True):
                black = other.black_level_per_channel[colours[row, column]]
                assert np.allclose(plane, mosaic[row::2, column::2] - black, atol=1e-3)
    with pytest.raises(ConfigError, match=r"no photo 'coded-9' \(there are .*coded, .*white"):
        run.raw("coded-9")


def test_raw_files_that_were_not_kept_are_told_from_none(tmp_path: Path) -> None:
    rig = config(tmp_path, schedule=ScheduleConfig(codes=8, window="whole"))
    with pdcd.local(rig, folder=tmp_path / "runs") as bench:
        run = bench.capture("indirect", parts=1, pilot=0, keep_raw="none", progress=False)
    with pytest.raises(DecodeError, match="were not kept"):
        run.raw("coded")
    with pytest.raises(ConfigError, match="no photo"):
        run.raw("no")


def test_codes_are_what_the_panels_showed(folder: Path) -> None:
    """Eq. 5 over the codes alone, one path after the other, gives the realised row on a bench
    whose panels are ideal."""
    run = pdcd.open(folder)
    codes = run.codes["coded"]
    assert codes.projector.shape == codes.mask.shape == (8, *GRID)
    for row, column in [(0, 0), (2, 3), (1, 2)]:
        wanted, found = np.zeros(GRID), run.row(row, column)
        for k in range(8):
            for r in range(GRID[0]):
                for c in range(GRID[1]):
                    wanted[r, c] += float(codes.mask[k, row, column] and codes.projector[k, r, c])
        realised = found.realised * wanted.sum() / found.realised.sum()
        assert np.allclose(realised, wanted, atol=1e-6 * wanted.max())
        assert found.wanted[row, column] == 0.0


@pytest.mark.parametrize("name", ["probe.npz", "codes.npz", "frames.csv", "linear/white.tif"])
def test_a_changed_file_is_refused_when_it_is_asked_for(
    folder: Path, tmp_path: Path, name: str
) -> None:
    copy = tmp_path / folder.name
    shutil.copytree(folder, copy)
    data = bytearray((copy / name).read_bytes())
    data[-1] ^= 1
    (copy / name).write_bytes(data)
    run = pdcd.open(copy)
    asked: dict[str, Callable[[], object]] = {
        "probe.npz": lambda: run.image,
        "codes.npz": lambda: run.codes,
        "frames.csv": lambda: run.frames,
        "linear/white.tif": lambda: run.pictures["white"],
    }
    with pytest.raises(DecodeError, match="SHA-256"):
        asked.pop(name)()
    for other in asked.values():
        other()


def test_what_is_no_whole_run_is_not_opened(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "nothing").mkdir()
    with pytest.raises(DecodeError, match="is no finished run"):
        pdcd.open(tmp_path / "nothing")
    cut = tmp_path / f"{folder.name}.partial"
    shutil.copytree(folder, cut)
    with pytest.raises(DecodeError, match="not finished"):
        pdcd.open(cut)
    forged = tmp_path / folder.name
    shutil.copytree(folder, forged)
    manifest = forged / "capture.json"
    manifest.write_bytes(manifest.read_bytes().replace(b'"codes": 8', b'"codes": 9'))
    with pytest.raises(DecodeError, match="SHA-256"):
        pdcd.open(forged)
    with pytest.raises(ConfigError, match="no cell"):
        pdcd.open(folder).row(99, 0)
    for wrong, said in ((None, "NoneType"), (5, "int")):
        with pytest.raises(RequestError, match=f"a folder of type {said} was given"):
            pdcd.open(wrong)  # type: ignore[arg-type]


def test_windows_that_move_show_one_more_cell(tmp_path: Path) -> None:
    rig = config(tmp_path, schedule=ScheduleConfig(codes=8, window="quarter"))
    with pdcd.local(rig, folder=tmp_path / "runs") as bench:
        run = bench.capture("indirect", parts=1, pilot=0, progress=False)
    assert run.codes["coded"].mask.shape == (8, GRID[0] + 1, GRID[1] + 1)
    assert run.pictures["indirect"].shape == run.image.shape == (*GRID, 3)


def test_decoding_again_is_what_lies_there(folder: Path) -> None:
    run = pdcd.open(folder)
    again = run.decode(progress=False)
    assert np.array_equal(again.image, run.image) and np.array_equal(again.sigma, run.sigma)
    assert again.sigma_kind == run.sigma_kind
    assert again.rms_sigma == pytest.approx(run.summary["rms_sigma"])
    for name, picture in run.pictures.items():
        assert np.array_equal(again.pictures[name].image.astype(np.float32), picture)


def test_other_options_give_what_a_capture_by_them_gives(tmp_path: Path) -> None:
    """Smoothed or not, by rows or by one number: as if the run had been taken that way; fewer of
    its parts: what an estimate from the shots of these alone is."""
    rig = config(tmp_path, camera=CameraConfig(noise="none"))
    asked = {"codes": 32, "parts": 4, "pilot": 0, "family": "balanced", "white": False}
    with pdcd.local(rig, folder=tmp_path / "runs") as bench:
        run = bench.capture("indirect", progress=False, **asked)  # type: ignore[arg-type]
        for options in ({"smooth": True}, {"normalise": "row"}):
            other = bench.capture("indirect", progress=False, **asked, **options)  # type: ignore[arg-type]
            decoded = run.decode(progress=False, **options)
            assert np.array_equal(decoded.image, other.image)
            assert not np.array_equal(decoded.image, run.image)
    assert run.sigma_kind == "measured"
    fewer = {parts: run.decode(parts=parts, progress=False) for parts in (1, 2, 4)}
    assert fewer[2].sigma_kind == "sensor"
    errors = [float(np.sum((each.image - run.image) ** 2)) for each in fewer.values()]
    assert errors[0] > errors[1] > errors[2] == 0.0
    noise = np.array([np.median(one.pictures["indirect"].sensor) for one in fewer.values()])
    np.testing.assert_allclose(noise / noise[2], [2.0, 2.0**0.5, 1.0], rtol=0.05)
    for wrong in (0, 5):
        with pytest.raises(RequestError, match="4 parts"):
            run.decode(parts=wrong)
    for none in ("a", 1.0, True):
        with pytest.raises(RequestError, match="is no number of parts"):
            run.decode(parts=none)  # type: ignore[arg-type]


def test_a_notebook_shows_it_and_runs_nothing_of_it(folder: Path) -> None:
    evil = "<script>alert(1)</script>"
    run = pdcd.open(folder)
    run.manifest = msgspec.structs.replace(run.manifest, warnings=(evil,), job=evil)
    quality = Quality(verdict="bad", reasons=(evil,), remarks=(evil,))
    run.manifest.summary.update(quality=quality, picture="indirect")
    shown = run._repr_html_()
    assert shown.count("&lt;script&gt;") == 4 and "<script" not in shown
    sources = re.findall(r'<img src="data:image/jpeg;base64,([^"]+)" alt="(\w+)"', shown)
    assert [name for _, name in sources] == ["indirect", "direct", "white"]
    for data, _ in sources:
        picture = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None and picture.shape[1] == 320
    assert "<td>RMS error of pixels</td>" in shown and str(folder) in shown


def _shares(run: pdcd.Run, truth: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.sum((run.image - truth) ** 2) / np.sum(truth**2)))


def test_its_truth_is_that_of_the_scene(folder: Path) -> None:
    run, matrix = pdcd.open(folder), transport()
    truth = np.repeat((matrix.sum(axis=1) - np.diag(matrix)).reshape(*GRID, 1), 3, axis=2)
    assert run.truth is not None and np.allclose(run.truth, truth, rtol=1e-6)
    assert run.rms_error_quads == pytest.approx(_shares(run, truth), rel=1e-4)
    unknown = pdcd.open(folder)
    del unknown.manifest.files["truth.npz"]  # as where nobody knows the scene
    assert unknown.truth is None


@pytest.mark.long
def test_its_truth_on_a_camera_of_any_frame(tmp_path: Path) -> None:
    """Frames that the grid does not divide: cells have the means of what their quads see."""
    rig = config(tmp_path, camera=CameraConfig(noise="none", frame_quads=(31, 22)))
    with pdcd.local(rig, folder=tmp_path / "runs") as bench:
        run = bench.capture("direct", codes=128, progress=False)
    assert run.truth is not None and run.truth.shape == (*GRID, 3)
    known = np.isfinite(run.truth)
    wanted = np.repeat(np.diag(transport()).reshape(*GRID, 1), 3, axis=2)
    for found in (run.truth, run.image):
        assert known.any() and np.allclose(found[known], wanted[known], rtol=0.1)
        assert not np.allclose(found[known], wanted[::-1][known], rtol=0.1)


def test_its_page_is_written_and_the_run_stays_whole(folder: Path, tmp_path: Path) -> None:
    run = pdcd.open(folder)
    assert "report.html" in {path.name for path in folder.iterdir()}  # it was cheap
    assert run.report(tmp_path / "page.html").read_text().startswith("<!")
    assert run.report() == folder / "report.html" and verify_run(folder).whole
