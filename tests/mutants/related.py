"""Which test files should notice a change of a module, the likeliest first."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

CAPTURES = (
    "tests/e2e/capture/test_engine.py",
    "tests/e2e/capture/test_golden.py",
)
"""Whole captures on the mock bench: asked last, about every module."""
RULES = ("tests/unit/test_catches.py",)
"""Rules that all source keeps: asked about every module."""


@cache
def _imports(file: Path, root: Path) -> frozenset[str]:
    """Modules that a file imports by the words of its import lines, `a.b.c` and `a.b` for each."""
    above = file.relative_to(root).parent.parts
    found: set[str] = set()
    text = file.read_text(encoding="utf-8").replace("(\n", " ")
    for named, names in re.findall(r"^\s*from ([\w.]+) import ([^\n]*)", text, re.MULTILINE):
        dots = len(named) - len(named.lstrip("."))
        base = above[: len(above) + 1 - dots] if dots else ()
        package = ".".join(filter(None, (*base, named.lstrip("."))))
        found |= {package, *(f"{package}.{name}" for name in re.findall(r"\w+", names))}
    found |= set(re.findall(r"^\s*import ([\w.]+)", text, re.MULTILINE))
    return frozenset(found)


def _module(path: str) -> str:
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def related(path: str, root: Path) -> list[str]:
    """Test files for a module, from the root of the tree.

    First those that import it, by themselves or by a helper of the tests; then those of its room,
    and of each the unit tests first; whole captures last. Tests of drivers share one folder: of
    these only those that know the driver's package, or one that uses the module.
    """
    module = _module(path)
    users = {module if path.count("/") == 1 else module.rsplit(".", 1)[0]}
    for file in sorted((root / "drivers").rglob("*.py")):
        if module in _imports(file, root):
            users.add(_module(file.parent.relative_to(root).as_posix()))
    users -= {"drivers"}
    every = sorted((root / "tests").rglob("*.py"))
    helpers = {
        _module(file.relative_to(root).as_posix())
        for file in every
        if not file.name.startswith("test_") and module in _imports(file, root)
    }
    room = path.split("/")[1] if path.startswith("pdcd/") else "drivers"
    ranks: dict[str, int] = {}
    for file in every:
        name = file.relative_to(root).as_posix()
        if not file.name.startswith("test_"):
            continue
        knows = _imports(file, root)
        unit = "/unit/" in name
        near = f"/{room}/" in name and (
            room != "drivers"
            or any(f"{known}.".startswith(f"{user}.") for known in knows for user in users)
        )
        if module in knows:
            ranks[name] = 0 if unit else 2
        elif near:
            ranks[name] = 1 if unit else 4
        elif knows & helpers:
            ranks[name] = 3
    found = sorted(ranks, key=lambda name: (ranks[name], name))
    return [*found, *RULES, *(name for name in CAPTURES if name not in ranks)]
