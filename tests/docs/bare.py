"""A bare Debian: Python with pip, make, and nothing else. Who works in it is a user, not root.

It is made by debootstrap once in two weeks, and kept as an archive among the user's caches. Each
run unpacks one into a folder of its own, which goes with it. Commands run by systemd-nspawn: what
they mount, start and leave running ends with them. The settings by which this machine reaches
registries (proxies, certificates, configuration of pip) hold inside, too, and the files that they
name are there.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from tests.places import ROOT
from tests.tools import missing, program, say_why_no_container

HOME = "/home/reader"
TREE = f"{HOME}/pdcd"
_MIRROR = "http://deb.debian.org/debian"
_PATH = f"{HOME}/.local/bin:/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin"
_KEPT_S = 14 * 86400.0
_MAKING_S = 1500.0
_MEMORY, _LEAST_FREE_BYTES = "/dev/shm", 8 << 30
_NOISE = re.compile(r"Attempted to remove disk file system|Container \S+ terminated by signal KILL")
"""What nspawn says where /run is no memory file system, and where it ended what still ran."""
_CODE = "=== ended with "
_SCRIPT = f"exec 2>&1\ntrap 'echo \"{_CODE}$?\"' EXIT\n{{}}"
_HANDED = re.compile(
    r"(?i)((https?|ftp|all|no)_proxy|pip_\w+|ssl_cert_(file|dir)|requests_ca_bundle|curl_ca_bundle)"
)
_OWN_PIP_FILE = "/etc/pip-of-user.conf"
_PIP_FILES = ("/etc/pip.conf", "/etc/xdg/pip", "/etc/ssl/certs/ca-certificates.crt")


_running: set[subprocess.Popen[bytes]] = set()
_over = threading.Event()


@dataclass(frozen=True)
class Release:
    """A release of Debian, the script by which debootstrap makes it, and the Python to take."""

    suite: str
    script: str
    python: str
    extra: tuple[str, ...] = ()
    tests: str = ""
    """What `make test` runs of the tests in it; all of them where it is empty."""

    @property
    def title(self) -> str:
        """For people."""
        return f"{self.suite}, {self.python}"


OLDEST = Release("bookworm", "bookworm", "python3", tests="tests/unit/cli tests/e2e/cli")
NEWEST = Release("testing", "sid", "python3.15", ("python3.15",))
"""The newest Python that Debian has."""


class NoRootError(Exception):
    """There can be none here, and why."""


def say_why_not() -> str:
    """Why no bare root can be had on this machine; "" where one can."""
    return say_why_no_container() or missing("debootstrap", "systemd-nspawn", "unshare", "setpriv")


@dataclass(frozen=True)
class Done:
    """How a script in there ended, all that it said, and how long it took."""

    code: int
    said: str
    wall_s: float


class BareRoot:
    """One of them, unpacked, with the tree in the home of its user."""

    def __init__(self, release: Release, folder: Path) -> None:
        self.release, self.folder = release, folder
        self._binds, self._settings = _list_settings()

    @property
    def tree(self) -> Path:
        """The checkout in it, from out here."""
        return self.folder / TREE[1:]

    def run(self, script: str, *, limit_s: float, network: bool = True, root: bool = False) -> Done:
        """Have bash run a script in the tree; past the limit all of it is killed, code 124."""
        words = [program("setpriv"), "--pdeathsig", "TERM", program("systemd-nspawn"), "-q", "-D"]
        words += [str(self.folder), "--pipe", "--as-pid2", "--register=no", "--keep-unit"]
        words += ["--link-journal=no", "--timezone=off", f"--machine=pdcd-{os.urandom(4).hex()}"]
        words += ["--resolv-conf=copy-host"] if network else ["--private-network"]
        words += [] if root else ["--user=reader"]
        inside = {"HOME": HOME, "USER": "reader", "LANG": "C.UTF-8", "PATH": _PATH}
        inside |= {"PYTHON": self.release.python, "PYTEST_ADDOPTS": self.release.tests}
        settings = [f"{key}={value}" for key, value in (self._settings | inside).items()]
        words += ["--chdir=/"] if root else [*self._binds, f"--chdir={TREE}"]
        words += ["/usr/bin/env", "-i", *settings]
        began_s = time.monotonic()
        with (
            tempfile.TemporaryFile() as said,
            subprocess.Popen(
                [*words, "/bin/bash", "-c", _SCRIPT.format(script)],
                stdin=subprocess.DEVNULL, stdout=said, stderr=said,
            ) as process,
        ):  # fmt: skip
            code = _wait(process, limit_s)
            said.seek(0)
            lines = said.read().decode(errors="replace").splitlines()
        text = "\n".join(line for line in lines if not _NOISE.match(line))
        if ended := re.fullmatch(rf"(.*){_CODE}(\d+)\s*", text, re.DOTALL):
            text, code = ended[1], int(ended[2])
        return Done(code, text, time.monotonic() - began_s)


def end_all() -> None:
    """End what runs in any root of this process; nothing more is run."""
    _over.set()
    for process in list(_running):
        process.terminate()


@contextmanager
def unpacked(release: Release) -> Iterator[BareRoot]:
    """A bare root with a user and the tree as it was committed last; it goes on leaving.

    Raises NoRootError where debootstrap cannot make one.
    """
    archive = _find_archive(release)
    folder = Path(tempfile.mkdtemp(prefix="pdcd-bare-", dir=_choose_disk()))
    try:
        folder.chmod(0o755)
        _call("tar", "-x", "--numeric-owner", "-f", str(archive), "-C", str(folder))
        root = BareRoot(release, folder)
        words = [program("git"), "-C", str(ROOT), "archive", "HEAD"]
        tree = subprocess.run(words, stdout=subprocess.PIPE, check=True).stdout
        made = root.run(f"useradd --create-home reader && install -d {TREE}", limit_s=60, root=True)
        if made.code:
            raise NoRootError(made.said)
        words = ["tar", "-x", "-C", str(root.tree)]
        subprocess.run(words, input=tree, check=True)
        made = root.run(f"chown -R reader: {HOME}", limit_s=60, root=True)
        if made.code:
            raise NoRootError(made.said)
        yield root
    finally:
        shutil.rmtree(folder)


def _find_archive(release: Release) -> Path:
    """The archive of a release, made anew where there is none or an old one."""
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "pdcd-tests"
    caches.mkdir(parents=True, exist_ok=True)
    archive = caches / f"{'-'.join((release.suite, *release.extra))}.tar"
    with suppress(FileNotFoundError):
        if time.time() - archive.stat().st_mtime < _KEPT_S:
            return archive
    with tempfile.TemporaryDirectory(prefix="pdcd-bare-", dir=_choose_disk()) as folder:
        include = ",".join(("python3", "python3-pip", "make", *release.extra))
        words = [program("debootstrap"), "--variant=minbase", f"--include={include}"]
        words += [release.suite, f"{folder}/root", _find_mirror(), release.script]
        # What it mounts is seen by it alone, and ends with it.
        _call(program("unshare"), "--mount", "--", *words)
        fresh = archive.with_suffix(".partial")
        _call("tar", "-c", "--numeric-owner", "--exclude=./var/cache/apt/archives/*.deb",
              "-f", str(fresh), "-C", f"{folder}/root", ".")  # fmt: skip
        fresh.replace(archive)
    return archive


def _choose_disk() -> str:
    """Where there is room for one, devices and programs: in memory, as thousands of files would
    wait to be on a disk, or on a disk."""
    with suppress(OSError):
        said = os.statvfs(_MEMORY)
        roomy = said.f_bavail * said.f_frsize >= _LEAST_FREE_BYTES
        if roomy and not said.f_flag & (os.ST_NOEXEC | os.ST_NODEV):
            return _MEMORY
    return "/var/tmp"


def _call(*words: str) -> None:
    """Raises NoRootError with the last line that was printed."""
    with (
        tempfile.TemporaryFile() as said,
        subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=said, stderr=said) as process,
    ):
        code = _wait(process, _MAKING_S)
        said.seek(0)
        lines = said.read().decode(errors="replace").strip().splitlines() or ["nothing said"]
    if code:
        raise NoRootError(f"{Path(words[0]).name} ended with {code}: {lines[-1]}")


def _wait(process: subprocess.Popen[bytes], limit_s: float) -> int:
    """Its exit code; that of `timeout` where it took too long and was ended. nspawn then kills what
    runs in its root."""
    _running.add(process)
    try:
        if _over.is_set():
            process.terminate()
        return process.wait(limit_s)
    except subprocess.TimeoutExpired:
        process.terminate()
        process.wait()
        return 124
    finally:
        _running.discard(process)
        if _over.is_set():
            raise NoRootError("ended from outside")


def _find_mirror() -> str:
    """Where this machine's apt gets Debian from."""
    with suppress(OSError):
        words = ["apt-get", "indextargets", "--format", "$(REPO_URI)"]
        listed = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=False).stdout
        for address in listed.split():
            if re.search(r"/debian/?$", address):
                return address
    return _MIRROR


def _list_settings() -> tuple[list[str], dict[str, str]]:
    """Options of nspawn that bring in the files, and the variables."""
    settings = {key: value for key, value in os.environ.items() if _HANDED.fullmatch(key)}
    texts, binds = list(settings.values()), list[str]()
    files = {name for name in _PIP_FILES if Path(name).exists()}
    for own in (Path.home() / ".config/pip/pip.conf", Path.home() / ".pip/pip.conf"):
        if own.is_file():
            settings.setdefault("PIP_CONFIG_FILE", _OWN_PIP_FILE)
            binds.append(f"--bind-ro={own}:{_OWN_PIP_FILE}")
            texts.append(own.read_text())
    for name in map(Path, files):
        read = [file for file in (name, *name.glob("*.conf")) if file.suffix == ".conf"]
        texts += [file.read_text() for file in read]
    for scheme, named in re.findall(r"(^|[\s=]|file://)(/[\w./+-]+)", "\n".join(texts)):
        if Path(named).exists():  # an index leads to files beside it
            files.add(str(Path(named).parent) if scheme == "file://" else named)
    return [*binds, *(f"--bind-ro={name}" for name in sorted(files))], settings
