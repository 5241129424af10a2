"""`pdcd runs`: the runs on disk, and what can be done with one of them."""

from __future__ import annotations

import argparse
import re
import textwrap
from collections.abc import Generator, Sequence
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from pdcd.api.progress import tell_user
from pdcd.api.rows import describe_error, summary_rows
from pdcd.bench.config import load_config
from pdcd.bench.folders import find_state_dir
from pdcd.cli.daemon import find_daemon
from pdcd.cli.exits import DONE, FAILED
from pdcd.cli.output import (
    WIDTH,
    ask_consent,
    say,
    say_json,
    say_table,
    say_verdict,
)
from pdcd.cli.parser import LISTED
from pdcd.cli.typed import WHEN
from pdcd.errors import ConfigError, DecodeError, DiskError
from pdcd.files.system import require_linux
from pdcd.files.text import encode_json
from pdcd.printable import to_one_line
from pdcd.protocol.entry import MOST_RUNS, Page, RunEntry, RunQuery
from pdcd.protocol.fields import list_request_fields
from pdcd.protocol.request import CaptureRequest
from pdcd.runs.elsewhere import list_noted_folders
from pdcd.runs.folder import REPORT_FILE, read_manifest
from pdcd.runs.index import iterate_run_pages, make_name_query, pick_run, read_run_at
from pdcd.runs.record import Manifest

if TYPE_CHECKING:
    from pdcd.runs.prune import UnwantedRun

_UNITS = {"s": "seconds", "m": "minutes", "h": "hours", "d": "days", "w": "weeks"}
_NEWEST = 50
"""Number of runs that are listed unless all are asked for."""
_COLUMNS = ("job", "came out", "goal", "codes", "exposure", "error")
_WIDTHS = (21, 10, 12, 5, 8, 8)
"""Widths of the columns; with two spaces between them they fit into a terminal."""
_FINISHED = ("done", "partial", "damaged")


def print_runs(args: argparse.Namespace) -> int:
    """Print the newest runs that match the filters, or all of them, the newest last."""
    everything: bool = args.list_all
    query = parse_run_query(
        args, LISTED, newest=MOST_RUNS if everything else _NEWEST, previews=everything
    )
    found: list[RunEntry] = []
    with closing(list_run_pages(args, query)) as pages:
        for page in pages:
            found += page.runs
            if not everything and len(found) >= _NEWEST:
                break
    elsewhere, foreign = ([], []) if args.state_dir is not None else list_noted_folders()
    for folder in elsewhere:
        found += _find_in_folder(folder, query, page.state_folder)
    found.sort(key=lambda run: run.job)
    if not everything:
        del found[:-_NEWEST]
    if args.json:
        for run in found:
            say_json(run)
        return DONE
    _say_runs(found)
    beside = f" and {len(elsewhere)} folders that --out named" if elsewhere else ""
    tell_user(
        f"{len(found)} runs in {page.state_folder}{beside}; in another: pdcd runs --state-dir DIR"
    )
    tell_user(
        "error: against the known truth, or +- as estimated from the photo, as a share of RMS"
    )
    _tell_limits(page)
    for folder in foreign:
        tell_user(f"not looked into, as it is somebody else's: {folder}")
    return DONE


def show_run(args: argparse.Namespace) -> int:
    """Print everything that is known of a run."""
    run = _run_of(args)
    try:
        manifest = read_manifest(Path(run.folder)) if run.state in ("done", "partial") else None
    except DecodeError as err:
        tell_user(f"pdcd: {err}")
        manifest = None
    if args.json:
        more: dict[str, Any] = {}
        if manifest is not None:
            more = {
                "request": manifest.request,
                "summary": manifest.summary,
                "warnings": manifest.warnings,
                "files": manifest.files,
                "versions": manifest.versions,
            }
        say_json({"run": run, **more})
        return DONE
    say_table(_shown(run, manifest))
    if manifest is not None:
        say_verdict(manifest.quality, manifest.warnings)
    return DONE


def export_run(args: argparse.Namespace) -> int:
    """Write pictures of a run, as `pdcd export` does."""
    from pdcd.cli.export import export as write

    args.folder = Path(_run_of(args).folder)
    return write(args)


def verify(args: argparse.Namespace) -> int:
    """Verify the named runs, or all finished runs that match the filters, as `pdcd verify` does."""
    from pdcd.cli.verify import verify_runs

    if args.run_name:
        args.folder = [Path(_run_of(args, name).folder) for name in args.run_name]
    else:
        query = parse_run_query(args, "", newest=MOST_RUNS)
        found = _find_everywhere(args, query)
        args.folder = [Path(run.folder) for run in found if run.state in _FINISHED]
        if not args.folder:
            tell_user("no finished run matches: nothing was verified")
    args.manifest_sha256 = None
    return verify_runs(args)


def _run_of(args: argparse.Namespace, text: str | None = None) -> RunEntry:
    """The run with this job, name or folder.

    Raises RequestError when there is none, or more than one of that name.
    """
    check_option_order(args)
    asked: str = args.run_name if text is None else text
    if "/" in asked or Path(asked).is_dir():
        return read_run_at(Path(asked))
    return pick_run(_find_everywhere(args, make_name_query(asked)), asked)


def _find_everywhere(args: argparse.Namespace, query: RunQuery) -> list[RunEntry]:
    """All runs that match the query, including those in folders given by --out."""
    found: list[RunEntry] = []
    for page in list_run_pages(args, query):
        found += page.runs
    if args.state_dir is None:
        for folder in list_noted_folders()[0]:
            found += _find_in_folder(folder, query, page.state_folder)
    return found


def _find_in_folder(folder: Path, query: RunQuery, state: str) -> list[RunEntry]:
    """Runs directly inside a folder; none if it cannot be read, or lies in the state folder, whose
    list already has them."""
    if folder.is_relative_to(state):
        return []
    try:
        return [run for page in iterate_run_pages(folder, query, 1) for run in page.runs]
    except DiskError:
        return []


def check_option_order(args: argparse.Namespace) -> None:
    """Raise ConfigError for options of the list that were typed in front of a command."""
    for name, value in vars(args).items():
        if name.startswith(LISTED) and value:
            option = name.removeprefix(LISTED).removesuffix("s" * (name == f"{LISTED}tags"))
            raise ConfigError(
                f"--{option} in front of {args.runs_command}",
                hint=f"put it behind: pdcd runs {args.runs_command} --{option} ...",
            )


def parse_run_query(
    args: argparse.Namespace, before: str, *, newest: int, previews: bool = False
) -> RunQuery:
    """The typed filters; `before` is the prefix of their names. Raises ConfigError."""
    if not before:
        check_option_order(args)
    typed: dict[str, Any] = {
        name: getattr(args, before + name) for name in ("goal", "since", "tags", "failed")
    }
    since: datetime | None = (
        None if typed["since"] is None else parse_moment(typed["since"], "--since")
    )
    try:
        return msgspec.convert(
            {
                **typed,
                "since": since,
                "tags": typed["tags"] or (),
                "newest": newest,
                "previews": previews,
            },
            RunQuery,
        )
    except msgspec.ValidationError as err:
        raise ConfigError(f"--tag: it takes {list_request_fields()['tags'].takes}") from err


def list_run_pages(args: argparse.Namespace, query: RunQuery) -> Generator[Page, None, None]:
    """Page after page of runs: below the folder that was named, else the daemon's, else where this
    user's captures without a daemon go."""
    if args.state_dir is not None:
        folder = args.state_dir.absolute()
        if not folder.is_dir():
            raise ConfigError(f"{folder} is no folder", hint="--state-dir names that of the runs")
        yield from iterate_run_pages(folder, query)
        return
    client = find_daemon(args)
    if client is None:
        yield from iterate_run_pages(find_state_dir(load_config(args.config)).absolute(), query)
        return
    with client:
        while True:
            page = client.find(query)
            yield page
            if page.more is None:
                return
            query = msgspec.structs.replace(query, before=page.more)


def _say_runs(found: list[RunEntry]) -> None:
    """Print a table of runs; notes on a run, and why it failed, go into lines below it."""
    _say_row(_COLUMNS)
    for run in found:
        _say_row(
            (
                run.job,
                run.verdict or run.state,
                run.goal or "?",
                "" if run.codes is None else str(run.codes),
                "" if run.exposure_s is None else f"{run.exposure_s:.4g} s",
                describe_error(run),
            )
        )
        said = [run.name or "", *(f"#{tag}" for tag in run.tags), *run.note.split()]
        words = to_one_line(" ".join(filter(None, said)))
        if words:
            say("    " + textwrap.shorten(words, WIDTH - 4, placeholder=" ..."))
        why = to_one_line(", ".join(filter(None, (run.reason, _beside(run)))))
        for line in textwrap.wrap(why, WIDTH - 4, max_lines=3, placeholder=" ..."):
            say("    " + line)


def _beside(run: RunEntry) -> str | None:
    """How far an interrupted run came, unless its reason already says so."""
    if run.taken is None or run.taken in (run.reason or ""):
        return None
    return f"after {run.taken}"


def _say_row(cells: tuple[str, ...]) -> None:
    shown = (to_one_line(cell).ljust(width) for cell, width in zip(cells, _WIDTHS, strict=True))
    say("  ".join(shown).rstrip())


def _tell_limits(page: Page) -> None:
    for folder in page.closed:
        tell_user(f"not looked into: {page.state_folder}/{folder}")
    if page.cut:
        tell_user(
            "there are more names than were looked at: some runs may be missing from this list"
        )


def _shown(run: RunEntry, manifest: Manifest | None) -> list[list[str]]:
    """Rows of the table of one run."""
    notes: list[list[str | None]] = [
        ["note" * (not n), line] for n, line in enumerate(run.note.splitlines())
    ]
    rows: list[Sequence[str | None]] = [
        ["job", run.job],
        ["state", run.state],
        ["verdict", run.verdict],
        ["name", run.name],
        ["tags", " ".join(run.tags)],
        *notes,
        ["goal", run.goal],
        ["asked for", "" if manifest is None else _asked(manifest)],
        ["method", run.method],
        *summary_rows(lambda key: getattr(run, key, None)),
        ["bench", None if run.mock is None else ("virtual" if run.mock else "real")],
        ["user", run.user],
        ["started", _local(run.started_utc)],
        ["finished", _local(run.finished_utc)],
        ["why", run.reason],
        ["folder", run.folder],
    ]
    if manifest is not None:
        size = sum(record.size_bytes for record in manifest.files.values())
        rows.append(["files", f"{len(manifest.files)}, {size / 2**20:.1f} MiB"])
        report = Path(run.folder) / REPORT_FILE
        rows.append(["report", str(report) if report.is_file() else None])
    return [[str(label), value] for label, value in rows if value]


def _asked(manifest: Manifest) -> str:
    """The values of the request that differ from the defaults."""
    usual = msgspec.to_builtins(CaptureRequest(goal="white"))
    apart = {"goal", "name", "tags", "note", "out"}
    return ", ".join(
        f"{key} {_json_words(value)}"
        for key, value in manifest.request.items()
        if key not in apart and value != usual.get(key)
    )


def _json_words(value: object) -> str:
    """A value of a request, shortened: text as it is, other values as JSON."""
    if isinstance(value, str):
        return value
    text = encode_json(value).decode()
    return text if len(text) <= 60 else text[:57] + "..."


def _local(utc: str | None) -> str | None:
    """A time of a manifest in the time of this machine."""
    if utc is None:
        return None
    try:
        return f"{datetime.fromisoformat(utc).astimezone():%Y-%m-%d %H:%M:%S %Z}"
    except (ValueError, OverflowError):
        return utc


def prune(args: argparse.Namespace) -> int:
    """List the runs to remove, ask, and remove them; fails if one of them cannot be removed."""
    require_linux("runs prune")
    from pdcd.runs.prune import find_unwanted_runs, remove_run

    _check_prune(args)
    older = None if args.older_than is None else parse_moment(args.older_than, "--older-than")
    query = parse_run_query(args, "", newest=1)
    # The daemon is only asked where its runs lie: this user's rights are used to remove them.
    with closing(list_run_pages(args, query)) as found:
        state = Path(next(found).state_folder)
    going = list(
        find_unwanted_runs(
            state,
            parse_run_query(args, "", newest=1000),
            older_than=older,
            leftovers=args.failed,
            keep=args.keep or 0,
        )
    )
    if not args.json:
        _say_going(going, state)
    if args.dry_run or not going:
        _say_unwanted(going, as_json=args.json)
        return DONE
    if not args.yes and not ask_consent(f"remove {len(going)} runs for good?", silent=args.json):
        return DONE
    gone = [remove_run(state, each) for each in reversed(going)]
    _say_unwanted(gone, as_json=args.json)
    for each in gone:
        if not args.json and not each.removed:
            say(f"kept {each.run.job}: {each.why}")
    removed = [each for each in gone if each.removed]
    tell_user(f"removed {len(removed)} of {len(gone)} runs, {_size(removed)}")
    return DONE if len(removed) == len(gone) else FAILED


def _check_prune(args: argparse.Namespace) -> None:
    """Raise ConfigError unless the command line says which runs to remove."""
    check_option_order(args)
    if args.keep is not None and args.keep < 0:
        raise ConfigError(f"--keep {args.keep} is negative", hint="type --keep 10 for ten")
    if args.older_than is None and args.keep is None and not args.failed:
        raise ConfigError(
            "no runs to remove were named",
            hint="name at least one of --older-than, --failed and --keep",
        )


def _say_going(going: list[UnwantedRun], state: Path) -> None:
    if not going:
        say(f"nothing to remove in {state}")
        return
    say(f"to be removed from {state}, the oldest first:")
    _say_runs([each.run for each in reversed(going)])
    say(f"{len(going)} runs, {_size(going)}")


def _say_unwanted(runs: list[UnwantedRun], *, as_json: bool) -> None:
    for each in runs if as_json else ():
        say_json(each)


def _size(runs: list[UnwantedRun]) -> str:
    return f"{sum(each.size_bytes for each in runs) / 2**20:.1f} MiB"


def parse_moment(text: str, option: str) -> datetime:
    """The moment in UTC; a date without a zone is in this machine's zone.

    Raises ConfigError, which names the `option`.
    """
    ago = re.fullmatch(r"(\d{1,6})([smhdw])", text)
    try:
        if ago is not None:
            return datetime.now(UTC) - timedelta(**{_UNITS[ago[2]]: int(ago[1])})
        # A moment without a zone is in this machine's zone.
        return datetime.fromisoformat(text).astimezone(UTC)
    except (ValueError, OverflowError) as err:
        raise ConfigError(f"{option} {text!r} is not a time", hint=f"it takes {WHEN}") from err
