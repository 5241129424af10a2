"""What every Preview driver must do: a role that a bench may lack."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pdcd.bench.clock import VirtualClock
from pdcd.bench.devices import DriverContext, Preview
from pdcd.bench.registry import load_driver
from tests import bench_rig
from tests.places import ROOT


@pytest.fixture
def preview(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Preview:
    """The finder that is tested; another driver's test module overrides it."""
    for package in ("stranger_driver", "stranger_samples"):
        monkeypatch.syspath_prepend(str(ROOT / "tests" / "data" / package))
    context = DriverContext(bench_rig.config(tmp_path), VirtualClock())
    made: Preview = load_driver("preview", "stranger").create(context)
    return made


class PreviewContract:
    """Uses nothing but the Protocol."""

    def test_connect_says_what_it_is(self, preview: Preview) -> None:
        assert all(isinstance(said, str) for said in preview.connect().values())

    def test_pictures_are_bytes_grey_or_coloured(self, preview: Preview) -> None:
        preview.connect()
        for _ in range(2):
            picture = preview.grab(5.0)
            assert picture.dtype == np.uint8
            assert picture.ndim == 2 or (picture.ndim == 3 and picture.shape[2] == 3)
            assert 0 not in picture.shape

    def test_disconnect_twice(self, preview: Preview) -> None:
        preview.disconnect()
        preview.connect()
        preview.disconnect()
        preview.disconnect()


class TestStrangersFinder(PreviewContract):
    """Of another package: pdcd itself has none so far."""
