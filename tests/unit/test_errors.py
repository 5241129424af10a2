"""What the system refuses, as an error that says what to do."""

from __future__ import annotations

import errno

import pytest

from pdcd.errors import BusyError, DiskError, NoSpaceError, PdcdError, disk_errors


@pytest.mark.parametrize(
    ("number", "kind", "hint"),
    [
        (errno.ENOSPC, NoSpaceError, "free some space"),
        (errno.EDQUOT, NoSpaceError, "free some space"),
        (errno.EMFILE, BusyError, "raise LimitNOFILE"),
        (errno.ENFILE, BusyError, "try again"),
        (errno.EROFS, DiskError, "check folder and rights"),
    ],
)
def test_each_refusal_of_the_system_is_told_by_what_mends_it(
    number: int, kind: type[PdcdError], hint: str
) -> None:
    with pytest.raises(kind) as caught, disk_errors("/runs"):
        raise OSError(number, "why")
    assert caught.value.device == "/runs" and hint in str(caught.value.hint)
