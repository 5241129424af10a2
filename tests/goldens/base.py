"""Goldens of a commit, taken by that commit's own `tests/goldens` in a worktree of its own."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from tests.goldens.comparing import compare
from tests.tools import program

TREE = Path(__file__).resolve().parents[2]


def compare_with(
    rev: str, only: Sequence[str] = (), keep: Path | None = None, *, words: bool = True
) -> bool:
    """Take goldens of a commit and of this tree, and compare; whether nothing differs.

    Both are taken with this Python, each tree with its own modules. keep : where they stay.
    """
    with tempfile.TemporaryDirectory(prefix="pdcd-goldens-") as made:
        folder = keep.absolute() if keep is not None else Path(made)
        with _worktree(rev, Path(made) / "tree") as tree:
            _take(tree, folder / "before", only)
        _take(TREE, folder / "after", only)
        return compare(folder / "before", folder / "after", words=words)


@contextmanager
def _worktree(rev: str, place: Path) -> Iterator[Path]:
    """The files of a commit."""
    _git("worktree", "add", "--detach", "--quiet", str(place), rev)
    try:
        if not (place / "tests" / "goldens").is_dir():
            raise SystemExit(f"{rev} has no tests/goldens: it cannot be compared with")
        yield place
    finally:
        _git("worktree", "remove", "--force", str(place))


def _git(*words: str) -> None:
    subprocess.run([program("git"), *words], cwd=TREE, check=True)


def _take(tree: Path, folder: Path, only: Sequence[str]) -> None:
    """Have a tree take its goldens; ends this program where it cannot."""
    sys.stdout.write(f"goldens of {tree}\n")
    sys.stdout.flush()
    command = [sys.executable, "-m", "tests.goldens", "take", str(folder)]
    command += ["--only", *only] if only else []
    if subprocess.run(command, cwd=tree).returncode:
        raise SystemExit(f"not all goldens of {tree} could be taken")
