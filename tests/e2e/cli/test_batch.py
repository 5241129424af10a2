"""A batch with a daemon: done photos are not taken again, what failed is."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from pdcd.cli.main import main
from tests.bench_rig import config
from tests.e2e.api.test_connected import daemon

TABLE = """
[all]
codes = 8
parts = 1
pilot = 0
[[photo]]
goal = "indirect"
name = "one"
[[photo]]
goal = "white"
radius = 3
[[photo]]
goal = "white"
"""


def list_folders() -> list[str]:
    """Folders in the table of the batch."""
    table = Path("night/table.csv").read_text()
    return [row["folder"] for row in csv.DictReader(table.splitlines())]


def test_the_same_command_takes_only_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("night.toml").write_text(TABLE)
    command = ["batch", "night.toml", "--socket", str(tmp_path / "s")]
    with daemon(config(tmp_path), tmp_path / "s") as bench:
        assert main(command) == 5
        folders = list_folders()
        taken = len(bench.client.list())
        assert "photo 2: " in capsys.readouterr().out
        Path("night.toml").write_text(TABLE.replace("radius = 3", "seed = 3"))
        assert main(command) == 0
        again = list_folders()
        assert (again[0], again[2]) == (folders[0], folders[2]) and again[1]
        assert len(bench.client.list()) == taken + 1
        assert main(command) == 0 and len(bench.client.list()) == taken + 1
    assert "3 of 3 photos are done" in Path("night/summary.txt").read_text()
