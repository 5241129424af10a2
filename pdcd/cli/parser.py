"""What can be typed: all commands, without anything that is slow to import."""

from __future__ import annotations

import argparse

from pdcd.cli.bench_options import add_bench_commands
from pdcd.cli.commands import EXIT_CODES, commands_below
from pdcd.cli.job_options import add_job_commands, add_shell_commands
from pdcd.cli.photo_options import add_photo_commands
from pdcd.cli.run_options import add_run_commands
from pdcd.version import __version__


def build_parser() -> argparse.ArgumentParser:
    """Return the parser; it sets `run` to the "module:function" of the command."""
    parser = argparse.ArgumentParser(
        prog="pdcd",
        description="Photograph chosen light paths: a projector, an LCD mask and a camera.",
        epilog=EXIT_CODES,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"pdcd {__version__}")
    parser.set_defaults(json=False)
    add = commands_below(parser, dest="command", required=True, metavar="COMMAND")
    add_photo_commands(add)
    add_job_commands(add)
    add_bench_commands(add)
    add_run_commands(add)
    add_shell_commands(add)
    return parser
