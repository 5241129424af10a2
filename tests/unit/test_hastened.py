"""What test processes are spared refuses what the real one refuses."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.hastened import looked_at


def test_what_cannot_be_synced_is_refused_as_ever(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"1")
    for flags in (os.O_RDONLY, os.O_WRONLY):
        whole = os.open(tmp_path / "a", flags)
        looked_at(whole)
        os.close(whole)
    with pytest.raises(OSError, match="Bad file descriptor"):
        looked_at(whole)
    folder = os.open(tmp_path, os.O_RDONLY | os.O_DIRECTORY)
    looked_at(folder)
    os.close(folder)
    named = os.open(tmp_path / "a", os.O_PATH)
    with pytest.raises(OSError, match="Bad file descriptor"):
        looked_at(named)
    os.close(named)
    ends = os.pipe()
    with pytest.raises(OSError, match="Invalid argument"):
        looked_at(ends[1])
    for end in ends:
        os.close(end)
