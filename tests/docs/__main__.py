"""Entry point: ``python -m tests.docs [--only oldest|newest] [--page README.md] [--whole]``.

In a bare Debian with the oldest Python that serves, and in one with the newest that can be had:
every block of README and tour in order, as their reader would type it, the tutorial, and how to
install. What they print is held against what the pages show. The tree is that of the last commit.
`make test`, which the README begins with, is run whole by the newest Python; by the oldest, by
which the tests are run outside, a part of it, unless it is to be the `whole`.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, replace

from tests.docs.bare import (
    NEWEST,
    OLDEST,
    BareRoot,
    Done,
    NoRootError,
    Release,
    end_all,
    say_why_not,
    unpacked,
)
from tests.docs.blocks import Block, read_blocks
from tests.docs.notebook import PAGE, run_tutorial
from tests.docs.typing_in import LIMIT_S, Told, run_block
from tests.places import ROOT

RELEASES = {"oldest": OLDEST, "newest": NEWEST}
PAGES = ("README.md", "docs/tour.md", PAGE, "docs/install.md")
_TAIL_LINES = 80
_lock = threading.Lock()


@dataclass
class Tally:
    """How the blocks of one root came out."""

    passed: int = 0
    failed: int = 0
    not_run: list[str] = field(default_factory=list)
    shorter: list[str] = field(default_factory=list)


def main() -> int:
    """0 where all held, and where nothing can be tried, unless in continuous integration."""
    parser = argparse.ArgumentParser(prog="python -m tests.docs", description=__doc__)
    parser.add_argument("--only", choices=RELEASES, help="in this root alone")
    parser.add_argument("--page", choices=PAGES, help="this page alone, behind .ci/setup dev")
    parser.add_argument("--whole", action="store_true", help="all of make test in both roots")
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    if why := say_why_not():
        return _give_up(why)
    releases = [RELEASES[args.only]] if args.only else list(RELEASES.values())
    releases = [replace(one, tests="") if args.whole else one for one in releases]
    pages = [args.page] if args.page else list(PAGES)
    tallies = [Tally() for _ in releases]
    try:
        _try_all(releases, tallies, pages)
    except NoRootError as err:
        return _give_up(str(err))
    return _sum_up(tallies)


def _try_all(releases: list[Release], tallies: list[Tally], pages: list[str]) -> None:
    """Side by side. Whatever ends one ends all."""
    with ThreadPoolExecutor(len(releases)) as pool:
        pairs = zip(releases, tallies, strict=True)
        begun = [pool.submit(_try_out, *pair, pages) for pair in pairs]
        try:
            for one in as_completed(begun):
                one.result()
        except BaseException:
            end_all()
            raise


def _give_up(why: str) -> int:
    """Say that nothing was tried; in continuous integration that is a failure."""
    sys.stdout.write(f"the docs are not tried in a bare root: {why}\n")
    sys.stdout.write("0 passed, 0 failed, 1 skipped\n")
    return 1 if os.environ.get("CI") else 0


def _sum_up(tallies: list[Tally]) -> int:
    for name, title in (("shorter", "run shorter"), ("not_run", "not run")):
        for line in sorted({line for tally in tallies for line in getattr(tally, name)}):
            sys.stdout.write(f"{title}: {line}\n")
    passed, failed = (sum(getattr(t, name) for t in tallies) for name in ("passed", "failed"))
    skipped = sum(len(tally.not_run) for tally in tallies)
    sys.stdout.write(f"{passed} passed, {failed} failed, {skipped} skipped\n")
    return 1 if failed or not passed else 0


def _try_out(release: Release, tally: Tally, pages: list[str]) -> None:
    began_s = time.monotonic()
    with unpacked(release) as root:
        _say(release, f"{time.monotonic() - began_s:6.1f} s  a bare root is there")
        if pages != list(PAGES):
            root.run(".ci/setup dev", limit_s=LIMIT_S)
        if release.tests:
            tally.shorter.append(f"make test by {release.title}: {release.tests}")
        for page in pages:
            steps = _run_cells(root) if page == PAGE else _run_page(root, page, tally)
            for place, what, done, wrong in steps:
                _enter(release, tally, place, what, done, wrong)
    _say(release, f"{time.monotonic() - began_s:6.1f} s  in all")


_Step = tuple[str, str, Done | None, str]


def _run_page(root: BareRoot, page: str, tally: Tally) -> Iterator[_Step]:
    told = Told({})
    for block in read_blocks(page, (ROOT / page).read_text(encoding="utf-8")):
        verb, _, why = block.mark.partition(": ")
        if verb == "not run":
            tally.not_run.append(f"{block.place} ({_first_line(block)}): {why}")
            continue
        if verb.startswith("as "):
            tally.shorter.append(f"{block.place} ({_first_line(block)}) {verb}: {why}")
        yield block.place, _first_line(block), *run_block(block, root, told)


def _run_cells(root: BareRoot) -> Iterator[_Step]:
    done, cells = run_tutorial(root, LIMIT_S)
    yield PAGE, "all cells", done, f"ended with {done.code}" if done.code else ""
    for number, wrong in cells:
        yield f"{PAGE} [{number}]", "", None, wrong


def _enter(
    release: Release, tally: Tally, place: str, what: str, done: Done | None, wrong: str
) -> None:
    took = f"{done.wall_s:6.1f} s" if done else "        "
    _say(release, f"{took}  {'FAILED' if wrong else 'ok'}  {place}  {what}")
    if wrong:
        tally.failed += 1
        tail = done.said.splitlines()[-_TAIL_LINES:] if done else []
        _say(release, "\n".join([f"  {wrong}", *(f"  | {line}" for line in tail)]))
    else:
        tally.passed += 1


def _first_line(block: Block) -> str:
    return block.text.partition("\n")[0] or block.mark


def _say(release: Release, text: str) -> None:
    with _lock:
        for line in text.splitlines():
            sys.stdout.write(f"[{release.title}] {line}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
