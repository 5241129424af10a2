"""Children: how they are started and ended, and the line to them; in part with real processes."""

from __future__ import annotations

import errno
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from pdcd import child as child_module
from pdcd.child import (
    LOOK_INTERVAL_S,
    PICKLES,
    SHORT_BYTES,
    WORDS,
    Codec,
    LineClosedError,
    LineSilentError,
    MessageLine,
    end_with_parent,
    ignore_signals,
    limit_memory,
    make_child_environment,
    make_module_command,
    start_child,
)
from pdcd.errors import DeviceLost, PdcdError
from tests.child_rig import Children, Clock, stand_ins

JSON: Codec[Any] = Codec(msgspec.json.encode, msgspec.json.decode)


@pytest.fixture
def children(monkeypatch: pytest.MonkeyPatch) -> Iterator[Children]:
    yield from stand_ins(monkeypatch)


def line_pair(codec: Codec[Any]) -> tuple[MessageLine[Any], MessageLine[Any]]:
    first, second = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    return MessageLine(first, codec), MessageLine(second, codec)


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


# Messages.


@pytest.mark.parametrize("length", [0, 1, SHORT_BYTES - 100, SHORT_BYTES + 1, 5_000_000])
def test_pickles_of_any_length_come_out_as_they_went_in(length: int) -> None:
    near, far = line_pair(PICKLES)
    before = descriptors()
    error = DeviceLost("gone", device="camera", hint="look for it")
    with near, far:
        for message in (np.arange(length) % 251, "last"):
            near.send((error, message))
        told, array_there = far.receive()
        assert np.array_equal(array_there, np.arange(length) % 251)
        array_there[:] = 7  # its own, to be written to
        assert (told.message, told.device, told.hint) == ("gone", "camera", "look for it")
        assert type(told) is DeviceLost and far.receive()[1] == "last"
        assert descriptors() == before


def test_a_descriptor_goes_along_where_messages_do_not_go_by_memory() -> None:
    near, far = line_pair(JSON)
    out, into = os.pipe()
    near.send({"a": 70_000 * "x"}, out)
    message, fd = far.receive_with_fd()
    near.send([1])
    assert message == {"a": 70_000 * "x"} and fd is not None and fd != out
    assert os.fstat(fd).st_ino == os.fstat(out).st_ino
    assert far.receive_with_fd() == ([1], None)
    for end in (out, into, fd):
        os.close(end)
    near.close()
    far.close()


def test_words_are_for_those_who_know_no_codec() -> None:
    near, far = line_pair(WORDS)
    near.send("arm 30")
    assert far.receive() == b"arm 30"
    near.close()
    far.close()
    assert near.fileno() == far.fileno() == -1


@pytest.mark.parametrize("unread", [True, False])
def test_the_end_is_told_after_what_was_said_before_it(unread: bool) -> None:
    near, far = line_pair(WORDS)
    if unread:
        near.send("never read")  # the kernel then speaks of a reset
    far.send("last")
    far.close()
    with near:
        assert near.wait(0.0)
        assert near.receive() == b"last"
        with pytest.raises(LineClosedError):
            near.receive()
        with pytest.raises(LineClosedError):
            near.send("hello")


def test_what_cannot_be_sent_is_the_end_of_the_talk() -> None:
    near, far = line_pair(WORDS)
    with near, far, pytest.raises(LineClosedError):
        near.send("x" * (1 << 22))


# Waiting.


def test_whoever_waits_is_asked_ten_times_a_second_and_no_longer_than_it_said(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    near, far = line_pair(WORDS)
    clock, signs_s = Clock(monkeypatch), []
    looks_s = clock.silence(LOOK_INTERVAL_S, deaf=True)
    with near, far:
        with pytest.raises(LineSilentError):
            near.receive(within_s=2.01, alive=lambda: signs_s.append(clock.now_s))
        assert clock.now_s == pytest.approx(102.05)
        assert max(np.diff(signs_s)) <= 0.1 and len(signs_s) >= 41
        assert max(s for s in looks_s if s is not None) == LOOK_INTERVAL_S <= 0.1
        # The last look is no longer than what is left.
        assert looks_s[-1] == pytest.approx(0.01)
        with pytest.raises(LineSilentError):
            near.send("x", within_s=1.0, alive=lambda: None)
        looks_s.clear()
        assert not near.wait(0.25) and looks_s[0] == pytest.approx(0.25)
        assert not near.wait(0.0)


def test_who_gives_no_bound_and_no_sign_is_not_woken(monkeypatch: pytest.MonkeyPatch) -> None:
    near, far = line_pair(WORDS)
    far.send("x")
    looks_s: list[float | None] = []
    poller = SimpleNamespace(
        register=lambda *_: None,
        poll=lambda wait_ms: looks_s.append(wait_ms) or [1],  # type: ignore[func-returns-value]
    )
    monkeypatch.setattr("pdcd.child.select.poll", lambda: poller)
    with near, far:
        assert near.receive() == b"x" and looks_s == [None]


def test_what_a_sign_of_life_raises_ends_the_wait_and_loses_nothing() -> None:
    near, far = line_pair(PICKLES)
    signs = 0

    def alive() -> None:
        nonlocal signs
        signs += 1
        if signs == 3:
            raise KeyboardInterrupt

    with near, far:
        with pytest.raises(KeyboardInterrupt):
            near.receive(alive=alive)
        far.send("x" * 100_000)
        assert near.wait(60.0) and len(near.receive()) == 100_000


# The start.


def test_a_program_gets_its_end_of_the_line_and_nothing_of_the_terminal(
    children: Children,
) -> None:
    made = start_child(
        ("program", "word"), JSON, what="it", inherits=(7, 8), environment={"A": "1"}
    )
    process = children.last
    assert process.command[:-1] == ["program", "word"] and process.inherits == (7, 8)
    assert process.how == {
        "stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "start_new_session": True,
        "env": {"A": "1"},
    }  # fmt: skip
    assert made.pid == process.pid == 100 and made.running
    far = process.line(JSON)
    made.line.send([1])
    assert far.receive() == [1]
    # Only the process has that end now: its death is heard of here.
    process.die(0)
    with pytest.raises(LineClosedError):
        made.line.receive()
    assert not made.running
    made.kill()
    assert process.done == [("wait", 5.0)]


def test_a_process_that_cannot_be_started_is_the_error_of_whoever_wants_it(
    children: Children,
) -> None:
    before = descriptors()
    children.refusal = BlockingIOError(11, "Resource temporarily unavailable")
    with pytest.raises(PdcdError) as caught:
        start_child(("program",), WORDS, what="the process that thinks")
    told = "cannot start the process that thinks: Resource temporarily unavailable"
    assert caught.value.message == told and "too little memory" in str(caught.value.hint)
    with pytest.raises(DeviceLost, match="cannot start it"):
        start_child(("program",), WORDS, what="it", error=DeviceLost)
    assert descriptors() == before
    children.refusal = None


def test_modules_of_the_current_folder_are_not_taken_for_ours() -> None:
    assert make_module_command("pdcd.x") == (sys.executable, "-P", "-m", "pdcd.x")


def test_threads_are_as_many_as_the_operator_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert make_child_environment() == {**os.environ, "OMP_NUM_THREADS": "1"}
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    assert make_child_environment() == os.environ


FOREVER = (sys.executable, "-I", "-S", "-c", "import time; time.sleep(600)")


@pytest.mark.parametrize("deaf", [True, False])
def test_a_process_has_a_session_of_its_own_and_is_deaf_if_need_be(deaf: bool) -> None:
    made = start_child(FOREVER, WORDS, what="it", deaf=deaf)
    try:
        assert os.getsid(made.pid) == made.pid
        fds = Path(f"/proc/{made.pid}/fd")
        assert [str((fds / n).readlink()) for n in "01"] == ["/dev/null"] * 2
        status = Path(f"/proc/{made.pid}/status").read_text()
        blocked = int(next(line for line in status.splitlines() if line[:6] == "SigBlk")[8:], 16)
        heard = {number for number in signal.valid_signals() if not blocked >> (number - 1) & 1}
        assert heard == ({signal.SIGKILL, signal.SIGSTOP} if deaf else signal.valid_signals())
        assert not signal.pthread_sigmask(signal.SIG_BLOCK, ())  # this process itself is not
    finally:
        made.kill()
    assert made.process.returncode == -signal.SIGKILL and made.line.fileno() == -1


# The end.


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (0, "ended with status 0"), (3, "ended with status 3"),
        (-11, "was ended by signal 11 (SIGSEGV)"), (-99, "was ended by signal 99"),
        (None, "closed its end"),
    ],
)  # fmt: skip
def test_how_it_ended_is_told_in_words(children: Children, status: int | None, words: str) -> None:
    made = start_child(("program",), WORDS, what="it")
    children.last.die(status)
    assert made.how_it_ended() == words
    children.last.returncode = status or 0
    made.kill()


def test_one_that_is_killed_does_not_hear_the_end_first(
    children: Children, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would take that for its cue."""
    made = start_child(("program",), WORDS, what="it")
    monkeypatch.setattr(
        children.last, "kill", lambda: children.last.done.append(made.line.fileno() >= 0)
    )
    children.last.returncode = -9
    made.kill()
    assert children.last.done == [True, ("wait", 5.0)] and made.line.fileno() == -1
    made.kill()


def test_one_that_hears_the_end_is_waited_for_as_long_as_wanted(children: Children) -> None:
    made = start_child(("program",), WORDS, what="it")
    far = children.last.line(WORDS)
    children.last.stubborn = True
    made.hang_up(0.5)
    with pytest.raises(LineClosedError):
        far.receive()
    assert children.last.done == [("wait", 0.5)]


def test_those_whose_end_nobody_saw_are_buried_by_the_next_start() -> None:
    before = descriptors()
    killed = [start_child(FOREVER, WORDS, what="it") for _ in range(3)]
    for made in killed:
        made.kill(reap_s=0.0)
        made.kill(reap_s=0.0)
    for made in killed:
        with suppress(ChildProcessError):  # whose end was seen at once
            os.waitid(os.P_PID, made.pid, os.WEXITED | os.WNOWAIT)  # until the kernel has ended it
    last = start_child(FOREVER, WORDS, what="it")
    assert [made.process.returncode for made in killed] == [-9] * 3
    last.kill()
    assert descriptors() == before
    assert not [p for p in child_module._unburied if p.returncode is not None]


def test_a_wait_is_ended_by_the_death_of_the_other_side_from_another_thread() -> None:
    made = start_child(FOREVER, WORDS, what="it")
    timer = threading.Timer(0.05, made.process.kill)
    timer.start()
    with pytest.raises(LineClosedError):
        made.line.receive(within_s=60.0)
    timer.join()
    assert made.how_it_ended() == "was ended by signal 9 (SIGKILL)"
    made.kill()


# What a child does to itself.


@pytest.mark.parametrize(
    ("limit", "hard", "most"), [(100, -1, 100), (100, 50, 50), (40, 50, 40), (50, 50, 50)]
)
def test_memory_is_bounded_for_good(
    limit: int, hard: int, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[object] = []
    monkeypatch.setitem(sys.modules, "resource", SimpleNamespace(
        RLIMIT_DATA=2, RLIM_INFINITY=-1, getrlimit=lambda which: (7, hard),
        setrlimit=lambda which, pair: seen.append((which, pair)),
    ))  # fmt: skip
    limit_memory(limit)
    assert seen == [(2, (most, most))]


@pytest.mark.parametrize("refused", [False, True])
def test_a_child_ends_with_its_parent_and_goes_first(
    refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[object] = []

    def written(path: Path, text: str) -> None:
        seen.append((str(path), text))
        if refused:
            raise PermissionError(13, "Permission denied")

    library = SimpleNamespace(prctl=lambda *words: seen.append(words))
    monkeypatch.setattr("pdcd.child.signal.signal", lambda number, how: seen.append((number, how)))
    monkeypatch.setattr("pdcd.child.ctypes.CDLL", lambda name: library)
    monkeypatch.setattr(Path, "write_text", written)
    ignored = [
        (number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    ]
    end_with_parent()
    bound: list[object] = [(1, signal.SIGKILL, 0, 0, 0), ("/proc/self/oom_score_adj", "500")]
    assert seen == ignored + bound
    seen.clear()
    ignore_signals()
    assert seen == ignored


@pytest.mark.parametrize("data", [b"no pickle", b"", b"\x80\x05."])
def test_what_is_no_message_is_the_end_of_the_talk(data: bytes) -> None:
    ours, theirs = line_pair(PICKLES)
    with ours, theirs:
        theirs._end.send(data)
        with pytest.raises(LineClosedError):
            ours.receive(within_s=5.0)


def test_a_message_for_which_there_is_no_memory_leaves_no_descriptor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ours, theirs = line_pair(PICKLES)
    with ours, theirs:
        before = descriptors()
        monkeypatch.setattr("pdcd.child.os.write", failing_write)
        with pytest.raises(MemoryError, match="File too large"):
            ours.send(bytes(2 * SHORT_BYTES))
        assert descriptors() == before


def failing_write(fd: int, data: object) -> int:
    raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))


def test_a_long_message_comes_whole_where_memory_takes_it_piece_by_piece(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    write = os.write
    monkeypatch.setattr("pdcd.child.os.write", lambda fd, data: write(fd, data[:1000]))
    ours, theirs = line_pair(PICKLES)
    said = np.arange(3 * SHORT_BYTES, dtype=np.int64)
    with ours, theirs:
        ours.send(said)
        assert np.array_equal(theirs.receive(within_s=5.0), said)
