"""A capture guided by a pilot, through the whole chain."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, LimitsConfig, PanelConfig, SceneConfig
from pdcd.capture.engine import Engine
from pdcd.codes.pilot.codes import SCOUTS
from pdcd.errors import RequestError
from pdcd.pictures.decode import decode_folder
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.folder import read_manifest
from pdcd.runs.record import ShotRecord
from tests import bench_rig
from tests.places import DATA
from tests.taken import capture_on

pytestmark = pytest.mark.whole

MIRROR = SceneConfig(kind="matrix", path=str(DATA / "mirror_32x24.npz"))


CORNER = SceneConfig(kind="matrix", path=str(DATA / "corner_32x24.npz"))


def run(
    folder: Path,
    request: CaptureRequest,
    camera: CameraConfig | None = None,
    scene: SceneConfig = MIRROR,
    limits: LimitsConfig | None = None,
    **tables: Any,
) -> CaptureResult:
    folder.mkdir(exist_ok=True)
    config = bench_rig.config(
        folder,
        scene=scene,
        camera=camera or CameraConfig(noise="none"),
        limits=limits or LimitsConfig(min_free_bytes=0),
        **tables,
    )
    return capture_on(config, request)


@pytest.mark.long
def test_a_pilot_makes_mirrors_sharp(tmp_path: Path) -> None:
    """The same 128 codes with and without a pilot; the pilot's are counted."""
    errors = []
    for pilot in (0, 64):
        folder = tmp_path / str(pilot)
        folder.mkdir()
        request = CaptureRequest(goal="indirect", codes=128, pilot=pilot, white=False)
        result = run(folder, request)
        assert result.state == "done", result.error
        errors.append(float(str(result.summary["rms_error_quads"])))
    assert errors[1] < errors[0] / 2.0
    assert result.folder is not None
    done = Path(result.folder)
    assert len(list((done / "raw").glob("pilot-*.dng"))) == 64
    assert decode_folder(done).identical
    assert read_manifest(done).plan["raw_files"] == 65


@pytest.mark.parametrize("quads", [(50, 38), (64, 48)])
def test_quads_that_see_two_cells_are_no_sharp_paths(
    tmp_path: Path, quads: tuple[int, int]
) -> None:
    """Three quads a cell, whose borders they lie across, and four that do not: as good a photo."""
    camera = CameraConfig(noise="none", frame_quads=quads)
    scene = SceneConfig(kind="open-book", grid=(12, 16))
    request = CaptureRequest(goal="indirect", codes=64, window="quarter", pilot="auto", white=False)
    panel = PanelConfig(size_px=(256, 192))
    result = run(tmp_path, request, camera, scene, projector=panel, mask=panel)
    assert result.state == "done" and result.folder is not None, result.error
    assert result.summary["pilot"] == SCOUTS
    assert float(str(result.summary["rms_error_quads"])) < 0.035


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "noise"),
    [("corner", "full"), ("open-book", "none"), ("wax-disk", "full"), ("milky-bottle", "none")],
)
def test_a_pilot_ends_where_it_cannot_pay(tmp_path: Path, kind: str, noise: str) -> None:
    """Diffuse scenes: four photos, the other 60 codes where they would be without a pilot."""
    scene = CORNER if kind == "corner" else SceneConfig(kind=kind, grid=(24, 32))
    errors = []
    for pilot in (0, 64):
        request = CaptureRequest(goal="indirect", codes=128, pilot=pilot, parts=1, white=False)
        camera = CameraConfig(noise=noise)  # type: ignore[arg-type]
        result = run(tmp_path / str(pilot), request, camera, scene)
        assert result.state == "done", result.error
        errors.append(float(str(result.summary["rms_error_quads"])))
    # Without the codes that come back the book errs 1.6 times as much.
    assert errors[1] < 1.15 * errors[0]
    assert (result.summary["codes"], result.summary["pilot"], result.summary["shots"]) == (
        128,
        SCOUTS,
        SCOUTS + 1,
    )
    assert result.folder is not None
    done = Path(result.folder)
    manifest = read_manifest(done)
    assert decode_folder(done).identical
    assert manifest.run.how.coded == 124 and manifest.plan["raw_files"] == SCOUTS + 1
    assert any("no sharp far paths" in warning for warning in manifest.warnings)


def test_what_ends_early_is_what_the_plan_foresaw(tmp_path: Path) -> None:
    request = CaptureRequest(goal="indirect", codes=128, pilot=64, parts=4, black_level="mask")
    camera = CameraConfig(noise="none", f_number=16.0)  # white is shown as often as planned
    engine = Engine.from_config(bench_rig.config(tmp_path, scene=CORNER, camera=camera))
    cost = engine.plan(request).pilot_cost
    assert cost is not None
    result = run(tmp_path, request, camera, CORNER)
    assert result.folder is not None, result.error
    manifest = read_manifest(Path(result.folder))
    assert cost.stopped_codes == manifest.run.how.coded == 112  # in fours of Hadamard sets
    assert cost.stopped_raw_files == manifest.plan["raw_files"] == len(manifest.run.shots)
    assert cost.stopped_seconds == pytest.approx(manifest.plan["seconds"])


def test_codes_that_come_back_stay_within_the_longest_exposure(tmp_path: Path) -> None:
    """64 codes of three refreshes take 3.2 s."""
    request = CaptureRequest(goal="indirect", codes=128, pilot=64, white=False, guards=True)
    limits = LimitsConfig(min_free_bytes=0, max_exposure_s=4.0)
    result = run(tmp_path, request, scene=CORNER, limits=limits)
    assert result.state == "done", result.error
    assert 64 + SCOUTS < float(str(result.summary["codes"])) < 128
    assert max(s.close_ns - s.open_ns for s in read_shots(result)) < 4.1e9


def read_shots(result: CaptureResult) -> tuple[ShotRecord, ...]:
    assert result.folder is not None
    return read_manifest(Path(result.folder)).run.shots


@pytest.mark.long
@pytest.mark.timeout(600)  # more than a minute of a processor
def test_short_range_light_keeps_its_far_codes(tmp_path: Path) -> None:
    """A pilot guides the codes that are lit half of the time; the others stay as they are. Which
    codes it leaves is luck: one seed alone says 0.94 to 1.24."""
    errors = []
    for pilot in (0, 64):
        for seed in range(3):
            request = CaptureRequest(
                goal="short-range", radius=1, codes=576, pilot=pilot, seed=seed
            )
            result = run(tmp_path / f"{pilot}-{seed}", request)
            assert result.state == "done", result.error
            errors.append(float(str(result.summary["rms_error_quads"])))
    assert sum(errors[3:]) < 1.2 * sum(errors[:3])


SMALL_VASE = SceneConfig(kind="mirror-and-vase", grid=(12, 16))
STRIPES = [[1.0 if col % 2 else 0.2 for col in range(16)]] * 12


def error_of(folder: Path, **fields: Any) -> float:
    result = run(folder, CaptureRequest(**fields), scene=SMALL_VASE)
    assert result.state == "done", result.error
    return float(str(result.summary["rms_error_quads"]))


@pytest.mark.parametrize("parts", [1, 4])
def test_paths_that_a_pilot_found_are_known_in_far_light(parts: int, tmp_path: Path) -> None:
    """Codes of far light count single paths by chance; what that makes wrong of known ones is
    taken off, of all photos and of each part."""
    asked: dict[str, Any] = {"goal": "long-range", "radius": 1, "codes": 64, "parts": parts}
    plain = error_of(tmp_path / "plain", pilot=0, **asked)
    assert error_of(tmp_path / "pilot", pilot=16, **asked) < plain / 3.0
    (folder,) = (tmp_path / "pilot").rglob("capture.json")
    assert decode_folder(folder.parent).identical


def test_a_pilot_helps_light_under_an_illumination(tmp_path: Path) -> None:
    """A path from a cell that is lit by a fifth is wanted by a fifth."""
    asked: dict[str, Any] = {"goal": "indirect", "codes": 64, "white": False}
    asked["illumination"] = STRIPES
    plain = error_of(tmp_path / "plain", pilot=0, **asked)
    assert error_of(tmp_path / "pilot", pilot=16, **asked) < plain / 2.0


@pytest.mark.long
@pytest.mark.parametrize(("grid", "pilot", "codes"), [((1, 7), 32, 48), ((5, 6), 128, 192)])
def test_a_long_pilot_of_few_cells_finds_nothing_to_keep_apart(
    grid: tuple[int, int], pilot: int, codes: int, tmp_path: Path
) -> None:
    """Its own Hadamard sets share no code, so that they cannot differ by one."""
    cells = grid[0] * grid[1]
    path = tmp_path / "mirror.npz"
    mirror = 0.3 * np.eye(cells) + 0.5 * np.roll(np.eye(cells), cells // 2, axis=1)
    np.savez(path, transport=mirror, grid=np.array(grid))
    # Windows that cut cells would lose light that goes from cell to cell.
    request = CaptureRequest(goal="indirect", codes=codes, pilot=pilot, window="whole")
    result = run(
        tmp_path / "run",
        request,
        CameraConfig(noise="none"),
        SceneConfig(kind="matrix", path=str(path)),
    )
    assert result.state == "done" and result.summary["pilot"] == pilot
    assert float(str(result.summary["rms_error_quads"])) < 0.02


def test_noise_in_the_pilot_does_no_harm(tmp_path: Path) -> None:
    noisy, errors = CameraConfig(noise="full"), []
    for pilot in (32, 0):
        request = CaptureRequest(goal="indirect", codes=64, pilot=pilot, parts=1, white=False)
        result = run(tmp_path / str(pilot), request, noisy, SMALL_VASE)
        errors.append(float(str(result.summary["rms_error_quads"])))
    assert errors[0] < errors[1] * 1.1


@pytest.mark.parametrize(
    ("request_", "what"),
    [
        (CaptureRequest(goal="white", codes=128, pilot=64), "takes no pilot"),
        (CaptureRequest(goal="indirect", codes=130, pilot=64), "66"),
    ],
)
def test_refusals(request_: CaptureRequest, what: str, tmp_path: Path) -> None:
    result = run(tmp_path, request_)
    assert result.error is not None and result.error["kind"] == "request"
    assert what in f"{result.error['message']} {result.error['hint']}"
    assert not np.any([p.suffix == ".dng" for p in tmp_path.rglob("*")])


VASE = SceneConfig(kind="mirror-and-vase", grid=(24, 32))
SMALL_PANELS: dict[str, Any] = {
    "projector": PanelConfig(size_px=(256, 192)),
    "mask": PanelConfig(size_px=(400, 300)),
}
"""8 pixels to a cell and more; where cells are seen in detail, work grows with the pixels."""


@pytest.mark.long
@pytest.mark.parametrize(("scene", "coins"), [(MIRROR, 0.097), (VASE, 0.127)])
def test_8_codes_show_mirrors_as_well_as_128_coins(
    tmp_path: Path, scene: SceneConfig, coins: float
) -> None:
    """All 8 in the pilot; `coins` is the error of 128 of them, mean of 5 seeds."""
    request = CaptureRequest(goal="indirect", codes=8, pilot=8, white=False)
    result = run(tmp_path, request, scene=scene)
    assert result.state == "done", result.error
    assert float(str(result.summary["rms_error_quads"])) < coins
    shown = [result.summary[name] for name in ("codes", "pilot", "shots", "family")]
    assert shown == [8, 8, 8, "hadamard"]
    assert result.folder is not None
    assert decode_folder(Path(result.folder)).identical


@pytest.mark.parametrize(("codes", "left"), [(8, 4), (16, 12)])
def test_a_pilot_of_all_codes_leaves_them_where_it_sees_nothing(
    tmp_path: Path, codes: int, left: int
) -> None:
    request = CaptureRequest(goal="indirect", codes=codes, pilot=codes)
    cost = Engine.from_config(bench_rig.config(tmp_path, scene=CORNER)).plan(request).pilot_cost
    assert cost is not None and (cost.raw_files, cost.stopped_codes) == (codes, left)
    result = run(tmp_path, request, scene=CORNER)
    assert result.folder is not None, result.error
    manifest = read_manifest(Path(result.folder))
    assert (manifest.run.how.coded, manifest.run.how.pilot) == (left, SCOUTS)
    assert cost.stopped_raw_files == len(manifest.run.shots) == SCOUTS + 2
    assert cost.stopped_seconds == pytest.approx(manifest.plan["seconds"])
    assert float(str(result.summary["rms_error_quads"])) < 0.05
    assert decode_folder(Path(result.folder)).identical


@pytest.mark.long
def test_a_pilot_of_all_codes_gives_direct_light_too(tmp_path: Path) -> None:
    """In colour and with more quads than one to a cell, beside a white photo."""
    camera = CameraConfig(noise="none", quads_per_cell=2)
    request = CaptureRequest(goal="direct", codes=16, pilot=16)
    result = run(tmp_path, request, camera, VASE, **SMALL_PANELS)
    assert result.folder is not None, result.error
    assert float(str(result.summary["rms_error_quads"])) < 0.012  # in detail finer than cells, too
    shown = {path.stem for path in (Path(result.folder) / "preview").iterdir()}
    assert shown == {"direct", "white", "indirect"}
    shot = read_shots(result)[-1]
    assert shot.name == "pilot-0016" and shot.refreshes == 3


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"parts": 4}, "no coded photo to split"),
        ({"repeat": 2}, "in one piece can be repeated"),
        ({"pilot": 64, "codes": 64}, "leaves none of 64 codes"),
        ({"pilot": 20, "codes": 64}, "a pilot of 20 codes cannot be made"),
        ({"exposure_s": 0.1}, "shorter than one pass over 8 codes"),
    ],
)
def test_what_a_pilot_of_all_codes_cannot_do(
    tmp_path: Path, wrong: dict[str, object], message: str
) -> None:
    asked = {"goal": "indirect", "codes": 8, "pilot": 8, "guards": True, **wrong}
    with pytest.raises(RequestError, match=message):
        Engine.from_config(bench_rig.config(tmp_path, scene=CORNER)).plan(
            CaptureRequest(**asked)  # type: ignore[arg-type]
        )
