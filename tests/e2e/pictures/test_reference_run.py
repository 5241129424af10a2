"""The reference run of the repository: whole, decoded to the numbers that stand beside it, taken
again on the mock bench, and held against an evaluation from first principles.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import pdcd
from pdcd.api.run import Run
from pdcd.bench.config import load_config
from pdcd.bench.placed import make_camera_map, panels_of
from pdcd.panels.frames import FrameLog, Frames
from pdcd.probing.panel import PanelOptics
from pdcd.runs.verify import verify_run
from pdcd.virtual.scene.build import build_scene
from tests import reference_run
from tests.dense_bench import DenseBench, DensePanel
from tests.oracles import cell_of, pair_integrals, timeline, to_cells

pytestmark = pytest.mark.whole

Floats = NDArray[np.float64]

SAME_RAW = 1e-5
"""Relative: two machines add up the same numbers in another order, and pictures are float32."""
OTHER_NOISE = 0.01
"""Relative, of a mean over the picture: what is left where noise was drawn anew."""


@pytest.fixture(scope="module")
def expected() -> dict[str, Any]:
    return dict(json.loads(reference_run.EXPECTED.read_text()))


@pytest.fixture(scope="module")
def run() -> Run:
    return pdcd.open(reference_run.RUN)


def check_pictures(
    found: dict[str, dict[str, float]], wanted: dict[str, dict[str, float]], relative: float
) -> None:
    assert found.keys() == wanted.keys()
    for name, numbers in wanted.items():
        for what in ("mean", "rms"):
            assert found[name][what] == pytest.approx(numbers[what], rel=relative), (name, what)


def test_it_is_whole_and_gives_the_numbers_beside_it(run: Run, expected: dict[str, Any]) -> None:
    report = verify_run(run.folder, manifest_sha256=expected["manifest_sha256"])
    assert report.whole, report.findings
    assert not report.later
    told = reference_run.describe_run(run)
    assert told["pictures"] == expected["pictures"]
    assert told == expected


def test_decoded_anew_from_its_raw_files_it_gives_the_same(
    tmp_path: Path, run: Run, expected: dict[str, Any]
) -> None:
    shutil.copytree(run.folder, tmp_path / "run")
    decoded = pdcd.open(tmp_path / "run").decode(progress=False)
    pictures = {name: picture.image for name, picture in decoded.pictures.items()}
    for name, before in run.pictures.items():
        unit = float(np.abs(before).max())
        np.testing.assert_allclose(pictures[name], before, atol=SAME_RAW * unit, rtol=0)
    found = reference_run.measure_pictures(pictures)
    check_pictures(found, expected["pictures"], SAME_RAW)
    np.testing.assert_allclose(decoded.image, run.image, atol=SAME_RAW * run.image.max(), rtol=0)
    np.testing.assert_allclose(decoded.sigma, run.sigma, rtol=1e-3)


def test_taken_again_on_the_mock_bench_it_is_the_same_photo(
    run: Run, expected: dict[str, Any]
) -> None:
    again = reference_run.take_run()
    told = reference_run.describe_run(again)
    for name in ("codes_sha256", "frames_sha256", "verdict"):
        assert told[name] == expected[name]
    for name, number in expected["summary"].items():
        wide = 0.25 if name.startswith("rms") else 1e-9
        assert told["summary"][name] == (
            pytest.approx(number, rel=wide) if isinstance(number, float) else number
        )
    check_pictures(told["pictures"], expected["pictures"], OTHER_NOISE)
    # Noise drawn anew moves a cell by sqrt(2) sigma, and where it is drawn alike by nothing.
    moved = (again.image - run.image) / np.hypot(again.sigma, run.sigma)
    assert np.sqrt(np.mean(moved**2)) < 1.3


SHARE = np.array([4.8e6, 8.6e6, 5.6e6]) / 19.0e6
"""A sensor without colours sees the mean of three, in proportion to their usual electrons."""


class Independent:
    """Reads the run's tables by itself, and works out from them what every photo must be."""

    def __init__(self, run: Run) -> None:
        self.run, self.config = run, load_config(reference_run.BENCH)
        self.shots = {shot.name: shot for shot in run.manifest.run.shots}
        self.stored = np.load(run.folder / "codes.npz")
        scene = build_scene(self.config.scene)
        seen, lit = (index.ravel() for index in np.indices((scene.cells, scene.cells)))
        indirect = sum(e.entries(seen, lit)[:, None] * e.tint for e in scene.effects[3:])
        other = np.reshape(indirect, (scene.cells, scene.cells, 3)).transpose(2, 0, 1)
        own = np.stack([e.albedo for e in scene.effects[:3]], axis=1)  # type: ignore[attr-defined]
        drawn, panels = panels_of(self.config), []
        for name in ("projector", "mask"):
            optics, place = getattr(self.config, name), getattr(drawn, name).map
            late = optics.rise_s, optics.fall_s, 0.0, optics.skew_s
            panels.append(DensePanel(name == "mask", place, place, *late))
        width, height = self.config.camera.frame_quads or (0, 0)
        self.bench = DenseBench(
            panels[0], panels[1], make_camera_map(self.config, (height, width)), run.grid,
            own, other, samples=2, texture=scene.texture,
        )  # fmt: skip

    def frames_of(self, shot: str) -> tuple[Frames, FrameLog]:
        """What the panels were sent and did in a shot, by the columns of frames.csv."""
        table, grid = self.run.frames, self.run.grid
        mine = {name: column[table["shot"] == shot] for name, column in table.items()}
        none, count = np.zeros((0, grid[0] * grid[1] // 8), np.uint8), len(mine["shot"])
        primal, dual = (
            self.stored[f"{shot}.{panel}"] if f"{shot}.{panel}" in self.stored else none
            for panel in ("primal", "dual")
        )
        frames = Frames(
            primal, dual, mine["primal_index"].astype(np.int32),
            mine["dual_index"].astype(np.int32), np.zeros(count, np.uint8),
            mine["code"].astype(np.int32), mine["guard"] == 1, grid, grid, "whole",
        )  # fmt: skip
        log = FrameLog(
            mine["primal_shown"].astype(np.int32), mine["dual_shown"].astype(np.int32),
            mine["t_primal_ns"], mine["t_dual_ns"], np.array(self.shots[shot].end_ns),
            np.zeros(count, np.int32), "mock", True,
        )  # fmt: skip
        return frames, log

    def electrons(self, shot: str) -> Floats:
        """What each pixel of the camera is to hold, (h, w)."""
        taken = self.shots[shot]
        light = self.bench.photo(*self.frames_of(shot), taken.open_ns, taken.close_ns)
        return np.asarray(light @ SHARE * 19.0e6 / taken.f_number**2)

    def pairs_s(self, shot: str) -> Floats:
        """How long each pixel of the mask passed light of each of the projector, by matrix
        exponentials."""
        taken, (frames, log) = self.shots[shot], self.frames_of(shot)
        optics = [PanelOptics.from_config(getattr(self.config, n)) for n in ("projector", "mask")]
        lit, seen = (
            timeline(frames, log, one, taken.open_ns, primal, fine=2)
            for one, primal in zip(optics, (True, False), strict=True)
        )
        exposure_s = (taken.close_ns - taken.open_ns) * 1e-9
        return pair_integrals(lit, seen, optics[0], optics[1], exposure_s)

    def picture(self, pairs_s: Floats, wanted: Floats) -> Floats:
        """The photo of these times, (h, w), divided by the weight with which their probing matrix
        comes nearest to the wanted one (N, N)."""
        matrix = to_cells(pairs_s, self.run.grid, fine=2)[0]
        weight_s = np.sum(matrix * wanted) / np.sum(wanted**2)
        lit = np.zeros((len(wanted), len(pairs_s)))
        lit[cell_of(self.run.grid, 2), np.arange(len(pairs_s))] = 0.25
        sent = np.einsum("cnl,jl->jnc", self.bench.transport, pairs_s @ lit.T)
        light = self.bench._samples(pairs_s, sent, np.zeros(len(pairs_s)))
        return np.asarray(light @ SHARE / weight_s)


@pytest.mark.parametrize("shot", ["white", "coded-2"])
def test_its_raw_files_hold_what_first_principles_say(run: Run, shot: str) -> None:
    wanted = Independent(run).electrons(shot)
    # The sensor: 2.6 electrons a step, 2.4 of read noise, 2 a second in the dark, and rounding.
    taken = next(one for one in run.manifest.run.shots if one.name == shot)
    dark = 2.0 * (taken.close_ns - taken.open_ns) * 1e-9
    found = run.raw(shot)[0].astype(np.float64) * 2.6
    off = (found - wanted) / np.sqrt(wanted + dark + 2.4**2 + 2.6**2 / 12.0)
    assert abs(off.mean()) < 4.0 / np.sqrt(off.size)
    assert 0.9 < off.std() < 1.1
    assert np.abs(off).max() < 5.0


def test_its_indirect_picture_is_what_the_realised_matrix_makes_of_the_scene(run: Run) -> None:
    alone, wanted = Independent(run), 1.0 - np.eye(run.grid[0] * run.grid[1])
    pairs_s = sum((alone.pairs_s(f"coded-{part}") for part in (1, 2, 3, 4)), np.zeros(()))
    photo = alone.picture(pairs_s, wanted)
    found = run.decode(smooth=False, progress=False).pictures["indirect"]
    off = (found.image[..., 0] - photo) / found.sensor[..., 0]
    assert abs(off.mean()) < 4.0 / np.sqrt(off.size)
    assert 0.9 < off.std() < 1.1


def test_its_error_is_that_against_a_truth_worked_out_by_hand(
    run: Run, expected: dict[str, Any]
) -> None:
    cell = cell_of(run.grid, 2)
    other = (cell[:, None] != cell).astype(np.float64)  # light of all cells but a place's own
    truth = Independent(run).picture(other, 1.0 - np.eye(run.grid[0] * run.grid[1]))
    error = np.sqrt(np.mean((run.pictures["indirect"][..., 0] - truth) ** 2) / np.mean(truth**2))
    assert error == pytest.approx(expected["summary"]["rms_error_quads"], rel=1e-3)
    assert error < 0.02
