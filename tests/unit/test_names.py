"""Public names: functions begin with a verb, and one name means one thing.

A quantity may be called by what it is, with its unit; what users type, and what the modules of
figures are asked for, keep their names.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator

from tests.places import ROOT

VERBS = frozenset(
    """
    add adjust answer append apply are arm ask assess average balance bind blur build calibrate
    can cancel capture catch check choose close collect colour combine compare compose compute
    connect convert copy correct count crop decide decode derive describe develop diagnose
    divide draw encode end estimate examine expand explain export expose extend factor fill
    filter find finish fit flash follow forget format from gather guard guess has hash hold
    ignore import index inspect interpolate invert is iterate join judge keep label lay learn
    limit link list load lock main make map mark match measure meet merge meter mirror name
    narrow note number open order pack paint parse photograph pick pin place plan play predict
    prepare print project prune pursue raise randomise read recompute record refuse release
    remove rename render repeat replace report require reserve resolve restore resume run
    sample save say scale scan search select send serve shift show shrink simulate solve split
    spread start stop store stretch suggest sum summarise sweep symmetrise take tell time to
    trace try undo unmix unpack use verify wait walk warp watch weigh widen with write
    """.split()
)
UNITS = (
    "_bytes", "_cells", "_db", "_deg", "_dn", "_e", "_h", "_hz", "_ms", "_ns", "_of", "_per_px",
    "_px", "_quads", "_refreshes", "_rows", "_s",
)  # fmt: skip
"""Ends of functions that return a quantity, or one thing of another."""
PINNED = frozenset({"disk_errors", "fault", "local", "streams"})
"""Names that programs and drivers of others rely on."""
HOOKS = frozenset({"FIGURE", "logger", "shown", "takes"})
"""What every module of a kind has."""
PRESETS = "pdcd.virtual.scene.presets."
"""Scenes are typed by their names."""


def public_names() -> Iterator[tuple[str, str, bool]]:
    """Module, name, and whether it is a function, of all that stands at the top of a module."""
    for folder in ("pdcd", "drivers"):
        for file in (ROOT / folder).rglob("*.py"):
            module = ".".join(file.relative_to(ROOT).with_suffix("").parts)
            for node in ast.parse(file.read_text()).body:
                for name in names_of(node):
                    if not name.startswith("_"):
                        yield module, name, isinstance(node, ast.FunctionDef)


def names_of(node: ast.stmt) -> list[str]:
    """What a statement at the top of a module defines."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else []
    targets = [node.target] if isinstance(node, ast.AnnAssign) else targets
    each = [t.elts if isinstance(t, ast.Tuple) else [t] for t in targets]
    return [one.id for some in each for one in some if isinstance(one, ast.Name)]


def test_functions_begin_with_a_verb() -> None:
    kept = PINNED | HOOKS
    wrong = [
        f"{module}: {name}"
        for module, name, function in public_names()
        if function and name.split("_")[0] not in VERBS and not name.endswith(UNITS)
        if name not in kept and not module.startswith(PRESETS)
    ]
    assert not wrong


def test_one_public_name_stands_in_one_module() -> None:
    places = defaultdict(list)
    for module, name, _ in public_names():
        places[name].append(module)
    twice = {n: m for n, m in places.items() if len(m) > 1 and n not in HOOKS}
    assert not twice
