"""Files that somebody else named are opened in `pdcd/files` alone, and JSON is written there."""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Iterator

from tests.places import ROOT

ROOM = "pdcd/files/"
READERS = frozenset(
    """
    copy copy2 copyfile copytree fromfile genfromtxt imread load loadtxt memmap read_bytes read_text
    TiffFile ZipFile
    """.split()
)
"""Methods that open what they are given the name of, and read it."""
MODULES = frozenset({"cv2", "np", "rawpy", "shutil", "tifffile"})
"""Of whose functions the short names above are meant."""

WORDS = re.compile(rf"\b(open|encode|{'|'.join(READERS)})\(")
"""What a file holds that is worth being taken apart."""

OWN = {
    "pdcd/bench/choosing.py: system.open": "folders, to lock them",
    "pdcd/capture/keeping.py: shutil.copyfile": "from one folder of its own to another, both open",
    "pdcd/cli/starting.py: log.open": "the log of a child, in a folder of its own",
    "pdcd/cli/streams.py: open": "/dev/null",
    "pdcd/cli/streams.py: os.open": "/dev/null",
    "pdcd/printable.py: os.open": "/dev/null",
    "pdcd/extras.py: read_text": "the Makefile of the program",
    "pdcd/pages/render.py: read_text": "a template of the program",
    "pdcd/pictures/written/export.py: read_bytes": "a scratch file that was written just now",
    "pdcd/runs/folder.py: os.open": "the run's own folder, and its files to be written through",
    "pdcd/runs/patterns.py: ZipFile": "of an open file",
    "pdcd/runs/place.py: system.open": "folders, one part of the way after the other",
    "pdcd/runs/provenance.py: read_text": "the commit of the program",
    "pdcd/runs/walk.py: system.open": "folders, through no link",
    "pdcd/server/lock.py: os.open": "a lock: no link, without waiting, and looked at",
    "pdcd/setup/files.py: read_text": "a template of the program",
    "pdcd/setup/files.py: path.read_bytes": "what would be overwritten, by who starts the program",
    "pdcd/setup/find.py: read_bytes": "what the kernel tells of a connector",
    "pdcd/setup/find.py: read_text": "what the kernel tells of a connector",
    "pdcd/setup/find.py: kept.read_text": "what udev keeps of an adapter",
    "drivers/serial_shutter/look.py: read_text": "a number of the kernel's",
    "pdcd/web/pages.py: file.read_bytes": "pages of the program",
    "drivers/genicam/doctor.py: path.read_text": "a number of the kernel's",
    "drivers/virtual_genicam/bench.py: open": "a camera and no file",
    "drivers/ptp/holders.py: read_text": "what the kernel tells of a process",
}
"""What else is opened to be read, and why it may be."""

ENCODERS = {
    "pdcd/protocol/line_talk.py": "asks of a user: what is no text is refused",
    "drivers/ptp/shutter.py": "options of the configuration, which is text",
    "drivers/gphoto/camera.py": "options of the configuration, which is text",
    "pdcd/runs/ledger.py": "around what is JSON already",
}
"""Who else makes JSON for others to read."""


@functools.cache
def calls() -> list[tuple[str, ast.Call]]:
    return list(find_calls())


def find_calls() -> Iterator[tuple[str, ast.Call]]:
    for room in ("pdcd", "drivers"):
        for file in sorted((ROOT / room).rglob("*.py")):
            name, text = str(file.relative_to(ROOT)), file.read_text()
            if not name.startswith(ROOM) and WORDS.search(text):
                for node in ast.walk(ast.parse(text)):
                    if isinstance(node, ast.Call):
                        yield name, node


def name_of(call: ast.Call) -> tuple[str, str]:
    """The receiver's last name and the function's: `np`, `load`."""
    function = call.func
    if isinstance(function, ast.Name):
        return "", function.id
    if not isinstance(function, ast.Attribute):
        return "", ""
    at = function.value
    owner = at.attr if isinstance(at, ast.Attribute) else at.id if isinstance(at, ast.Name) else ""
    return owner, function.attr


def is_read(call: ast.Call) -> bool:
    """Whether a call opens a file by its name to read it; devices have an `open` as well."""
    owner, name = name_of(call)
    if call.args and isinstance(call.args[0], ast.Call) and name_of(call.args[0])[1] == "BytesIO":
        return False
    if name == "open":
        modes = [a.value for a in call.args if isinstance(a, ast.Constant)]
        modes += [k.value.value for k in call.keywords if isinstance(k.value, ast.Constant)]
        written = [m for m in map(str, modes) if m and set(m) <= set("rwxabt+")]
        if owner in ("os", "system", "io", "") or {k.arg for k in call.keywords} & {
            "newline",
            "encoding",
        }:
            return not written or written[0][0] == "r"
        plain = not call.args and owner.lower().endswith(("path", "file", "source", "folder"))
        return plain or bool(written and written[0][0] == "r")
    short = name in ("copy", "load", "imread", "copy2", "copyfile", "copytree", "memmap")
    return name in READERS and (not short or owner in MODULES)


def test_what_somebody_else_named_is_opened_in_one_room() -> None:
    found = set()
    for file, call in calls():
        if is_read(call):
            owner, name = name_of(call)
            found.add(f"{file}: {owner}.{name}" if owner else f"{file}: {name}")
    assert found - OWN.keys() == set()
    assert OWN.keys() - found == set()


def test_json_that_leaves_the_program_is_written_in_one_room() -> None:
    """Where a text of it is of others: names on a disk may be any bytes."""
    found = {file for file, call in calls() if name_of(call) == ("json", "encode")}
    assert found == ENCODERS.keys()


def test_the_search_finds_what_it_is_to_find() -> None:
    for text, told in (
        ("open(x)", True), ("path.open()", True), ("p.open('rb')", True), ("os.open(p, f)", True),
        ("system.open(p, f)", True),
        ("x.open(newline='')", True), ("p.open('xb')", False), ("camera.open('shutter')", False),
        ("shutter.open()", False), ("np.load(p)", True), ("rig.load(p)", False),
        ("rawpy.imread(p)", True),
        ("rawpy.imread(io.BytesIO(b))", False), ("p.read_bytes()", True),
        ("shutil.copy(a, b)", True), ("a.copy()", False),
    ):  # fmt: skip
        call, *_ = [n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.Call)]
        assert is_read(call) == told, text
