"""What the daemon tells the service manager, and how it ends."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pdcd.bench.tables import Config, ServerConfig
from pdcd.errors import ConfigError, DriverUnavailable
from pdcd.protocol import events
from pdcd.protocol.request import CaptureRequest
from pdcd.server import daemon, log
from pdcd.server.daemon import run_daemon, tell_watchdog
from pdcd.server.jobs import Job, JobTable, Owner
from pdcd.server.notify import Notifier
from pdcd.server.worker import EngineThread

OWNER = Owner(uid=1, pid=2, user="anna", connection=3)


class Manager(Notifier):
    """Hears what is sent."""

    def __init__(self) -> None:
        super().__init__({})
        self.told: list[tuple[str, ...]] = []

    def send(self, *lines: str) -> None:
        self.told.append(lines)


def job() -> Job:
    return JobTable().admit(
        CaptureRequest(goal="white"), {}, OWNER, kind="plan", detach=False, queue=False
    )


def progress(frame: int) -> events.Event:
    return events.Progress(job="j", shot="s", frame=frame, frames=9, missed=0)


@pytest.mark.parametrize(
    ("event", "status"),
    [
        (progress(4), "plan j 4/9"),
        (
            events.PlanningProgress(job="j", stage="codes", done=1.0, total=4.0),
            "plan j planning 25%",
        ),
        (events.DecodingProgress(job="j", done=3.0, total=4.0), "plan j decoding 75%"),
        (events.ShotArmed(job="j", shot="s", frames=9), "plan j armed"),
        (events.JobQueued(job="j", ahead=0), "plan j queued"),
        (events.JobDone(job="j"), "idle, last plan j done"),
        (events.JobCancelled(job="j"), "idle, last plan j cancelled"),
    ],
)
def test_the_status_tells_where_the_rig_stands(event: events.Event, status: str) -> None:
    manager = Manager()
    daemon._Status(manager).follow(job(), event)
    assert manager.told == [(f"STATUS={status}",)]


def test_progress_is_told_once_a_second_and_the_rest_always(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_ns = 5 * 10**9
    monkeypatch.setattr(daemon, "time", SimpleNamespace(monotonic_ns=lambda: now_ns))
    manager = Manager()
    status, mine = daemon._Status(manager), job()
    times = (0, 999_999_999, 1_000_000_000, 1_500_000_000, 2_000_000_001)
    for number, later_ns in enumerate(times):
        now_ns = 5 * 10**9 + later_ns
        status.follow(mine, progress(number))
        if number == 1:
            status.follow(mine, events.ShotArmed(job="j", shot="s", frames=9))
    assert [line.rpartition(" ")[2] for (line,) in manager.told] == ["0/9", "armed", "2/9", "4/9"]


def test_the_watchdog_is_fed_thrice_in_its_time_while_the_thread_beats(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    slept: list[float] = []
    probed: list[int] = []

    class Thread:
        beats = 0

        def probe(self) -> None:
            probed.append(len(slept))

    thread, manager = Thread(), Manager()

    async def sleep(seconds: float) -> None:
        slept.append(seconds)
        if len(slept) == 4:
            raise asyncio.CancelledError
        thread.beats += len(slept) != 2  # the second time it does not

    monkeypatch.setattr("pdcd.server.daemon.asyncio.sleep", sleep)
    with pytest.raises(asyncio.CancelledError):
        asyncio.run(tell_watchdog(manager, cast(EngineThread, thread), 6.0))
    assert slept == [2.0] * 4 and probed == [0, 1, 2, 3]
    assert manager.told == [("WATCHDOG=1",)] * 2
    assert caplog.text.count("gives no sign of life") == 1


def test_a_driver_that_is_not_there_is_a_wrong_configuration(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def serve(config: Config, **_: Any) -> None:
        raise DriverUnavailable("none")

    monkeypatch.setattr(daemon, "serve_daemon", serve)
    monkeypatch.setattr(log, "send_to_stderr", lambda *, verbose: None)
    before = signal.getsignal(signal.SIGTERM)
    assert run_daemon(Config(), engine_factory=cast(Any, None)) == 2
    assert signal.getsignal(signal.SIGTERM) is before


def test_the_state_folder_is_made_and_held_for_one(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "state"
    config = Config(server=ServerConfig(state_dir=str(folder)))
    for _ in range(2):  # also where it is there already
        with daemon._state(config):
            assert (folder / "daemon.lock").exists()
            with pytest.raises(ConfigError, match=f"the state folder {folder} belongs to") as taken:
                with daemon._state(config):
                    pass
            assert "--state-dir" in str(taken.value.hint)
    (tmp_path / "file").touch()
    wrong = Config(server=ServerConfig(state_dir=str(tmp_path / "file" / "state")))
    with pytest.raises(ConfigError, match=r"cannot make the state folder .*: Not a directory"):
        daemon._state(wrong)
