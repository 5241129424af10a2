"""Captures from request to run folder, in process, against the scene's known truth."""

from __future__ import annotations

import csv
import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from drivers.mock.display import MockDisplay
from pdcd.bench.tables import CameraConfig, Config, PanelConfig, RigConfig, SceneConfig
from pdcd.capture.engine import Engine
from pdcd.errors import DecodeError
from pdcd.pictures.decode import decode_folder
from pdcd.protocol.events import Event
from pdcd.protocol.result import make_job_id
from pdcd.runs.folder import read_manifest
from tests import bench_rig, tampered
from tests.places import DATA
from tests.sampled import sampled
from tests.taken import relative_rms, started, take, take_with

CORNER = SceneConfig(kind="matrix", path=str(DATA / "corner_32x24.npz"))


def run(config: Config, **fields: Any) -> tuple[Path, dict[str, object]]:
    made = take(config, **fields)
    return made.folder, made.summary


def test_what_the_display_says_of_its_panels_is_said_of_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    connect, said = MockDisplay.connect, ("mask dither: on",)
    monkeypatch.setattr(MockDisplay, "connect", lambda self: replace(connect(self), warnings=said))
    folder, _ = run(bench_rig.config(tmp_path), codes=8, window="whole")
    assert said[0] in read_manifest(folder).warnings


def image_of(folder: Path) -> np.ndarray:
    with np.load(folder / "probe.npz") as data:
        image, sigma = data["image"], data["sigma"]
    assert image.shape == sigma.shape
    assert image.dtype.kind == sigma.dtype.kind == "f"
    assert np.all(sigma > 0)
    return np.asarray(image)


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run, of which tests spoil copies."""
    return run(bench_rig.config(tmp_path_factory.mktemp("kept")), codes=8)[0]


@pytest.fixture
def copy(kept: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "copy"
    shutil.copytree(kept, folder)
    tampered.files(folder)  # which may be written to, too
    return folder


@pytest.mark.parametrize(
    ("goal", "p", "diagonal", "off", "window"),
    [("white", None, 1, 1, "whole"), ("fraction", 0.5, 1, 0.5, "whole"),
     ("fraction", 0.0625, 1, 0.0625, "whole"), ("indirect", None, 0, 1, "quarter"),
     ("fraction", 0.25, 1, 0.25, "quarter")],
)  # fmt: skip
def test_every_goal_in_scene_units(
    tmp_path: Path, goal: str, p: float | None, diagonal: float, off: float, window: str
) -> None:
    """With more codes than cells only quantisation is left, and in quarter windows clumping.

    Quarter windows treat paths between neighbouring halves of cells as direct (R4): this scene
    has no more light there than elsewhere, so the bound is the share of those paths.
    """
    config = bench_rig.config(tmp_path)
    folder, summary = run(config, goal=goal, p=p, codes=64, window=window)
    t = bench_rig.transport()
    direct = np.diag(t)
    truth = diagonal * direct + off * (t.sum(axis=1) - direct)
    want = truth.reshape(*bench_rig.GRID, 1).repeat(3, axis=2)
    error = relative_rms(image_of(folder), want)
    assert error == pytest.approx(summary["rms_error_quads"], rel=1e-9)
    exact = goal == "white" or (window == "whole" and p in (None, 0.5))
    assert error < (5e-4 if exact else 0.25)


def test_a_run_folder_holds_everything(tmp_path: Path) -> None:
    folder, _ = run(bench_rig.config(tmp_path), codes=8, out=str(tmp_path / "runs"))
    assert folder.parent == tmp_path / "runs"
    names = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    expected = {
        "capture.json", "capture.json.sha256", "codes.npz", "frames.csv", "probe.npz", "log.jsonl",
        "raw/white.dng", "raw/coded.dng", "raw/meter-white-1.dng", "raw/meter-coded-1.dng",
        "linear/white.tif", "linear/indirect.tif", "linear/direct.tif",
        "preview/white.png", "preview/indirect.png", "preview/direct.png",
    }  # fmt: skip
    assert expected <= names
    manifest = read_manifest(folder)
    assert set(manifest.files) == names - {"capture.json", "capture.json.sha256"}
    for name, kept in manifest.files.items():
        data = (folder / name).read_bytes()
        assert (hashlib.sha256(data).hexdigest(), len(data)) == (kept.sha256, kept.size_bytes)
    assert manifest.mock and manifest.state == "done"
    with (folder / "frames.csv").open() as file:
        rows = list(csv.DictReader(file))
    # At the codes' stop white fits in one slot of the two that are planned, of three refreshes.
    assert [row["shot"] for row in rows] == ["white"] * 3 + ["coded"] * 8 * 3
    lines = (folder / "log.jsonl").read_text().splitlines()
    events = [json.loads(line)["event"] for line in lines]
    assert events.index("shutter_open") < events.index("shutter_closed") < events.index("decoding")
    assert (folder / "raw" / "coded.dng").stat().st_mode & 0o222 == 0
    codes = np.load(folder / "codes.npz")
    assert codes["coded.primal"].shape == codes["coded.dual"].shape == (8, 2)
    assert "pdcd" in str(codes["generator"])
    picture = cv2.imread(str(folder / "preview" / "indirect.png"))
    assert picture is not None and picture.shape[1] >= 640 and picture.std() > 1


@pytest.mark.parametrize(("window", "black_level"), [("whole", "none"), ("quarter", "both")])
def test_decode_reproduces_the_tiff_bit_for_bit(
    tmp_path: Path, window: str, black_level: str
) -> None:
    config = bench_rig.with_defects(tmp_path, camera=CameraConfig(noise="full"))
    folder, _ = run(config, codes=8, window=window, black_level=black_level)
    moved = tmp_path / "elsewhere"
    shutil.move(folder, moved)
    report = decode_folder(moved)
    assert report.identical and len(report.files) == 3
    tiff = moved / "linear" / "indirect.tif"
    tiff.write_bytes(tiff.read_bytes()[:-4] + b"\1\2\3\4")
    with pytest.raises(DecodeError, match=r"linear/indirect\.tif: .* SHA-256"):
        decode_folder(moved)
    tampered.relisted(moved)
    assert not decode_folder(moved).identical


@pytest.mark.parametrize("name", ["raw/coded.dng", "codes.npz", "frames.csv", "capture.json"])
def test_damaged_runs_do_not_decode(copy: Path, name: str) -> None:
    path = copy / name
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(DecodeError):
        decode_folder(copy)
    with pytest.raises(DecodeError, match="holds runs"):
        decode_folder(copy.parent)


FRAME_DAMAGE: dict[str, tuple[Callable[[list[bytes]], list[bytes]], str]] = {
    "empty": (lambda lines: [], "cannot read"),
    "no heads": (lambda lines: lines[1:], "cannot read"),
    "a lost line": (lambda lines: lines[:-1], "refreshes of shot"),
    "a short line": (lambda lines: [*lines[:-1], lines[-1].rsplit(b",", 1)[0]], "cannot read"),
    "a word for a number": (lambda lines: [*lines[:-1], lines[-1] + b"x"], "cannot read"),
    "an empty line": (lambda lines: [*lines, b"", b""], "cannot read"),
}


@pytest.mark.parametrize("kind", FRAME_DAMAGE)
def test_a_damaged_frame_log_does_not_decode(copy: Path, kind: str) -> None:
    damage, words = FRAME_DAMAGE[kind]
    path = copy / "frames.csv"
    path.write_bytes(b"\n".join(damage(path.read_bytes().splitlines())))
    with pytest.raises(DecodeError, match=r"frames\.csv"):
        decode_folder(copy)
    tampered.relisted(copy)
    with pytest.raises(DecodeError, match=words):
        decode_folder(copy)


@pytest.mark.long
def test_same_seed_same_answer(tmp_path: Path) -> None:
    images = []
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        camera = CameraConfig(noise="full", seed=seed)
        folder, _ = run(
            bench_rig.config(tmp_path, camera=camera), codes=8, out=str(tmp_path / name)
        )
        images.append(image_of(folder))
    np.testing.assert_array_equal(images[0], images[1])
    assert np.any(images[0] != images[2])


def test_indirect_errors_on_the_path_traced_corner(tmp_path: Path) -> None:
    """One seed through the whole chain; the five-seed mean is tested on the codes themselves."""
    errors = {}
    for family in ("hadamard", "bernoulli"):
        config = bench_rig.config(tmp_path, scene=CORNER)
        folder, summary = run(config, codes=128, family=family, out=str(tmp_path / family))
        errors[family] = summary["rms_error_quads"]
        image = image_of(folder)
        assert image.shape == (24, 32, 3)
        data = np.load(DATA / "corner_32x24.npz")
        t = data["transport"].astype(np.float64)
        truth = (t.sum(axis=1) - np.diag(t)).reshape(24, 32, 1)
        assert relative_rms(image, truth) == pytest.approx(errors[family])
    assert float(str(errors["hadamard"])) < float(str(errors["bernoulli"])) / 20


@pytest.mark.long
def test_sigma_is_the_spread_of_repeated_photos(tmp_path: Path) -> None:
    """Photon, read, dark and rounding noise: captures of one scene scatter as sigma says."""
    config = bench_rig.config(
        tmp_path, camera=CameraConfig(noise="full", f_number=32.0), grid=(24, 32)
    )
    images, sigmas = [], []
    with started(config) as engine:
        for i in range(10):
            made = take_with(engine, f"job{i}", goal="direct", codes=4)
            images.append(made.image)
            sigmas.append(made.probe["sigma_sensor"])
            shutil.rmtree(made.folder)
    variance = np.var(images, axis=0, ddof=1) / np.mean(np.square(sigmas), axis=0)
    # 2304 variances, each known to 47 %: the root of their mean is known to 0.5 %.
    assert np.sqrt(np.mean(variance)) == pytest.approx(1.0, abs=0.02)


def test_black_level_shots_remove_leak_and_ambient_light(tmp_path: Path) -> None:
    """L3: contrast 300:1 and 100:1 and ambient light; the plain photo is far off, four are not."""
    config = bench_rig.config(
        tmp_path,
        scene=bench_rig.matrix_scene(tmp_path, ambient=0.02),
        projector=PanelConfig(size_px=(1024, 768), contrast=300.0),
        mask=PanelConfig(size_px=(1600, 1200), contrast=100.0),
    )
    plain = run(config, codes=64, black_level="none", out=str(tmp_path / "plain"))[1][
        "rms_error_quads"
    ]
    four = run(config, codes=64, black_level="both", out=str(tmp_path / "four"))[1][
        "rms_error_quads"
    ]
    assert isinstance(plain, float) and isinstance(four, float)
    assert plain > 0.1
    assert four < 2e-3


def test_the_report_states_the_leak_of_slow_panels(tmp_path: Path) -> None:
    slow = PanelConfig(size_px=(1600, 1200), rise_s=0.004, fall_s=0.008, contrast=300.0)
    folder, _ = run(bench_rig.config(tmp_path, mask=slow), codes=16)
    leak = read_manifest(folder).realised["coded"]["diagonal_max"]
    assert 0.005 < leak < 0.2
    ideal, _ = run(bench_rig.config(tmp_path), codes=16, out=str(tmp_path / "ideal"))
    assert read_manifest(ideal).realised["coded"]["diagonal_max"] == 0.0


def test_saturation_is_flagged(tmp_path: Path) -> None:
    config = bench_rig.config(tmp_path, camera=CameraConfig(noise="none", f_number=2.0))
    folder, _ = run(config, codes=64)
    with np.load(folder / "probe.npz") as data:
        assert np.isinf(data["sigma"]).any()
    assert any("saturated" in w for w in read_manifest(folder).warnings)


@pytest.mark.parametrize(
    ("grid", "window"),
    sampled(list(product([(1, 1), (1, 7), (5, 4), (7, 11)], ["whole", "quarter"])), 2),
)
def test_odd_grids(tmp_path: Path, grid: tuple[int, int], window: str) -> None:
    """Of usual panels no pixels end where these cells end: what gets in along borders is taken
    out, as well as a camera of a quad a cell tells how bright it is there."""
    usual = {"projector": PanelConfig(size_px=(320, 240)), "mask": PanelConfig(size_px=(500, 375))}
    for name, panels, most in (("fit", bench_rig.fitting(grid), 1e-3), ("usual", usual, 2e-3)):
        (tmp_path / name).mkdir()
        config = bench_rig.config(tmp_path / name, grid=grid, **panels)
        folder, summary = run(config, codes=128, window=window)
        assert image_of(folder).shape == (*grid, 3)
        if grid == (1, 1):
            assert np.abs(image_of(folder)).max() < 1e-12 and summary["rms_error_quads"] is None
        elif window == "whole":
            assert float(str(summary["rms_error_quads"])) < most


def test_real_clock_takes_real_time(tmp_path: Path) -> None:
    config = bench_rig.config(
        tmp_path, rig=RigConfig(clock="real"), camera=CameraConfig(noise="none", f_number=8.0)
    )
    _, summary = run(config, goal="white", codes=4, guards=False)
    assert float(str(summary["wall_s"])) > float(str(summary["exposure_s"])) * 0.9


def test_show_and_preview(tmp_path: Path) -> None:
    engine = Engine.from_config(bench_rig.config(tmp_path))
    engine.start()
    bench = bench_rig.bench_of(engine)
    for pattern in ("white", "checker", "code"):
        engine.show(pattern, 3)
        assert not bench_rig.are_panels_black(bench)
    engine.show("black")
    assert bench_rig.are_panels_black(bench)
    told: list[Event] = []
    preview = engine.preview(job=make_job_id(), emit=told.append)
    assert {"shutter_open", "shutter_closed"} <= {event.type for event in told}
    assert preview.shape == (3, 4, 3)
    assert cv2.imread(preview.path) is not None
    engine.stop()
