"""One holder at a time, whatever lies at the lock's name and however the last holder ended."""

from __future__ import annotations

import contextlib
import fcntl
import os
import signal
import socket
import subprocess
import sys
import threading
from collections import Counter
from pathlib import Path

import pytest

from pdcd.bench.tables import RoleConfig, ServerConfig
from pdcd.errors import ConfigError
from pdcd.server import listening
from pdcd.server.listening import open_listener
from pdcd.server.lock import hold_lock_file


def lock(path: Path) -> contextlib.AbstractContextManager[None]:
    return hold_lock_file(path, "the thing", "wait")


def test_the_second_is_told_who_has_it(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    with lock(path):
        wanted = f"the thing belongs to another daemon: process {os.getpid()} of uid {os.getuid()} "
        with pytest.raises(ConfigError, match=wanted), lock(path):
            pass
        assert path.stat().st_mode & 0o777 == 0o600
    assert not path.exists()
    with lock(path):
        pass


def test_what_a_killed_holder_left_is_no_lock(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    script = (
        "import sys; from pathlib import Path; from pdcd.server.lock import hold_lock_file\n"
        "with hold_lock_file(Path(sys.argv[1]), 'it', ''): print('held', flush=True);"
        " sys.stdin.read()"
    )
    words = [sys.executable, "-c", script, str(path)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        assert child.stdout is not None and child.stdout.readline() == b"held\n"
        with pytest.raises(ConfigError, match=f"process {child.pid} "), lock(path):
            pass
        child.send_signal(signal.SIGKILL)
    assert path.exists()
    with lock(path):
        assert path.read_text() == f"{os.getpid()} {os.getuid()}\n"


def test_a_name_that_was_removed_before_it_was_locked_is_no_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "lock"
    flock, calls = fcntl.flock, []

    def late(fd: int, how: int) -> None:
        calls.append(fd)
        if len(calls) == 1:
            path.unlink()  # as its last holder does when it ends
        flock(fd, how)

    monkeypatch.setattr(fcntl, "flock", late)
    with lock(path):
        assert path.exists()
        with pytest.raises(ConfigError, match="belongs to"), lock(path):
            pass


@pytest.mark.parametrize("text", ["", "x", "1 2 3", "\x1b[2J \n", "\udcff" * 99])
def test_a_holder_who_wrote_nonsense_is_named_as_far_as_can_be(tmp_path: Path, text: str) -> None:
    path = tmp_path / "lock"
    with lock(path):
        path.write_bytes(text.encode(errors="surrogateescape"))
        with pytest.raises(ConfigError, match="belongs to another daemon") as caught, lock(path):
            pass
        assert caught.value.message.isprintable()


def test_what_is_no_file_is_refused_and_left_alone(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.write_text("data")
    (tmp_path / "link").symlink_to(precious)
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "folder").mkdir()
    for name in ("link", "fifo", "folder", "missing/lock"):
        with pytest.raises(ConfigError, match=name), lock(tmp_path / name):
            pass
    assert precious.read_text() == "data"
    assert {path.name for path in tmp_path.iterdir()} == {"precious", "link", "fifo", "folder"}


def race(path: Path, config: ServerConfig, workers: int) -> Counter[str]:
    """Let so many claim a socket at once; those who get it keep it until all have tried."""
    start, tried = threading.Barrier(workers), threading.Barrier(workers)
    ends: list[str] = []

    def run() -> None:
        start.wait()
        with contextlib.ExitStack() as stack:
            try:
                sock = stack.enter_context(open_listener(path, config))
            except ConfigError as err:
                ends.append(err.message.split(":")[0])
                tried.wait()
                return
            tried.wait()
            with socket.socket(socket.AF_UNIX) as client:
                client.connect(str(path))
                sock.accept()[0].close()
            ends.append("served")

    threads = [threading.Thread(target=run) for _ in range(workers)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return Counter(ends)


def test_of_many_at_once_exactly_one_gets_the_socket(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "s"
    probe = listening._clear_stale

    def slowly(path: Path) -> None:
        probe(path)
        threading.Event().wait(0.002)  # as long as others need to find the same

    monkeypatch.setattr(listening, "_clear_stale", slowly)
    for _ in range(20):
        with socket.socket(socket.AF_UNIX) as stale:
            stale.bind(str(path))
        ends = race(path, ServerConfig(), 8)
        assert ends.pop("served") == 1
        assert sum(ends.values()) == 7 and set(ends) == {
            f"the socket {path} belongs to another daemon"
        }
        assert not list(tmp_path.iterdir())


def opened(passed: str) -> int:
    """A descriptor that a service manager should not have passed."""
    if passed == "file":
        return os.open("/etc/passwd", os.O_RDONLY)
    if passed == "pipe":
        reading, writing = os.pipe()
        os.close(writing)
        return reading
    if passed == "datagram":
        return socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM).detach()
    if passed == "internet":
        with socket.create_server(("127.0.0.1", 0)) as listener:
            return listener.detach()
    left, right = socket.socketpair()
    right.close()
    return left.detach()


@pytest.mark.parametrize("passed", ["file", "pipe", "datagram", "internet", "not listening"])
def test_what_was_passed_and_is_no_listening_socket_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, passed: str
) -> None:
    fd = opened(passed)
    monkeypatch.setattr(listening, "count_listen_fds", lambda: 1)
    monkeypatch.setattr(listening, "FIRST_FD", fd)
    with pytest.raises(ConfigError, match="passed") as caught:
        with open_listener(tmp_path / "s", ServerConfig()):
            pass
    assert "ListenStream" in str(caught.value.hint)
    os.close(fd)  # which was left open: it may be another's
    with pytest.raises(ConfigError, match="passed is no socket: Bad file descriptor"):
        with open_listener(tmp_path / "s", ServerConfig()):
            pass


@pytest.mark.parametrize(
    ("tables", "mode"),
    [
        (ServerConfig(), 0o660),
        (ServerConfig(allow_uids=(7,)), 0o666),
        (ServerConfig(look=RoleConfig(uids=(7,))), 0o666),
        (ServerConfig(administer=RoleConfig(groups=("x",))), 0o666),
    ],
)
def test_whoever_has_a_role_can_reach_the_socket(
    tmp_path: Path, tables: ServerConfig, mode: int
) -> None:
    path = tmp_path / "s"
    with open_listener(path, tables):
        assert path.stat().st_mode & 0o777 == mode
