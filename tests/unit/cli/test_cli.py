"""The command line: usage, capture over the socket, how every end and refusal is told."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

from pdcd import words
from pdcd.cli import parser
from pdcd.cli.main import main
from pdcd.errors import (
    BusyError,
    Cancelled,
    ConfigError,
    DeniedError,
    DeviceLost,
    DriverUnavailable,
    PdcdError,
    RequestError,
    SyncError,
)
from pdcd.protocol.line_talk import UnreachableError
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from tests.unit.cli.cli_stubs import (
    JOB,
    SUMMARY,
    StubClient,
    ended,
    last_object,
)

# --- start-up -----------------------------------------------------------------------------------


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys, pdcd.cli.main\n"
        "try: pdcd.cli.main.main(['--help'])\n"
        "except SystemExit as end: print(end.code, sorted(sys.modules), file=sys.stderr)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.startswith("usage: pdcd ")
    code_, _, modules = run.stderr.partition(" ")
    assert code_ == "0"
    for heavy in (
        "numpy",
        "scipy",
        "msgspec",
        "rich",
        "cv2",
        "rawpy",
        "asyncio",
        "pdcd.capture.engine",
    ):
        assert f"'{heavy}'" not in modules
    assert "'argparse'" in modules


@pytest.mark.parametrize(
    ("imported", "named", "heavy"),
    [
        # What talks to a daemon names its maps, but works nothing out with them.
        ("pdcd.client", "pdcd.panels.map", {"scipy", "cv2", "rawpy", "asyncio"}),
        # What only the daemon's work process needs takes a fifth of its start.
        ("pdcd.server.daemon, pdcd.capture.engine", "pdcd.pictures.darkroom",
         {"scipy.sparse", "scipy.ndimage", "scipy.special", "scipy.fft"}),
    ],
)  # fmt: skip
def test_clients_and_daemons_begin_without_heavy_libraries(
    imported: str, named: str, heavy: set[str]
) -> None:
    code = f"import sys, {imported}; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    modules = set(run.stdout.split())
    assert named in modules and not modules & heavy


@pytest.mark.parametrize(
    ("option", "names"),
    [
        ("--family", words.FamilyName),
        ("--method", words.MethodName),
        ("--schedule", words.GuardsName),
        ("--window", words.WindowName),
        ("--black-level", words.BlackLevel),
        ("--normalise", words.NormaliseName),
    ],
)
def test_every_word_of_a_request_can_be_typed(option: str, names: object) -> None:
    commands = parser.build_parser()
    for goal in get_args(words.GoalName):
        for name in get_args(names):
            args = commands.parse_args(["capture", goal, option, name])
            assert args.goal == goal and name in vars(args).values()


# --- capture over the socket --------------------------------------------------------------------


def test_capture_sends_what_was_typed(
    daemon: type[StubClient], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    line = (
        "capture fraction --socket /a/b.sock --codes 16 --family balanced --p 0.25 --seed 7"
        " --exposure 1.5 --window quarter --no-guards --black-level both --no-white --out runs"
        " --note hello --detach --queue --white-patch 0.25 0.5"
    )
    assert main(line.split()) == 0
    wanted = CaptureRequest(
        goal="fraction",
        codes=16,
        family="balanced",
        p=0.25,
        seed=7,
        exposure_s=1.5,
        window="quarter",
        guards=False,
        black_level="both",
        white=False,
        out=str(tmp_path / "runs"),
        note="hello",
        white_patch=(0.25, 0.5),
    )
    assert daemon.asked == [Path("/a/b.sock"), (wanted, True, True), "closed"]


def test_files_are_opened_here_and_never_named_to_the_daemon(
    daemon: type[StubClient], tmp_path: Path
) -> None:
    line = "capture filtered --kernel k.npy --illumination l.png --prior t.npz"
    assert main(line.split()) == 0
    files = {"kernel": Path("k.npy"), "illumination": Path("l.png"), "prior": Path("t.npz")}
    assert daemon.asked[1] == (CaptureRequest(goal="filtered"), False, False, files)
    assert main(["plan", "indirect", "--prior", "decay:3"]) == 0
    assert daemon.asked[-2] == ("plan", CaptureRequest(goal="indirect", prior="decay:3"))


def test_socket_comes_from_the_configuration(daemon: type[StubClient], tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text("[server]\nsocket = 'lab.sock'\n")
    assert main(["status", "--config", str(tmp_path / "rig.toml")]) == 0
    assert daemon.asked[0] == tmp_path / "lab.sock"


def test_capture_prints_a_table_and_progress_apart(
    daemon: type[StubClient], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["capture", "indirect"]) == 0
    printed = capsys.readouterr()
    assert printed.out.splitlines() == [
        f"job               {JOB}",
        "state             done",
        "codes             8",
        "refreshes         480",
        "exposure          8.200 s",
        "missed refreshes  2",
        "RMS error         1.23 % of quads, against the known truth",
        "wall time         0.50 s",
        "folder            /runs/x",
    ]
    # The second progress event comes within the second and is left out.
    assert printed.err.splitlines() == [
        "coded: armed",
        "coded: 12/24 refreshes",
        "coded: of the future",
        "decoding",
    ]


def test_capture_json_ends_with_the_result_unchanged(
    daemon: type[StubClient], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["capture", "indirect", "--json"]) == 0
    assert last_object(capsys.readouterr().out) == {
        "job": JOB,
        "state": "done",
        "folder": "/runs/x",
        "manifest_sha256": None,
        "error": None,
        "files": [],
        "summary": SUMMARY,
        "warnings": [],
    }


@pytest.mark.parametrize(
    ("result", "code"),
    [
        (ended("failed", "device_lost"), 5),
        (ended("failed", "config"), 2),
        (ended("failed", "request"), 2),
        (ended("failed", "busy"), 4),
        (ended("failed", "something new"), 5),
        (CaptureResult(job=JOB, state="failed"), 5),
        (ended("cancelled", "cancelled"), 130),
        (CaptureResult(job=JOB, state="queued"), 0),
        (CaptureResult(job=JOB, state="running"), 0),
    ],
)
@pytest.mark.parametrize("line", ["capture indirect", f"wait {JOB}", f"watch {JOB}"])
def test_end_of_the_job_gives_the_exit_code(
    daemon: type[StubClient],
    capsys: pytest.CaptureFixture[str],
    line: str,
    result: CaptureResult,
    code: int,
) -> None:
    daemon.result = result
    assert main([*line.split(), "--json"]) == code
    printed = capsys.readouterr()
    assert last_object(printed.out)["state"] == result.state
    said = "pdcd: camera: it broke (mend it)" in printed.err.splitlines()
    assert said == (result.error is not None)


@pytest.mark.parametrize(
    ("error", "code", "kind", "line"),
    [
        (BusyError("the rig is taken", hint="by ada"), 4, "busy", "the rig is taken (by ada)"),
        (ConfigError("no such key"), 2, "config", "no such key"),
        (RequestError("no such goal"), 2, "request", "no such goal"),
        (DriverUnavailable("no driver is called 'x'", device="display"), 2, "driver_unavailable",
         "display: no driver is called 'x'"),
        (DeniedError("not yours"), 6, "denied", "not yours"),
        (SyncError("3 late", device="mask"), 5, "sync", "mask: 3 late"),
        (DeviceLost("gone", device="camera"), 5, "device_lost", "camera: gone"),
        (Cancelled("ended"), 130, "cancelled", "ended"),
        (UnreachableError("no daemon answers"), 3, "unreachable", "no daemon answers"),
        (KeyboardInterrupt(), 130, "cancelled", "interrupted"),
        (PermissionError(13, "Permission denied", "/x"), 5, "disk",
         "cannot use '/x': Permission denied (check folder and rights)"),
        (OSError(24, "Too many open files"), 4, "busy",
         "the system has nothing left: Too many open files (try again in a moment; if it stays, "
         "raise LimitNOFILE or give it more memory)"),
    ],
)  # fmt: skip
def test_refusal_is_one_line_and_one_object(
    daemon: type[StubClient],
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    code: int,
    kind: str,
    line: str,
) -> None:
    daemon.error = error
    assert main(["capture", "indirect", "--json"]) == code
    printed = capsys.readouterr()
    assert printed.err.splitlines()[-1] == f"pdcd: {line}"
    told = last_object(printed.out)
    assert (told["job"], told["folder"]) == (None, None)
    assert told["state"] == ("cancelled" if code == 130 else "failed")
    assert told["error"]["kind"] == kind
    if isinstance(error, PdcdError):
        assert told["error"] == {
            "kind": kind,
            "message": error.message,
            "device": error.device,
            "hint": error.hint,
        }

    assert main(["capture", "indirect"]) == code
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("command", ["transport", "calibrate"])
def test_what_has_a_job_done_says_that_there_was_none(
    capsys: pytest.CaptureFixture[str], command: str
) -> None:
    assert main([command, "--json", "--socket", "/no/such/socket"]) == 3
    printed = capsys.readouterr()
    assert "/no/such/socket" in printed.err
    told = last_object(printed.out)
    assert (told["job"], told["state"], told["folder"]) == (None, "failed", None)
    assert told["error"]["kind"] == "unreachable"


def test_reader_that_has_gone_is_no_error_message() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    code = "from pdcd.cli.main import main; raise SystemExit(main(['config', 'schema']))"
    run = subprocess.run(
        [sys.executable, "-c", code], stdout=writer, stderr=subprocess.PIPE, check=False
    )
    os.close(writer)
    assert (run.returncode, run.stderr) == (5, b"")
