"""`pdcd status`, `watch`, `cancel`: look at the daemon's jobs and end them."""

from __future__ import annotations

import argparse

from pdcd.api.progress import show_bar, tell_user
from pdcd.cli.daemon import connect_daemon
from pdcd.cli.exits import DONE
from pdcd.cli.output import say, say_json, say_result, say_table
from pdcd.errors import ConfigError
from pdcd.protocol.events import Event, encode_event, pick_event_fields
from pdcd.protocol.messages import JobView


def show_status(args: argparse.Namespace) -> int:
    """Print what the daemon is doing."""
    with connect_daemon(args) as client:
        answer = client.status()
    if args.json:
        say_json(answer)
        return DONE
    say_table(
        [
            ["version", answer.version],
            ["state", answer.state],
            ["running", _job_words(answer.running) if answer.running else "nothing"],
            *(["queued", _job_words(job)] for job in answer.queued),
            ["connections", str(answer.connections)],
            ["up", f"{answer.uptime_s:.0f} s"],
        ]
    )
    return DONE


def watch(args: argparse.Namespace) -> int:
    """Follow one job and report its end, or all jobs until interrupted."""
    with connect_daemon(args) as client:
        if args.job is None:
            for event in client.events():
                _say_event(event, as_json=args.json)
            return DONE
        if args.json:
            result = client.wait(args.job, lambda event: _say_event(event, as_json=True))
        else:
            with show_bar() as on_event:
                result = client.wait(args.job, on_event)
    return say_result(result, as_json=args.json)


def cancel(args: argparse.Namespace) -> int:
    """End a job; the panels are black and the shutter is closed on return."""
    with connect_daemon(args) as client:
        job = args.job
        if job is None:
            running = client.status().running
            if running is None:
                raise ConfigError("nothing is running", hint="queued jobs are cancelled by name")
            job = running.job
        result = client.cancel(job)
        if result.state == "running":
            tell_user("; ".join(result.warnings))
            result = client.wait(job)
    # The job's end is the news here, not a failure of this command.
    say_result(result, as_json=args.json)
    return DONE


def _say_event(event: Event, *, as_json: bool) -> None:
    if as_json:
        say_json(encode_event(event))
        return
    told = pick_event_fields(event).items()
    words = " ".join(f"{k}={v}" for k, v in told if isinstance(v, str | int | float))
    say(f"{event.job} {event.type} {words}".rstrip())


def _job_words(job: JobView) -> str:
    return f"{job.job} {job.kind} {job.goal} by {job.owner.user}"
