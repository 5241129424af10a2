"""Child processes: how one is started, talked to, watched, and killed.

Four programs here have children: the display has its presenter, the daemon its worker, a shutter
its guardian, a sweep the processes that take its photos. (Figures use a pool of the standard
library, and the demo starts a daemon as a user would.) Each child gets one end of a socket pair,
the number of that descriptor as the last word of its command, and a session of its own. Both sides
hold a `MessageLine`, which carries whole messages. The parent also holds a `Child`, which knows
whether the process lives and how it ended.

Either side may die at any time. The kernel then closes its end, and the other side notices.
"""

from __future__ import annotations

import array
import ctypes
import mmap
import os
import pickle
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from pdcd.errors import PdcdError

LOOK_INTERVAL_S = 0.05
"""Longest time between two calls of `alive` during a wait."""
_PACKET_BYTES = 1 << 18
"""Longest message that is received: a little more than the kernel allows on the socket."""
SHORT_BYTES = 1 << 15
"""Longest pickle that goes through the socket; longer ones go through memory, which is faster."""
REAP_S = 5.0
"""How long the kernel may take to remove a killed process."""
_STATUS_S = 0.1
"""How long a process may live on after its end of the line was closed."""
_FIRST_VICTIM = "500"
"""For oom_score_adj: when memory runs out, the kernel ends this process before its parent."""
_PR_SET_PDEATHSIG = 1
"""From sys/prctl.h: sets the signal to this process when the parent's thread that started it ends.
"""


def list_end_signals() -> list[signal.Signals]:
    """Signals that ask this process to end; SIGHUP is not one of them where it is ignored
    (nohup)."""
    heard = signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN
    return [signal.SIGTERM, signal.SIGINT, *([signal.SIGHUP] if heard else [])]


class LineClosedError(Exception):
    """The other side of a line is gone."""


class LineSilentError(Exception):
    """The other side of a line was silent for too long."""


_Heard = TypeVar("_Heard")
_Alive = Callable[[], object]


@dataclass(frozen=True)
class Codec(Generic[_Heard]):
    """How messages become bytes.

    by_memory : long messages are sent as a descriptor of anonymous memory; messages then cannot
        carry a descriptor of their own.
    """

    encode: Callable[[Any], bytes]
    decode: Callable[[Any], _Heard]
    by_memory: bool = False


def _pickled(message: object) -> bytes:
    return pickle.dumps(message, protocol=5)


PICKLES: Codec[Any] = Codec(_pickled, pickle.loads, by_memory=True)
"""For a child that is the same program of the same user, whose messages can be trusted. Data from a
client must never be read as a pickle."""
WORDS: Codec[bytes] = Codec(str.encode, bytes)
"""For a child that imports nothing from pdcd."""


class MessageLine(Generic[_Heard]):
    """One end of the line, for one thread at a time: each message comes whole or not at all.

    During a wait, `alive` is called at least every `LOOK_INTERVAL_S`; whatever it raises ends the
    wait.
    """

    def __init__(self, end: socket.socket, codec: Codec[_Heard]) -> None:
        self._end, self._codec = end, codec

    @classmethod
    def at(cls, fd: int, codec: Codec[_Heard]) -> MessageLine[_Heard]:
        """The child's end; `fd` is the last word of its command."""
        return cls(socket.socket(fileno=fd), codec)

    def __enter__(self) -> MessageLine[_Heard]:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def fileno(self) -> int:
        """The descriptor, -1 when it is closed."""
        return self._end.fileno()

    def close(self) -> None:
        """Hang up. Idempotent."""
        self._end.close()

    def send(
        self,
        message: object,
        fd: int | None = None,
        *,
        within_s: float | None = None,
        alive: _Alive | None = None,
    ) -> None:
        """Send a message, and a descriptor with it.

        Raises LineClosedError when the other side is gone, LineSilentError when it takes nothing
        for `within_s`.
        """
        data, held = self._codec.encode(message), None
        try:
            if self._codec.by_memory and len(data) > SHORT_BYTES:
                fd = held = _memory_of(data)
                data = b"by memory"
            fds = [] if fd is None else [fd]
            self._wait_until_ready(select.POLLOUT, within_s, alive)
            with _failure_as_end():
                rights = (socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", fds))
                self._end.sendmsg([data], [rights] if fds else [])
        finally:
            if held is not None:
                os.close(held)

    def receive(self, *, within_s: float | None = None, alive: _Alive | None = None) -> _Heard:
        """The next message.

        Raises LineClosedError when the other side is gone, LineSilentError when it sends nothing
        for `within_s`.
        """
        return self.receive_with_fd(within_s=within_s, alive=alive)[0]

    def receive_with_fd(
        self, *, within_s: float | None = None, alive: _Alive | None = None
    ) -> tuple[_Heard, int | None]:
        """The next message and the descriptor that came with it, which the caller closes."""
        self._wait_until_ready(select.POLLIN, within_s, alive)
        with _failure_as_end():
            try:
                data, fds, *_ = socket.recv_fds(self._end, _PACKET_BYTES, 1)
            except ConnectionResetError:
                # The other side ended with unread messages, which is reported first; its own last
                # message can still be read.
                data, fds, *_ = socket.recv_fds(self._end, _PACKET_BYTES, 1)
        if not data:
            raise LineClosedError
        if not (fds and self._codec.by_memory):
            return self._decoded(data), fds[0] if fds else None
        try:
            return self._decoded(mmap.mmap(fds[0], 0, prot=mmap.PROT_READ)), None
        finally:
            os.close(fds[0])

    def _decoded(self, data: bytes | mmap.mmap) -> _Heard:
        """The message; an invalid one ends the line, as nothing after it can be trusted."""
        try:
            return self._codec.decode(data)
        except Exception as err:
            raise LineClosedError from err

    def wait(self, within_s: float | None = None, alive: _Alive | None = None) -> bool:
        """Whether a message, or the end of the line, comes within that time."""
        try:
            self._wait_until_ready(select.POLLIN, within_s, alive)
        except LineSilentError:
            return False
        return True

    def _wait_until_ready(self, event: int, within_s: float | None, alive: _Alive | None) -> None:
        poller = select.poll()
        try:
            poller.register(self._end, event)
        except ValueError:  # this end was closed by another thread
            raise LineClosedError from None
        until_s = None if within_s is None else time.monotonic() + within_s
        while True:
            if alive is not None:
                alive()
            look_s = None if alive is None else LOOK_INTERVAL_S
            if until_s is not None:
                left_s = max(0.0, until_s - time.monotonic())
                look_s = left_s if look_s is None else min(look_s, left_s)
            if poller.poll(None if look_s is None else look_s * 1000):
                return
            if until_s is not None and time.monotonic() >= until_s:
                raise LineSilentError


def _memory_of(data: bytes) -> int:
    """A descriptor of anonymous memory that holds the data; the caller closes it."""
    fd = os.memfd_create("pdcd", os.MFD_CLOEXEC)
    try:
        rest = memoryview(data)
        while rest:
            rest = rest[os.write(fd, rest) :]
    except OSError as err:
        os.close(fd)
        raise MemoryError(f"a message of {len(data)} bytes: {err.strerror}") from err
    return fd


@contextmanager
def _failure_as_end() -> Iterator[None]:
    """Treat any other failure of a socket pair as the end of the line."""
    try:
        yield
    except OSError as err:
        raise LineClosedError from err


class Child(Generic[_Heard]):
    """A process that was started here, and the line to it."""

    def __init__(self, process: subprocess.Popen[bytes], line: MessageLine[_Heard]) -> None:
        self.process, self.line = process, line

    @property
    def pid(self) -> int:
        """Process number."""
        return self.process.pid

    @property
    def running(self) -> bool:
        """Whether it has not ended yet."""
        return self.process.poll() is None

    def how_it_ended(self) -> str:
        """How it ended, in words that continue "the process"."""
        with suppress(subprocess.TimeoutExpired):
            status = self.process.wait(_STATUS_S)
            if status >= 0:
                return f"ended with status {status}"
            with suppress(ValueError):
                return f"was ended by signal {-status} ({signal.Signals(-status).name})"
            return f"was ended by signal {-status}"
        return "closed its end"

    def kill(self, reap_s: float = REAP_S) -> None:
        """End it before it notices that this end is closed; wait up to `reap_s` until it is gone.

        If the kernel takes longer, a later `start_child` collects it. Idempotent.
        """
        self.process.kill()
        self.hang_up(reap_s)

    def hang_up(self, reap_s: float) -> None:
        """Close this end, which ends a sound process; wait up to `reap_s` until it is gone."""
        self.line.close()
        try:
            self.process.wait(reap_s)
        except subprocess.TimeoutExpired:
            with _lock:
                if self.process not in _unburied:
                    _unburied.append(self.process)


_unburied: list[subprocess.Popen[bytes]] = []
"""Processes that were killed or left, but whose end has not been collected yet."""
_lock = threading.Lock()


def _bury() -> None:
    """Collect the processes that have ended since."""
    with _lock:
        _unburied[:] = [process for process in _unburied if process.poll() is None]


def start_child(
    command: Sequence[str],
    codec: Codec[_Heard],
    *,
    what: str,
    inherits: Sequence[int] = (),
    deaf: bool = False,
    environment: Mapping[str, str] | None = None,
    error: Callable[..., PdcdError] = PdcdError,
) -> Child[_Heard]:
    """Start a program; returns at once, before it is ready.

    command : its words, to which the number of its end of the line is added.
    what : the process in words, for the error.
    inherits : further descriptors that it gets.
    deaf : it starts with every signal blocked that can be blocked.
    environment : its variables, None for those of this process.
    error : makes the error that is raised when the process cannot be started.
    """
    _bury()
    # A socket of packets: a message is never received, or sent, in part.
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        try:
            with _signals_blocked(deaf):
                process = subprocess.Popen(
                    [*command, str(theirs.fileno())],
                    pass_fds=(*inherits, theirs.fileno()),
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    # A session of its own: the terminal's Ctrl-C and hang-up do not reach it.
                    start_new_session=True,
                    env=environment,
                )
        except OSError as err:
            ours.close()
            raise error(
                f"cannot start {what}: {err.strerror}",
                hint="see the log; too many processes, or too little memory?",
            ) from err
    return Child(process, MessageLine(ours, codec))


def make_module_command(module: str) -> tuple[str, ...]:
    """The command of one of our modules; modules in the current folder cannot shadow it."""
    return sys.executable, "-P", "-m", module


def make_child_environment() -> Mapping[str, str]:
    """This process's environment with one thread for linear algebra, unless it says otherwise.

    More threads gain nothing on arrays of our size, and each takes memory from the child's limit.
    """
    return {"OMP_NUM_THREADS": "1", **os.environ}


@contextmanager
def _signals_blocked(blocked: bool) -> Iterator[None]:
    """Block every signal in this thread, so that a process it starts has them blocked for good.

    The C library leaves out signals 32 and 33, which it uses itself.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals() if blocked else ())
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# What a child does to itself.


def ignore_signals() -> None:
    """Let the parent decide when this process ends: ignore a Ctrl-C in the parent's terminal, and
    the signal that systemd sends to all processes of a service."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)


def end_with_parent() -> None:
    """`ignore_signals`, but die with the parent's thread that started this process, whatever this
    one is doing: while it works it does not read its line."""
    ignore_signals()
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(_FIRST_VICTIM)


def limit_memory(limit_bytes: int) -> None:
    """Limit the memory of this process, for good."""
    import resource  # missing on Windows, where runs are only read

    # Data, not addresses: libraries reserve gigabytes of addresses that they never touch.
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = limit_bytes if hard == resource.RLIM_INFINITY else min(limit_bytes, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))
