"""Run folders of earlier schemas: still decoded, bit for bit, or refused by the name of theirs."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from pdcd.cli.main import main
from pdcd.errors import DecodeError
from pdcd.pictures.darkroom import Darkroom
from pdcd.pictures.decode import decode_folder
from pdcd.protocol.request import Goal, How
from pdcd.runs.folder import read_manifest
from pdcd.runs.older import upgraded
from pdcd.runs.record import SCHEMA_VERSION
from pdcd.runs.verify import verify
from tests import tampered
from tests.places import DATA


def unpacked(name: str, folder: Path) -> Path:
    """A run that was taken by a program of schema 1."""
    with zipfile.ZipFile(DATA / f"{name}.zip") as packed:
        packed.extractall(folder)
    return folder


@pytest.mark.parametrize("name", ["schema-1-pilot", "schema-1-parts", "schema-2"])
def test_a_run_of_an_earlier_schema_decodes_bit_for_bit(tmp_path: Path, name: str) -> None:
    """Its pictures, of 32 bits; the 64 of the answer are rounded as the NumPy of the day does."""
    folder = unpacked(name, tmp_path)
    assert json.loads((folder / "capture.json").read_bytes())["schema"] == int(name[7])
    report = decode_folder(folder)
    assert report.identical and report.files
    answer = Darkroom(folder, read_manifest(folder).run).decoded().answer
    with np.load(folder / "probe.npz") as kept:
        largest = float(np.abs(answer.image).max())
        np.testing.assert_allclose(kept["image"], answer.image, rtol=1e-13, atol=1e-14 * largest)
        np.testing.assert_allclose(kept["sigma"], answer.sigma, rtol=1e-9)


@pytest.mark.parametrize("name", ["schema-1-pilot", "schema-1-parts", "schema-2"])
def test_a_run_of_an_earlier_schema_is_verified_as_far_as_it_goes(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """All files by their digests; of the manifest nobody knows, and that is said."""
    folder = unpacked(name, tmp_path / "run")
    assert main(["verify", str(folder)]) == 0
    said = capsys.readouterr().out
    assert said.startswith("whole")
    assert f"not checked: the manifest: a run of schema {name[7]}" in said
    files = [path for path in tampered.files(folder) if path.name != "capture.json"]
    assert verify(folder).files == len(files) >= 15
    for path in files:
        bit = path.stat().st_size * 4
        tampered.flip(path, bit)
        assert [f.path for f in verify(folder).findings] == [str(path.relative_to(folder))]
        tampered.flip(path, bit)
    (folder / "capture.json.sha256").touch()
    assert {f.what for f in verify(folder).findings} == {"manifest", "unknown"}


def test_flat_fields_become_a_goal_and_how(tmp_path: Path) -> None:
    run = read_manifest(unpacked("schema-1-parts", tmp_path / "a")).run
    assert run.goal == Goal(name="off-diagonal", shift=(1, -1))
    assert run.how == How(codes=16, parts=4, family="hadamard", black_level="mask")
    assert run.cells is None
    run = read_manifest(unpacked("schema-1-pilot", tmp_path / "b")).run
    assert (run.how.codes, run.how.pilot, run.how.coded) == (24, 8, 16)


@pytest.mark.parametrize("schema", [0, 4, 99, None, "2", 2.5, True])
def test_another_schema_is_refused_by_its_name(tmp_path: Path, schema: object) -> None:
    folder = unpacked("schema-1-parts", tmp_path)
    path = folder / "capture.json"
    path.write_text(json.dumps({**json.loads(path.read_bytes()), "schema": schema}))
    assert verify(folder).findings[0].path == "capture.json"
    with pytest.raises(DecodeError, match=f"schema {schema!r}.*reads 1 to {SCHEMA_VERSION}"):
        read_manifest(folder)


@pytest.mark.parametrize("lost", ["run", "plan"])
def test_a_manifest_of_schema_1_without_its_parts_is_damaged(lost: str) -> None:
    with pytest.raises(DecodeError, match="no run or no plan"):
        upgraded({"schema": 1, "run": {}, "plan": {}, lost: None})


def test_the_present_schema_is_left_alone() -> None:
    manifest = {"schema": SCHEMA_VERSION, "run": {"goal": {"name": "white"}}}
    assert upgraded(manifest) == manifest
