"""Take all cases, in two processes, each case in a scratch folder of its own."""

from __future__ import annotations

import fnmatch
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from tests.goldens.case import Bench, UnavailableError
from tests.goldens.cases import all_cases
from tests.goldens.masks import Masks
from tests.goldens.program import case_environment, own_environment

TREE = Path(__file__).resolve().parents[2]
PROCESSES = 2


@dataclass(frozen=True)
class Taken:
    """How a case ended. seconds : of a processor. wrong : the trace of what went wrong; missing :
    what this machine lacks."""

    name: str
    seconds: float
    wrong: str = ""
    missing: str = ""


def take(folder: Path, only: Sequence[str] = ()) -> bool:
    """Take all cases, or those whose names match one of `only`, into a folder; whether all could
    be taken. Goldens of the same cases that are there are replaced."""
    wanted = [case for case in all_cases() if not only or _matches(case.name, only)]
    wanted.sort(key=lambda case: -case.weight)
    folder.mkdir(parents=True, exist_ok=True)
    begun_s = time.monotonic()
    scratch = Path(tempfile.mkdtemp(prefix="pg-", dir="/tmp"))
    try:
        found = _take_all([case.name for case in wanted], scratch, folder.absolute())
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return _tell(found, time.monotonic() - begun_s)


def _take_all(names: Sequence[str], scratch: Path, folder: Path) -> list[Taken]:
    """In a pool whose processes have an environment of their own."""
    for name in ("home", "tmp"):
        (scratch / name).mkdir()
    before, own = dict(os.environ), own_environment(scratch, TREE)
    os.environ.clear()
    os.environ.update(own)
    try:
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(PROCESSES, mp_context=context) as pool:
            jobs = [
                pool.submit(take_one, name, scratch / str(number), folder / name, scratch)
                for number, name in enumerate(names)
            ]
            found = []
            for job in as_completed(jobs):
                found.append(job.result())
                _say(found[-1], len(found), len(names))
            return found
    finally:
        os.environ.clear()
        os.environ.update(before)


def take_one(name: str, scratch: Path, out: Path, root: Path) -> Taken:
    """Take one case in this process."""
    (case,) = (one for one in all_cases() if one.name == name)
    for made in (scratch, scratch / "run"):
        made.mkdir(mode=0o700)
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    os.environ.update(case_environment(scratch))
    os.chdir(scratch)
    bench = Bench(scratch, out, Masks({scratch: "<scratch>", root: "<root>", TREE: "<tree>"}))
    begun_s = _processor_s()
    wrong = missing = ""
    try:
        case.take(bench)
        bench.end()
    except UnavailableError as err:
        missing = str(err)
        shutil.rmtree(out)
    except Exception:
        wrong = traceback.format_exc()
        shutil.rmtree(out)
    os.chdir(root)
    shutil.rmtree(scratch, ignore_errors=True)
    return Taken(name, _processor_s() - begun_s, wrong, missing)


def _processor_s() -> float:
    """Time of a processor that this process and those it started and that ended have had."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _matches(name: str, only: Sequence[str]) -> bool:
    return any(fnmatch.fnmatchcase(name, one) or name.startswith(one + "/") for one in only)


def _say(taken: Taken, done: int, count: int) -> None:
    end = "FAILED" if taken.wrong else "not here" if taken.missing else "taken"
    sys.stdout.write(f"{done:4d}/{count} {taken.name:44} {taken.seconds:6.1f} s  {end}\n")
    sys.stdout.flush()


def _tell(found: Sequence[Taken], wall_s: float) -> bool:
    for taken in found:
        if taken.wrong:
            sys.stdout.write(f"\n{taken.name}\n{taken.wrong}")
    for taken in found:
        if taken.missing:
            sys.stdout.write(f"not covered here: {taken.name}: {taken.missing}\n")
    failed = sum(bool(taken.wrong) for taken in found)
    spent_s = sum(taken.seconds for taken in found)
    sys.stdout.write(
        f"{len(found) - failed} of {len(found)} cases in {wall_s:.0f} s, "
        f"{spent_s:.0f} s of processors\n"
    )
    return not failed
