"""Finders keep the contract of their role: ours, and that of another package."""

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


class TestMockFinder(PreviewContract):
    """The mock bench as it stands."""

    driver = "mock"


class TestPtpFinder(PreviewContract):
    """Live view of the virtual EOS."""

    driver = "ptp"
    config = {"camera": {"driver": "ptp", "profile": "450d", "options": {"usb": "virtual"}}}  # noqa: RUF012
