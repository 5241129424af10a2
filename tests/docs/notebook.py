"""The tutorial, run in a bare root as somebody would who opened it there, and what it shows."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tests.docs.bare import TREE, BareRoot, Done
from tests.docs.printed import find_difference
from tests.places import ROOT

PAGE = "docs/tutorial.ipynb"
_RUN = f"""
set -e
.ci/setup notebook
mkdir ~/notebook; cp {PAGE} ~/notebook; cd ~/notebook
{TREE}/.venv/bin/jupyter nbconvert --to notebook --execute --output ran.ipynb tutorial.ipynb
"""


def run_tutorial(root: BareRoot, limit_s: float) -> tuple[Done, list[tuple[int, str]]]:
    """How it ended, and of each code cell its number and what differs from what is kept."""
    done = root.run(_RUN, limit_s=limit_s)
    if done.code:
        return done, []
    ran = _list_shown((root.tree / "../notebook/ran.ipynb").resolve())
    kept = _list_shown(ROOT / PAGE)
    if len(ran) != len(kept):
        return done, [(0, f"{len(ran)} cells, not {len(kept)}")]
    pairs = zip(kept, ran, strict=True)
    return done, [(number, _compare_cells(*pair)) for number, pair in enumerate(pairs, 1)]


def _list_shown(path: Path) -> list[tuple[str, int]]:
    """Text and count of pictures below each cell."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    outputs = [cell["outputs"] for cell in cells if cell["cell_type"] == "code"]
    return [
        ("\n".join(map(_text_of, each)), sum("image/png" in o.get("data", {}) for o in each))
        for each in outputs
    ]


def _text_of(output: dict[str, Any]) -> str:
    if output.get("name") == "stderr":
        return ""
    text = output.get("text") or output.get("data", {}).get("text/plain", "")
    return text if isinstance(text, str) else "".join(text)


def _compare_cells(kept: tuple[str, int], ran: tuple[str, int]) -> str:
    if kept[1] != ran[1]:
        return f"{ran[1]} pictures, not {kept[1]}"
    return find_difference(kept[0], ran[0])
