"""`pdcd verify`: checks whether runs and calibrations are whole and unchanged since they ended."""

from __future__ import annotations

import argparse
import re

from pdcd.bench.calibration import RECORD
from pdcd.cli.exits import DONE, FAILED
from pdcd.cli.output import say, say_json
from pdcd.errors import ConfigError
from pdcd.runs.verify import VerifyReport, verify_run
from pdcd.runs.verify_calibration import verify_calibration


def verify_runs(args: argparse.Namespace) -> int:
    """Check every folder; fails when one of them is not whole and unchanged."""
    sha256: str | None = args.manifest_sha256
    if sha256 is not None and (len(args.folder) > 1 or not re.fullmatch("[0-9a-fA-F]{64}", sha256)):
        raise ConfigError(
            "--manifest-sha256 takes 64 hexadecimal digits, and goes with one folder",
            hint="capture --json and capture.wait tell it as manifest_sha256",
        )
    found = [
        (verify_calibration if (folder / RECORD).exists() else verify_run)(
            folder, manifest_sha256=sha256
        )
        for folder in args.folder
    ]
    for run in found:
        if args.json:
            say_json(run)
        else:
            _say(run)
    return DONE if all(run.whole for run in found) else FAILED


def _say(run: VerifyReport) -> None:
    if [(each.path, each.what) for each in run.findings] == [(".", "unreadable")]:
        say(f"UNREAD   {run.folder}: {run.findings[0].detail}; see pdcd runs for those there are")
        return
    damaged = any(finding.what != "partial" for finding in run.findings)
    state = "whole  " if run.whole else "DAMAGED" if damaged else "PARTIAL"
    say(f"{state}  {run.folder}: {run.files} files, {run.size_bytes} bytes as they were")
    for finding in run.findings:
        say(f"  {finding.what:10}  {finding.path}: {finding.detail}")
    if run.not_kept:
        say(
            f"  not kept    {len(run.not_kept)} RAW files: their digests are in the manifest; "
            "pictures cannot be made again"
        )
    for name in run.later:
        say(f"  made later  {name}: to look at; nothing vouches for it")
