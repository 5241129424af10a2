"""How deep and how long the path to a place may be, which letters it may have, and what is made."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdcd.errors import RequestError
from pdcd.runs.place import MAX_PATH_BYTES, MAX_PATH_PARTS, HeldFolder

JOB = "20260101T000000Z-00ff"


def made(state: Path, out: str, *, make: bool = True) -> Path:
    with HeldFolder.below(state, out, make=make) as place:
        return place.real


def test_a_path_has_so_many_parts_and_no_more(tmp_path: Path) -> None:
    deepest = "/".join("a" * MAX_PATH_PARTS)
    assert made(tmp_path, deepest) == tmp_path / deepest
    with pytest.raises(RequestError, match="too long"):
        made(tmp_path / "b", f"{deepest}/a")
    assert list((tmp_path / "b").iterdir()) == []


def test_a_path_has_so_many_bytes_and_no_more(tmp_path: Path) -> None:
    part = "é" * 100
    longest = "/".join([part] * 10) + "/" + "x" * (MAX_PATH_BYTES - 2010)
    assert len(longest.encode()) == MAX_PATH_BYTES
    assert made(tmp_path, longest) == tmp_path / longest
    with pytest.raises(RequestError, match="too long"):
        made(tmp_path / "b", f"{longest}x")


@pytest.mark.parametrize("letter", ["\x1f", "\n", "\x7f", "\x80", "\x9f"])
def test_letters_that_nobody_sees_are_refused_to_a_client(letter: str, tmp_path: Path) -> None:
    with pytest.raises(RequestError, match="control characters"):
        made(tmp_path, f"a/b{letter}c")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("out", [JOB, f"a/{JOB}", f"{JOB}/a"])
def test_nobody_takes_the_name_of_a_run_to_come(out: str, tmp_path: Path) -> None:
    with pytest.raises(RequestError, match=f"'{JOB}' is a name for runs"):
        made(tmp_path, out)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / out).mkdir(parents=True)  # one that is there may be looked into
    assert made(tmp_path, f"{out}/b", make=False) == tmp_path / out


def test_for_a_look_the_deepest_folder_that_is_there_is_enough(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    assert made(tmp_path, "a/b/c", make=False) == tmp_path / "a"
    assert list((tmp_path / "a").iterdir()) == []
    assert made(tmp_path, "a/b/c") == tmp_path / "a/b/c"


@pytest.mark.parametrize("out", ["..", "../x", "a/../../x", "/", "/elsewhere"])
def test_no_client_leads_out_of_the_state_folder(out: str, tmp_path: Path) -> None:
    state = tmp_path / "state"
    with pytest.raises(RequestError, match="leaves the daemon's state folder") as told:
        made(state, out)
    assert str(state) in str(told.value.hint)
    assert list(state.iterdir()) == [] and [*tmp_path.iterdir()] == [state]


@pytest.mark.parametrize("out", ["", ".", "a/.."])
def test_the_state_folder_itself_is_a_place(out: str, tmp_path: Path) -> None:
    assert made(tmp_path, out) == tmp_path
