"""The listening socket: where it is made, with which rights, and what is left in its place."""

from __future__ import annotations

import contextlib
import os
import socket
from pathlib import Path

import pytest

from pdcd.bench.tables import ServerConfig
from pdcd.errors import ConfigError
from pdcd.server import listening
from pdcd.server.listening import open_listener


def test_a_socket_is_made_in_place_of_a_stale_one_and_removed_in_the_end(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX) as stale:
        stale.bind(str(path))
    umask = os.umask(0o027)
    try:
        with open_listener(path, ServerConfig()) as sock, socket.socket(socket.AF_UNIX) as client:
            assert path.stat().st_mode & 0o777 == 0o660
            client.connect(str(path))
            sock.accept()[0].close()
        assert os.umask(0o027) == 0o027  # as it was
    finally:
        os.umask(umask)
    assert not [*tmp_path.iterdir()] and "stale" in caplog.text


@pytest.mark.parametrize("what", ["gone", "another"])
def test_what_lies_at_its_name_in_the_end_is_not_ours(what: str, tmp_path: Path) -> None:
    path = tmp_path / "s"
    with open_listener(path, ServerConfig()):
        (tmp_path / "kept").touch()
        path.unlink()
        if what == "another":
            (tmp_path / "kept").rename(path)
    assert path.exists() == (what == "another")


def test_a_path_that_is_taken_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "s"
    path.write_text("precious")
    with pytest.raises(ConfigError, match="is there and is no socket") as caught:
        with open_listener(path, ServerConfig()):
            pass
    assert caught.value.hint == "remove it, or use another path"
    assert path.read_text() == "precious"
    path.unlink()
    with socket.socket(socket.AF_UNIX) as other:
        other.bind(str(path))
        other.listen()
        with pytest.raises(ConfigError, match="another daemon answers on") as answered:
            with open_listener(path, ServerConfig()):
                pass
        assert "--socket" in str(answered.value.hint) and path.exists()


def test_a_daemon_that_is_too_busy_to_answer_is_one(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with contextlib.ExitStack() as stack:
        busy = stack.enter_context(socket.socket(socket.AF_UNIX))
        busy.bind(str(path))
        busy.listen(0)
        for _ in range(3):
            client = stack.enter_context(socket.socket(socket.AF_UNIX))
            client.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                client.connect(str(path))
        with pytest.raises(ConfigError, match="is in use: Resource temporarily unavailable"):
            with open_listener(path, ServerConfig()):
                pass
        assert path.exists()


def test_a_path_that_cannot_be_bound_is_named(tmp_path: Path) -> None:
    path = tmp_path / ("x" * 120)
    with pytest.raises(ConfigError, match=r"cannot listen on .*: AF_UNIX path too long") as caught:
        with open_listener(path, ServerConfig()):
            pass
    assert "[server] socket" in str(caught.value.hint)


@pytest.mark.parametrize(
    ("path", "told", "hint"),
    [
        ("/", "/ is a folder, not a socket", "name a file in it"),
        ("/no/such/s", "cannot lock the socket /no/such/s .*: No such file", "its folder is there"),
    ],
)
def test_where_no_socket_can_be_it_is_said_why(path: str, told: str, hint: str) -> None:
    with pytest.raises(ConfigError, match=told) as caught:
        with open_listener(Path(path), ServerConfig()):
            pass
    assert hint in str(caught.value.hint)


def test_the_socket_that_was_passed_is_served_and_not_handed_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))
        made.listen()
        passed = os.dup(made.fileno())
        os.set_inheritable(passed, True)
    monkeypatch.setattr(listening, "FIRST_FD", passed)
    monkeypatch.setattr(listening, "count_listen_fds", lambda: 1)
    with open_listener(tmp_path / "other", ServerConfig()) as sock:
        assert sock.fileno() == passed and not sock.get_inheritable()
        assert sock.getsockname() == str(path)
    assert sock.fileno() == -1 and path.exists() and not (tmp_path / "other").exists()
    monkeypatch.setattr(listening, "count_listen_fds", lambda: 2)
    with pytest.raises(ConfigError, match="2 sockets were passed") as caught:
        with open_listener(tmp_path / "other", ServerConfig()):
            pass
    assert caught.value.hint == "pdcd.socket needs one ListenStream"
