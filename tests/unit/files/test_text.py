"""JSON can always be written: texts from outside may come from any bytes."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pdcd.cli.main import main
from pdcd.cli.output import say_json
from pdcd.errors import DecodeError, to_error_fields
from pdcd.files.text import encode_json
from pdcd.protocol.result import CaptureResult
from pdcd.runs.folder import LOG, RunFolder
from pdcd.runs.place import HeldFolder
from pdcd.server.protocol import encode_reply

LATIN = os.fsdecode(b"IMG_\xe9.dng")
ESCAPED = "IMG_\\udce9.dng"


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ("é \n", "é \n"),
        (LATIN, ESCAPED),
        (["a\nb", {LATIN: (LATIN, 1, None)}], ["a\nb", {ESCAPED: [ESCAPED, 1, None]}]),
        (Path("/x") / LATIN, f"/x/{ESCAPED}"),
        ("\ud83d\ude00", "\\ud83d\\ude00"),
    ],
)
def test_what_is_no_text_is_escaped_and_all_else_stays(value: Any, told: Any) -> None:
    assert json.loads(encode_json(str(value) if isinstance(value, Path) else value)) == told


def test_a_result_of_any_names_goes_to_client_log_and_terminal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    error = to_error_fields(DecodeError(f"cannot read {LATIN}", device=LATIN, hint=LATIN))
    result = CaptureResult(
        job="job", state="failed", folder=f"/tmp/{LATIN}", error=error, files=(LATIN,),
        warnings=(LATIN,),
    )  # fmt: skip
    told = msgspec.json.decode(encode_reply(1, result))["result"]
    assert told["error"]["message"] == f"cannot read {ESCAPED}" and told["files"] == [ESCAPED]
    say_json(result)
    assert json.loads(capsys.readouterr().out)["folder"] == f"/tmp/{ESCAPED}"
    with HeldFolder.at(tmp_path) as place, RunFolder(place, "job") as folder:
        folder.create(min_free_bytes=0)
        folder.log({"event": "failed", "message": LATIN})
        assert msgspec.json.decode((folder.path / LOG).read_bytes())["message"] == ESCAPED


def test_a_command_tells_of_such_a_name_in_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["verify", str(tmp_path / LATIN), "--json"]) != 0
    out = capsys.readouterr().out.splitlines()[-1]
    assert out.isascii() or out.encode()
    assert ESCAPED in json.dumps(json.loads(out)).replace("\\\\", "\\")


@pytest.mark.parametrize(
    ("umask", "left"), [(0, 0o022), (0o020, 0o022), (0o002, 0o002), (0o077, 0o077)]
)
def test_what_a_command_makes_is_nothing_that_everybody_may_write_to(
    umask: int, left: int, capsys: pytest.CaptureFixture[str]
) -> None:
    before = os.umask(umask)
    try:
        main(["completion", "bash"])
        assert os.umask(0) == left
    finally:
        os.umask(before)
