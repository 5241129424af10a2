"""Notes, while a program runs, which of its files are loaded and called, and where objects of some
classes come by.

Every process of the program writes its own file of notes, a JSON list a line, at once: a process
that is killed has lost nothing. Whoever starts a program by `traced_environment` gets them by
`read_notes`.
"""

from __future__ import annotations

import inspect
import json
import os
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType, FrameType, MemberDescriptorType
from typing import Any

VARIABLE = "PDCD_WALK"
HOOK = Path(__file__).parent / "hook"
STEPS = 2
"""How many attributes may lie between an argument and the object that it holds."""
MOST = 64
"""Longer tuples, lists and dictionaries are not searched: they are data."""


@dataclass(frozen=True, order=True)
class Step:
    """The first call at one place of the source that passes an object of a class on.

    Files are relative to the root of the tree; `caller` is "" where nothing of the program called.
    """

    time_ns: int
    held: str
    home: str
    """The module that defines the class."""
    callee: str
    function: str
    caller: str
    line: int


@dataclass
class Notes:
    """What all processes of a program noted; steps in order of time."""

    loaded: set[str] = field(default_factory=set)
    called: set[str] = field(default_factory=set)
    steps: list[Step] = field(default_factory=list)


def traced_environment(
    out: Path, root: Path, packages: Sequence[str], classes: Sequence[str]
) -> dict[str, str]:
    """The environment in which a Python program is traced, with all Python that it starts.

    out : folder for the notes. packages : top-level folders of `root` that are the program.
    classes : names of the classes to look for.
    """
    wanted = {
        "out": str(out),
        "root": str(root),
        "packages": list(packages),
        "classes": list(classes),
    }
    home = Path(__file__).parents[2]
    paths = [str(HOOK), str(home), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, VARIABLE: json.dumps(wanted), "PYTHONPATH": os.pathsep.join(paths)}


def read_notes(out: Path) -> Notes:
    """The notes that lie in a folder."""
    notes = Notes()
    for path in sorted(out.iterdir()):
        for line in path.read_text().splitlines():
            kind, *rest = json.loads(line)
            if kind == "load":
                notes.loaded.add(*rest)
            elif kind == "call":
                notes.called.add(*rest)
            else:
                notes.steps.append(Step(*rest))
    notes.steps.sort()
    return notes


def begin() -> None:
    """Trace this process and its threads, where the environment asks for it."""
    if VARIABLE not in os.environ:
        return
    tracer = Tracer(**json.loads(os.environ[VARIABLE]))
    threading.setprofile(tracer.see)
    sys.setprofile(tracer.see)


class Tracer:
    """Sees every call of a process (`sys.setprofile`)."""

    def __init__(
        self, out: str, root: str, packages: Sequence[str], classes: Sequence[str]
    ) -> None:
        self._root, self._packages, self._classes = root, tuple(packages), frozenset(classes)
        self._tops = tuple(f"{root}/{package}/" for package in packages)
        flags = os.O_CREAT | os.O_WRONLY | os.O_APPEND
        self._out = os.open(f"{out}/{os.getpid()}.jsonl", flags)
        self._files: dict[CodeType, str] = {}
        self._said: set[tuple[str, ...]] = set()
        self._sites: set[tuple[CodeType, CodeType | None, int, str]] = set()

    def see(self, frame: FrameType, event: str, arg: Any) -> None:
        """Note a call; for `sys.setprofile`."""
        if event != "call":
            return
        code = frame.f_code
        file = self._file(code)
        if not file:
            return
        if code.co_name == "<module>":
            self._say("load", file)
        elif code.co_flags & inspect.CO_OPTIMIZED:  # a function; bodies of classes are none
            self._say("call", file)
            self._pass_on(frame, file)

    def _pass_on(self, frame: FrameType, file: str) -> None:
        """Note the classes that the arguments of a call hold."""
        code = frame.f_code
        held: dict[str, type] = {}
        values = frame.f_locals
        for name in code.co_varnames[: _argument_count(code)]:
            value = values.get(name)
            self._search(value, STEPS, held)
            for item in _items(value):
                self._search(item, 0, held)
        if not held:
            return
        caller = frame.f_back
        while caller is not None and not self._file(caller.f_code):
            caller = caller.f_back
        at = None if caller is None else caller.f_code
        line = 0 if caller is None else caller.f_lineno
        for name, kind in held.items():
            if (code, at, line, name) in self._sites:
                continue
            self._sites.add((code, at, line, name))
            came = "" if at is None else self._file(at)
            now = time.monotonic_ns()
            self._write("step", now, name, kind.__module__, file, code.co_qualname, came, line)

    def _search(self, value: Any, steps: int, found: dict[str, type]) -> None:
        """Which of the classes a value is of, or reaches by so many attributes."""
        kind = type(value)
        if kind.__module__.partition(".")[0] not in self._packages:
            return
        if kind.__name__ in self._classes:
            found[kind.__name__] = kind
        if steps:
            for one in _attributes(value):
                self._search(one, steps - 1, found)

    def _file(self, code: CodeType) -> str:
        """The file of a code relative to the root; "" for what is not of the program."""
        file = self._files.get(code)
        if file is None:
            path = code.co_filename
            inside = path.startswith(self._tops)
            file = self._files[code] = path[len(self._root) + 1 :] if inside else ""
        return file

    def _say(self, *what: str) -> None:
        if what not in self._said:
            self._said.add(what)
            self._write(*what)

    def _write(self, *what: str | int) -> None:
        os.write(self._out, json.dumps(what).encode() + b"\n")


def _argument_count(code: CodeType) -> int:
    """How many of a function's local names are its parameters, which come first."""
    more = bool(code.co_flags & inspect.CO_VARARGS) + bool(code.co_flags & inspect.CO_VARKEYWORDS)
    return code.co_argcount + code.co_kwonlyargcount + more


def _items(value: Any) -> list[Any]:
    """What lies in a short tuple, list or dictionary."""
    if type(value) not in (tuple, list, dict) or len(value) > MOST:
        return []
    return list(value.values() if isinstance(value, dict) else value)


def _attributes(value: Any) -> Iterator[Any]:
    """What an object stores: no code of its own is run for that, such as a property's."""
    yield from list(getattr(value, "__dict__", {}).values())
    for kind in type(value).__mro__:
        for name, slot in list(vars(kind).items()):
            if isinstance(slot, MemberDescriptorType) and name != "__dict__":
                try:
                    yield slot.__get__(value)
                except AttributeError:  # not set so far
                    continue
