"""What a block becomes in a bare root: a script of bash, and what has to come of it."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass

from tests.docs.bare import BareRoot, Done
from tests.docs.blocks import Block
from tests.docs.printed import find_difference, find_figure, is_near

LIMIT_S = 1500.0
"""How long one block may take."""
_READY_S = 120
_LINE = "=== line: "
_INTERRUPTED = 130

# Runs a line until it has said its words, or an address, which then has to answer; then Ctrl-C.
_UNTIL = r"""
: >~/said
({line}) >~/said 2>&1 &
for _ in $(seq {ready}0); do
    if grep -qE {words} ~/said || ! kill -0 $! 2>/dev/null; then break; fi
    sleep 0.1
done
grep -qE {words} ~/said || {{ cat ~/said; echo "never said: "{words}; exit 1; }}
[ {words} != http ] || .venv/bin/python -c 'import re, sys, urllib.request as u
url = re.findall(r"http://[^\s#]+", sys.stdin.read())[-1]
print(url, u.urlopen(url, timeout=30).status)' <~/said
kill -INT -- -$!; ended=0; wait $! || ended=$?
cat ~/said; echo "ended with $ended"
[ $ended = 0 -o $ended = {interrupted} ]
"""

_BESIDE = """
.venv/bin/pdcd serve --background
.venv/bin/python -c {code} & follower=$!
while kill -0 $follower 2>/dev/null; do .venv/bin/pdcd capture white --codes 4; done
wait $follower
"""


@dataclass
class Told:
    """What the lines of a page have said so far: of each, the last time."""

    lines: dict[str, str]
    last: str = ""

    def keep(self, said: str) -> None:
        """Split what a script has said, line by line."""
        _, *parts = said.split(_LINE)
        for part in parts:
            line, _, rest = part.partition("\n")
            self.lines[_strip_comment(line)] = self.last = rest


def run_block(block: Block, root: BareRoot, told: Told) -> tuple[Done | None, str]:
    """Do what a block says. Returns how its script ended, None where there is none, and what is
    wrong, "" where nothing is."""
    verb, _, rest = block.mark.partition(": ")
    if verb == "paths":
        return None, _find_missing(block.text, root)
    if verb.startswith("printed by "):
        said = told.lines.get(verb.removeprefix("printed by "))
        if said is None:
            return None, "not typed before"
        return Done(0, said, 0.0), find_difference(block.text, said)
    if figure := re.fullmatch(r"(\S+) % is (.+)", block.mark):
        return None, _compare_figure(figure[1], figure[2], block.prose, told.last)
    network = verb != "until interrupted"
    if not network:  # it is to find all there; and nobody else shall have its port
        for target in re.findall(r"^make (\w+)", block.text, re.MULTILINE):
            done = root.run(f".ci/setup {target}", limit_s=LIMIT_S)
            if done.code:
                return done, f".ci/setup {target} ended with {done.code}"
    done = root.run(_write_script(block, verb, rest), limit_s=LIMIT_S, network=network)
    told.keep(done.said)
    return done, _judge(block, verb, done, told)


def _judge(block: Block, verb: str, done: Done, told: Told) -> str:
    wanted = int(verb.removeprefix("ends with ")) if verb.startswith("ends with ") else 0
    if done.code != wanted:
        return f"ended with {done.code}, not {wanted}"
    if "Traceback (most recent call last)" in done.said:
        return "a traceback"
    if verb == "comments are RMS errors":
        for line in block.text.splitlines():
            if figure := re.search(r"# (\S+) %$", line):
                said = told.lines[_strip_comment(line)]
                wrong = _compare_figure(figure[1], "RMS error", line, said)
                if wrong:
                    return wrong
    return ""


def _compare_figure(figure: str, name: str, prose: str, said: str) -> str:
    printed = find_figure(name, said)
    if f"{figure} %" not in prose:
        return f"{figure} % is not in the text before"
    if printed is None or not is_near(figure, printed):
        return f"{name} is {printed} %, not {figure} %"
    return ""


def _write_script(block: Block, verb: str, rest: str) -> str:
    head = "set -em\nexport PS1='$ '\n"
    if verb == "beside captures":
        return head + _BESIDE.format(code=shlex.quote(block.text))
    if block.language == "python":
        return head + f".venv/bin/python -c {shlex.quote(block.text)}"
    lines = block.text.splitlines()
    if verb.startswith("as "):
        lines = [verb.removeprefix("as ")]
    if verb.startswith("so "):
        lines = [block.mark.removeprefix("so ")]
    waits = iter(rest.split(", ")) if verb == "until interrupted" else None
    return head + "\n".join(_type_lines(lines, waits, answers=verb == "Enter answers"))


def _type_lines(lines: list[str], waits: Iterator[str] | None, *, answers: bool) -> Iterator[str]:
    for line in lines:
        yield f"echo {shlex.quote(_LINE + line)}"
        bare = _strip_comment(line)
        if waits is not None:
            words = shlex.quote(next(waits))
            yield _UNTIL.format(line=bare, words=words, ready=_READY_S, interrupted=_INTERRUPTED)
        elif answers:
            yield f"yes '' | head -50 | script -qec {shlex.quote(bare)} /dev/null"
        else:
            yield line
        if bare.endswith("&"):  # who types waits for what it says
            yield "until .venv/bin/pdcd status >/dev/null 2>&1; do sleep 0.1; done"


def _strip_comment(line: str) -> str:
    return re.split(r"\s{2,}#", line)[0]


def _find_missing(drawing: str, root: BareRoot) -> str:
    """What a drawing of folders names and the tree has not."""
    tree, above = root.tree, ""
    gone = []
    for line in drawing.splitlines():
        deep = line.startswith("  ")
        names = re.split(r"\s{2,}", line.strip())[0].split()
        if not deep:
            above = names[0] if names[0].endswith("/") else ""
        for name in names:
            path = tree / (above if deep else "") / name
            if not path.exists() and not path.with_suffix(".py").exists():
                gone.append(f"{above if deep else ''}{name}")
    return f"not there: {', '.join(gone)}" if gone else ""
