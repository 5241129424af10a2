"""`pdcd batch`: what a table says, what is tried again, and how it ends."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from pdcd.api.table import Table
from pdcd.api.task import TaskRecord, make_failed_row, make_result_row
from pdcd.cli import batch as module
from pdcd.cli.batch_table import read_batch_table
from pdcd.cli.main import main
from pdcd.errors import ConfigError, DeviceLost, PdcdError, RequestError
from pdcd.protocol.line_talk import UnreachableError
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from tests.places import ROOT

TOML = """
[all]
codes = 16
[[photo]]
goal = "indirect"
name = "first"
warp = "maps/w.npy"
prior = "decay:3"
[[photo]]
goal = "fraction"
p = 0.25
codes = 32
config = {scene = {kind = "wax-disk"}}
"""
CSV = """\ufeffgoal,codes,p,shift,tags,white,rows,guards,name,codes_from
indirect,,,0 1,a b,no,,,"first, of all",own.npz

fraction,16,25%,,,,,,,
transport,,,,,true,3,false,,
"""


def test_a_table_says_what_each_photo_is(tmp_path: Path) -> None:
    (tmp_path / "night.toml").write_text(TOML)
    (tmp_path / "night.csv").write_text(CSV)
    first, second = read_batch_table(tmp_path / "night.toml")
    warp = tmp_path / "maps" / "w.npy"
    assert first == {"goal": "indirect", "name": "first", "codes": 16, "warp": warp,
                     "prior": "decay:3"}  # fmt: skip
    assert second["codes"] == 32 and second["config"] == {"scene": {"kind": "wax-disk"}}
    assert read_batch_table(tmp_path / "night.csv") == [
        {"goal": "indirect", "shift": [0, 1], "tags": ["a", "b"], "white": False,
         "name": "first, of all", "codes_from": tmp_path / "own.npz"},
        {"goal": "fraction", "codes": 16, "p": 0.25},
        {"goal": "transport", "white": True, "rows": [3, 3], "guards": False},
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "text", "faults"),
    [
        ("x.toml", '[[photo]]\ngoal = "indirec"\n[[photo]]\ncodes = 1',
         ["photo 1: indirec: no such goal; is indirect meant?", "photo 2: goal: must be given"]),
        ("x.toml", '[[photo]]\ngoal = "indirect"\ncods = 1\nseed = "x"',
         ["photo 1: cods: no such keyword; is codes meant?", "photo 1: seed: it takes a whole"]),
        ("x.toml", "[photos]", ["photos is not a table of a batch"]),
        ("x.toml", "photo = [1]", ["a photo is not a table"]),
        ("x.toml", "photo = [", ["is not TOML"]),
        ("x.toml", "", ["lists no photo"]),
        ("x.csv", "goal,codes\nindirect,many\nwhite,1,2",
         ["photo 2: 3 values for 2 names"]),
        ("x.csv", "goal,codes\nindirect,many", ["photo 1: codes: it takes a whole number"]),
        ("x.csv", "goal,pp\nindirect,1", ["photo 1: pp: no such keyword"]),
        ("x.csv", "", ["lists no photo"]),
        ("x.csv", 'goal\n"indirect', ["is not CSV"]),
        ("gone.csv", None, ["cannot read the table"]),
    ],
)  # fmt: skip
def test_a_wrong_table_is_refused_with_all_its_faults(
    tmp_path: Path, name: str, text: str | None, faults: list[str]
) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError) as caught:
        read_batch_table(tmp_path / name)
    assert name in str(caught.value)
    for fault in faults:
        assert fault in caught.value.message


WHITE = CaptureRequest(goal="white")
DONE = make_result_row(WHITE, CaptureResult(job="j", state="done", folder="/r/j"))
LOST, WRONG = DeviceLost("it is gone", hint="plug it in"), RequestError("no such photo")

_Ends = list[PdcdError | None] | Exception


@pytest.fixture
def rounds(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Callable[..., list[float]]]:
    """Makes sweeps end like that, one after the other; returns the pauses between them."""
    monkeypatch.chdir(tmp_path)
    Path("night.csv").write_text("goal,name\nwhite,one\nwhite,two\n")

    def script(*ends: _Ends) -> list[float]:
        left, pauses = list(ends), list[float]()

        def sweep(bench: Any, photos: Any, *, progress: Any, **how: Any) -> Table:
            assert [photo["name"] for photo in photos] == ["one", "two"]
            end = left.pop(0)
            if isinstance(end, Exception):
                raise end
            rows: list[TaskRecord] = []
            for number, error in enumerate(end):
                row = DONE if error is None else make_failed_row(WHITE, error)
                rows.append({"number": number, **row})
                progress(rows[-1])
            return Table(rows)

        monkeypatch.setattr(module, "sweep", sweep)
        monkeypatch.setattr(time, "sleep", pauses.append)
        return pauses

    yield script


@pytest.mark.parametrize(
    ("ends", "more", "code", "pauses"),
    [
        ([[None, None]], "", 0, []),
        ([[None, LOST], [None, None]], "", 0, [30.0]),
        ([[None, LOST], [None, LOST]], "", 5, [30.0]),
        ([[None, LOST]], "--retries 0", 5, []),
        ([[LOST, LOST], [None, LOST], [None, None]], "--retries 3 --pause 5", 0, [5.0, 5.0]),
        ([[None, WRONG]], "--retries 9", 5, []),
        ([UnreachableError("it went away"), [None, None]], "", 0, [30.0]),
        ([UnreachableError("it went away")], "--retries 0", 3, []),
    ],
)
def test_what_failed_is_tried_again_where_that_may_help(
    rounds: Any, capsys: pytest.CaptureFixture[str], ends: list[_Ends], more: str, code: int,
    pauses: list[float],
) -> None:  # fmt: skip
    found = rounds(*ends)
    assert main(["batch", "night.csv", "--local", *more.split()]) == code
    assert found == pauses
    if code == 3:
        return
    printed = capsys.readouterr()
    assert Path("night/summary.txt").read_text() == printed.out
    failed = [error for error in ends[-1] if error is not None]  # type: ignore[union-attr]
    assert printed.out.splitlines()[-1].startswith(f"{2 - len(failed)} of 2 photos are done")
    assert f"photo 2: {failed[0]}" in printed.out if failed else "/r/j" in printed.out
    assert len(Path("night/table.csv").read_text().splitlines()) == 3
    assert "photo 1 of 2 white one: " in printed.err


def test_what_scripts_get_of_a_batch(rounds: Any, capsys: pytest.CaptureFixture[str]) -> None:
    rounds([None, WRONG])
    assert main(["batch", "night.csv", "--local", "--out", "there", "--json"]) == 5
    *rows, last = map(json.loads, capsys.readouterr().out.splitlines())
    assert [row["state"] for row in rows] == ["done", "failed"]
    assert last == {"state": "failed", "photos": 2, "failed": 1,
                    "folder": str(Path("there").absolute())}  # fmt: skip


def test_an_interrupted_batch_says_how_to_go_on(
    rounds: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*unused: Any, **how: Any) -> Table:
        raise KeyboardInterrupt

    rounds()
    monkeypatch.setattr(module, "sweep", interrupt)
    assert main(["batch", "night.csv", "--local"]) == 130
    assert "the same command goes on" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("batch night.csv --workers 2", "--workers goes with --local"),
        ("batch night.csv --retries -1", "--retries -1"),
        ("batch night.csv --pause nan", "--pause nan"),
        ("batch night.csv --local --socket s", "--local goes without --socket"),
    ],
)
def test_options_that_do_not_go_together(
    rounds: Any, capsys: pytest.CaptureFixture[str], line: str, what: str
) -> None:
    rounds()
    assert main(line.split()) == 2
    assert what in capsys.readouterr().err


def test_the_tables_of_the_docs_are_sound(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "python.md").read_text().partition("## Many photos")[2]
    text = text.partition("## Codes of your own")[0]
    (tmp_path / "night.toml").write_text(text.split("```toml\n")[1].split("```")[0])
    lines = [line.strip() for line in text.splitlines() if line.startswith("    ") and "," in line]
    (tmp_path / "night.csv").write_text("\n".join(line for line in lines if "pdcd" not in line))
    goals = ["indirect", "fraction", "indirect"]
    assert [photo["goal"] for photo in read_batch_table(tmp_path / "night.toml")] == goals
    assert [photo["goal"] for photo in read_batch_table(tmp_path / "night.csv")] == [
        "indirect", "fraction", "off-diagonal",
    ]  # fmt: skip
