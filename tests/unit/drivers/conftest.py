"""The rigs that tests of one device share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.ptp_rig import PtpRig


@pytest.fixture
def rig() -> Iterator[PtpRig]:
    """A virtual 450D and the drivers that use it, connected."""
    rig = PtpRig()
    rig.connect()
    yield rig
    rig.disconnect_quietly()
