"""Entry point: ``python -m tests.goldens``.

::

    python -m tests.goldens list
    python -m tests.goldens take FOLDER [--only NAME ...]
    python -m tests.goldens compare BEFORE AFTER [--no-words]
    python -m tests.goldens base REV [--only NAME ...]       what `make goldens` calls
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path


def main() -> int:
    """Take, or compare; 1 where a case failed or something differs."""
    parser = argparse.ArgumentParser(prog="python -m tests.goldens", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="names of all cases")
    taking = commands.add_parser("take", help="have this tree take its goldens")
    taking.add_argument("folder", type=Path)
    comparing = commands.add_parser("compare", help="list what differs between two folders")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    based = commands.add_parser("base", help="compare this tree with a commit")
    based.add_argument("rev")
    based.add_argument("--keep", type=Path, help="folder that the goldens stay in")
    for one in (taking, based):
        one.add_argument("--only", nargs="*", default=[], metavar="NAME", help="pattern or room")
    for one in (comparing, based):
        one.add_argument("--no-words", action="store_true", help="sentences may differ")
    args = parser.parse_args()
    return _run(args)


def _run(args: argparse.Namespace) -> int:
    if args.command == "list":
        from tests.goldens.cases import all_cases

        sys.stdout.write("".join(f"{case.name}\n" for case in all_cases()))
        return 0
    if args.command == "take":
        from tests.goldens.taking import take

        return 0 if take(args.folder, args.only) else 1
    if args.command == "compare":
        from tests.goldens.comparing import compare

        return 0 if compare(args.before, args.after, words=not args.no_words) else 1
    from tests.goldens.base import compare_with

    alike = compare_with(args.rev, args.only, args.keep, words=not args.no_words)
    return 0 if alike else 1


if __name__ == "__main__":
    sys.exit(main())
