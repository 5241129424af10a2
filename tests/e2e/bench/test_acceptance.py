"""The acceptance of a bench: a good mock bench passes, each planted fault fails in its own row."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from pdcd.api.acceptance import AcceptanceRecord, AcceptanceRow, write_acceptance
from pdcd.cli.exits import FAILED
from pdcd.cli.main import main
from tests.browser import browser

pytestmark = pytest.mark.whole

BENCH = """
[rig]
name = "tried & <accepted>"
[scene]
kind = "card"
grid = [12, 16]
[projector]
size_px = [256, 192]
[mask]
size_px = [256, 192]
contrast = 500.0
[camera]
frame_quads = [128, 96]
{camera}
[limits]
min_free_bytes = 0
[bench]
truth = "truth.toml"
"""

DIRTY = "[sensor]\nstops = [{ f_number = 4.0, true = 4.6 }]"
"""A stop that lets a quarter less light through than its number says."""


def accept(
    folder: Path, capsys: pytest.CaptureFixture[str], truth: str = "", camera: str = ""
) -> tuple[int, dict[str, dict[str, Any]], Path]:
    """Exit code, rows by check, and the page."""
    config, page = folder / "bench.toml", folder / "acceptance.html"
    config.write_text(BENCH.format(camera=camera))
    (folder / "truth.toml").write_text(truth)
    capsys.readouterr()
    asked = ["--config", str(config), "--page", str(page), "--json"]
    code = main(["doctor", "bench", *asked])
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["accepted"] == (code == 0)
    return code, {row["check"]: row for row in told["rows"]}, page


def failed(rows: dict[str, dict[str, Any]]) -> set[str]:
    return {name for name, row in rows.items() if row["state"] == "fail"}


def test_a_good_bench_passes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "bench.toml"
    config.write_text(BENCH.format(camera=""))
    (tmp_path / "truth.toml").write_text("")
    assert main(["calibrate", "sensor", "--local", "--json", "--config", str(config)]) == 0
    code, rows, page = accept(tmp_path, capsys)
    assert failed(rows) == set()
    assert code == 0
    assert {name: row["state"] for name, row in rows.items() if row["state"] != "pass"} == {
        "devices: click": "not tried",
        "calibration: other steps": "not tried",
    }
    assert rows["calibration: sensor"]["found"].startswith("good")
    text = page.read_text()
    assert "tried &amp; &lt;accepted&gt;" in text
    assert "virtual" in text  # the camera's serial
    assert "accepted; not tried: devices: click, calibration: other steps" in text


def test_without_a_calibration_it_is_not_accepted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, rows, _ = accept(tmp_path, capsys)
    assert (code, failed(rows)) == (5, {"calibration"})


@pytest.mark.parametrize(
    ("truth", "camera", "row"),
    [
        (DIRTY, "f_number = 4.0", "brightness of the card"),
        ("[mask.place]\noffset_px = [4.0, 0.0]", "", "places of the panels"),
        ("[mask]\nskew_s = 0.02", "", "indirect light of the card"),
        ("[sensor]\nread_noise = 120.0", "", "noise"),
        ("[scene]\nambient = 0.4", "", "dark"),
    ],
    ids=["dirty stop", "mask moved", "mask late", "noisy sensor", "lit room"],
)  # fmt: skip
def test_a_planted_fault_fails_in_its_row(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: str, camera: str, row: str
) -> None:
    code, rows, _ = accept(tmp_path, capsys, truth, camera)
    assert code == 5
    assert row in failed(rows)


def test_a_page_that_cannot_be_written_is_refused_before_any_light(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "bench.toml"
    config.write_text("")
    for page in (tmp_path, tmp_path / "nowhere" / "page.html"):
        asked = ["--config", str(config), "--page", str(page), "--out", str(tmp_path / "runs")]
        assert main(["doctor", "bench", *asked]) == FAILED
        assert str(page) in capsys.readouterr().err
        assert [file.name for file in tmp_path.iterdir()] == ["bench.toml"]


def test_the_page_fits_one_sheet_and_does_nothing(tmp_path: Path) -> None:
    """As many rows as a bench has, a quarter of which fail at length."""
    words = "the mask's picture lies 4.0 px right of where it is believed to lie; " * 3
    rows = tuple(
        AcceptanceRow(
            f"check {k}", "fail" if k % 4 == 0 else "pass", words[: 40 + 3 * k], "none", "mend"
        )
        for k in range(24)
    )
    devices = (("camera", "<script>alert(1)</script>"), ("mask", "m"))
    page = tmp_path / "page.html"
    write_acceptance(AcceptanceRecord("a bench", "2026-01-01 00:00 UTC", devices, rows), page)
    with browser() as tab:
        tab.page.goto(page.absolute().as_uri())
        assert tab.page.locator(".checks tbody tr").count() == len(rows)
        assert tab.page.locator("td.fail").count() == 6
        assert "<script>alert(1)" in tab.page.locator(".pairs").inner_text()
        tab.page.emulate_media(media="print")
        pdf = tab.page.pdf(prefer_css_page_size=True)
        assert len(re.findall(rb"/Type */Page[^s]", pdf)) == 1
        assert not tab.faults
