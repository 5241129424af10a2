"""`pdcd calibrate list | use | forget`: the calibrations that are kept, and which one is used."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from pdcd.bench.calibration import Calibration
from pdcd.bench.choosing import FOLDER, Candidate, candidate, candidates, forget, pin, place_of
from pdcd.bench.config import load
from pdcd.bench.folders import state_dir
from pdcd.bench.measured import Choice, choice
from pdcd.bench.tables import Config
from pdcd.cli.exits import DONE
from pdcd.cli.output import agreed, say, say_json, say_table, say_text
from pdcd.errors import ConfigError

ACTIONS = ("list", "use", "forget")
"""Words in the place of the first step."""
NOT_WITH = ("scene", "again", "out", "anew", "queue", "socket")
"""Options that go with steps only."""


def manage(args: argparse.Namespace, words: Sequence[str]) -> int:
    """Do what the first of the words says with the calibrations of a configuration's bench."""
    given = [name for name in NOT_WITH if getattr(args, name)]
    if given or args.marks != "auto":
        raise ConfigError(f"pdcd calibrate {words[0]} takes no --{(*given, 'marks')[0]}")
    config = load(args.config)
    action, *names = words
    if action == "list":
        if names:
            raise ConfigError("pdcd calibrate list takes no name")
        return _list(config, as_json=args.json)
    if len(names) != 1:
        wanted = "NAME, none or latest" if action == "use" else "NAME"
        raise ConfigError(f"pdcd calibrate {action} takes one word: {wanted}")
    if action == "use":
        return _use(config, names[0], as_json=args.json)
    return _forget(config, names[0], yes=args.yes, as_json=args.json)


def _list(config: Config, *, as_json: bool) -> int:
    """All of them, the newest first."""
    used, trouble = _choice(config)
    found = list(candidates(config))
    rows = [["", "name", "ended", "steps", "fits this bench"]]
    for one in found:
        in_use = used is not None and used.folder == one.folder
        if as_json:
            say_json(_told(one, in_use=in_use))
            continue
        record = one.record
        ended = "" if record is None else record.finished_utc[:16].replace("T", " ")
        steps = "" if record is None else _steps(record)
        rows.append(["in use" if in_use else "", one.name, ended, steps, one.why or "yes"])
    if as_json:
        return DONE
    if not found:
        say(f"no calibration is kept in {state_dir(config) / FOLDER}")
    else:
        say_table(rows)
    if trouble:
        say_text(trouble)
    elif used is not None and used.folder is None and found:
        say("none is in use")
    return DONE


def _use(config: Config, name: str, *, as_json: bool) -> int:
    """Write down which one is used from now on."""
    typed = config.calibration.use
    if name in ("none", "latest"):
        pin(config, None if name == "latest" else name)
    else:
        at = place_of(config, name)
        found = candidate(at, config, named=True)
        why = "it holds nothing that is whole" if found is None else found.why
        if found is None or why:
            raise ConfigError(
                f"calibration {name} cannot be used by this bench: {why}",
                hint="pdcd calibrate list says which ones fit",
            )
        name = found.name
        pin(config, name)
    if as_json:
        say_json({"use": name, "rig": config.rig.name, "typed": typed})
        return DONE
    if typed != "latest":
        say_text(f"written down; but the configuration says [calibration] use = {typed!r}, ")
        say_text("which goes first: remove that line")
        return DONE
    used, trouble = _choice(config)
    if used is None:
        say_text(trouble)
        return DONE
    folder = "no calibration" if used.folder is None else str(used.folder)
    say_text(f"in use: {folder}; a daemon that runs goes by it from its next start on")
    return DONE


def _forget(config: Config, name: str, *, yes: bool, as_json: bool) -> int:
    """Remove one for good, or the link to it."""
    at = place_of(config, name)
    what = "the link to" if at.is_symlink() else "for good"
    if not yes and not agreed(f"remove {what} calibration {name}?", silent=as_json):
        return DONE
    forget(config, at)
    if as_json:
        say_json({"forgotten": name})
    else:
        say(f"removed {at}")
    return DONE


def _choice(config: Config) -> tuple[Choice | None, str]:
    """What is used; or why nothing can be."""
    try:
        return choice(config), ""
    except ConfigError as err:
        return None, str(err)


def _steps(record: Calibration) -> str:
    """Each step with its verdict; of those that are not used, why."""
    words = [f"{name} (taken over)" for name in record.taken_over]
    for step in record.steps:
        if step.name != "meter":
            why = record.left_out.get(step.name)
            words.append(
                f"{step.name} {step.verdict}" + (f" ({why})" if why not in (None, "bad") else "")
            )
    if record.stopped is not None:
        words.append(f"stopped at {record.stopped.step}")
    elif record.state == "running":
        words.append("cut short")
    return ", ".join(words)


def _told(one: Candidate, *, in_use: bool) -> dict[str, object]:
    record = one.record
    return {
        "name": one.name,
        "folder": str(one.folder),
        "in_use": in_use,
        "fits": not one.why,
        "why_not": one.why or None,
        "ended_utc": None if record is None else record.finished_utc,
        "state": None if record is None else record.state or "done",
        "verdict": None if record is None else record.verdict,
        "steps": {} if record is None else {s.name: s.verdict for s in record.steps[1:]},
        "left_out": {} if record is None else record.left_out,
        "stopped": None if record is None else record.stopped,
    }
