"""`pdcd drivers`, `config`, `decode`, `virtual-camera`: commands that need no daemon."""

from __future__ import annotations

import argparse
import json

from pdcd.api.progress import show_bar, watch_decoding
from pdcd.bench.config import (
    find_config_file,
    format_config,
    load_config,
    make_config_schema,
    read_config,
)
from pdcd.bench.measured import apply_calibration, choose_calibration
from pdcd.bench.origins import describe_calibration_age, trace_origins
from pdcd.bench.placed import describe_oblong_cells
from pdcd.bench.reading import make_faults_error
from pdcd.bench.tables import Config
from pdcd.cli.exits import DONE, FAILED
from pdcd.cli.output import say, say_comparison, say_json, say_table, say_text
from pdcd.errors import ConfigError
from pdcd.files.system import require_linux
from pdcd.watch import Watch


def print_drivers(args: argparse.Namespace) -> int:
    """Print every known driver, where it comes from, and why it is unavailable if so."""
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


def examine_config(args: argparse.Namespace) -> int:
    """Check the configuration without a device, or print it in full, or its JSON Schema."""
    if args.action == "schema":
        _say_all(json.dumps(make_config_schema(), indent=2))
        return DONE
    if args.action == "show":
        return _show(args)
    from pdcd.capture.check import try_config

    source = find_config_file(args.config)
    settings, faults = (Config(), []) if source is None else read_config(source)
    lines = [fault.message for fault in faults]
    lines += try_config(settings, [key for fault in faults for key in fault.keys])
    if lines:
        raise make_faults_error(source, lines)
    say(f"sound: {source}" if source else "sound: no file, the mock bench")
    if settings.scene.kind != "matrix" and (
        oblong := describe_oblong_cells(settings, settings.code_grid())
    ):
        say_text(f"warning: {oblong}")
    _say_calibration(settings)
    return DONE


def _say_calibration(settings: Config) -> None:
    """Print which calibration would be used, and which are passed over. Raises ConfigError if one
    was named that cannot be used."""
    found = choose_calibration(settings)
    if found.folder is not None or found.passed:
        say(f"calibration: {describe_calibration_age(settings) or 'none'}")
    for text in found.passed:
        say_text(f"passed over: {text}")


def _show(args: argparse.Namespace) -> int:
    """Print the configuration as it is used, and where each of its values comes from."""
    source, settings = find_config_file(args.config), load_config(args.config)
    notes = {tuple(o.key.split(".")): o.words for o in trace_origins(source, settings)}
    age = describe_calibration_age(settings)
    if age is not None:
        notes[("calibration",)] = age
        notes["calibration", "typed"] = "in whose place stand measured values"
    _say_all(format_config(apply_calibration(settings), notes).rstrip())
    return DONE


def decode(args: argparse.Namespace) -> int:
    """Decode a run again; fails when a picture differs from the one kept."""
    from pdcd.pictures.decode import decode_folder

    if args.out is not None and not args.partial:
        raise ConfigError("--out goes with --partial: a finished run is only compared")
    with show_bar("reading") as show:
        watch = watch_decoding(show)
        if args.partial:
            require_linux("decode --partial")
            return _salvage(args, watch)
        report = decode_folder(args.folder, watch)
    files = ((file.name, file.identical) for file in report.files)
    return say_comparison(report, files, as_json=args.json)


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


_MOST_PORT = 65535


def run_virtual_camera(args: argparse.Namespace) -> int:
    """Serve the virtual camera until interrupted. Raises ConfigError for a port out of range."""
    if not 0 <= args.port <= _MOST_PORT:
        raise ConfigError(f"--port {args.port} is not between 0 and {_MOST_PORT}")
    from pdcd.bench.registry import import_driver_module

    # By name, as drivers are loaded: pdcd imports none of them.
    command = import_driver_module("virtual_camera.command")
    try:
        command.serve_virtual_camera(args.port, scene=args.scene, small=args.small, say=say)
    except KeyboardInterrupt:
        return DONE  # that is how it ends
    return DONE
