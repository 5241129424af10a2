"""`python -m tests.api_pages FOLDER`: the API reference, made of docstrings, as HTML.

The exit status is 1 where something public says nothing of itself, or pdoc warns: `make lint` asks.
"""

from __future__ import annotations

import importlib
import re
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import msgspec
import pdoc.doc
import pdoc.render

from pdcd.protocol.fields import fields_of, list_request_fields

MODULES = (
    "pdcd",
    "pdcd.errors",
    "pdcd.client",
    "pdcd.driver",
    "pdcd.testing",
    "pdcd.api.stream",
    "pdcd.protocol.request",
    "pdcd.protocol.stream",
    "pdcd.protocol.plan_summary",
    "pdcd.protocol.result",
    "pdcd.protocol.events",
    "pdcd.protocol.views",
)
"""What docs/python.md and docs/new-driver.md call public, and what it takes and returns."""


def write_api_pages(folder: Path, names: tuple[str, ...] = MODULES) -> list[str]:
    """Write a page a module and `index.html`. Returns what is wrong: public names that say nothing
    of themselves, and warnings."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        pages = {name: pdoc.doc.Module(_import_whole(name)) for name in names}
        wrong = [f"{name} has no docstring" for page in pages.values() for name in _untold(page)]
        pdoc.render.configure(show_source=False, search=False)
        for name, page in pages.items():
            page.docstring = re.sub(r"^::$", "", page.docstring, flags=re.MULTILINE)
            path = folder / f"{name.replace('.', '/')}.html"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(pdoc.render.html_module(page, pages), encoding="utf-8")
        index = folder / "index.html"
        index.write_text(pdoc.render.html_index(pages), encoding="utf-8")
    return [*wrong, *(f"{warning.filename}: {warning.message}" for warning in heard)]


def _import_whole(name: str) -> ModuleType:
    """A module, with the names that it brings when they are first used."""
    module = importlib.import_module(name)
    for member in getattr(module, "__all__", ()):
        getattr(module, member)
    return module


def _untold(space: pdoc.doc.Module | pdoc.doc.Class) -> Iterator[str]:
    """Full names of all that is public, is not inherited, and is explained nowhere.

    A variable may be explained by the docstring of its module, its class or a base of that. What a
    message or a request says of its field becomes its docstring.
    """
    fields = _describe_fields(space.obj)
    for member in space.members.values():
        if member.name.startswith("_") or member.is_inherited:
            continue
        if isinstance(member, pdoc.doc.Variable):
            member.docstring = member.docstring or fields.get(member.name, "")
            if not member.docstring and not _mentions(space, member.name):
                yield member.fullname
        elif not member.docstring:
            yield member.fullname
        if isinstance(member, pdoc.doc.Class):
            yield from _untold(member)


def _describe_fields(obj: object) -> dict[str, str]:
    if not (isinstance(obj, type) and issubclass(obj, msgspec.Struct)):
        return {}
    fields = dict(fields_of(obj))
    if "`CaptureRequest` with the same names" in " ".join((obj.__doc__ or "").split()):
        fields = {**list_request_fields(), **{k: v for k, v in fields.items() if v.text}}
    return {name: field.text for name, field in fields.items() if field.text}


def _mentions(space: pdoc.doc.Module | pdoc.doc.Class, name: str) -> bool:
    kind = space.obj
    homes = [kind]
    if isinstance(kind, type):  # with bases of its own package, not Exception or Struct
        package = kind.__module__.partition(".")[0]
        homes = [base for base in kind.__mro__ if base.__module__.partition(".")[0] == package]
    return any(re.search(rf"\b{name}\b", getattr(home, "__doc__", None) or "") for home in homes)


if __name__ == "__main__":
    found = write_api_pages(Path(sys.argv[1]))
    sys.stderr.writelines(f"{line}\n" for line in found)
    sys.exit(1 if found else 0)
