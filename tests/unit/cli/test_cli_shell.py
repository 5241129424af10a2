"""What is made of the one parser: completion that shells really take, and the manual page."""

from __future__ import annotations

import os
import pty
import re
import select
import subprocess
import time
from pathlib import Path

import pytest

from pdcd.cli.main import main
from pdcd.cli.parser import build_parser, list_subparsers
from pdcd.cli.shell import make_completion_script, make_manual_page
from pdcd.version import __version__
from tests.places import ROOT
from tests.tools import needs, program

PATIENCE_S = 30.0
TYPED = {
    "pdcd runs pr": "prune",
    "pdcd capture indi": "indirect",
    "pdcd capture indirect --fam": "--family",
    "pdcd capture indirect --family had": "hadamard",
    "pdcd doctor tri": "trigger",
    "pdcd decode a_fol": "a_folder",
    "pdcd config check --config a_fi": "a_file.toml",
}
"""What is typed, and what a tabulator makes of its last word."""


@pytest.fixture
def home(tmp_path: Path) -> Path:
    (tmp_path / "a_folder").mkdir()
    (tmp_path / "a_file.toml").touch()
    return tmp_path


def said(home: Path, *command: str) -> str:
    done = subprocess.run(
        command, cwd=home, env={**os.environ, "HOME": str(home)}, capture_output=True, text=True,
        timeout=PATIENCE_S, check=True,
    )  # fmt: skip
    assert done.stderr == ""
    return done.stdout


@needs("bash")
def test_bash_completes(home: Path) -> None:
    (home / "script").write_text(make_completion_script("bash"))
    lines = [
        f"COMP_WORDS=({line}); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1)); COMPREPLY=(); "
        '_shtab_pdcd pdcd "${COMP_WORDS[$COMP_CWORD]}"; echo "${COMPREPLY[*]}"'
        for line in TYPED
    ]
    told = said(home, program("bash"), "--norc", "-c", "\n".join([". ./script", *lines]))
    assert told.splitlines() == list(TYPED.values())


@needs("fish")
def test_fish_completes(home: Path) -> None:
    (home / "script").write_text(make_completion_script("fish"))
    lines = [f"complete -C '{line}'; echo END" for line in TYPED]
    told = said(home, program("fish"), "--no-config", "-c", "\n".join(["source script", *lines]))
    found = [part.split("\t")[0].split() for part in told.split("END\n")[:-1]]
    # Folders end in / there.
    assert [[word.rstrip("/") for word in words] for words in found] == [
        [word] for word in TYPED.values()
    ]


@needs("zsh")
def test_zsh_completes(home: Path) -> None:
    """Into _pdcd in a folder of $fpath, and by a tabulator at a terminal: there is no other way."""
    (home / "_pdcd").write_text(make_completion_script("zsh"))
    shell = program("zsh")
    terminal, other_end = pty.openpty()
    environ = {**os.environ, "TERM": "dumb", "HOME": str(home)}
    with subprocess.Popen(
        [shell, "-f", "-i"], cwd=home, env=environ, start_new_session=True,
        stdin=other_end, stdout=other_end, stderr=other_end,
    ) as child:  # fmt: skip
        os.close(other_end)
        begin = (
            "fpath=($PWD $fpath); autoload -U compinit; compinit -D -u; unset zle_bracketed_paste"
        )
        os.write(terminal, f"{begin}; unset zle_bracketed_paste; print RE''ADY\n".encode())
        heard(terminal, "READY")
        for line, word in TYPED.items():
            os.write(terminal, f"print -r -- '[{line}'\n".encode())  # what is seen from here on
            heard(terminal, f"[{line}\r\n")
            os.write(terminal, f"{line}\t".encode())
            wanted = line.rpartition(" ")[0] + f" {word}"
            heard(terminal, wanted)
            os.write(terminal, b"\x15")  # take the line back
        child.kill()
    os.close(terminal)


def heard(terminal: int, wanted: str) -> None:
    """Wait until a terminal shows that."""
    text, end_s = "", time.monotonic() + PATIENCE_S
    while wanted not in text:
        assert time.monotonic() < end_s, text
        if select.select([terminal], [], [], 0.1)[0]:
            text += os.read(terminal, 65536).decode(errors="replace")


def test_a_script_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "bash"]) == 0
    assert capsys.readouterr().out == make_completion_script("bash")


def test_the_manual_has_every_command_and_every_option(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["man"]) == 0
    text = capsys.readouterr().out
    assert text == make_manual_page() and __version__ in text.splitlines()[0]
    every = list(list_subparsers(build_parser()))
    assert {"pdcd capture", "pdcd runs prune", "pdcd doctor camera"} <= {c.prog for c in every}
    sections = dict(part.split("\n", 1) for part in text.replace(r"\-", "-").split("\n.SH ")[1:])
    for command in every:
        section = sections[command.prog.upper()]
        for action in command._actions:
            assert all(option in section for option in action.option_strings), command.prog
    assert "%%" not in text and "None" not in text


@needs("mandoc")
def test_the_manual_is_in_order(tmp_path: Path) -> None:
    (tmp_path / "pdcd.1").write_text(make_manual_page())
    done = subprocess.run(
        [program("mandoc"), "-T", "lint", "-W", "warning", str(tmp_path / "pdcd.1")],
        capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    # It has no date of its own: the version tells it apart.
    assert [line for line in done.stdout.splitlines() if "missing date" not in line] == []


def test_the_version_is_told_in_both_ways(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert end.value.code == 0 and main(["version"]) == 0
    assert capsys.readouterr().out == f"pdcd {__version__}\n" * 2


def test_who_cites_us_cites_this_version_and_the_paper() -> None:
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^version: (.+)$", text, re.MULTILINE) == [__version__]
    assert "doi: 10.1145/2185520.2185535" in text.partition("references:")[2]
