"""The API reference: what says nothing of itself is found."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

pytest.importorskip("pdoc")

from tests.api_pages import write_api_pages

MODULE = '''"""A module. `told` is a number."""

from __future__ import annotations

import msgspec
from typing import Annotated

__all__ = ["Base", "Derived", "Message", "broken", "told", "untold"]
told, untold = 1, 2

class Base:
    """A base. size : in metres."""

class Derived(Base):
    """A class."""

    size: float = 1.0

    def _hidden(self): ...

    def bare(self): ...

class Message(msgspec.Struct):
    """A message."""

    codes: Annotated[int, msgspec.Meta(description="how many there are")] = 1
    cells: int = 1

def broken() -> "NoSuchName":
    """Do something."""
'''


def test_names_that_say_nothing_and_warnings_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "acme_documented.py").write_text(MODULE, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    *untold, warning = write_api_pages(tmp_path / "api", ("acme_documented",))
    monkeypatch.delitem(sys.modules, "acme_documented")
    assert sorted(untold) == [
        f"acme_documented.{name} has no docstring"
        for name in ("Derived.bare", "Message.cells", "untold")
    ]
    assert "NoSuchName" in warning
    page = (tmp_path / "api" / "acme_documented.html").read_text(encoding="utf-8")
    assert "how many there are" in page and "_hidden" not in page
