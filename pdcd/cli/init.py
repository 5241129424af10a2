"""`pdcd init`: examines the machine, asks what it cannot see, writes the files of a bench, and says
what is left to do."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from pdcd.api.progress import tell_user
from pdcd.bench.config import load_config, read_config
from pdcd.bench.devices import Finding
from pdcd.bench.folders import read_folder_variable
from pdcd.cli.doctor import examine_bench, say_findings
from pdcd.cli.exits import DONE, FAILED
from pdcd.cli.output import say, say_table, say_text
from pdcd.errors import ConfigError
from pdcd.setup.facts import MOCK, OWN_RELEASE, VIRTUAL, BenchChoices, BenchFacts
from pdcd.setup.files import CONFIG, INSTALL, make_bench_files, write_beside
from pdcd.setup.find import find_bench_facts
from pdcd.setup.propose import BenchProposal, describe_panel, suggest_bench, suggest_choices

_TYPED = "projector", "mask", "camera", "release"
_MOVES = "open", "close"
_SOCKET = "/run/pdcd.sock"
"""Socket of the service."""


def prepare_bench(args: argparse.Namespace) -> int:
    """Write a bench's files, examine it as the doctor does; fails when anything must be mended."""
    asks = not args.yes
    if asks and not sys.stdin.isatty():
        raise ConfigError("there is nobody to ask", hint="give --yes to accept every proposal")
    folder = _find_folder(args.out)
    tell_user("looking at outputs, USB, network and serial ports ...")
    facts = find_bench_facts(args.display)
    _say_facts(facts)
    typed = {name: getattr(args, name) for name in _TYPED}
    chosen = suggest_choices(facts, typed)
    if asks:
        chosen = _ask_all(facts, chosen, typed)
    made = suggest_bench(facts, chosen)
    say("")
    for text in made.why:
        say_text(text)
    files = make_bench_files(made, folder)
    for name, text in files.items():
        say_text(f"{folder / name}: {write_beside(folder / name, text)}")
    if made.plug:
        say("what goes where:")
    for text in made.plug:
        say_text(f"- {text}")
    return _say_left(made, folder)


def _find_folder(out: Path | None) -> Path:
    """The folder given, or the one where this user's daemon looks for its configuration."""
    folder = out.absolute() if out else _find_default()
    if folder is None:
        raise ConfigError(
            f"uid {os.getuid()} has no home folder for a configuration",
            hint="give --out DIR, or set XDG_CONFIG_HOME",
        )
    return folder


def _find_default() -> Path | None:
    try:
        return (read_folder_variable("XDG_CONFIG_HOME") or Path.home() / ".config") / "pdcd"
    except RuntimeError:  # $HOME is not set, and uid has no entry
        return None


def _say_facts(facts: BenchFacts) -> None:
    rows = [["output", describe_panel(output)] for output in facts.outputs]
    rows += [["camera", f"{camera.words}: {camera.key}"] for camera in facts.cameras]
    rows += [["serial port", port.path] for port in facts.ports]
    missing = (("output", facts.outputs), ("camera", facts.cameras), ("serial port", facts.ports))
    rows += [[what, "none found"] for what, found in missing if not found]
    say_table(rows)
    for text in facts.notes:
        say_text(f"note: {text}")


def _ask_all(facts: BenchFacts, chosen: BenchChoices, typed: dict[str, str | None]) -> BenchChoices:
    """Ask at the terminal what cannot be seen from here, unless it was given as an option."""
    answers: dict[str, str | None] = dict(typed)
    outputs = {output.name: describe_panel(output) for output in facts.outputs}
    for role in ("projector", "mask"):
        if typed[role] is None and len(outputs) > 1:
            proposed = getattr(suggest_choices(facts, answers), role)
            answers[role] = _ask(f"Which output is the {role}?", outputs, proposed)
            outputs.pop(str(answers[role]), None)
    if typed["camera"] is None:
        cameras = {camera.key: camera.words for camera in facts.cameras}
        cameras |= {VIRTUAL: "an EOS 450D that is not there", MOCK: "none yet: simulate photos"}
        answers["camera"] = _ask("Which camera?", cameras, chosen.camera)
    if typed["release"] is None and facts.ports:
        ways = {OWN_RELEASE: "the camera itself"} | {p.path: "a release" for p in facts.ports}
        answers["release"] = _ask("What opens the shutter?", ways, chosen.release)
    chosen = suggest_choices(facts, answers)
    if chosen.release != OWN_RELEASE:
        lines = {"rts": "a cable on RTS", "dtr": "a cable on DTR", "command": "a box, by bytes"}
        chosen = replace(chosen, line=_ask(f"What is on {chosen.release}?", lines, "rts"))
        if chosen.line == "command":
            asked = [_ask(f"Bytes that {what} it, such as FF 01 01?", {}, "") for what in _MOVES]
            chosen = replace(chosen, open_hex=asked[0], close_hex=asked[1])
    if chosen.camera in {camera.key for camera in facts.cameras}:
        number = _ask("F-number of the lens, where it is set by hand?", {}, "auto")
        chosen = replace(chosen, f_number=None if number == "auto" else _to_number(number))
    return chosen


def _to_number(text: str) -> float:
    try:
        return float(text.removeprefix("f/"))
    except ValueError as err:
        raise ConfigError(f"{text!r} is no f-number", hint="give one as 5.6, or auto") from err


def _ask(question: str, ways: dict[str, str], proposed: str) -> str:
    """One answer: a number or a name in the list, or any text where there is no list. Return alone
    takes the proposal. Raises ConfigError at the end of input."""
    names = list(ways)
    tell_user(question)
    for number, name in enumerate(names, 1):
        tell_user(f"  {number}  {ways[name]}{'' if name in ways[name] else f' ({name})'}")
    while True:
        told = "type a number or a name" if names else "type it"
        tell_user(f"{told}, or Return alone for {proposed}:" if proposed else f"{told}:")
        line = sys.stdin.readline()
        if not line:
            raise ConfigError("there is no answer", hint="give --yes to accept every proposal")
        said = line.strip() or proposed
        if said.isdecimal() and 1 <= int(said) <= len(names):
            return names[int(said) - 1]
        if said in names or (said and not names):
            return said
        tell_user(f"type a number from 1 to {len(names)}" if names else "type an answer")


def _say_left(made: BenchProposal, folder: Path) -> int:
    """Print the doctor's findings on the written configuration, and what is left to do."""
    path = folder / CONFIG
    faults = [Finding("configuration", "fault", f.message) for f in read_config(path)[1]]
    found = faults or list(_examine(path))
    say("")
    say_findings(found)
    bad = [finding for finding in found if finding.state == "fault"]
    say("")
    say("left to do:")
    for text in _list_steps(made, folder, bad):
        say_text(f"- {text}")
    return FAILED if bad else DONE


def _examine(path: Path) -> Iterator[Finding]:
    tell_user("looking at the bench; both panels go black for some seconds ...")
    yield from examine_bench(load_config(path))


def _list_steps(made: BenchProposal, folder: Path, bad: Sequence[Finding]) -> Iterator[str]:
    """The steps that are left, as sentences, in the order in which to do them."""
    yield from made.left
    if made.modes is not None:
        yield f"read {folder / INSTALL}, then run: sudo sh {folder / INSTALL}"
        yield (
            "the X server of the bench takes the screen: from ssh or a text terminal (Ctrl-Alt-F3) "
            "run: sudo systemctl disable --now display-manager; sudo systemctl start pdcd-x pdcd"
        )
        yield (
            "log in again, for the group pdcd, then run: XAUTHORITY=/run/pdcd-x/auth pdcd doctor "
            f"display (the service reads /etc/pdcd/{CONFIG}, a copy)"
        )
    elif made.port is not None or made.tables.get("camera", {}).get("driver") == "ptp":
        yield f"for rights on devices, or for the service, run: sudo sh {folder / INSTALL}"
    waits = {"X server"} if made.modes is not None else set()
    yield from (f"{f.what}: {f.hint or f.found}" for f in bad if f.what not in waits)
    config = "" if folder == _find_default() else f" --config {folder / CONFIG}"
    where = f" --socket {_SOCKET}" if made.modes is not None else f" --local{config}"
    # Steps that count refreshes cannot be measured where the processor draws.
    drawn = made.tables.get("display", {}).get("options", {}).get("allow_software")
    step = " geometry" if drawn else ""
    yield f"put a white card where the scene will be and run: pdcd calibrate{step}{where}"
    yield f"take a photo: pdcd capture indirect{where}"
