"""`python -m tests.tutorial`: runs docs/tutorial.ipynb in an empty folder, keeps what it shows."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

from tests import world
from tests.places import ROOT

PATH = ROOT / "docs" / "tutorial.ipynb"
TIMEOUT_S = 300


def executed(folder: Path) -> Any:
    """The notebook, run anew with `folder` as its current one. Raises CellExecutionError."""
    notebook = nbformat.read(PATH, as_version=4)  # type: ignore[no-untyped-call]
    # The kernel imports this tree, whatever is installed.
    os.environ["PYTHONPATH"] = str(ROOT)
    client = NotebookClient(
        notebook, timeout=TIMEOUT_S, resources={"metadata": {"path": str(folder)}}
    )
    client.execute()
    return notebook


def main() -> None:
    """Write it back as it came out, without what differs from run to run and tells nothing."""
    world.enter()
    with tempfile.TemporaryDirectory() as folder:
        notebook = executed(Path(folder))
    for number, cell in enumerate(notebook.cells):
        cell["id"] = f"cell-{number:02d}"
        cell.metadata.clear()
        if cell.cell_type == "code":  # where a bar of progress was, nothing is left
            bars = [o for o in cell.outputs if o.get("data", {}).get("text/html") == ""]
            cell.outputs = [output for output in cell.outputs if output not in bars]
    notebook.metadata.language_info = {"name": "python"}
    nbformat.write(notebook, PATH)  # type: ignore[no-untyped-call]


if __name__ == "__main__":
    main()
