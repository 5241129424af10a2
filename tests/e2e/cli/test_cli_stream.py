"""`pdcd stream` on the mock bench: figures, pictures that are kept, and a run at the end."""

from __future__ import annotations

from pathlib import Path

import cv2
import msgspec
import pytest

from pdcd.api.run import open_run
from pdcd.cli.main import main
from pdcd.pictures.written.picture_files import read_tiff

TABLES = """
[camera]
profile = "mono"
frame_quads = [36, 27]
[scene]
kind = "open-book"
grid = [9, 12]
[limits]
min_free_bytes = 0
[server]
state_dir = "{state}"
"""


@pytest.fixture
def config(tmp_path: Path) -> str:
    path = tmp_path / "pdcd.toml"
    path.write_text(TABLES.format(state=tmp_path / "state"))
    return str(path)


@pytest.mark.whole
def test_figures_pictures_and_a_run(
    config: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "pictures"
    asked = ["stream", "indirect", "--local", "--config", config, "--codes", "8", "--seconds", "1"]
    assert main([*asked, "--json", "--out", str(out)]) == 0
    lines = [
        msgspec.json.decode(line) for line in capsys.readouterr().out.splitlines() if "{" in line
    ]
    assert lines and [line["number"] for line in lines] == sorted(
        {line["number"] for line in lines}
    )
    assert lines[-1]["latency_s"] > 0.0 and "jpeg" not in lines[-1]
    kept = sorted(out.iterdir())
    assert kept and read_tiff(kept[-1]).shape == (27, 36, 1)
    video = tmp_path / "live.mp4"
    assert main([*asked, "--out", str(video), "--record"]) == 0
    said = capsys.readouterr().out
    assert "pictures/s, latency" in said and "sigma" in said
    read = cv2.VideoCapture(str(video))
    assert read.isOpened() and read.get(cv2.CAP_PROP_FRAME_COUNT) > 1
    assert read.get(cv2.CAP_PROP_FRAME_WIDTH) == 36
    (folder,) = [Path(line) for line in said.splitlines() if "captures" in line]
    assert open_run(folder).goal == "indirect"


def test_what_is_no_stream_is_said_in_words(
    config: str, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["stream", "indirect", "--local", "--config", config]
    assert main([*asked, "--over", "9"]) == 2
    assert "parts are too few for a stream" in capsys.readouterr().err
    assert main([*asked, "--rate", "0"]) == 2
    assert "rate_hz" in capsys.readouterr().err


def test_a_reader_that_leaves_ends_the_stream_and_is_told_of(
    config: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def leave(text: str) -> None:
        raise BrokenPipeError

    monkeypatch.setattr("pdcd.cli.live_figures.write_stdout", leave)
    assert main(["stream", "indirect", "--local", "--config", config, "--codes", "8"]) == 5
    assert "nobody reads the figures any more" in capsys.readouterr().err
