"""Tables and sentences fit a terminal, and lose nothing by it."""

from __future__ import annotations

import random

import pytest

from pdcd.cli.output import WIDTH, find_terminal_width, say_table, say_text


def shown(capsys: pytest.CaptureFixture[str], rows: list[list[str]]) -> list[str]:
    say_table(rows)
    return capsys.readouterr().out.splitlines()


def test_a_table_that_fits_is_aligned(capsys: pytest.CaptureFixture[str]) -> None:
    rows = [["job", "state"], ["a" * 30, "b " * 20], ["", "x"], ["a\nb", "[b]\x1b[2J"]]
    assert shown(capsys, rows) == [
        "job" + " " * 29 + "state", "a" * 30 + "  " + ("b " * 20).rstrip(), " " * 32 + "x",
        r"a\nb" + " " * 28 + r"[b]\u001b[2J",
    ]  # fmt: skip


def test_paths_stay_in_one_piece(capsys: pytest.CaptureFixture[str]) -> None:
    path = "/home/anna/.local/state/pdcd/captures/20260101T120301Z-7f3a/preview/indirect.png"
    name = "20260101T120301Z-7f3a"
    lines = shown(capsys, [["to look at", path], ["why", "so " * 40]])
    assert lines[0] == f"to look at  {path}" and max(map(len, lines[1:])) <= WIDTH
    rows = [["", "name", "steps", "fits"], ["in use", name, "step good, " * 9, "the mask is " * 9]]
    lines = shown(capsys, rows)
    assert max(map(len, lines)) <= WIDTH and lines[1].startswith(f"in use  {name}  step good,")


def test_names_that_are_indented_stay_in_one_piece(capsys: pytest.CaptureFixture[str]) -> None:
    names = [["  figure", "value", "limit"], ["  shutter.travel_opening_s", "-0.01758 +- 0.002 s",
             "each exposure known to 0.3 ms, and no more than that"]]  # fmt: skip
    lines = shown(capsys, names)
    assert lines[1].startswith("  shutter.travel_opening_s  -0.01758 +- 0.002 s")
    assert max(map(len, lines)) <= WIDTH


@pytest.mark.parametrize("seed", range(5))
def test_no_word_is_lost_and_no_line_too_long(
    seed: int, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = random.Random(seed)
    rows = [
        [" ".join("w" * rng.randint(1, 12) for _ in range(rng.randint(0, 12))) for _ in range(4)]
        for _ in range(9)
    ]
    lines = shown(capsys, rows)
    assert max(map(len, lines)) <= WIDTH
    told = " ".join(cell for row in rows for cell in row)
    assert sorted(" ".join(lines).split()) == sorted(told.split())


def test_a_sentence_goes_on_further_in(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pdcd.cli.output.find_terminal_width", lambda: 40)
    say_text("warning: " + "well-known " * 8 + "x" * 50 + "\n")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "warning: well-known well-known"
    assert lines[-1] == "  " + "x" * 50 + r"\n" and all(line[:2] == "  " for line in lines[1:])


def test_a_terminal_says_how_wide_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    for typed, wide in (("120", 120), ("41", 41), ("7", 40)):
        monkeypatch.setenv("COLUMNS", typed)
        assert find_terminal_width() == wide
    monkeypatch.setattr("sys.stdout.isatty", lambda: False)
    assert find_terminal_width() == WIDTH == 80  # nobody looks: a file, a pipe
