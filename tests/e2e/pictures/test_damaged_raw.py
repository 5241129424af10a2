"""A RAW file that is not the one that was fetched makes no picture, whatever its size."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdcd.bench.devices import RawFile
from pdcd.capture.engine import Engine
from pdcd.errors import DecodeError
from pdcd.pictures.decode import decode_folder
from pdcd.protocol.request import CaptureRequest
from tests import bench_rig
from tests.taken import capture_on

REQUEST = CaptureRequest(goal="indirect", codes=4, white=False)


def flip(path: Path) -> None:
    """Change one bit of the last sample; every reader takes the file for a sound one."""
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.chmod(0o640)  # a finished run's are read-only
    path.write_bytes(data)


def test_a_run_whose_raw_file_changed_is_not_decoded(tmp_path: Path) -> None:
    folder = Path(str(capture_on(bench_rig.config(tmp_path), REQUEST).folder))
    assert decode_folder(folder).identical
    raw = next(folder.glob("raw/coded*.dng"))
    size = raw.stat().st_size
    flip(raw)
    assert raw.stat().st_size == size
    with pytest.raises(DecodeError, match="SHA-256"):
        decode_folder(folder)


@pytest.mark.parametrize("first", [True, False])
def test_a_file_that_changes_after_it_was_fetched_fails_the_capture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, first: bool
) -> None:
    """In the metering, which comes first, and in the photo."""
    engine = Engine.from_config(bench_rig.config(tmp_path))
    engine.start()
    fetch = engine._rig.readout.fetch

    def damaged(folder: Path, name: str, timeout_s: float) -> RawFile:
        raw = fetch(folder, name, timeout_s)
        assert isinstance(raw, RawFile)
        if name.startswith("meter-") == first:
            flip(raw.path)
        return raw

    monkeypatch.setattr(engine._rig.readout, "fetch", damaged)
    result = bench_rig.capture(engine, REQUEST)
    engine.stop()
    assert result.state == "failed"
    assert result.error is not None and result.error["kind"] == "decode"
    assert "SHA-256" in str(result.error["message"])
