"""`pdcd export`: values, metadata, refusals; the run stays as it was."""

from __future__ import annotations

import io
import json
import shutil
from hashlib import sha256
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import PIL.Image
import pytest
import tifffile

from pdcd import __version__
from pdcd.api.run import open_run
from pdcd.cli.main import main
from pdcd.errors import RequestError
from pdcd.pictures.written.export import ExportedFile, ExportRequest, export_run_pictures
from pdcd.pictures.written.picture_files import read_tiff
from pdcd.runs.verify import verify_run
from tests import bench_rig, tampered
from tests.taken import take


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of three pictures of 3 x 4 quads."""
    return take(bench_rig.config(tmp_path_factory.mktemp("run")), codes=8).folder


def made(run: Path, format_: Any, **more: Any) -> dict[str, ExportedFile]:
    return {
        file.picture: file
        for file in export_run_pictures(run, ExportRequest(format=format_, **more), lambda: None)
    }


def kept(run: Path, name: str = "indirect") -> Any:
    return read_tiff(run / "linear" / f"{name}.tif")


def test_floats_are_those_of_the_run(run: Path, tmp_path: Path) -> None:
    told = {
        "picture": "indirect",
        "job": "job",
        "goal": "indirect",
        "units": "scene units: a white, fully lit, facing matte surface is 1",
        "geometry": "the camera's own, a pixel for each Bayer quad",
        "white_balance": "1 1 1",
        "scene": "virtual",
        "taken_by": f"pdcd {__version__}",
        "manifest_sha256": sha256((run / "capture.json").read_bytes()).hexdigest(),
        "verdict": open_run(run).verdict,
        "scale": "1",
        "software": f"pdcd {__version__}",
    }
    path = tmp_path / "a.exr"
    path.write_bytes(made(run, "exr")["indirect"].data)
    with OpenEXR.File(str(path)) as file:
        assert np.array_equal(file.channels()["RGB"].pixels, kept(run))
        assert {name: file.header()[name] for name in told} == told
    with np.load(io.BytesIO(made(run, "npz")["indirect"].data)) as arrays:
        assert np.array_equal(arrays["image"], kept(run))
        assert {name: str(arrays[name]) for name in told} == told


@pytest.mark.parametrize("format_", ["tiff16", "png16"])
def test_sixteen_bits_give_the_values_back(run: Path, format_: str) -> None:
    found = made(run, format_, span=(-0.1, 1.5))["indirect"]
    words = cv2.imdecode(np.frombuffer(found.data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert words is not None and (found.below, found.above, found.unknown) == (0, 0, 0)
    values = words[..., ::-1] / 65535 * 1.6 - 0.1
    assert np.abs(values - kept(run)).max() <= 0.51 * 1.6 / 65535
    if format_ == "tiff16":
        with tifffile.TiffFile(io.BytesIO(found.data)) as file:
            lines = file.pages.first.description.splitlines()
        told = {name: words for name, _, words in (line.partition(": ") for line in lines)}
    else:
        with PIL.Image.open(io.BytesIO(found.data)) as picture:
            told = {str(name): words for name, words in picture.info.items()}
    assert (told["black"], told["white"]) == ("0 is -0.1", "65535 is 1.5")
    assert told["scale"] == "40959.375 steps for 1; linear"
    assert told["job"] == "job" and told["units"].startswith("scene units")


def test_the_usual_white_is_one_for_all_pictures_of_a_run(run: Path) -> None:
    alone = made(run, "png16", pictures=("indirect",))
    everything = made(run, "png16")
    assert set(alone) == {"indirect"} and set(everything) == {"white", "indirect", "direct"}
    assert alone["indirect"] == everything["indirect"]
    top = max(np.percentile(kept(run, name), 99.9) for name in everything)
    black, white = everything["white"].span or (0.0, 0.0)
    assert black == 0.0 and top <= white < 2 * top and np.log2(white) % 1 == 0


def test_what_is_clipped_is_counted(run: Path) -> None:
    image = kept(run)
    low, high = (float(np.percentile(image, share)) for share in (25.0, 75.0))
    found = made(run, "tiff16", span=(low, high))["indirect"]
    assert (found.below, found.above) == ((image < low).sum(), (image > high).sum())
    words = tifffile.imread(io.BytesIO(found.data))
    assert ((words == 0) >= (image < low)).all() and ((words == 65535) >= (image > high)).all()


def test_upright_is_the_field(run: Path) -> None:
    """The camera of this bench has 3 x 4 quads, and the field is 1024 x 768."""
    found = made(run, "npz", upright=True)["white"]
    with np.load(io.BytesIO(found.data)) as arrays:
        assert arrays["image"] == pytest.approx(kept(run, "white"), abs=1e-5)
        assert str(arrays["geometry"]) == "the field, as the projector sees it"


def test_a_white_patch_makes_its_place_grey(run: Path) -> None:
    found = made(run, "npz", white_patch=(0.4, 0.5))["white"]
    with np.load(io.BytesIO(found.data)) as arrays:
        balanced, words = arrays["image"], str(arrays["white_balance"])
    ratio = balanced / kept(run, "white")
    assert np.ptp(ratio.reshape(-1, 3), axis=0) == pytest.approx(0.0, abs=1e-5)
    assert ratio[0, 0, 1] == pytest.approx(1.0) and words.endswith(", by a patch at 0.4 0.5")
    assert np.ptp(balanced[1, 1]) <= 1e-4  # the middle of that cell is all that the patch holds


def test_the_command_writes_and_tells(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = ["export", str(run), "--format", "tiff16", "--out", str(tmp_path / "out")]
    assert main([*line, "--picture", "white", "--range", "0.4", "0.5", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    path = tmp_path / "out" / "job-white.tiff"
    assert told["file"] == str(path) and told["black"] == 0.4 and told["above"] > 0
    assert told["sha256"] == sha256(path.read_bytes()).hexdigest()
    assert main(line) == 2  # one of three is there: none is written
    assert "job-white.tiff is there already" in capsys.readouterr().err
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["job-white.tiff"]
    assert main([*line, "--force", "--range", "0.4", "0.5"]) == 0
    out = capsys.readouterr().out
    assert "black is 0.4, white is 0.5 scene units" in out and "values above white" in out
    assert len(list((tmp_path / "out").iterdir())) == 3
    assert verify_run(run).whole


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--picture", "blue"], "no picture 'blue' (it has direct, indirect, white)"),
        (["--range", "1", "1"], "from 1 to 1 is not one"),
        (["--range", "0", "nan"], "from 0 to nan is not one"),
        (["--white-patch", "0.5", "1.5"], "white patch lies at 0 to 1"),
        (["--white-patch", "nan", "0.5"], "white patch lies at 0 to 1"),
        (["--format", "exr", "--range", "0", "1"], "exr files need no range"),
        (["--out", "RUN"], "another run, and nothing is written into it"),
    ],
)
def test_refusals(
    more: list[str],
    words: str,
    run: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    more = [str(run / "linear") if word == "RUN" else word for word in more]
    assert main(["export", str(run), "--format", "png16", *more]) == 2
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir()) and verify_run(run).whole


def test_a_changed_run_is_not_exported(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = shutil.copytree(run, tmp_path / "copy")
    tampered.files(copy)  # which makes them writable
    out = ["--format", "npz", "--out", str(tmp_path / "out")]
    path = copy / "linear" / "white.tif"
    tampered.flip(path, 100)
    assert main(["export", str(copy), *out]) == 5
    assert "linear/white.tif: it does not have the SHA-256" in capsys.readouterr().err
    tampered.flip(path, 100)
    manifest = copy / "capture.json"
    manifest.write_text(manifest.read_text().replace('"job": "job"', '"job": "../job"'))
    tampered.relisted(copy)
    assert main(["export", str(copy), *out]) == 5
    assert "cannot be part of a file's name" in capsys.readouterr().err
    assert not (tmp_path / "out").exists() and not (tmp_path / "job-white.npz").exists()


def test_a_patch_in_the_dark_is_refused(run: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(run, tmp_path / "copy")
    for path in tampered.files(copy):
        if path.parent.name == "linear":
            dark = cv2.imencode(".tiff", np.zeros((3, 4, 3), np.float32))[1]
            path.write_bytes(dark.tobytes())
    tampered.relisted(copy)
    with pytest.raises(RequestError, match="nothing white can be seen at"):
        made(copy, "exr", white_patch=(0.5, 0.5))
    assert made(copy, "png16")["white"].span == (0.0, 1.0)
