"""`python -m tests.walk` sees what a program does, in the processes that it starts too, and counts
what its words say; shown on a program of three rooms."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.walk.route import homes, room_of, route_of
from tests.walk.trace import Notes, read_notes, traced_environment
from tests.walk.weight import weigh

SHOP = {
    "__init__.py": "",
    "plans/__init__.py": "",
    "plans/plan.py": """
class Plan:
    __slots__ = ("size",)
    def __init__(self, size):
        self.size = size
    @property
    def area(self):
        return self.size ** 2
class Kept:
    def __init__(self, plan):
        self.plan = plan
""",
    "plans/unused.py": "LEAST = 1\n\nclass Never:\n    pass\n",
    "trade/__init__.py": "",
    "trade/desk.py": """
from shop.plans.unused import LEAST
def measure(plan):
    return plan.area
def look(kept):
    return LEAST
def ignore(plans):
    return None
""",
    "front.py": """
import subprocess, sys
from shop.plans.plan import Kept, Plan
from shop.trade.desk import ignore, look, measure
def run():
    plan = Plan(3)
    for _ in range(5):
        measure(plan)
    look([plan])
    show(plan)
    look(Kept(plan))
    ignore([7])
    subprocess.run([sys.executable, "-P", "-m", "shop.child"], check=True)
def show(plan):
    return 0
if __name__ == "__main__":
    run()
""",
    "child.py": """
import os, signal
from shop.plans.plan import Plan
def begin(plan):
    return plan
if __name__ == "__main__":
    begin(Plan(1))
    os._exit(0)
""",
}


@pytest.fixture
def root(tmp_path: Path) -> Path:
    for name, text in SHOP.items():
        path = tmp_path / "shop" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path


@pytest.fixture
def notes(root: Path) -> Notes:
    out = root / "notes"
    out.mkdir()
    environment = traced_environment(out, root, ["shop"], ["Plan"])
    environment["PYTHONPATH"] += f":{root}"
    subprocess.run([sys.executable, "-m", "shop.front"], env=environment, check=True, cwd=root)
    return read_notes(out)


def test_a_file_is_called_only_where_a_function_of_it_runs(notes: Notes) -> None:
    real = {file for file in notes.loaded if not file.endswith("__init__.py")}
    assert real == {
        "shop/front.py",
        "shop/child.py",
        "shop/plans/plan.py",
        "shop/plans/unused.py",
        "shop/trade/desk.py",
    }
    assert notes.called == real - {"shop/plans/unused.py"}


def test_the_way_of_a_class_goes_through_all_processes_and_counts_a_loop_once(notes: Notes) -> None:
    route = route_of("Plan", notes.steps)
    assert [(step.callee, step.function) for step in route.steps] == [
        ("shop/plans/plan.py", "Plan.__init__"),
        ("shop/trade/desk.py", "measure"),
        ("shop/plans/plan.py", "Plan.area"),
        ("shop/trade/desk.py", "look"),  # in a list
        ("shop/front.py", "show"),
        ("shop/plans/plan.py", "Kept.__init__"),
        ("shop/trade/desk.py", "look"),  # as an attribute
        ("shop/plans/plan.py", "Plan.__init__"),  # in the child
        ("shop/child.py", "begin"),
    ]
    assert route.moves == 8
    assert [room_of(step.callee) for step in route.comebacks()] == [
        "shop/plans",
        "shop/trade",
        "shop/plans",
        "shop/trade",
        "shop/plans",
        "shop",
    ]
    assert homes("Plan", notes.steps) == ["shop.plans.plan"]
    assert route_of("Absent", notes.steps).moves == 0


def test_a_tree_is_weighed_and_its_circles_are_found(root: Path) -> None:
    (root / "pyproject.toml").write_text(
        '[[tool.importlinter.contracts]]\ntype = "layers"\nlayers = ["shop.trade | shop.a", "shop"]'
    )
    shop = root / "shop"
    body = "    pass\n" * 59
    (shop / "long.py").write_text(
        f"def just():\n{body}class A:\n  def over(self):\n{body}    pass\n"
    )
    (shop / "more.py").write_text("\n" * 451)
    (shop / "a.py").write_text("from . import b\n")
    (shop / "b.py").write_text("def late():\n    from shop.c import x\n")
    (shop / "c.py").write_text("import shop.a\n")
    (shop / "d.py").write_text(
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from shop import e\n"
    )
    (shop / "e.py").write_text("import shop.d\n")
    weight = weigh(root, ["shop"])
    assert weight.long_functions == {"shop/long.py A.over": 61}
    assert weight.long_files == {"shop/more.py": 451}
    assert (weight.rooms, weight.floors) == (3, 2)
    assert weight.circles == [["shop.a", "shop.b", "shop.c"]]
