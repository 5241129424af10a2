"""`pdcd runs`: what it lists, shows, verifies and removes, and how it is told which runs."""

from __future__ import annotations

import json
import os
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import pytest

from pdcd.cli import runs as runs_cli
from pdcd.cli.main import main
from pdcd.cli.runs import parse_moment
from pdcd.errors import ConfigError
from pdcd.protocol.entry import Page, RunQuery
from pdcd.protocol.line_talk import UnreachableError
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import Quality
from pdcd.runs.elsewhere import list_noted_folders, note_folder
from tests.run_folders import cut, find_runs, finished, job
from tests.unit.cli.cli_stubs import (
    StubClient,
    last_object,
    stub_daemon,
)

FAILED = {
    "event": "failed", "kind": "sync", "message": "the panels " + "missed refreshes " * 20,
    "taken": "1 of 3 shots",
}  # fmt: skip


@pytest.fixture
def state(tmp_path: Path) -> Path:
    """Where captures of this user go that need no daemon."""
    folder = tmp_path / ".local" / "state" / "pdcd"
    captures = folder / "captures"
    labels = {"goal": "off-diagonal", "name": "Chart in milk", "tags": ["glass", "wax"],
              "note": "a long note " * 40}  # fmt: skip
    finished(captures, job(1), request=labels)
    finished(captures, job(2), summary={"rms_error_quads": None, "exposure_s": 1234.5})
    cut(captures, job(3), FAILED)
    finished(folder / "preview", job(4), request={"goal": "white"})
    return folder


def told(capsys: pytest.CaptureFixture[str], *words: object, code: int = 0) -> list[str]:
    assert main(["runs", *map(str, words)]) == code
    return capsys.readouterr().out.splitlines()


def test_the_list_fits_a_terminal_and_says_why_a_run_failed(
    state: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = told(capsys)
    assert max(map(len, lines)) <= 80
    rows = {line.split()[0]: line.split()[1:] for line in lines if not line.startswith(" ")}
    assert list(rows) == ["job", job(1), job(2), job(3)]  # the newest last
    assert rows[job(1)] == ["good", "off-diagonal", "8", "0.5", "s", "3.21", "%"]
    assert rows[job(2)] == ["good", "indirect", "8", "1234", "s", "+-2", "%"]
    assert rows[job(3)] == ["failed", "indirect", "8"]
    assert any(line.startswith("    Chart in milk #glass #wax a long note") for line in lines)
    assert any("the panels missed refreshes" in line for line in lines)
    assert len(lines) == 4 + 1 + 3


def test_json_has_a_run_a_line_and_filters_choose(
    state: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def jobs(*words: str) -> list[str]:
        return [json.loads(line)["job"] for line in told(capsys, "--json", *words)]

    assert jobs() == [job(1), job(2), job(3)]
    assert jobs("--all") == [job(1), job(2), job(3), job(4)]
    assert jobs("--failed") == [job(3)]
    assert jobs("--goal", "off-diagonal") == [job(1)]
    assert jobs("--tag", "glass", "--tag", "wax") == [job(1)]
    assert jobs("--tag", "glass", "--tag", "paper") == []
    assert jobs("--since", "2026-01-01T00:00:02+00:00") == [job(2), job(3)]
    assert jobs("--state-dir", str(state / "preview" / job(4))) == []
    for wrong in (("--tag", "a b"), ("--since", "soon"), ("--state-dir", "nowhere")):
        told(capsys, *wrong, code=2)
    told(capsys, "--socket", "/x", code=3)


def test_runs_in_folders_that_out_named_are_found(
    state: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def jobs(*words: str) -> list[str]:
        return [json.loads(line)["job"] for line in told(capsys, "--json", *words)]

    here, beside = state.parents[3] / "here", state.parents[3] / "beside"
    finished(here, job(5), request={"name": "Elsewhere"})
    finished(beside / "below", job(6))
    circle = state.parents[3] / "circle"
    circle.symlink_to("circle")
    for folder in (here, beside, here, circle, state / "captures"):
        note_folder(folder)
    # Those that lie in the folder itself, each once; and nothing that was put below it.
    assert jobs() == [job(1), job(2), job(3), job(5)]
    assert main(["runs"]) == 0
    assert "4 runs in" in capsys.readouterr().err
    assert told(capsys, "show", "Elsewhere")[0].split() == ["job", job(5)]
    assert jobs("--state-dir", str(state)) == [job(1), job(2), job(3)]
    # What became another user's is named, and not looked into.
    if os.geteuid() == 0:
        os.chown(here, 12345, 12345)
        assert main(["runs", "--json"]) == 0
        printed = capsys.readouterr()
        assert job(5) not in printed.out and not printed.err
        assert main(["runs"]) == 0
        assert f"somebody else's: {here}" in capsys.readouterr().err
    shutil.rmtree(here)
    assert jobs() == [job(1), job(2), job(3)]


def test_a_run_by_local_and_out_is_noted(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    config = tmp_path / "small.toml"
    config.write_text("[scene]\ngrid = [6, 8]\n")
    line = ["capture", "white", "--local", "--config", str(config), "--json", "--out"]
    assert main([*line, str(tmp_path / "here")]) == 0
    made = last_object(capsys.readouterr().out)["job"]
    assert main([*line, str(config)]) == 2  # which is no folder
    capsys.readouterr()
    assert [json.loads(line)["job"] for line in told(capsys, "--json")] == [made]
    assert list_noted_folders() == ([tmp_path / "here"], [])


def test_a_damaged_list_of_folders_harms_no_list_of_runs(
    state: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for text in ("", "{}", "[1]", '["\\u0000", "/dev/null", "gone"]', "[" * 10000):
        (state / "elsewhere.json").write_text(text)
        assert len(told(capsys, "--json")) == 3
    (state / "elsewhere.json").unlink()
    os.mkfifo(state / "elsewhere.json")
    assert len(told(capsys, "--json")) == 3
    for number in range(105):
        note_folder(state / f"f{number}")
    assert len(json.loads((state / "elsewhere.json").read_bytes())) == 100


def test_runs_of_a_daemon_that_goes_away_are_not_mixed_with_others(
    state: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (hers, *_), asked = find_runs(state), []

    class Leaves(StubClient):
        asked = []  # noqa: RUF012

        def find(self, query: RunQuery) -> Page:
            asked.append(query)
            if query.before:
                raise UnreachableError("it went away")
            return Page(state_folder="/hers", runs=[hers], more="captures/x")

    monkeypatch.setattr("pdcd.cli.daemon.Client", Leaves)
    assert main(["runs", "--all"]) == 3 and len(asked) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err == "pdcd: it went away\n"


def test_where_nothing_was_verified_it_is_said(
    state: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["runs", "verify", "--tag", "nobodys", "--state-dir", str(state)]) == 0
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err == "no finished run matches: nothing was verified\n"


def test_one_run_is_shown_by_its_name(state: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = told(capsys, "show", job(3))
    assert max(map(len, lines[:-1])) <= 80  # the last is the path of the folder
    rows = {line.split()[0]: " ".join(line.split()[1:]) for line in lines}
    assert rows["state"] == "failed" and rows["taken"] == "1 of 3 shots"
    assert rows["why"].startswith("the panels missed")
    (line,) = told(capsys, "show", "Chart in milk", "--json")
    assert json.loads(line)["run"]["tags"] == ["glass", "wax"]
    told(capsys, "show", "nobody", code=2)


@pytest.mark.parametrize(
    ("asked", "shown"),
    [
        ({}, None),
        ({"codes": None, "white": True}, None),  # as they are without being asked for
        ({"disparity": [-1, 2], "keep": "out"}, "disparity [-1,2], keep out"),
        ({"smooth": False, "p": 0.25}, "smooth false, p 0.25"),
        ({"warp": {"file": "x" * 49}}, 'warp {"file":"' + "x" * 49 + '"}'),  # 60 letters
        ({"warp": {"file": "x" * 50}}, 'warp {"file":"' + "x" * 48 + "..."),
    ],
)
def test_what_was_asked_for_is_shown_in_few_words(
    state: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    asked: dict[str, object],
    shown: str | None,
) -> None:
    request = {"goal": "keyed", "name": "n", "tags": ["t"], "note": "m", "out": "/x", **asked}
    files = {name: SimpleNamespace(size_bytes=size) for name, size in (("a", 2**20), ("b", 0))}
    good = Quality(verdict="good")
    manifest = SimpleNamespace(request=request, files=files, quality=good, warnings=())
    monkeypatch.setattr(runs_cli, "read_manifest", lambda _: manifest)
    monkeypatch.setenv("COLUMNS", "200")
    rows = {line[:11].strip(): line[11:].strip() for line in told(capsys, "show", job(1))}
    assert rows.get("asked for") == shown
    assert rows["files"] == "2, 1.0 MiB"


def test_what_is_in_front_of_a_command_is_not_lost(
    state: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`runs --tag wax prune --keep 0` must not remove what has no such tag."""
    for words in (["--tag", "wax"], ["--goal", "white"], ["--failed"], ["--since", "1d"]):
        told(capsys, *words, "prune", "--keep", "0", "--yes", code=2)
        told(capsys, *words, "show", job(1), code=2)
    assert len(find_runs(state)) == 3


def test_prune_says_what_goes_and_removes_nothing_unasked(
    state: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told(capsys, "prune", code=2)
    told(capsys, "prune", "--failed", code=2)  # nobody is there to agree
    told(capsys, "prune", "--failed", "--json", code=2)
    lines = told(capsys, "prune", "--failed", "--dry-run")
    assert str(state) in lines[0] and max(map(len, lines[1:])) <= 80
    assert [line.split()[0] for line in lines if line.startswith("2026")] == [job(3)]
    (line,) = told(capsys, "prune", "--failed", "--dry-run", "--json")
    assert (json.loads(line)["run"]["job"], json.loads(line)["removed"]) == (job(3), False)
    assert len(find_runs(state)) == 3
    told(capsys, "prune", "--failed", "--yes")
    assert [run.job for run in find_runs(state)] == [job(2), job(1)]
    told(capsys, "prune", "--keep", "1", "--older-than", "2026-02-01", "--yes")
    assert [run.job for run in find_runs(state)] == [job(2)]
    assert told(capsys, "prune", "--failed", "--yes") == [f"nothing to remove in {state}"]


def test_labels_are_typed_with_a_capture_and_refused_where_they_cannot_be(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    daemon = stub_daemon(monkeypatch)
    words = ["--name", "Chart, 2nd", "--tag", "glass", "--tag", "v-1", "--note", "so\nit is"]
    assert main(["capture", "white", *words]) == 0
    (request,) = (a for asked in daemon.asked if isinstance(asked, tuple) for a in asked[:1])
    assert isinstance(request, CaptureRequest)
    assert (request.name, request.tags, request.note) == (
        "Chart, 2nd",
        ("glass", "v-1"),
        "so\nit is",
    )
    for option, text in (
        ("--name", "a/b"), ("--name", " a"), ("--name", "a\n"), ("--name", "x" * 81),
        ("--tag", "a b"), ("--tag", ""), ("--tag", "a\n"), ("--note", "\x1b[2J"),
        ("--note", "\u202eabc"), ("--note", "x" * 4097), ("--note", "Bl\udce4tter"),
    ):  # fmt: skip
        assert main(["capture", "white", f"{option}={text}", "--json"]) == 2
        error = last_object(capsys.readouterr().out)["error"]
        assert f"{option} takes" in error["message"], (option, text)


def test_a_moment_is_a_date_or_how_long_ago() -> None:
    for text, ago in (("90m", timedelta(minutes=90)), ("2w", timedelta(weeks=2))):
        before = datetime.now(UTC)
        assert before <= parse_moment(text, "--since") + ago <= datetime.now(UTC)
    assert parse_moment("2026-01-02T03:04:05+01:00", "--since") == datetime(
        2026, 1, 2, 2, 4, 5, tzinfo=UTC
    )
    assert parse_moment("2026-01-02", "--since") == datetime(2026, 1, 2).astimezone(UTC)
    for text in ("", "yesterday", "-1d", "999999w", "1y", "2026-13-01", "0001-01-01T00:00+14:00"):
        with pytest.raises(ConfigError, match="--since"):
            parse_moment(text, "--since")
