"""Attacks put to the methods of a daemon, with a real engine behind them, without a socket."""

from __future__ import annotations

import asyncio
import os
import resource
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import msgspec

from pdcd.bench.folders import find_state_dir
from pdcd.bench.tables import LimitsConfig, ServerConfig
from pdcd.capture.engine import Engine
from pdcd.errors import PdcdError, to_error_fields
from pdcd.protocol.messages import Admission
from pdcd.protocol.views import ClientRole
from pdcd.server.access import Peer
from pdcd.server.descriptors import Descriptors
from pdcd.server.methods import Methods
from pdcd.server.protocol import RpcFault, RpcRequest, parse_line
from pdcd.server.runner import Runner
from pdcd.server.worker import EngineThread
from tests import bench_rig
from tests.hostile import files
from tests.hostile.requests import Attack, attacks

LONGEST_CAPTURE_S = 0.3
"""After this a capture is cancelled: what is tried here is requests, not exposures."""


@dataclass
class Caller:
    """As much of a caller as the methods look at."""

    peer: Peer
    role: ClientRole = ClientRole.SHOOT
    number: int = 1
    gone: bool = False
    interest: str = "none"


@dataclass
class Outcome:
    """What came back: counts by kind ("done" for a result), and what broke a promise."""

    kinds: Counter[str] = field(default_factory=Counter)
    broken: list[str] = field(default_factory=list)
    slowest_s: float = 0.0
    slowest: bytes = b""
    longest_pause_s: float = 0.0
    peak_mib: float = 0.0

    def note(self, kind: str, attack: Attack, error: object, took_s: float) -> None:
        """Count an answer; `internal` is a broken promise."""
        self.kinds[kind] += 1
        if took_s > self.slowest_s:
            self.slowest_s, self.slowest = took_s, attack.line[:600]
        if kind == "internal":
            self.broken.append(f"{error!r}\n    {attack.line[:600]!r}")


@contextmanager
def _methods(folder: Path) -> Iterator[tuple[Methods, Runner]]:
    config = bench_rig.config(
        folder,
        server=ServerConfig(state_dir=str(folder / "state"), arrays=str(folder / "arrays")),
        limits=LimitsConfig(min_free_bytes=0, max_exposure_s=20.0),
    )
    worker = EngineThread()
    engine = Engine.from_config(config)
    runner = Runner(engine, worker, lambda job, event: None)
    try:
        engine.start()
        yield (
            Methods(
                config,
                engine,
                worker,
                runner,
                description=engine.describe(),
                state_dir=find_state_dir(config),
                connections=lambda: 1,
            ),
            runner,
        )
    finally:
        engine.stop()
        worker.close()


def trial(folder: Path, seed: int, count: int) -> Outcome:
    """Make so many attacks, one after the other, and see what comes back."""
    files.kinds(folder / "arrays")
    outcome = Outcome()
    with _methods(folder) as (methods, runner):
        asyncio.run(_all(methods, runner, attacks(seed, count, folder / "arrays"), outcome))
    outcome.peak_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return outcome


async def _all(methods: Methods, runner: Runner, made: Iterator[Attack], outcome: Outcome) -> None:
    pulse = asyncio.create_task(_pulse(outcome))
    while (attack := await asyncio.to_thread(next, made, None)) is not None:
        begun_s = time.monotonic()
        try:
            kind, error = await _one(methods, runner, attack)
        finally:
            attack.close()
        outcome.note(kind, attack, error, time.monotonic() - begun_s)
    pulse.cancel()
    await runner.drain()


async def _one(methods: Methods, runner: Runner, attack: Attack) -> tuple[str, Any]:
    held = Descriptors()
    held.receive(map(os.dup, attack.fds))
    try:
        return await _answered(methods, runner, attack, parse_line(attack.line, held))
    finally:
        await held.end()


async def _answered(
    methods: Methods, runner: Runner, attack: Attack, request: RpcRequest | RpcFault
) -> tuple[str, Any]:
    if isinstance(request, RpcFault):
        return request.error.kind, request.error
    caller = cast(Any, Caller(Peer(os.getpid(), attack.uid, attack.uid, "eve")))
    try:
        answer = await methods.handle(caller, request)
    except PdcdError as err:
        return err.kind, to_error_fields(err)
    except Exception as err:  # what the server would call internal
        return "internal", err
    if not isinstance(answer, Admission):
        msgspec.json.encode(answer)
        return "done", None
    job = runner.table.get(answer.job)
    canceller = asyncio.get_running_loop().call_later(LONGEST_CAPTURE_S, job.cancel_flag.set)
    result = await runner.wait(answer.job)
    canceller.cancel()
    return ("done", None) if result.error is None else (str(result.error["kind"]), result.error)


async def _pulse(outcome: Outcome) -> None:
    """The longest time for which the loop did nothing else."""
    while True:
        before_s = time.monotonic()
        await asyncio.sleep(0.005)
        outcome.longest_pause_s = max(outcome.longest_pause_s, time.monotonic() - before_s)
