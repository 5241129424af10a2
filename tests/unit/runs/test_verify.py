"""A run that was changed in any way is named as such, and not decoded; a sound one is whole."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from pdcd.capture.engine import Engine
from pdcd.cli.main import main
from pdcd.errors import DecodeError
from pdcd.pictures.decode import decode_folder
from pdcd.pictures.row import read_matrix_row
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.views import OwnerView
from pdcd.runs.index import read_run_at
from pdcd.runs.manifest import MANIFEST, MANIFEST_DIGEST
from pdcd.runs.record import SCHEMA_VERSION
from pdcd.runs.verify import VerifyReport, verify_run
from tests import bench_rig, tampered
from tests.tampered import FORGERIES, HIDDEN, TAMPERINGS, Tampering

FLIPS = 60


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A finished run and the digest of its manifest, as the capture told it."""
    folder = tmp_path_factory.mktemp("kept")
    engine = Engine.from_config(bench_rig.config(folder))
    engine.start()
    result = engine.capture(
        CaptureRequest(goal="indirect", codes=4),
        job="job",
        owner=OwnerView(uid=1000, pid=11, user="anna"),
        emit=lambda _: None,
        cancelled=lambda: False,
    )
    engine.stop()
    assert result.folder is not None and result.manifest_sha256 is not None
    return Path(result.folder), result.manifest_sha256


@pytest.fixture
def run(kept: tuple[Path, str], tmp_path: Path) -> Iterator[Path]:
    """A copy of it that may be spoilt."""
    yield Path(shutil.copytree(kept[0], tmp_path / "run"))


def noticed(folder: Path) -> VerifyReport:
    """What verify says of a spoilt run; decode must refuse it, too."""
    found = verify_run(folder)
    assert not found.whole and found.findings
    with pytest.raises(DecodeError):
        decode_folder(folder)
    return found


def test_a_finished_run_is_whole(run: Path, kept: tuple[Path, str]) -> None:
    found = verify_run(run, manifest_sha256=kept[1])
    assert found.whole and found.findings == ()
    assert (found.job, found.schema, found.manifest_sha256) == ("job", SCHEMA_VERSION, kept[1])
    files = [path for path in run.rglob("*") if path.is_file()]
    assert found.files == len(files) - 2
    manifest = {run / MANIFEST, run / MANIFEST_DIGEST}
    assert found.size_bytes == sum(p.stat().st_size for p in files if p not in manifest)
    assert decode_folder(run).identical
    listed = read_run_at(run)  # a copy, known by its manifest and not by its name
    assert (listed.job, listed.state, listed.folder) == ("job", "done", str(run))


def test_the_digest_is_one_that_sha256sum_checks(run: Path) -> None:
    check = ["sha256sum", "--check", "--strict", "--quiet", MANIFEST_DIGEST]
    assert subprocess.run(check, cwd=run, check=False).returncode == 0
    tampered.flip(run / MANIFEST, 800)
    assert subprocess.run(check, cwd=run, check=False, capture_output=True).returncode == 1


@pytest.mark.long
def test_every_flipped_bit_is_noticed(run: Path) -> None:
    """60 of 60, each file at least once."""
    met = set()
    for path, bit in tampered.flips(run, FLIPS, seed=5):
        met.add(path)
        tampered.flip(path, bit)
        found = noticed(run)
        wanted = (
            MANIFEST if path.name in (MANIFEST, MANIFEST_DIGEST) else str(path.relative_to(run))
        )
        assert wanted in {finding.path for finding in found.findings}, (path, bit)
        tampered.flip(path, bit)
    assert met == set(tampered.files(run)) and len(met) > 15
    assert verify_run(run).whole


@pytest.mark.parametrize("tampering", TAMPERINGS, ids=str)
def test_whatever_happens_to_the_files_is_noticed(run: Path, tampering: Tampering) -> None:
    tampering.spoil(run)
    noticed(run)


@pytest.mark.parametrize("tampering", FORGERIES, ids=str)
def test_a_manifest_that_cannot_be_true_is_noticed(run: Path, tampering: Tampering) -> None:
    tampering.spoil(run)
    found = noticed(run).findings
    assert {finding.path for finding in found} & {MANIFEST, MANIFEST_DIGEST}
    assert max(len(finding.detail) for finding in found) <= 300


@pytest.mark.parametrize("tampering", HIDDEN, ids=str)
def test_who_knows_the_digest_notices_a_forger(
    run: Path, kept: tuple[Path, str], tampering: Tampering
) -> None:
    """And who does not cannot: the forger wrote a digest that fits."""
    tampering.spoil(run)
    assert verify_run(run).whole
    found = verify_run(run, manifest_sha256=kept[1])
    assert [finding.what for finding in found.findings] == ["manifest"]


@pytest.mark.parametrize(
    "change",
    [
        {"shots": []},
        {"grid": [8, 8], "cells": None},
        {"responsivity_e": [1e308, 1e-308, 1.0]},
        {"goal": {"name": "split", "period": 4}},
        {"goal": {"name": "warped"}},
        {"how": {"pilot": 8, "codes": 8}},
        {"how": {"parts": 64}},
        {"cells": {"grid": [0, 0], "frame": [0, 0]}},
    ],
    ids=str,
)
def test_a_flawless_forgery_that_makes_no_sense_is_not_decoded(
    run: Path, change: dict[str, object]
) -> None:
    """All digests fit; what the record asks for does not fit the files."""
    tampered.forged(run, lambda told: told["run"].update(change))
    with pytest.raises(DecodeError):
        decode_folder(run)


@pytest.mark.parametrize("field", ["name", "iso", "refreshes"])
def test_a_flawless_forgery_of_a_shot_is_not_decoded(run: Path, field: str) -> None:
    values = {"name": "other", "iso": 7, "refreshes": 7}
    tampered.forged(run, lambda told: told["run"]["shots"][0].update({field: values[field]}))
    with pytest.raises(DecodeError):
        decode_folder(run)


def test_a_row_of_the_matrix_looks_at_what_it_reads(run: Path) -> None:
    (run / "raw/coded.dng").unlink()
    read_matrix_row(run, (0, 0))
    tampered.flip(run / "frames.csv", 4000)
    with pytest.raises(DecodeError, match=r"frames\.csv"):
        read_matrix_row(run, (0, 0))


def test_a_run_without_its_final_name_is_not_whole(run: Path) -> None:
    found = noticed(run.rename(run.with_name("run.partial")))
    assert "not finished" in found.findings[0].detail


@pytest.mark.parametrize("name", ["nowhere", "a\0b", "loop", "x" * 300, "file"])
def test_what_is_no_folder_is_no_run(tmp_path: Path, name: str) -> None:
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "file").touch()
    assert verify_run(tmp_path / name).findings
    with pytest.raises(DecodeError):
        decode_folder(tmp_path / name)


def test_verify_on_the_command_line(
    run: Path, kept: tuple[Path, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["verify", str(run), str(kept[0])]) == 0
    assert capsys.readouterr().out.startswith(f"whole    {run}: ")
    assert main(["verify", str(run), "--manifest-sha256", kept[1].upper(), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["whole"] is True and told["manifest_sha256"] == kept[1] and told["findings"] == []

    (run / "a\nb").touch()
    assert main(["verify", str(run), str(kept[0])]) == 5
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["DAMAGED", "unknown", "whole"]
    assert "a\\nb: a file that the manifest does not list" in lines[1]
    assert main(["verify", str(run), "--json"]) == 5
    told = json.loads(capsys.readouterr().out)
    assert told["findings"] == [
        {"path": "a\\nb", "what": "unknown", "detail": "a file that the manifest does not list"}
    ]
    assert main(["decode", str(run)]) == 5
    assert "pdcd verify" in capsys.readouterr().err


def test_a_page_that_a_killed_program_left_unfinished_is_no_fault(run: Path) -> None:
    kill = "import os; from pdcd.files import put; put.system.rename = lambda *a, **k: os._exit(9)"
    write = f"from pathlib import Path; put.replace_file(Path({str(run)!r}) / NAME, b'half a page')"
    for name in ("report.html", "capture.html"):
        done = subprocess.run([sys.executable, "-c", f"{kill}; NAME = {name!r}; {write}"])
        assert done.returncode == 9
    (of_page,) = run.glob(".report*")
    (of_another,) = run.glob(".capture*")
    found = verify_run(run)
    assert found.later == (of_page.name,)
    assert [finding.path for finding in found.findings] == [of_another.name]


def test_what_is_made_later_to_look_at_is_named_and_nothing_else(run: Path) -> None:
    """And it must be a regular file of one of these very names."""
    (run / "report.html").write_text("a page")
    (run / "row-coded-1-2.png").write_bytes(b"a picture")
    found = verify_run(run)
    assert found.whole and found.later == ("report.html", "row-coded-1-2.png")
    assert decode_folder(run).identical
    (run / "row-coded-2-1.png").symlink_to("/etc/passwd")
    (run / "row-coded-3-1.png").mkdir()
    others = ["report.html.new", "row-coded-1.png", "row-a b-1-2.png", "raw/report.html", "x.html"]
    for name in others:
        (run / name).write_text("")
    unknown = {finding.path for finding in noticed(run).findings}
    assert unknown == {*others, "row-coded-2-1.png", "row-coded-3-1.png"}
