"""`pdcd drivers`, `config`, `decode`, `virtual-camera`: what needs no daemon."""

from __future__ import annotations

import argparse
import json

from pdcd.api.progress import bar
from pdcd.bench.config import find, load, read, schema, show
from pdcd.bench.measured import calibrated, choice
from pdcd.bench.origins import age_words, origins
from pdcd.bench.reading import faults_error
from pdcd.bench.tables import Config
from pdcd.cli.exits import DONE, FAILED
from pdcd.cli.output import say, say_compared, say_json, say_table, say_text
from pdcd.errors import ConfigError
from pdcd.protocol.events import Decoded
from pdcd.watch import Watch


def drivers(args: argparse.Namespace) -> int:
    """Print every known driver, where it comes from and why it may be unavailable."""
    from pdcd.bench.registry import describe_drivers

    found = describe_drivers()
    if args.json:
        say_json(found)
        return DONE
    rows = [["role", "name", "maturity", "from", "state"]]
    for d in found:
        state = "available" if d["available"] else f"unavailable: {d['reason']}"
        rows.append([str(d["role"]), str(d["name"]), str(d["maturity"] or "?")])
        rows[-1] += [str(d["origin"]), state]
    say_table(rows)
    return DONE


def config(args: argparse.Namespace) -> int:
    """Try the configuration without a device, or print it in full, or its JSON Schema."""
    if args.action == "schema":
        _say_all(json.dumps(schema(), indent=2))
        return DONE
    if args.action == "show":
        return _show(args)
    from pdcd.capture.check import faults_in

    source = find(args.config)
    settings, faults = (Config(), []) if source is None else read(source)
    lines = [fault.message for fault in faults]
    lines += faults_in(settings, [key for fault in faults for key in fault.keys])
    if lines:
        raise faults_error(source, lines)
    say(f"sound: {source}" if source else "sound: no file, the mock bench")
    _say_calibration(settings)
    return DONE


def _say_calibration(settings: Config) -> None:
    """Print which calibration would be used, and all that are passed over. Raises ConfigError for
    one that was named and cannot be used."""
    found = choice(settings)
    if found.folder is not None or found.passed:
        say(f"calibration: {age_words(settings) or 'none'}")
    for text in found.passed:
        say_text(f"passed over: {text}")


def _show(args: argparse.Namespace) -> int:
    """Print the configuration as it is used, and where each of its values comes from."""
    source, settings = find(args.config), load(args.config)
    notes = {tuple(o.key.split(".")): o.words for o in origins(source, settings)}
    age = age_words(settings)
    if age is not None:
        notes[("calibration",)] = age
        notes["calibration", "typed"] = "in whose place stand measured values"
    _say_all(show(calibrated(settings), notes).rstrip())
    return DONE


def decode(args: argparse.Namespace) -> int:
    """Decode a run again; fails when a picture differs from the one kept."""
    from pdcd.pictures.decode import decode_folder

    if args.out is not None and not args.partial:
        raise ConfigError("--out goes with --partial: a finished run is only compared")
    with bar("reading") as show:
        watch = Watch(step=lambda done, total: show(Decoded(done=done, total=total)))
        if args.partial:
            return _salvage(args, watch)
        report = decode_folder(args.folder, watch)
    files = ((file.name, file.identical) for file in report.files)
    return say_compared(report, files, as_json=args.json)


def _salvage(args: argparse.Namespace, watch: Watch) -> int:
    """Make pictures of an unfinished run; fails when any of its shots is missing."""
    from pdcd.capture.salvage import decode_partial

    found = decode_partial(args.folder, args.out, watch)
    if args.json:
        say_json(found)
    else:
        say_table([["state", found.state], ["taken", found.taken], ["folder", found.folder]])
        for text in found.lost:
            say(f"left out: {text}")
    return DONE if found.state == "done" else FAILED


def _say_all(text: str) -> None:
    for line in text.split("\n"):
        say(line)


MOST_PORT = 65535


def virtual_camera(args: argparse.Namespace) -> int:
    """Serve the virtual camera until interrupted. Raises ConfigError for a port out of range."""
    if not 0 <= args.port <= MOST_PORT:
        raise ConfigError(f"--port {args.port} is not between 0 and {MOST_PORT}")
    from pdcd.bench.registry import own_module

    # By name, as it loads drivers: pdcd imports none of them.
    command = own_module("virtual_camera.command")
    try:
        command.serve(args.port, scene=args.scene, small=args.small, say=say)
    except KeyboardInterrupt:
        return DONE  # that is how it ends
    return DONE
