"""What a source tree weighs: lines, long files, long functions, rooms, circles of imports."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

LONG_FILE, LONG_FUNCTION = 450, 60
"""Lines that are just allowed."""


@dataclass(frozen=True)
class Weight:
    """Figures of a tree; files are relative to its root."""

    lines: dict[str, int]
    """By file of the product."""
    test_lines: int
    long_files: dict[str, int]
    long_functions: dict[str, int]
    floors: int
    rooms: int
    circles: list[list[str]]


def weigh(root: Path, packages: Sequence[str]) -> Weight:
    """The figures of the tree at `root`, whose product lies in `packages`."""
    sources = {path: path.read_text() for path in _sources(root, packages)}
    lines = {name(root, path): text.count("\n") for path, text in sources.items()}
    tests = sum(path.read_text().count("\n") for path in _sources(root, ["tests"]))
    trees = {path: ast.parse(text) for path, text in sources.items()}
    functions = {
        f"{name(root, path)} {called}": length
        for path, tree in trees.items()
        for called, length in _functions(tree)
    }
    floors = _floors(root)
    return Weight(
        lines=lines,
        test_lines=tests,
        long_files={file: n for file, n in lines.items() if n > LONG_FILE},
        long_functions={f: n for f, n in functions.items() if n > LONG_FUNCTION},
        floors=len(floors),
        rooms=sum(len(floor) for floor in floors),
        circles=circles(imports_of(root, trees)),
    )


def name(root: Path, path: Path) -> str:
    """A file as it is told to people."""
    return path.relative_to(root).as_posix()


def _sources(root: Path, packages: Sequence[str]) -> list[Path]:
    return sorted(path for package in packages for path in (root / package).rglob("*.py"))


def _functions(tree: ast.AST, prefix: str = "") -> Iterator[tuple[str, int]]:
    """Name and lines of every function, from `def` to its end."""
    for node in ast.iter_child_nodes(tree):
        called = prefix
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            called = f"{prefix}.{node.name}".lstrip(".")
            if not isinstance(node, ast.ClassDef):
                yield called, (node.end_lineno or node.lineno) - node.lineno + 1
        yield from _functions(node, called)


def _floors(root: Path) -> list[list[str]]:
    """Rooms by floor, as the import contract lists them."""
    settings = tomllib.loads((root / "pyproject.toml").read_text())
    contracts = settings.get("tool", {}).get("importlinter", {}).get("contracts", [])
    layers = [layer for one in contracts if one["type"] == "layers" for layer in one["layers"]]
    return [[room.strip() for room in layer.split("|")] for layer in layers]


def imports_of(root: Path, trees: dict[Path, ast.Module]) -> dict[str, set[str]]:
    """By module the modules that it imports anywhere, in functions too, but for type checkers.

    Only what an import names counts: `import a.b` is none of `a`.
    """
    modules = {_module(root, path): path for path in trees}
    found: dict[str, set[str]] = {}
    for module, path in modules.items():
        package = module if path.name == "__init__.py" else module.rpartition(".")[0]
        wanted = {one for names in _imports(trees[path], package) for one in _known(names, modules)}
        found[module] = wanted - {module}
    return found


def _module(root: Path, path: Path) -> str:
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _known(names: tuple[str, str], modules: dict[str, Path]) -> set[str]:
    """The module that `from names[0] import names[1]` loads, of those there are."""
    base, member = names
    whole = f"{base}.{member}"
    return {whole} if whole in modules else {base} & modules.keys()


def _imports(node: ast.AST, package: str) -> Iterator[tuple[str, str]]:
    """Every import below a node: where from, and what ("" for the module itself)."""
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        kept = node.body if isinstance(node.test, ast.UnaryOp) else node.orelse
        for statement in kept:
            yield from _imports(statement, package)
        return
    if isinstance(node, ast.Import):
        yield from ((alias.name, "") for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        base = node.module or ""
        if node.level:
            above = package.split(".")[: len(package.split(".")) - node.level + 1]
            base = ".".join([*above, *filter(None, [base])])
        yield from ((base, alias.name) for alias in node.names)
    for inner in ast.iter_child_nodes(node):
        yield from _imports(inner, package)


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules each of which leads to every other of its group."""
    reach = {module: _reached(graph, module) for module in graph}
    groups = {
        tuple(sorted(one for one in reach[module] if module in reach[one]))
        for module in graph
        if module in reach[module]
    }
    return sorted(map(list, groups))


def _reached(graph: dict[str, set[str]], start: str) -> set[str]:
    found: set[str] = set()
    waiting = list(graph[start])
    while waiting:
        module = waiting.pop()
        if module not in found:
            found.add(module)
            waiting.extend(graph[module])
    return found
