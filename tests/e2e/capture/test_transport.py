"""Slices of the transport matrix through the whole chain, against matrices written out here."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.bench.tables import CameraConfig, Config, PanelConfig
from pdcd.cli.main import main
from pdcd.panels.placing import Placing
from pdcd.pictures.decode import decode_folder
from tests import bench_rig, taken
from tests.sampled import sampled
from tests.taken import Taken

pytestmark = pytest.mark.whole

GRID = (6, 8)
ROWS, COLS = GRID


def config(
    folder: Path, *, noise: str = "none", turned: float | None = None, **more: Any
) -> Config:
    """turned : blur in quads of a camera that stands askew; None: one quad a cell."""
    camera: dict[str, Any] = {"noise": noise}
    if turned is not None:
        place = Placing(turn_deg=7.0, scale=1.2, radial=(0.02, 0.0))
        camera |= {"frame_quads": (72, 54), "place": place, "blur_quads": turned}
    given: dict[str, Any] = {
        "camera": CameraConfig(**camera),
        "projector": PanelConfig(size_px=(96, 72)),
        "mask": PanelConfig(size_px=(120, 90)),
        **more,
    }
    return bench_rig.config(folder, grid=GRID, **given)


def take(rig: Config, **fields: Any) -> tuple[Taken, dict[str, np.ndarray]]:
    """A capture, and the slice that it found."""
    made = taken.take(rig, goal="transport", **fields)
    with np.load(made.folder / "transport.npz") as data:
        return made, dict(data)


def true(rows: tuple[int, int]) -> np.ndarray:
    """Written out: the entry of camera cell (r2, c) and projector cell (r, d)."""
    t = bench_rig.transport(GRID)
    return np.array(
        [[t[rows[1] * COLS + c, rows[0] * COLS + d] for d in range(COLS)] for c in range(COLS)]
    )


def off(found: dict[str, np.ndarray], wanted: np.ndarray) -> float:
    difference = found["transport"] - wanted[..., None]
    return float(np.sqrt(np.mean(difference**2) / np.mean(wanted**2)))


@pytest.mark.parametrize("masked", [False, True])
def test_a_slice_is_photographed_and_made_again(tmp_path: Path, masked: bool) -> None:
    """Fig. 5. Without noise only the RAW file rounds."""
    made, found = take(config(tmp_path), rows=[2, 3], masked=masked or None)
    assert off(found, true((2, 3))) < 1e-3
    np.testing.assert_array_equal(found["camera_cells"], 3 * COLS + np.arange(COLS))
    np.testing.assert_array_equal(found["projector_cells"], 2 * COLS + np.arange(COLS))
    told = made.summary["transport_error"]
    assert told == pytest.approx(off(found, true((2, 3))), rel=1e-6)
    assert made.summary["transport_photos"] == int(found["photos"]) == 15
    assert (made.folder / "preview" / "transport.png").is_file()
    again = decode_folder(made.folder)
    assert again.identical and "transport.npz" in {file.name for file in again.files}


@pytest.mark.parametrize(("blur", "bound"), sampled([(1.0, 0.02), (0.0, 0.002), (0.4, 0.02)], 3))
def test_a_turned_camera_of_many_quads_sees_the_same_slice(
    tmp_path: Path, blur: float, bound: float
) -> None:
    """Quads at the edges of cells see two of them, and do not count; where blur leaves no others,
    what they mix is parted."""
    _, found = take(config(tmp_path, turned=blur), rows=[2, 2])
    assert off(found, true((2, 2))) < bound


def test_errors_are_as_large_as_sigma_says(tmp_path: Path) -> None:
    _, found = take(config(tmp_path, noise="full"), rows=[4, 4])
    scores = (found["transport"] - true((4, 4))[..., None]) / found["sigma"]
    assert 0.8 < float(np.sqrt(np.mean(scores**2))) < 1.2
    assert np.sqrt(np.mean(found["sigma"] ** 2)) > 1e-4


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"rows": [6, 0]}, "no row 6"),
        ({"rows": [0, 0], "parts": 4}, "parts"),
        ({"goal": "white", "rows": [0, 0]}, "takes no rows"),
    ],
)
def test_what_cannot_be_is_refused_before_any_light(
    tmp_path: Path, fields: dict[str, Any], told: str
) -> None:
    result = taken.attempt(config(tmp_path), **{"goal": "transport", **fields})
    assert result.error is not None and result.error["kind"] == "request"
    assert told in f"{result.error['message']} {result.error['hint']}"
    assert not list((tmp_path / "state").glob("captures/*"))


def test_the_command_takes_one_row_or_two(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(
        f'[scene]\ngrid = [6, 8]\n[server]\nstate_dir = "{tmp_path}/state"\n'
        "[limits]\nmin_free_bytes = 0\n"
    )
    rig = ["--local", "--config", str(path)]
    assert main(["transport", "--rows", "2", *rig]) == 0
    out = capsys.readouterr().out
    assert "error of T" in out and "transport.npz" in out
    assert main(["plan", "transport", "--rows", "2", "3", *rig]) == 0
    assert "15 of 1 codes" in capsys.readouterr().out
    assert main(["transport", "--rows", "1", "2", "3", *rig]) == 2
    assert "--rows takes 1 or 2 whole numbers" in capsys.readouterr().err


@pytest.mark.parametrize("columns", [1, 3])
def test_a_slice_of_few_cells_is_good_with_its_dark_photos(tmp_path: Path, columns: int) -> None:
    """Light of none of them comes up in one of seven photos, or in three of a single cell."""
    rig = bench_rig.config(tmp_path, grid=(4, columns), camera=CameraConfig(noise="full"))
    made, found = take(rig, rows=[1, 2])
    t = bench_rig.transport((4, columns))
    wanted = t[2 * columns : 3 * columns, columns : 2 * columns]
    assert off(found, wanted) < 0.05
    assert made.quality.verdict == "good", made.quality
