"""Tables and sentences fit a terminal, and lose nothing by it."""

from __future__ import annotations

import random

import pytest

from pdcd.cli import tables
from pdcd.cli.tables import WIDTH, fitted, wrapped


def words(lines: list[str]) -> list[str]:
    return sorted(" ".join(lines).split())


def test_a_table_that_fits_is_left_alone() -> None:
    rows = [["job", "state"], ["a" * 30, "b " * 20], ["", "x"]]
    assert list(fitted(rows, WIDTH)) == [
        "job" + " " * 29 + "state",
        "a" * 30 + "  " + ("b " * 20).rstrip(),
        " " * 32 + "x",
    ]


def test_the_last_column_gives_way_first_then_heads() -> None:
    head = ["what was measured here", "its value", "what to know of it"]
    rows = [head, ["gain", "2.5 e-", "measured " * 12], ["lag", "12 ms", "foreseen"]]
    wide = list(fitted(rows, 65))
    assert max(map(len, wide)) <= 65 and wide[0].startswith("what was measured here  its value")
    lines = list(fitted(rows, 50))
    assert max(map(len, lines)) <= 50
    assert [line[:8].strip() for line in lines[:3]] == ["what was", "measured", "here"]
    row = next(n for n, line in enumerate(lines) if line.startswith("gain"))
    assert "2.5 e-" in lines[row] and lines[row + 1].strip().startswith("measured")
    assert any(line.startswith("lag") and line.endswith("foreseen") for line in lines)


def test_a_number_stays_with_its_unit_and_a_path_in_one_piece() -> None:
    path = "/home/anna/.local/state/pdcd/captures/20260101T120301Z-7f3a/preview/indirect.png"
    text = "it takes " + "12.5 ms " * 12
    lines = list(fitted([["to look at", path], ["time", text]], WIDTH))
    assert lines[:2] == ["to look at", "    " + path]
    assert all(line.rstrip().endswith("ms") for line in lines[2:])
    for columns in range(20, 60):
        lines = list(wrapped("warning: " + "1 % of it and " * 9, columns))
        assert not [line for line in lines if line.endswith("1") or len(line) > columns]


@pytest.mark.parametrize("seed", range(5))
def test_no_word_is_lost_and_no_line_too_long(seed: int) -> None:
    rng = random.Random(seed)
    rows = [
        [" ".join("w" * rng.randint(1, 12) for _ in range(rng.randint(0, 12))) for _ in range(4)]
        for _ in range(9)
    ]
    lines = list(fitted(rows, WIDTH))
    assert max(map(len, lines)) <= WIDTH
    assert words(lines) == words([cell for row in rows for cell in row])


def test_what_cannot_be_seen_is_escaped_before_it_is_measured() -> None:
    (line,) = fitted([["a\nb", "\x1b[2J", "c"]], WIDTH)
    assert line == r"a\nb  \u001b[2J  c"


def test_a_terminal_says_how_wide_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    assert tables.width() == WIDTH  # nobody looks: a file, a pipe
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    assert tables.width() == 120
    monkeypatch.setenv("COLUMNS", "7")
    assert tables.width() == 40
