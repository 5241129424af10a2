"""Runs tests in a copy of the tree that has its own interpreter's folder, within limits."""

from __future__ import annotations

import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

from tests.mutants.operators import Mutant
from tests.tools import program

MEMORY_BYTES = 8 << 30
"""Address space of a process of the tests."""

SLACK, SPARE_S = 4.0, 30.0
"""Tests may take that many times what they take on the sound tree, and that much more."""

FIRST_S = 600.0
"""Bound of a test file on the sound tree."""

MARK = "PDCD_MUTANT"
"""Variable that carries the copy's folder to every process of its tests."""


@dataclass(frozen=True)
class Answer:
    """What some tests said."""

    passed: bool
    seconds: float
    test: str = ""
    """The first that failed; '' when none did, or it hung."""
    hung: bool = False


@dataclass
class Bench:
    """A copy of the tree, outside of it; `close` removes it."""

    root: Path
    sound: dict[str, Answer]
    """Test files on the tree as it is, each run once; benches share it."""
    copy: Path = field(init=False)

    def __post_init__(self) -> None:
        # A short path: sockets below it have names of 107 bytes at most.
        self.copy = Path(tempfile.mkdtemp(prefix="pm"))
        self.copy.chmod(0o755)  # tests of what other users may read put their files below it
        listed = [program("git"), "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        names = subprocess.run(listed, cwd=self.root, capture_output=True, check=True).stdout
        for name in names.decode().split("\0"):
            if name and (self.root / name).is_file():
                (self.copy / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(self.root / name, self.copy / name)
        self._interpreter()
        # By its content, not its date: a changed file is compiled anew, and only that.
        words = [sys.executable, "-m", "compileall", "-q", "--invalidation-mode", "checked-hash"]
        subprocess.run([*words, "pdcd", "drivers", "tests"], cwd=self.copy, check=False)

    def _interpreter(self) -> None:
        """An environment whose `pdcd` is the copy's, for programs that tests start, too."""
        venv = self.copy / ".venv"
        subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(venv)], check=True)
        (packages,) = venv.glob("lib/python*/site-packages")
        (real,) = Path(sys.prefix).glob("lib/python*/site-packages")
        # The .pth files of a folder that is named by a .pth file are not read: pdcd is not there.
        (packages / "copy.pth").write_text(f"{self.copy}\n{real}\n", encoding="utf-8")
        for script in Path(sys.prefix, "bin").iterdir():
            head = f"#!{sys.prefix}/bin/python".encode()
            if script.is_file() and (text := script.read_bytes()).startswith(head):
                mine = venv / "bin" / script.name
                mine.write_bytes(text.replace(head, f"#!{venv}/bin/python".encode(), 1))
                mine.chmod(0o755)

    def close(self) -> None:
        """Remove the copy."""
        shutil.rmtree(self.copy, ignore_errors=True)

    def is_sound(self, file: str) -> bool:
        """Whether a test file passes without any change; measured once."""
        if file not in self.sound:
            self.sound[file] = self._run([file], FIRST_S)
        return self.sound[file].passed

    def noticed(self, mutant: Mutant, files: list[str]) -> str:
        """The test that notices a change, '' for none; unit tests are asked first.

        A test that fails is run again, as one may fail for the load of the machine alone.
        """
        place = self.copy / mutant.path
        kept = place.read_bytes()
        unit = [file for file in files if file.startswith("tests/unit/")]
        for stage in (unit, [file for file in files if file not in unit]):
            usable = [file for file in stage if self.is_sound(file)]
            if not usable:
                continue
            limit_s = SLACK * sum(self.sound[file].seconds for file in usable) + SPARE_S
            place.write_bytes(mutant.applied(kept))
            try:
                first = self._run(usable, limit_s)
                if first.hung:
                    return f"{usable[0]} or one of the next (time-out)"
                again = [first.test] if first.test else usable
                if not first.passed and not self._run(again, limit_s).passed:
                    return first.test or usable[0]
            finally:
                place.write_bytes(kept)
        return ""

    def _run(self, tests: list[str], limit_s: float) -> Answer:
        """Run test files, or single tests of them, up to the first failure."""
        files = self.copy / "t"
        shutil.rmtree(files, ignore_errors=True)
        # A path from outside would lead the programs that tests start to another tree.
        inherited = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        environ = {
            **inherited, "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1",
            "TMPDIR": str(self.copy), MARK: str(self.copy),
        }  # fmt: skip
        words = ["-m", "pytest", "-q", "-x", "-n", "0", "--tb=no", "-p", "no:cacheprovider"]
        command = [str(self.copy / ".venv/bin/python"), *words, f"--basetemp={files}", *tests]
        since_s = time.monotonic()
        said, hung = "", False
        with subprocess.Popen(
            command, cwd=self.copy, env=environ, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace",
            start_new_session=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES,) * 2),
        ) as process:  # fmt: skip
            try:
                said, _ = process.communicate(timeout=limit_s)
            except subprocess.TimeoutExpired:
                hung = True
            finally:
                self._end_all()
        failed = re.search(r"^(?:FAILED|ERROR) (\S+::.*?)(?: - |$)", said, re.MULTILINE)
        # 5: no test was left, as where all of a file are skipped by name.
        passed = not hung and process.returncode in (0, 5)
        test = failed.group(1) if failed and not passed else ""
        return Answer(passed, time.monotonic() - since_s, test, hung)

    def _end_all(self) -> None:
        """End what a run has left behind: the processes that carry this copy's mark."""
        mark = f"{MARK}={self.copy}".encode()
        for folder in Path("/proc").iterdir():
            if folder.name.isdigit():
                try:
                    if mark in (folder / "environ").read_bytes().split(b"\0"):
                        os.kill(int(folder.name), signal.SIGKILL)
                except OSError:
                    continue
