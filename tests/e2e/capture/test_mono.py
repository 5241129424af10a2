"""A camera without colours, all the way: what it makes of every goal, and what is made of runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from unittest import mock

import cv2
import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

import pdcd
from drivers.mock.camera import BenchSensor
from pdcd.bench.tables import BenchConfig, CameraConfig, Config, RigConfig, SceneConfig
from pdcd.errors import ConfigError
from pdcd.pictures.written.export import ExportRequest, export_run_pictures
from tests import bench_rig
from tests.sampled import sampled
from tests.taken import Taken, attempt, relative_rms, take

pytestmark = pytest.mark.whole

ROWS, COLS = bench_rig.GRID
N = ROWS * COLS
SHARES = np.array([4.8, 8.6, 5.6]) / 19.0
"""What filters of red, green and blue let through, as docs/cameras.md has it."""
HALF = (np.arange(N).reshape(ROWS, COLS) % COLS < COLS // 2).astype(float).tolist()
WARP = np.arange(N, dtype=float)[::-1].reshape(ROWS, COLS).tolist()
KERNEL = [[0.0, 0.25, 0.0], [0.25, -1.0, 0.25], [0.0, 0.25, 0.0]]
WEIGHTS = np.round(np.random.default_rng(3).random((N, N)), 3).tolist()
GOALS: list[dict[str, Any]] = [
    {"goal": "indirect"},
    {"goal": "white"},
    {"goal": "direct"},
    {"goal": "fraction", "p": 0.25},
    {"goal": "illuminated", "illumination": HALF},
    {"goal": "diagonal"},
    {"goal": "off-diagonal", "shift": [0, 1]},
    {"goal": "warped", "warp": WARP},
    {"goal": "two-samples", "mix": [0.7, -0.3], "warp": WARP, "warp_b": WARP[::-1]},
    {"goal": "relit", "matrix": WEIGHTS},
    {"goal": "long-range", "radius": 1},
    {"goal": "short-range", "radius": 1},
    {"goal": "blocked", "region_a": HALF, "region_b": HALF[::-1]},
    {"goal": "descattered", "shift": [0, -1]},
    {"goal": "filtered", "kernel": KERNEL},
    {"goal": "split", "period": 4},
    {"goal": "transport", "rows": [1, 2]},
    {"goal": "keyed", "disparity": [-1, 0]},
    {"goal": "epipolar"},
    {"goal": "stereo", "disparity": [-2, 0]},
]
OFF_AXIS = {"keyed": "off-axis-box", "epipolar": "off-axis-wedge", "stereo": "off-axis-shelf"}


def config(folder: Path, profile: str, goal: str) -> Config:
    """Noise-free, of a scene whose colours differ, but where extremes of photos are taken."""
    folder.mkdir()
    tables: dict[str, Any] = {"camera": CameraConfig(profile=profile, noise="none")}
    if goal in OFF_AXIS:
        tables["scene"] = SceneConfig(kind=OFF_AXIS[goal], grid=(6, 8))
        tables["rig"] = RigConfig(arrangement="off-axis")
        return bench_rig.config(folder, **tables)
    found = bench_rig.config(folder, **tables)
    of_colours = np.stack([bench_rig.transport(seed=0 if goal == "split" else c) for c in range(3)])
    transport = np.moveaxis(of_colours, 0, -1)
    np.savez(str(found.scene.path), transport=transport, grid=np.array(bench_rig.GRID))
    return found


def seen_without_colours(image: NDArray[Any]) -> NDArray[Any]:
    return np.asarray((image @ SHARES)[..., None])


@pytest.mark.parametrize("fields", sampled(GOALS, 4))
def test_every_goal_is_the_mean_of_the_colours(fields: dict[str, Any], tmp_path: Path) -> None:
    goal = str(fields["goal"])
    codes: dict[str, Any] = {} if goal in ("white", "diagonal", "transport") else {"codes": 64}
    profiles = {"grey": bench_rig.write_grey_profile(tmp_path), "coloured": "modern"}
    grey, coloured = (
        take(config(tmp_path / name, profile, goal), **codes, **fields)
        for name, profile in profiles.items()
    )
    assert grey.decodes_the_same()
    assert grey.image.shape == (*coloured.image.shape[:2], 1)
    # What the codes err of each colour depends on its own light, a little.
    assert relative_rms(grey.image, seen_without_colours(coloured.image)) < 0.01
    assert grey.quality.verdict == coloured.quality.verdict, (grey.quality, coloured.quality)
    known, wanted = (np.isfinite(taken.probe["sigma"]).all(axis=-1) for taken in (grey, coloured))
    assert np.array_equal(known, wanted)
    if coloured.summary.get("rms_error_cells") is not None:
        most = 1.1 * coloured.summary["rms_error_cells"] + 1e-4
        assert grey.summary["rms_error_cells"] < most


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> Taken:
    """Indirect light of a folder of wax, with full noise, four quads a cell."""
    folder = tmp_path_factory.mktemp("noisy")
    camera = CameraConfig(profile="mono", quads_per_cell=4)
    scene = SceneConfig(kind="wax-disk", grid=(12, 16))
    return take(bench_rig.config(folder, camera=camera, scene=scene), codes=96)


@pytest.mark.whole
def test_error_bars_are_honest(noisy: Taken) -> None:
    truth = pdcd.open(noisy.folder).truth
    assert truth is not None and truth.shape == noisy.image.shape
    off = (noisy.image - truth) / noisy.probe["sigma"]
    assert 0.7 < np.sqrt(np.mean(off**2)) < 1.3
    assert noisy.quality.verdict == "good", noisy.quality
    assert noisy.decodes_the_same()


@pytest.mark.whole
def test_dead_columns_and_stuck_pixels_spoil_nothing(tmp_path: Path) -> None:
    """A column without light, and three pixels that are white whatever they see, as of a camera
    whose own correction is off: they are left out, said, and do not set the aperture."""
    plane = BenchSensor._plane

    def worn(self: BenchSensor, iso: int, f_number: float) -> Any:
        samples, tags = plane(self, iso, f_number)
        samples[:, 21] = tags["black"]
        for row, column in ((5, 5), (20, 40), (41, 33)):
            samples[row, column] = tags["white"]
        return samples, tags

    camera = CameraConfig(profile="mono", quads_per_cell=4)
    scene = SceneConfig(kind="wax-disk", grid=(12, 16))
    with mock.patch.object(BenchSensor, "_plane", worn):
        made = take(bench_rig.config(tmp_path, camera=camera, scene=scene), codes=96)
    assert made.quality.verdict == "good", made.quality
    assert made.summary["rms_error_cells"] < 0.005
    # Of the cells with the column a quarter is missing; one pixel that is stuck loses no cell.
    lost = np.isinf(made.probe["sigma"]).any(axis=-1)
    assert lost[:, 21 // 4].all() and np.delete(lost, 21 // 4, axis=1).sum() == 0
    assert sum("48 pixels of the camera stay dark" in text for text in made.warnings) == 1
    truth = pdcd.open(made.folder).truth
    off = (made.image - truth) / made.probe["sigma"]
    assert 0.7 < np.sqrt(np.mean(off**2)) < 1.3
    assert made.decodes_the_same()


def test_a_sensor_that_is_full_below_its_profile_is_told(tmp_path: Path) -> None:
    """At a fixed aperture that is much too wide: pixels end at three fifths of what was stated,
    and pictures are of what they hold, and not of light."""
    truth = tmp_path / "truth.toml"
    truth.write_text("[sensor]\nfull_well = 0.6\n")
    camera = CameraConfig(profile="mono", quads_per_cell=4, f_number=4.0)
    scene = SceneConfig(kind="wax-disk", grid=(12, 16))
    bench = BenchConfig(truth=str(truth))
    made = take(bench_rig.config(tmp_path, camera=camera, scene=scene, bench=bench), codes=96)
    assert made.quality.verdict == "bad"
    assert any("of the field is saturated" in reason for reason in made.quality.reasons)
    (said,) = (text for text in made.warnings if "samples end" in text)
    assert "at 62 % of the sensor profile's saturation" in said
    assert made.decodes_the_same()


def test_files_have_one_plane(noisy: Taken) -> None:
    picture = noisy.picture("indirect")
    assert picture.shape == (48, 64, 1)
    run = pdcd.open(noisy.folder)
    assert np.array_equal(run.pictures["indirect"], picture) and run.image.shape == (12, 16, 1)
    preview = cv2.imread(str(noisy.folder / "preview" / "indirect.png"), cv2.IMREAD_UNCHANGED)
    assert preview is not None and preview.ndim == 2  # grey
    tifffile = pytest.importorskip("tifffile")
    with tifffile.TiffFile(noisy.folder / "linear" / "indirect.tif") as file:
        assert file.pages[0].photometric.name == "MINISBLACK"
        assert np.array_equal(file.asarray(), picture[..., 0])


def test_exports_have_one_plane(noisy: Taken, tmp_path: Path) -> None:
    exr = pytest.importorskip("OpenEXR")
    picture = noisy.picture("indirect")
    for form in ("exr", "tiff16", "png16", "npz"):
        asked = ExportRequest(format=form, pictures=("indirect",))
        (file,) = export_run_pictures(noisy.folder, asked, lambda: None)
        assert file.values == file.size_px[0] * file.size_px[1]
        path = tmp_path / file.name
        path.write_bytes(file.data)
        if form == "exr":
            assert list(exr.File(str(path)).channels()) == ["Y"]
        elif form != "npz":
            shown = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            assert shown is not None and shown.shape == picture.shape[:2]


def test_the_page_has_one_plane(noisy: Taken, tmp_path: Path) -> None:
    assert pdcd.open(noisy.folder).report(tmp_path / "page.html").exists()


@pytest.mark.parametrize("responsivity", [(1e6,) * 3, (1e6, 1e6)])
def test_an_answer_to_light_of_other_colours_is_refused(
    responsivity: tuple[float, ...], tmp_path: Path
) -> None:
    camera = CameraConfig(profile="mono", responsivity_e=responsivity)
    with pytest.raises(
        ConfigError, match=f"has {len(responsivity)} numbers, colours of mock mono: 1"
    ):
        attempt(bench_rig.config(tmp_path, camera=camera))


def test_a_typed_answer_to_light_scales_the_pictures(tmp_path: Path) -> None:
    """Twice as many electrons are meant by a unit: the mock camera has them, too."""
    means = []
    for number, light in enumerate((1e7, 2e7)):
        (tmp_path / str(number)).mkdir()
        found = config(tmp_path / str(number) / "a", "mono", "white")
        camera = msgspec.structs.replace(found.camera, responsivity_e=(light,))
        made = take(msgspec.structs.replace(found, camera=camera), goal="white")
        assert made.manifest.run.responsivity_e == (light,)
        means.append(made.image.mean())
    assert means[0] == pytest.approx(means[1], rel=1e-3)
