"""The harness of `make mutants` makes the changes that it says, and takes a change for noticed only
where tests fail by it."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.mutants import trial
from tests.mutants.draw import EQUIVALENT, FAIL_CLOSED, drawn, equivalents, files_of
from tests.mutants.draw import must_fail_closed as closed
from tests.mutants.operators import Mutant, mutants
from tests.mutants.related import related
from tests.mutants.trial import Bench
from tests.places import ROOT
from tests.tools import needs, program

SOURCE = b'''"""A module."""

def share(a: int, b: int = 2) -> float:
    """Above 1."""
    if a < b and not b == 0:
        raise ValueError(f"{a} of {b + 1}")
    try:
        logger.info("share %d", 3)
        return min(a, b) / b
    except (ValueError, KeyError):
        return -1.0
'''


def made(source: bytes) -> set[str]:
    return {one.key.split(" :: ")[2] for one in mutants("pdcd/a.py", source)}


def test_every_kind_of_change_is_made_and_nothing_that_is_only_said() -> None:
    assert made(SOURCE) == {
        "2 => 3",
        "a < b => a >= b",
        "a < b => a <= b",
        "a < b and not b == 0 => a < b or not b == 0",
        "not b == 0 => b == 0",
        "b == 0 => b != 0",
        "0 => 1",
        'raise ValueError(f"{a} of {b + 1}") => pass',
        "return min(a, b) / b => return None",
        "min(a, b) / b => min(a, b) * b",
        "min(a, b) => max(a, b)",
        "(ValueError, KeyError) => (KeyError,)",
        "(ValueError, KeyError) => (ValueError,)",
        "(ValueError, KeyError) => Exception",
        "return -1.0 => return None",
        "-1.0 => 1.0",
        "1.0 => 2.0",
    }


def test_changes_of_calls_and_statements() -> None:
    assert made(b"self.x = f(1 + n, key=y)\nfor k in range(n):\n    total += x[a:b]\n") == {
        "self.x = f(1 + n, key=y) => pass",
        "f(1 + n, key=y) => f(1 + n)",
        "1 + n => 1 - n",
        "1 => 2",
        "range(n) => range(n - 1)",
        "total += x[a:b] => pass",
        "a:b => a + 1:b",
        "a:b => a:b + 1",
    }


@pytest.mark.parametrize("base", ["Protocol", "typing.Protocol", "Protocol[T]"])
def test_classes_that_only_name_types_are_left_alone(base: str) -> None:
    text = "class A({}):\n    n = 1\n"
    assert not made(text.format(base).encode())
    assert made(text.format("asyncio.Protocol").encode()) == {"1 => 2"}


def test_that_zipped_lists_are_of_equal_length_is_only_made_sure_of() -> None:
    assert made(b"f(zip(a, b, strict=True))\n") == {"f(zip(a, b, strict=True)) => pass"}
    assert "True => False" in made(b"f(a, strict=True)\n")


def test_a_mutant_changes_its_place_only() -> None:
    (one,) = (m for m in mutants("pdcd/a.py", SOURCE) if m.new == "max(a, b)")
    assert one.applied(SOURCE) == SOURCE.replace(b"min(", b"max(")
    assert (one.function, one.line, one.operator) == ("share", 9, "other extreme")
    moved = b"\n\n" + SOURCE
    assert one.key in {m.key for m in mutants("pdcd/a.py", moved)}


@pytest.mark.long
def test_a_draw_goes_by_its_seed_and_leaves_known_ones_out() -> None:
    files = files_of("recipes", ROOT)
    first, second = (drawn(files, ROOT, 5, seed=3) for _ in range(2))
    assert first == second != drawn(files, ROOT, 5, seed=4)
    again = drawn(files, ROOT, 5, seed=3, known={first[0].key})
    assert first[0].key not in {one.key for one in again}
    assert all(one.path.startswith("pdcd/recipes/") for one in first)
    with pytest.raises(ValueError, match="capture"):
        files_of("kitchen", ROOT)


def test_paths_that_must_fail_closed_are_there() -> None:
    def of(path: str, function: str) -> Mutant:
        return Mutant(path, function, "", 1, 0, 0, "", "")

    assert closed(of("drivers/serial_shutter/port.py", "any"))
    assert closed(of("pdcd/sensor/raw.py", "read_raw"))
    assert not closed(of("pdcd/sensor/raw.py", "read_raw_of"))
    for path in FAIL_CLOSED:
        file, _, function = path.partition("::")
        assert (ROOT / file).exists(), path
        if function:
            text = (ROOT / file).read_text(encoding="utf-8")
            assert f"def {function.rpartition('.')[2]}(" in text, path


@pytest.mark.whole
def test_known_equivalents_are_changes_that_can_still_be_made() -> None:
    """One that cannot has been mended or rewritten: its line goes, too."""
    keys = equivalents(EQUIVALENT.read_text(encoding="utf-8"))
    for path in {key.split(" :: ")[0] for key in keys}:
        possible = {one.key for one in mutants(path, (ROOT / path).read_bytes())}
        assert {key for key in keys if key.startswith(f"{path} ::")} <= possible


def test_related_tests_are_those_of_the_module_and_its_room() -> None:
    found = related("pdcd/panels/balance.py", ROOT)
    assert found[0] == "tests/unit/panels/test_balance.py"
    assert "tests/unit/panels/test_pixels.py" in found
    assert found[-1].startswith("tests/e2e/capture/")
    assert not any("ptp" in name for name in related("drivers/serial_shutter/port.py", ROOT))
    # Drivers name each other relatively.
    assert "tests/unit/drivers/test_ptp_guardian.py" in related("drivers/guard.py", ROOT)


PROGRAM = """
def f(n):
    return n + 1


def g(n):
    return 5
"""
TESTS = """
from time import sleep

from pdcd.a import f


def test_f():
    n = 0
    while f(n) < 9:
        n = f(n)
        sleep(0.01)
    assert f(1) == 2
"""


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    """A project of two functions, one of them tested."""
    (tmp_path / "pdcd").mkdir()
    (tmp_path / "drivers").mkdir()
    (tmp_path / "tests").mkdir()
    (tmp_path / "pdcd/a.py").write_text(PROGRAM)
    (tmp_path / "tests/test_a.py").write_text(TESTS)
    (tmp_path / "tests/test_wrong.py").write_text("def test_w():\n    assert False\n")
    subprocess.run([program("git"), "init", "-q"], cwd=tmp_path, check=True)
    return Bench(tmp_path, {})


@pytest.mark.long
@needs("git")
def test_what_is_tested_is_noticed_and_nothing_else(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A test that fails anyway notices nothing; one that hangs does."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))  # where another pdcd is
    files = ["tests/test_wrong.py", "tests/test_a.py"]
    try:
        assert bench.copy.stat().st_mode & 0o777 == 0o755  # else tests of rights fail anyway
        source = (bench.copy / "pdcd/a.py").read_bytes()
        found = {one.key: one for one in mutants("pdcd/a.py", source)}
        wrong, unseen, endless = (
            found[f"pdcd/a.py :: {change}"]
            for change in ("f :: 1 => 2", "g :: 5 => 6", "f :: n + 1 => n - 1")
        )
        assert bench.noticed(wrong, files) == "tests/test_a.py::test_f"
        assert bench.noticed(unseen, files) == ""
        monkeypatch.setattr(trial, "SLACK", 0.0)
        monkeypatch.setattr(trial, "SPARE_S", 2.0)
        assert bench.noticed(endless, files) == "tests/test_a.py or one of the next (time-out)"
        assert (bench.copy / "pdcd/a.py").read_bytes() == source
    finally:
        bench.close()
    assert not bench.copy.exists()
