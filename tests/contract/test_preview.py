"""The finder of another package keeps the contract of its role: pdcd itself has none so far."""

from __future__ import annotations

import pytest

from pdcd.testing import PreviewContract
from tests.places import ROOT


class TestStrangersFinder(PreviewContract):
    """Small grey pictures of a card."""

    driver = "stranger"

    @pytest.fixture(autouse=True)
    def package(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for package in ("stranger_driver", "stranger_samples"):
            monkeypatch.syspath_prepend(str(ROOT / "tests" / "data" / package))
