"""Tutorial, examples and docs/python.md use public names only, and every public name is told of."""

from __future__ import annotations

import ast
import re
import runpy
from pathlib import Path
from typing import Any

import nbformat
import pytest

import pdcd
from pdcd.api.bench import Bench
from pdcd.api.connected import DaemonBench
from pdcd.api.decoding import DecodingResult
from pdcd.api.run import Run
from pdcd.api.table import Table
from tests import tutorial
from tests.places import ROOT

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
PAGE = (ROOT / "docs" / "python.md").read_text()
LIBRARIES = {"pdcd", "numpy", "matplotlib.pyplot", "pandas", "dask"}


def _cells() -> list[Any]:
    notebook = nbformat.read(tutorial.PATH, as_version=4)  # type: ignore[no-untyped-call]
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def _sources() -> dict[str, str]:
    blocks = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    found = {f"python.md {number}": block for number, block in enumerate(blocks)}
    found |= {path.name: path.read_text() for path in EXAMPLES}
    return found | {"tutorial": "\n".join(cell.source for cell in _cells())}


@pytest.mark.parametrize(("name", "source"), _sources().items(), ids=[*_sources()])
def test_only_public_names_are_used(name: str, source: str) -> None:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            assert {alias.name for alias in node.names} <= LIBRARIES
        assert not isinstance(node, ast.ImportFrom), "import pdcd, and nothing below it"
        if isinstance(node, ast.Attribute):
            assert not node.attr.startswith("_")
            if isinstance(node.value, ast.Name) and node.value.id == "pdcd":
                assert node.attr in pdcd.__all__


def test_every_public_name_is_told_of() -> None:
    assert [n for n in pdcd.__all__ if f"`pdcd.{n}" not in PAGE] == []
    for kind in (Bench, DaemonBench, Run, Table, DecodingResult):
        names = {n for n in (*vars(kind), *kind.__annotations__) if not n.startswith("_")}
        assert {n for n in names if not re.search(rf"`\.?{n}\b", PAGE)} == set(), kind


def test_the_tutorial_is_kept_as_it_ran() -> None:
    cells = _cells()
    assert [cell.execution_count for cell in cells] == [*range(1, len(cells) + 1)]
    outputs = [output for cell in cells for output in cell.outputs]
    assert not [o for o in outputs if o.output_type == "error" or o.get("name") == "stderr"]
    assert sum("image/png" in o.get("data", {}) for o in outputs) >= 4
    told = tutorial.PATH.read_text()
    assert len(told) < 400_000 and not re.search(r'[" (](/home|/tmp|/root|/work)', told)


@pytest.mark.parametrize("name", ["own_scene", "with_daemon"])
def test_an_example_runs(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))  # where no daemon listens
    runpy.run_path(str(ROOT / "examples" / f"{name}.py"))
    told = {
        "own_scene": r"indirect light 0\.1\d+, in truth 0\.1990",
        "with_daemon": "no daemon answers",
    }
    assert re.search(told[name], capsys.readouterr().out)
