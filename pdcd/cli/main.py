"""The command line: `pdcd COMMAND ...`. Results go to stdout, progress and errors to stderr.

Nothing but the parser is imported until a command runs, so that `pdcd --help` answers at once.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import os
import sys
from collections.abc import Callable, Sequence

from pdcd.cli.exits import CANCELLED, FAILED, UNREACHABLE, exit_code_of
from pdcd.cli.parser import build_parser
from pdcd.cli.streams import (
    open_missing_streams,
    replace_broken_streams,
    write_stdout,
)
from pdcd.errors import PdcdError, to_error_fields, to_typed_error
from pdcd.files.system import require_linux
from pdcd.printable import to_indented_lines, write_stderr

_JOBS = ("capture", "transport", "calibrate")
"""Commands that run one job, and print how it ended."""
_READERS = (
    "runs", "decode", "verify", "export", "report", "row", "snr", "version", "completion", "man",
)  # fmt: skip
"""Commands that need no bench, and therefore no Linux."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return the exit code (see `pdcd.cli.exits`).

    Wrong usage ends in SystemExit(2), as argparse does it.
    """
    open_missing_streams()
    typed = sys.argv[1:] if argv is None else argv
    _keep_others_out()
    try:
        return _run(build_parser(typed).parse_args(typed))
    except BrokenPipeError:
        return FAILED  # the reader of our output is gone
    finally:
        replace_broken_streams()


def _run(args: argparse.Namespace) -> int:
    try:
        if args.command not in _READERS:
            require_linux(f"pdcd {args.command}")
        code = _command(args)(args)
        write_stdout("")
        return code
    except ModuleNotFoundError as err:
        from pdcd.extras import explain_missing

        missing = explain_missing(err)
        if missing is None:
            raise
        return _fail(args, exit_code_of(missing.kind), str(missing), missing.kind, missing)
    except PdcdError as err:
        return _fail(args, exit_code_of(err.kind), str(err), err.kind, err)
    except KeyboardInterrupt:
        return _fail(args, CANCELLED, "interrupted", "cancelled")
    except SystemExit as err:  # from a driver, or from what it loads
        said = f"a driver, or one of its libraries, ended the program: SystemExit {err.code!r:.200}"
        return _fail(args, FAILED, said, PdcdError.kind)
    except BrokenPipeError:
        raise
    except ConnectionError as err:  # the client's Unreachable, which is not imported here
        return _fail(args, UNREACHABLE, str(err), "unreachable")
    except OSError as err:
        typed = to_typed_error(err)
        if typed.kind == PdcdError.kind:
            return _fail(args, FAILED, str(err), typed.kind)
        return _fail(args, exit_code_of(typed.kind), str(typed), typed.kind, typed)


def _keep_others_out() -> None:
    """If the umask lets everybody write to files of this process, let only the user write. A umask
    that lets only the group write is left as it is."""
    mask = os.umask(0o077)
    os.umask(mask if mask & 0o002 else mask | 0o022)


def _command(args: argparse.Namespace) -> Callable[[argparse.Namespace], int]:
    """Import the function that the parser names as "module:function"."""
    module, _, function = args.run.partition(":")
    found: Callable[[argparse.Namespace], int] = getattr(
        importlib.import_module(f"pdcd.cli.{module}"), function
    )
    return found


def _fail(
    args: argparse.Namespace, code: int, text: str, kind: str, error: PdcdError | None = None
) -> int:
    """Print an error on stderr and, for scripts that asked for JSON, on stdout."""
    if args.json:
        told: dict[str, object] = {}
        if args.command in _JOBS:  # the last line of every job has these three
            told = {"job": None, "state": "failed", "folder": None}
            if code == CANCELLED:
                told["state"] = "cancelled"
        from pdcd.files.text import encode_json  # nothing but the parser is imported before

        told["error"] = {**to_error_fields(error or PdcdError(text)), "kind": kind}
        with contextlib.suppress(PdcdError, BrokenPipeError):  # stdout itself may be broken
            write_stdout(encode_json(told).decode() + "\n")
    if kind == "request":
        from pdcd.cli.request import name_options

        text = name_options(text)
    write_stderr(f"pdcd: {to_indented_lines(text)}\n")
    return code
