"""A program is taken for what it answers, not for its name."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests import tools
from tests.places import ROOT
from tests.tools import THINGS, Found, Library, Module, Tool, find, linked, missing, needs, search

PAINT = Tool("Paint", "paint-tools", ("paint7", "paint"), ("-version",), r"^Version: Paint \d")


def fake(folder: Path, name: str, script: str, mode: int = 0o755) -> Path:
    """A program of this name that does this."""
    folder.mkdir(exist_ok=True)
    file = folder / name
    file.write_text(f"#!/bin/sh\n{script}\n", encoding="utf-8")
    file.chmod(mode)
    return file


@pytest.mark.parametrize(
    ("files", "found"),
    [
        # On either stream, in any line, whatever its exit status.
        (
            {"a/paint": 'test "$1" = -version && printf "\\nVersion: Paint 6\\n" >&2; exit 3'},
            "a/paint",
        ),
        # The real one behind a stand-in; the first of its names before others.
        ({"a/paint": "echo no", "b/paint": "echo Version: Paint 6"}, "b/paint"),
        ({"a/paint": "echo Version: Paint 6", "a/paint7": "echo Version: Paint 7"}, "a/paint7"),
        # Asked without a display and in no language.
        (
            {"a/paint": 'test -z "$DISPLAY" && test "$LC_ALL" = C && echo Version: Paint 6'},
            "a/paint",
        ),
    ],
)
def test_a_program_that_answers_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, files: dict[str, str], found: str
) -> None:
    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setenv("LC_ALL", "de_DE.UTF-8")
    for name, script in files.items():
        fake(tmp_path / name[0], name[2:], script)
    assert search(PAINT, f"{tmp_path}/a:{tmp_path}/b") == Found(str(tmp_path / found))


def test_a_stand_in_of_the_name_is_not_it(tmp_path: Path) -> None:
    file = fake(tmp_path, "paint", 'echo "paint: not installed; Version: Paint 6 is" >&2; exit 1')
    found = search(PAINT, str(tmp_path))
    assert found.path == ""
    assert found.why == (f"`{file} -version` says 'paint: not installed; Version: Paint 6 is'")


def test_folders_of_its_own_go_before_path(tmp_path: Path) -> None:
    fake(tmp_path / "bin", "x", "echo ours")
    file = fake(tmp_path / "lib", "x", "echo ours")
    tool = Tool("X", "x", ("x",), (), "^ours$", (str(tmp_path / "lib"),))
    assert search(tool, str(tmp_path / "bin")) == Found(str(file))


def test_what_cannot_run_is_no_program(tmp_path: Path) -> None:
    fake(tmp_path, "paint", "echo Version: Paint 6", mode=0o644)
    (tmp_path / "paint7").mkdir()
    assert search(PAINT, str(tmp_path)) == Found("", "no paint7 or paint on PATH")
    broken = fake(tmp_path / "b", "paint", "")
    broken.write_text("#!/no/such/shell\n", encoding="utf-8")
    assert "No such file" in search(PAINT, str(tmp_path / "b")).why


def test_one_that_never_answers_is_not_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tools, "ANSWER_S", 0.2)
    fake(tmp_path, "paint", "exec sleep 60")
    assert "no answer within 0.2 s" in search(PAINT, str(tmp_path)).why


def test_a_library_is_there_when_it_loads() -> None:
    assert search(Library("C", "libc6", "libc.so.6")).path == "libc.so.6"
    assert "does not load" in search(Library("none", "none", "libnone.so.99")).why


def test_a_file_is_found_by_its_pattern(tmp_path: Path) -> None:
    (tmp_path / "lib" / "arm").mkdir(parents=True)
    (tmp_path / "lib" / "arm" / "a.so").touch()
    module = Module("A", "a", "lib/*/a.so")
    assert search(module, root=tmp_path).path == str(tmp_path / "lib" / "arm" / "a.so")
    assert search(module, root=tmp_path / "lib").why == "no lib/*/a.so"


@pytest.fixture
def table(monkeypatch: pytest.MonkeyPatch) -> None:
    """A table of one program that is there, and one that is not."""
    things = {"paint": PAINT, "jq": Tool("jq", "jq", ("jq",), (), "")}
    monkeypatch.setattr(tools, "THINGS", things)
    found = {"paint": Found("", "no paint on PATH"), "jq": Found("/bin/jq")}
    monkeypatch.setattr(tools, "find", lambda name: found[name])


@pytest.mark.usefixtures("table")
def test_a_skip_says_what_is_missing_and_where_it_comes_from() -> None:
    mark = needs("jq", "paint")
    assert mark.args == (True,)
    reason = "Paint IS MISSING: no paint on PATH (Debian package paint-tools)"
    assert mark.kwargs["reason"] == missing("paint") == reason
    with pytest.raises(pytest.skip.Exception, match="Paint IS MISSING"):
        tools.program("paint")
    assert needs("jq").args == (False,)
    assert missing("jq") == ""
    assert tools.program("jq") == "/bin/jq"


@pytest.mark.usefixtures("table")
def test_setup_is_told_the_packages_and_what_each_is_for(
    capsys: pytest.CaptureFixture[str],
) -> None:
    tools.main()
    out, err = capsys.readouterr()
    assert out == "paint-tools\n"
    assert err == f"  {missing('paint')}\n"


@pytest.mark.usefixtures("table")
def test_what_only_one_target_needs_is_brought_for_that_target_only(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tools, "APART", {"art": ("paint",)})
    tools.main()
    assert capsys.readouterr() == ("\n", "")
    tools.main("art")
    assert capsys.readouterr().out == "paint-tools\n"


def test_scripts_find_the_real_programs_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = fake(tmp_path / "real", "paint7", "echo painted")
    fake(tmp_path / "false", "paint7", "echo no")
    monkeypatch.setattr(tools, "THINGS", {"paint": PAINT})
    monkeypatch.setattr(tools, "find", lambda name: Found(str(file)))
    monkeypatch.setenv("PATH", f"{tmp_path}/false:/usr/bin:/bin")
    path = linked(tmp_path / "bin", "paint")
    done = subprocess.run(
        ["/bin/sh", "-c", "paint7"], env={"PATH": path}, capture_output=True, text=True, check=True
    )
    assert done.stdout == "painted\n"


def test_every_entry_of_the_table_is_whole() -> None:
    for name, thing in THINGS.items():
        assert re.fullmatch(r"[a-z0-9][a-z0-9+.-]+", thing.package), name
        if isinstance(thing, Tool):
            assert thing.commands and thing.answer, name
            re.compile(thing.answer)
            nothing = search(thing, path="")
            assert thing.folders or not nothing.path, name
    assert find("bash").path or "bash" in missing("bash")


def test_tests_call_programs_by_what_was_found() -> None:
    """No `shutil.which`, and no command by its bare name, in any test; benchmarks are none."""
    bare = re.compile(r"(subprocess\.[a-z_]+|Popen|_exec)\(\s*\[?\s*f?\"|shutil\.which")
    for file in sorted((ROOT / "tests").rglob("*.py")):
        if file.name not in (Path(__file__).name, "tools.py") and "bench" not in file.parent.name:
            found = bare.search(file.read_text(encoding="utf-8"))
            assert found is None, f"{file}: {found and found.group()}"


def test_interrupts_reach_the_tests_where_a_shell_would_have_them_ignored() -> None:
    """As what a script starts in its background inherits it."""
    code = "import os, signal, tests.conftest\nos.kill(os.getpid(), signal.SIGINT)"
    done = subprocess.run(
        ["/bin/sh", "-c", 'trap "" INT; exec "$0" "$@"', sys.executable, "-c", code],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert "KeyboardInterrupt" in done.stderr


def test_setup_has_the_table_from_here() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.tools"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    (packages,) = done.stdout.splitlines()
    assert set(packages.split()) <= {thing.package for thing in THINGS.values()}
    assert bool(packages) == bool(done.stderr)
    assert "-m tests.tools" in (ROOT / ".ci" / "setup").read_text(encoding="utf-8")
