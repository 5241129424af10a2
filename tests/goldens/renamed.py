"""Names that changed on purpose: `renamed.toml` lists them, each with a reason.

::

    [[field]]
    old = "capture.json:run.how.bars"    # FILE:PATH, or PATH in every file; * stands for one step
    new = "capture.json:run.how.noise"   # left out: the field is gone
    reason = "..."

    [[new]]                              # a field, file or array that was not there before
    name = "capture.json:run.schema"
    reason = "..."

    [[case]]                             # all that a case keeps may differ: it means another thing
    name = "ways/method/pairs*"
    reason = "..."

The file of a field is the end of its path in the case, such as "capture.json" or "codes.npz"; an
array is a field of its file. A field that moves stays in its file. "FILE:" is a whole file.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

LISTED = Path(__file__).with_name("renamed.toml")


@dataclass(frozen=True)
class Name:
    """A pattern of fields: file ("" for every one) and path."""

    file: str
    path: str

    @classmethod
    def read(cls, text: str) -> Name:
        """FILE:PATH, or PATH."""
        file, colon, path = text.partition(":")
        return cls(file, path) if colon else cls("", file)

    def match(self, file: str, path: str) -> re.Match[str] | None:
        """How it fits a field of a file; what is below the field fits, too."""
        if self.file and not (file == self.file or file.endswith("/" + self.file)):
            return None
        steps = [r"([^.]+)" if step == "*" else re.escape(step) for step in self.path.split(".")]
        look = r"\.".join(steps) + r"(?P<rest>(\..*)?)"
        return re.fullmatch(look if self.path else ".*", path)


@dataclass
class Renamed:
    """What may differ."""

    fields: Sequence[tuple[Name, Name | None]] = ()
    new: Sequence[Name] = ()
    cases: Sequence[str] = ()

    def file_now(self, file: str) -> str | None:
        """What a file of before is called now; None: it is gone on purpose."""
        for old, new in self.fields:
            if not old.path and old.match(file, ""):
                return None if new is None else file.removesuffix(old.file) + new.file
        return file

    def field_now(self, file: str, path: str) -> str | None:
        """What a field of before is called now; None: it is gone on purpose."""
        for old, new in self.fields:
            found = old.match(file, path) if old.path else None
            if found is None:
                continue
            if new is None:
                return None
            steps = iter(found.groups())
            there = ".".join(next(steps) if s == "*" else s for s in new.path.split("."))
            return there + found["rest"]
        return path

    def is_new(self, file: str, path: str) -> bool:
        """Whether a field may be there that was not before."""
        return any(name.match(file, path) for name in self.new)

    def is_another(self, case: str) -> bool:
        """Whether a case means another thing now."""
        return any(fnmatchcase(case, name) for name in self.cases)


def read_renamed(path: Path = LISTED) -> Renamed:
    """The list of a tree. Raises ValueError for an entry without a reason."""
    told = tomllib.loads(path.read_text())
    unknown = set(told) - {"field", "new", "case"}
    entries = [entry for kind in told.values() for entry in kind]
    if unknown or not all(str(entry.get("reason", "")).strip() for entry in entries):
        raise ValueError(f"{path}: entries are [[field]], [[new]] and [[case]], with a reason each")
    return Renamed(
        fields=[
            (Name.read(e["old"]), Name.read(e["new"]) if "new" in e else None)
            for e in told.get("field", ())
        ],
        new=[Name.read(e["name"]) for e in told.get("new", ())],
        cases=[e["name"] for e in told.get("case", ())],
    )
