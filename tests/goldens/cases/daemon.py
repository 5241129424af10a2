"""The daemon's socket: lines in and lines out, events, refusals, cancelled jobs, `pdcd.connect`."""

from __future__ import annotations

import base64
import io
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from tests.goldens.case import Bench, Case
from tests.goldens.keep import keep_run
from tests.goldens.talking import ENDS, TIMES, Talk, daemon

CONFIG = """
[scene]
kind = "open-book"
grid = [6, 8]
[server]
state_dir = "state"
"""
SMALL = """
[projector]
size_px = [256, 192]
[mask]
size_px = [400, 300]
[camera]
profile = "450d"
frame_quads = [128, 96]
[scene]
kind = "card"
grid = [6, 8]
[server]
state_dir = "state"
"""
REFUSED: tuple[tuple[str, dict[str, Any]], ...] = (
    ("nonsense", {}),
    ("capture.start", {}),
    ("capture.start", {"goal": "nonsense"}),
    ("capture.start", {"goal": "indirect", "codes": 0}),
    ("capture.start", {"goal": "indirect", "nonsense": 1}),
    ("capture.start", {"goal": "indirect", "radius": 2}),
    ("capture.start", {"goal": "long-range", "radius": 70000}),
    ("capture.start", {"goal": "illuminated", "illumination": "light.npy"}),
    ("capture.start", {"goal": "illuminated", "illumination": [[1.0]]}),
    ("capture.start", {"goal": "illuminated", "illumination": {"fd": 0}}),
    ("capture.start", {"goal": "white", "out": "../elsewhere"}),
    ("capture.start", {"goal": "white", "name": "a/b"}),
    ("capture.plan", {"goal": "indirect", "codes": 16, "error": 0.01}),
    ("capture.wait", {"job": "nobody"}),
    ("capture.cancel", {}),
    ("capture.list", {"runs": 5000}),
    ("calibrate.start", {"steps": ["nonsense"]}),
    ("calibrate.proceed", {"job": "nobody"}),
    ("display.show", {"pattern": "nonsense"}),
    ("events.subscribe", {"jobs": "none"}),
    ("hello", {"protocol": [1, 0], "more": 1}),
)
LINES = (
    b"nonsense",
    b"[]",
    b'[{"jsonrpc":"2.0","id":1,"method":"ping"}]',
    b'{"jsonrpc":"1.0","method":"ping"}',
    b'{"jsonrpc":"2.0","id":1.5,"method":"ping"}',
)


def cases() -> list[Case]:
    """All of them."""
    return [
        Case("daemon/captures", _take_captures, 8.0),
        Case("daemon/refused", _take_refused, 6.0),
        Case("daemon/waiting", _take_waiting, 8.0),
        Case("daemon/commands", _take_commands, 8.0),
    ]


@contextmanager
def _talk(bench: Bench, config: str = CONFIG) -> Iterator[tuple[Path, Talk]]:
    """A daemon and a client that hears of all jobs; the transcript is kept."""
    bench.masks.cover(TIMES)
    bench.write("bench.toml", config)
    with daemon(bench.scratch, "bench.toml") as (path, codes):
        talk = Talk(path)
        talk.ask("events.subscribe", jobs="all")
        yield path, talk
        talk.close()
    bench.keep_json("transcript", {**talk.told(), "exit": codes})


def _run(talk: Talk, method: str, **params: Any) -> dict[str, Any]:
    """Start a job and wait for its end, by answer and by event."""
    time.sleep(1.0)  # runs of one second are listed in any order
    job = talk.ask(method, **params)["result"]["job"]
    result: dict[str, Any] = talk.ask("capture.wait", job=job)["result"]
    talk.wait_for(job, *ENDS)
    return result


def _take_captures(bench: Bench) -> None:
    """What a client asks who takes photos."""
    light = 0.5 * np.ones((6, 8))
    file = io.BytesIO()
    np.save(file, light)
    with _talk(bench) as (_, talk):
        for method in ("ping", "rig.status", "rig.describe", "config.get"):
            talk.ask(method)
        talk.ask("hello", protocol=[1, 0])
        talk.ask("capture.plan", goal="indirect", codes=16, parts=4)
        first = _run(talk, "capture.start", goal="indirect", codes=16, parts=4, name="first")
        _run(talk, "capture.start", goal="direct", codes=8, parts=1, out="mine")
        _run(talk, "capture.start", goal="illuminated", illumination=light.tolist())
        sent = {"npy": base64.b64encode(file.getvalue()).decode(), "file": "light.npy"}
        last = _run(talk, "capture.start", goal="illuminated", illumination=sent)
        talk.ask("capture.list", runs=10)
        talk.ask("capture.list", find={"goal": "illuminated"})
        talk.ask("preview.grab")
        talk.ask("display.show", pattern="checker")
        talk.ask("display.show", pattern="code", index=3)
        talk.ask("display.show", pattern="black")
        talk.ask("events.unsubscribe")
    keep_run(bench, Path(first["folder"]), "first")
    keep_run(bench, Path(last["folder"]), "last")


def _take_refused(bench: Bench) -> None:
    """What a client is refused, and lines that are none."""
    with _talk(bench) as (path, talk):
        for method, params in REFUSED:
            job = talk.ask(method, **params).get("result", {}).get("job")
            if job is not None:  # admitted first
                talk.ask("capture.wait", job=job)
                talk.wait_for(job, *ENDS)
        others = []
        for line in LINES:
            other = Talk(path)
            other.write(line)
            others.append(other.told())
            other.close()
        other = Talk(path)
        other.ask("hello", protocol=[2, 0])
        others.append(other.told())
        other.close()
        bench.keep_json("lines", others)


def _take_waiting(bench: Bench) -> None:
    """Jobs that wait: for somebody at the bench, for each other, for their end."""
    with _talk(bench, SMALL) as (path, talk):
        words = {"steps": ["focus"], "attended": True}
        job = talk.ask("calibrate.start", **words)["result"]["job"]
        talk.wait_for(job, "attention")
        talk.ask("capture.start", goal="white")
        waiting = talk.ask("capture.start", goal="white", queue=True)["result"]["job"]
        other = talk.ask("capture.start", goal="white", queue=True)["result"]["job"]
        talk.ask("rig.status")
        talk.ask("capture.cancel", job=other)
        talk.ask("calibrate.proceed", job=job)
        talk.wait_for(job, "attention", *ENDS)
        talk.ask("capture.cancel", job=job)
        talk.ask("capture.wait", job=waiting)
        talk.wait_for(waiting, *ENDS)
        talk.ask("capture.cancel", job=waiting)
        talk.ask("capture.list")
        leaves = Talk(path)
        job = leaves.ask("calibrate.start", **words)["result"]["job"]
        talk.wait_for(job, "attention")
        leaves.close()
        talk.wait_for(job, *ENDS)
        talk.ask("capture.wait", job=job)


def _take_commands(bench: Bench) -> None:
    """The command line and `pdcd.connect` with a daemon."""
    import pdcd

    with _talk(bench) as (path, _):
        there = ("--socket", str(path), "--json")
        for name, words in {
            "status": "status",
            "plan": "plan indirect --codes 8 --parts 1",
            "capture": "capture indirect --codes 8 --parts 4 --tag a",
            "local-too": "capture white --queue",
            "list": "list",
            "runs": "runs",
            "nobody": "wait nobody",
            "cancel-nobody": "cancel nobody",
            "bad": "capture indirect --radius 3",
        }.items():
            bench.keep_said(name, bench.pdcd(*words.split(), *there))
        with pdcd.connect(path) as rig:
            run = rig.capture("diagonal", codes=16, parts=4, progress=False)
            bench.keep_json("grid", list(rig.grid))
        keep_run(bench, run.folder, "connected")
