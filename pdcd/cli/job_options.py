"""What can be typed behind the commands that ask a daemon of its jobs, and of the shell."""

from __future__ import annotations

import argparse
from pathlib import Path

from pdcd.cli.commands import Add
from pdcd.cli.options import client_options, rig_options


def add_job_commands(add: Add) -> None:
    """Add what asks a daemon of its jobs."""
    add("status", "jobs:status", "say what the daemon is doing", client_options)
    add("watch", "jobs:watch", "follow a job to its end, or all jobs until interrupted", _job)
    add("cancel", "jobs:cancel", "end a job: the one named, else the running one", _job)
    add("list", "jobs:list_jobs", "list jobs, and the runs that the daemon has on disk", _list)
    add("wait", "capture:wait", "wait for a job and report it as capture does", _wait)
    add("web", "web:web", "serve a page for the person at the bench, to this machine alone", _web)


def add_shell_commands(add: Add) -> None:
    """Add what tells of the program itself."""
    add("version", "tools:version", "print the version", _nothing)
    add("completion", "completion:completion", "print a script that completes commands", _shell)
    add("man", "manual:man", "print the manual page", _nothing)


def _job(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("job", nargs="?", metavar="JOB")
    client_options(parser)


def _wait(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("job", metavar="JOB")
    client_options(parser)


def _list(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--newest",
        type=int,
        default=50,
        metavar="N",
        help="runs on disk to list, unfinished ones too; 0 to 1000, default: 50",
    )
    client_options(parser)


def _web(parser: argparse.ArgumentParser) -> None:
    rig_options(parser, socket="where the daemon listens")
    parser.add_argument(
        "--state-dir", type=Path, metavar="DIR", help="where the daemon keeps its runs"
    )
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="of the loopback interface; default: 127.0.0.1",
    )
    parser.add_argument(
        "--port", type=int, default=8137, metavar="N", help="default: 8137; 0 takes a free one"
    )


def _shell(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shell", choices=("bash", "zsh", "fish"))
    parser.description = (
        "Print a script by which a shell completes commands, options and files. For bash into "
        "~/.local/share/bash-completion/completions/pdcd, for zsh into _pdcd in a folder of "
        "$fpath, for fish into ~/.config/fish/completions/pdcd.fish."
    )


def _nothing(parser: argparse.ArgumentParser) -> None:
    """The command takes no options."""
