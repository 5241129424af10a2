"""The udev rules: well-formed as far as can be told here, and in their place among the others."""

from __future__ import annotations

import re
import subprocess

import pytest

from tests.places import ROOT
from tests.tools import needs, program

RULES = ROOT / "systemd" / "70-pdcd.rules"
_TERM = re.compile(
    r'(ACTION|SUBSYSTEM|GROUP|MODE|TAG|SYMLINK|(?:ENV|ATTR)\{[\w/]+\})(==|!=|=|\+=)"[^"]*"'
)


def lines(*, commented: bool) -> list[str]:
    """The rules, or those that are commented out."""
    text = [line for line in RULES.read_text(encoding="ascii").splitlines() if line]
    found = [line.removeprefix("#") for line in text if line.startswith("#ACTION")]
    return found if commented else [line for line in text if not line.startswith("#")]


@pytest.mark.parametrize("commented", [False, True])
def test_every_rule_is_terms_that_udev_knows(commented: bool) -> None:
    found = lines(commented=commented)
    assert len(found) == (2 if commented else 5)
    for line in found:
        for term in line.split(", "):
            assert _TERM.fullmatch(term), term


def test_access_is_for_the_group_and_the_seat_only() -> None:
    for line in lines(commented=False):
        for term in ('GROUP="plugdev"', 'MODE="0660"', 'TAG+="uaccess"'):
            assert term in line
    # 60-libgphoto2 sets what ours may clear; 73-seat-late acts on the tag.
    assert 60 < int(RULES.name.split("-")[0]) < 73


@needs("udevadm verify")
def test_udevadm_accepts_them() -> None:
    command = [program("udevadm verify"), "verify", str(RULES)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
