"""`report.html`: when it is made, what it costs nobody, and that texts of others stay texts."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pdcd.capture.salvage import decode_partial
from pdcd.capture.worker.worker import Worker
from pdcd.cli.main import main
from pdcd.errors import DecodeError
from pdcd.pages.report import material, write_report
from pdcd.protocol.events import ShotArmed
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.runs.folder import read_manifest
from pdcd.runs.verify import verify_run
from tests import bench_rig
from tests.taken import started, take_with

EVIL = "</script><b onclick=x()>&amp;{{data}}\u202e\x1b[2J"


def captured(folder: Path, **fields: Any) -> CaptureResult:
    folder.mkdir(exist_ok=True)
    with started(bench_rig.config(folder)) as engine:
        result = engine.capture(
            CaptureRequest(**{"goal": "indirect", "codes": 8, **fields}),
            job="job",
            emit=lambda _: None,
            cancelled=lambda: False,
            report=True,
        )
    assert result.state == "done", result.error
    return result


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> CaptureResult:
    """A run with a page and a hostile note."""
    return captured(tmp_path_factory.mktemp("kept"), note=EVIL)


@pytest.fixture
def folder(kept: CaptureResult, tmp_path: Path) -> Path:
    """A copy of it without the page, that may be spoilt."""
    copy = Path(shutil.copytree(str(kept.folder), tmp_path / "run"))
    (copy / "report.html").unlink()
    return copy


def test_a_capture_ends_with_its_page(kept: CaptureResult) -> None:
    folder = Path(str(kept.folder))
    assert "report.html" in kept.files
    assert "report.html" not in read_manifest(folder).files
    assert verify_run(folder).later == ("report.html",)
    made = (folder / "report.html").read_bytes()
    assert (
        write_report(folder).read_bytes() == made
    )  # the same from the folder alone, truth included
    assert b'"kind":"truth"' in made


def test_no_page_where_it_is_dear_or_unwanted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(material, "DEFAULT_S", 0.0)
    result = captured(tmp_path)
    assert "report.html" not in result.files
    assert verify_run(Path(str(result.folder))).later == ()
    monkeypatch.undo()
    with started(bench_rig.config(tmp_path)) as engine:
        plain = take_with(engine, "plain", goal="white", codes=4)
    assert "report.html" not in plain.result.files


def test_a_page_that_cannot_be_made_costs_the_run_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*told: object) -> str:
        raise ValueError("no page")

    monkeypatch.setattr(Worker, "report", broken)
    result = captured(tmp_path)
    assert "report.html" not in result.files and verify_run(Path(str(result.folder))).whole


def test_texts_of_others_are_escaped(folder: Path) -> None:
    text = write_report(folder).read_text()
    assert "\u202e" not in text and "\x1b" not in text
    assert text.count("<script") == 2 and text.count("</script") == 2
    shown = "&lt;/script&gt;&lt;b onclick=x()&gt;&amp;amp;{{data}}"
    assert shown in text
    told = json.loads(text.split('id="data">')[1].split("</script>")[0])
    assert told["job"] == "job"


def test_the_policy_allows_the_one_script_and_nothing_from_anywhere(folder: Path) -> None:
    text = write_report(folder).read_text()
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)
    assert policy is not None and policy[1].startswith("default-src 'none'; ")
    script = text.rsplit("<script>", 1)[1].split("</script>")[0]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in policy[1]
    assert not re.search(r"(?i)https?://|src=|@import|url\(", text.split('id="data"')[0])


def test_a_changed_run_gets_no_page(folder: Path) -> None:
    with (folder / "frames.csv").open("a") as file:
        file.write("x")
    with pytest.raises(DecodeError, match=r"frames.csv"):
        write_report(folder)
    assert not (folder / "report.html").exists()


def test_a_run_that_was_cut_has_a_page_that_says_so(tmp_path: Path) -> None:
    armed: list[str] = []
    with started(bench_rig.config(tmp_path)) as engine:
        cut = engine.capture(
            CaptureRequest(goal="indirect", codes=8, parts=4, out=str(tmp_path)),
            job="job",
            emit=lambda event: armed.append(event.shot) if isinstance(event, ShotArmed) else None,
            cancelled=lambda: "coded-3" in armed,
        )
    made = decode_partial(Path(str(cut.folder)))
    assert made.missing == ("coded-3", "coded-4")
    text = write_report(Path(made.folder)).read_text()
    assert "missing shots: coded-3, coded-4" in text
    found = verify_run(Path(made.folder))
    assert [finding.what for finding in found.findings] == ["partial"]


def test_entries_of_t_are_on_the_page(tmp_path: Path) -> None:
    folder = Path(str(captured(tmp_path, goal="transport", rows=(0, 1)).folder))
    picture = base64.b64encode((folder / "preview/transport.png").read_bytes()).decode()
    assert picture in write_report(folder).read_text()


def test_a_truth_that_does_not_fit_is_refused(folder: Path) -> None:
    np.savez(folder / "truth.npz", image=np.zeros(3))
    with pytest.raises(DecodeError, match=r"truth.npz"):
        write_report(folder)


def test_the_command_says_where_the_page_is(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "page.html"
    assert main(["report", str(folder), "--out", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == {"file": str(out), "size_bytes": out.stat().st_size}
    assert not (folder / "report.html").exists()
    assert main(["report", str(folder), "--out", str(tmp_path / "no" / "page.html")]) == 5
    assert "cannot write" in capsys.readouterr().err
    out.unlink()
    out.symlink_to(tmp_path / "elsewhere")
    assert main(["report", str(folder), "--out", str(out)]) == 0
    assert f"{out}: " in capsys.readouterr().out
    assert not out.is_symlink() and not (tmp_path / "elsewhere").exists()
