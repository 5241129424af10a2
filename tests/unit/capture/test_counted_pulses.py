"""Pulses that a camera counts, of displays and cameras of strangers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pdcd.bench.devices import PhotoFrame, RawFile
from pdcd.capture.exposure import verify_times
from pdcd.errors import PhotoError
from tests.frame_logs import make_log

LOG = replace(make_log(4), verified=False, pulses=(3, 2), pulses_hint="look at the panels' plug")
PHOTO = PhotoFrame(
    np.zeros((2, 2), np.uint16), 0, 255, 100, 1.0, pulses=(3, 2), pulses_hint="name the sockets"
)


def test_only_right_counts_of_both_prove_times() -> None:
    assert verify_times(LOG, PHOTO).verified
    assert not verify_times(replace(LOG, pulses=None), PHOTO).verified
    assert not verify_times(LOG, replace(PHOTO, pulses=None)).verified
    assert not verify_times(LOG, RawFile(Path("a.cr2"), 1, "")).verified


def test_wrong_counts_are_told_in_the_words_of_both_drivers() -> None:
    wrong = replace(PHOTO, pulses=(3, 1))
    with pytest.raises(PhotoError, match="1 of the mask") as told:
        verify_times(LOG, wrong)
    assert told.value.hint == "look at the panels' plug; name the sockets"
    with pytest.raises(PhotoError) as told:
        verify_times(replace(LOG, pulses_hint=""), replace(wrong, pulses_hint=""))
    assert told.value.hint and "options" not in told.value.hint
