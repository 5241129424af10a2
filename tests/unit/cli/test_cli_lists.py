"""Lists of runs and jobs, what is said of one, which runs go."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from pdcd.cli import runs as runs_cli
from pdcd.cli.main import main
from pdcd.errors import DecodeError, RequestError
from pdcd.protocol.entry import Page, RunEntry, RunQuery
from pdcd.runs.prune import UnwantedRun


def entry(number: int, **more: Any) -> RunEntry:
    told: dict[str, Any] = {"state": "done", "goal": "white", "folder": f"/r/{number}"}
    return RunEntry(job=f"2026010{number}T000000Z-beef", **{**told, **more})


class Finder:
    """A daemon that has pages of runs; `asked` is by which queries."""

    pages: list[Page]
    asked: list[RunQuery]

    def __init__(self, path: Path) -> None: ...

    def __enter__(self) -> Finder:
        return self

    def __exit__(self, *unused: object) -> None: ...

    def find(self, query: RunQuery) -> Page:
        self.asked.append(query)
        return self.pages[len(self.asked) - 1]


@pytest.fixture
def finder(monkeypatch: pytest.MonkeyPatch) -> type[Finder]:
    class Fresh(Finder):
        pages: list[Page] = []  # noqa: RUF012
        asked: list[RunQuery] = []  # noqa: RUF012

    monkeypatch.setattr("pdcd.cli.daemon.Client", Fresh)
    return Fresh


def listed(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[list[str], list[str]]:
    """Lines of both streams."""
    assert main(["runs", *words]) == 0
    said = capsys.readouterr()
    return said.out.splitlines(), said.err.splitlines()


def test_the_newest_fifty_are_listed_and_pages_asked_for_until_then(
    finder: type[Finder], capsys: pytest.CaptureFixture[str]
) -> None:
    finder.pages = [Page(state_folder="/srv", runs=[entry(n % 9)] * 30, more=f"m{n}")
                    for n in range(4)]  # fmt: skip
    out, err = listed(capsys)
    assert len(out) == 51 and err[0].startswith("50 runs in /srv; ")
    assert err[0].endswith("pdcd runs --state-dir DIR")
    assert [query.before for query in finder.asked] == [None, "m0"]
    del finder.asked[:]
    finder.pages = [*finder.pages[:3], Page(state_folder="/srv", runs=[entry(7)])]
    out, _ = listed(capsys, "--all", "--json")
    assert len(out) == 91 and json.loads(out[0])["job"] == entry(0).job  # the oldest first
    first = finder.asked[0]
    assert (first.newest, first.previews, len(finder.asked)) == (1000, True, 4)
    assert [query.before for query in finder.asked] == [None, "m0", "m1", "m2"]


# --- one run --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("state", "read"), [("done", True), ("partial", True), ("failed", False),
                                             ("damaged", False), ("running", False)])  # fmt: skip
def test_a_manifest_is_read_where_there_is_one(
    finder: type[Finder],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    state: Any,
    read: bool,
) -> None:
    asked: list[Path] = []

    def look(folder: Path) -> Any:
        asked.append(folder)
        raise DecodeError("it is damaged")

    monkeypatch.setattr(runs_cli, "read_manifest", look)
    finder.pages = [Page(state_folder="/srv", runs=[entry(1, state=state, mock=True)])] * 2
    out, err = listed(capsys, "show", "x")
    assert asked == [Path("/r/1")] * read and err == ["pdcd: it is damaged"] * read
    assert ["bench", "virtual"] in [line.split() for line in out]
    (line,), _ = listed(capsys, "show", "x", "--json")
    assert list(json.loads(line)) == ["run"]


def test_a_run_is_named_by_a_folder_a_job_or_a_name(
    finder: type[Finder], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    looked: list[Path] = []

    def at(folder: Path) -> RunEntry:
        looked.append(folder)
        raise RequestError("no run")

    monkeypatch.setattr(runs_cli, "read_run_at", at)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "here").mkdir()
    for name in ("a/b", "here", "/x"):
        assert main(["runs", "show", name]) == 2
    assert looked == [Path("a/b"), Path("here"), Path("/x")] and finder.asked == []
    finder.pages = [Page(state_folder="/srv", runs=[])] * 2
    assert main(["runs", "show", "Chart"]) == 2
    assert main(["runs", "show", entry(1).job]) == 2
    assert [query.name or query.job for query in finder.asked] == ["Chart", entry(1).job]


def test_all_finished_runs_are_verified_where_none_is_named(
    finder: type[Finder], monkeypatch: pytest.MonkeyPatch
) -> None:
    states = ("done", "partial", "damaged", "failed", "cancelled", "running", "unfinished")
    runs = [entry(n + 1, state=state) for n, state in enumerate(states)]
    finder.pages = [Page(state_folder="/srv", runs=runs)]
    verified: list[Any] = []

    def verify(args: Any) -> int:
        verified.append((args.folder, args.manifest_sha256))
        return 77

    monkeypatch.setattr("pdcd.cli.verify.verify_runs", verify)
    assert main(["runs", "verify", "--goal", "white"]) == 77
    assert verified == [([Path("/r/1"), Path("/r/2"), Path("/r/3")], None)]
    assert finder.asked == [RunQuery(newest=1000, goal="white")]


# --- what goes ------------------------------------------------------------------------------------


class Pruned:
    """Two runs that are to go, of a mebibyte each; those in `kept` cannot be removed."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, finder: type[Finder]) -> None:
        self.going = [UnwantedRun(run=entry(n), size_bytes=n << 20) for n in (2, 1)]
        self.asked: list[Any] = []
        self.removed: list[str] = []
        self.kept: tuple[str, ...] = ()
        self.line, self.terminal = "n", True
        finder.pages = [Page(state_folder="/srv", runs=[])] * 9
        monkeypatch.setattr("pdcd.runs.prune.find_unwanted_runs", self.unwanted)
        monkeypatch.setattr("pdcd.runs.prune.remove_run", self.remove)
        stdin = SimpleNamespace(isatty=lambda: self.terminal, readline=lambda: self.line)
        monkeypatch.setattr("sys.stdin", stdin)

    def unwanted(self, state: Path, query: RunQuery, **how: Any) -> list[UnwantedRun]:
        self.asked.append((state, query, how))
        return self.going

    def remove(self, state: Path, one: UnwantedRun) -> UnwantedRun:
        assert state == Path("/srv")
        self.removed.append(one.run.job)
        if one.run.job in self.kept:
            return msgspec.structs.replace(one, why="it is in use")
        return msgspec.structs.replace(one, removed=True)


@pytest.fixture
def pruned(monkeypatch: pytest.MonkeyPatch, finder: type[Finder]) -> Pruned:
    return Pruned(monkeypatch, finder)


OLDEST_FIRST = [entry(1).job, entry(2).job]


@pytest.mark.parametrize(
    ("line", "goes"),
    [("y\n", True), ("YES\n", True), (" y \n", True), ("\n", False), ("", False), ("n\n", False),
     ("yep\n", False)],
)  # fmt: skip
def test_runs_go_where_somebody_agrees(
    pruned: Pruned, capsys: pytest.CaptureFixture[str], line: str, goes: bool
) -> None:
    pruned.line = line
    out, err = listed(capsys, "prune", "--failed")
    assert out[0] == "to be removed from /srv, the oldest first:"
    assert [row.split()[0] for row in out[2:4]] == OLDEST_FIRST and out[4] == "2 runs, 3.0 MiB"
    assert pruned.removed == OLDEST_FIRST * goes
    assert err == ["remove 2 runs for good? [y/N]",
                   "removed 2 of 2 runs, 3.0 MiB" if goes else "nothing was removed"]  # fmt: skip


def test_which_runs_go_is_what_was_typed(pruned: Pruned) -> None:
    since = "2026-01-02T00:00:00+00:00"
    words = ["--older-than", since, "--keep", "3", "--tag", "a", "--goal", "white", "--yes"]
    assert main(["runs", "prune", *words]) == 0
    assert main(["runs", "prune", "--failed", "--yes"]) == 0
    then = datetime(2026, 1, 2, tzinfo=UTC)
    assert pruned.asked == [
        (Path("/srv"), RunQuery(newest=1000, goal="white", tags=("a",)),
         {"older_than": then, "leftovers": False, "keep": 3}),
        (Path("/srv"), RunQuery(newest=1000, failed=True),
         {"older_than": None, "leftovers": True, "keep": 0}),
    ]  # fmt: skip


def test_a_run_that_could_not_be_removed_is_a_failure(
    pruned: Pruned, capsys: pytest.CaptureFixture[str]
) -> None:
    pruned.kept = (entry(2).job,)
    assert main(["runs", "prune", "--keep", "0", "--yes"]) == 5
    said = capsys.readouterr()
    assert said.out.splitlines()[-1] == f"kept {entry(2).job}: it is in use"
    assert said.err == "removed 1 of 2 runs, 1.0 MiB\n"
    assert main(["runs", "prune", "--keep", "0", "--yes", "--json"]) == 5
    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(one["run"]["job"], one["removed"]) for one in told] == [
        (OLDEST_FIRST[0], True), (OLDEST_FIRST[1], False),
    ]  # fmt: skip
