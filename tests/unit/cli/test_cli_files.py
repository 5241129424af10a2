"""What commands do with files of runs, and what they say of it: verify, figures."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pdcd.bench.calibration import RECORD
from pdcd.cli import figures as figures_cli
from pdcd.cli import verify as verify_cli
from pdcd.cli.main import main
from pdcd.figures.figure import FULL_MODE, QUICK_MODE
from pdcd.runs.verify import FolderFinding, VerifyReport

# --- verify ---------------------------------------------------------------------------------------


def verified(folder: str, *findings: tuple[Any, str], **more: Any) -> VerifyReport:
    return VerifyReport(
        folder=folder, whole=not findings, job="j", schema=1, manifest_sha256=None, files=7,
        size_bytes=99, findings=tuple(FolderFinding(what=a, path=b, detail="so") for a,
        b in findings),
        **more,
    )  # fmt: skip


@pytest.fixture
def checked(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Answers by the folder's name; `asked` is what was looked at how."""
    found: dict[str, Any] = {"asked": []}

    def looker(how: str) -> Any:
        def look(folder: Path, *, manifest_sha256: str | None) -> VerifyReport:
            found["asked"].append((how, folder.name, manifest_sha256))
            answer: VerifyReport = found[folder.name]
            return answer

        return look

    for name in ("verify_run", "verify_calibration"):
        monkeypatch.setattr(verify_cli, name, looker(name))
    return found


def test_every_folder_is_looked_at_and_one_that_is_not_whole_fails(
    checked: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b", "c", "d"):
        (tmp_path / name).mkdir()
    (tmp_path / "d" / RECORD).touch()
    checked["a"] = verified("/a", later=("report.html",))
    checked["b"] = verified("/b", ("changed", "x.tif"), ("partial", "y"))
    checked["c"] = verified("/c", ("partial", "y"))
    checked["d"] = verified("/d")
    folders = [str(tmp_path / name) for name in ("a", "d")]
    assert main(["verify", *folders]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "whole    /a: 7 files, 99 bytes as they were",
        "  made later  report.html: to look at; nothing vouches for it",
        "whole    /d: 7 files, 99 bytes as they were",
    ]
    assert checked["asked"] == [("verify_run", "a", None), ("verify_calibration", "d", None)]
    folders = [str(tmp_path / name) for name in ("b", "c", "a")]
    assert main(["verify", *folders]) == 5
    assert capsys.readouterr().out.splitlines()[:6] == [
        "DAMAGED  /b: 7 files, 99 bytes as they were",
        "  changed     x.tif: so",
        "  partial     y: so",
        "PARTIAL  /c: 7 files, 99 bytes as they were",
        "  partial     y: so",
        "whole    /a: 7 files, 99 bytes as they were",
    ]
    assert main(["verify", "--json", *folders]) == 5
    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(run["folder"], run["whole"]) for run in told] == [
        ("/b", False), ("/c", False), ("/a", True),
    ]  # fmt: skip


# --- figures --------------------------------------------------------------------------------------


@pytest.fixture
def outcome(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """What comes of the figures: one that held, one that did not, one that was not made."""

    def thing(name: str, held: bool) -> dict[str, Any]:
        return {"what": name, "name": name, "held": held}

    good = {"number": "1", "numbers": [thing("gain", True)], "captures": []}
    bad = {
        "number": "2", "numbers": [thing("gain", False), thing("loss", True), thing("lag", False)],
        "captures": [thing("book", False), thing("chart", True)],
    }  # fmt: skip
    made = SimpleNamespace(held=False, made=[good, bad], failed={"3": "no light"}, asked=[])

    def make(*asked: Any, **how: Any) -> SimpleNamespace:
        made.asked.append((*asked, how))
        return made

    monkeypatch.setattr(figures_cli, "make_paper_figures", make)
    monkeypatch.setattr(figures_cli, "open_processes", nullcontext)
    monkeypatch.setattr(
        figures_cli, "choose_figures", lambda numbers: [f"figure {n}" for n in numbers]
    )
    return made


def test_figures_say_which_of_their_numbers_did_not_hold(
    outcome: SimpleNamespace,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["figures", "1", "2", "--out", "page", "--full", "--workers", "3"]) == 5
    assert capsys.readouterr().out.splitlines() == [
        "1: held", "2: NOT HELD: gain; lag; RMS error of book", "3: could not be made: no light",
        f"page  {tmp_path}/page/index.html",
    ]  # fmt: skip
    ((figures, out, mode, workers, how),) = outcome.asked
    assert (figures, out, mode) == (["figure 1", "figure 2"], tmp_path / "page", FULL_MODE)
    assert (workers, how["plots"]) == (3, True)
    outcome.held = True
    assert main(["figures", "--out", "page", "--no-plots"]) == 0
    *_, (figures, _, mode, workers, how) = outcome.asked
    assert (figures, mode, workers, how["plots"]) == ([], QUICK_MODE, None, False)
