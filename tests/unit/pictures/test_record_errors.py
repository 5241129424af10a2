"""What a forged record makes of the decoding is an error of the run; other errors stay."""

from __future__ import annotations

from pathlib import Path

import pytest

from pdcd.errors import ConfigError, DecodeError, DiskError, NoSpaceError, PdcdError
from pdcd.pictures.decode import convert_record_errors
from pdcd.watch import Watch


@pytest.mark.parametrize(
    ("error", "says"),
    [
        (ConfigError("no place", hint="mend it"), "its record is wrong: no place"),
        (ValueError("odd"), "its record does not fit its files: ValueError: odd"),
        (KeyError("shot"), "its record does not fit its files: KeyError: 'shot'"),
        (ZeroDivisionError("x"), "ZeroDivisionError: x"),
    ],
)
def test_faults_of_a_record_are_those_of_its_run(error: Exception, says: str) -> None:
    with pytest.raises(DecodeError) as caught, convert_record_errors(Path("/run")):
        raise error
    assert caught.value.message.startswith("/run: ") and says in caught.value.message
    assert caught.value.__cause__ is error
    assert caught.value.hint == ("mend it" if isinstance(error, ConfigError) else FAULT)


FAULT = "if pdcd wrote this run, this is a fault of the program"


@pytest.mark.parametrize(
    "error",
    [
        *(NoSpaceError("full"), DiskError("no"), DecodeError("lost"), PdcdError("x")),
        *(OSError("gone"), KeyboardInterrupt()),
    ],
)
def test_other_errors_stay_as_they_are(error: BaseException) -> None:
    with pytest.raises(type(error)) as caught, convert_record_errors(Path("/run")):
        raise error
    assert caught.value is error


def test_a_watch_hears_every_sign_of_life_and_what_is_worked_on() -> None:
    signs: list[None] = []
    told: list[tuple[float, float]] = []
    watch = Watch(lambda: signs.append(None), lambda done, total: told.append((done, total)))
    assert watch.stage == ""
    watch()
    watch.step(1.0, 3.0)
    assert (len(signs), told) == (1, [(1.0, 3.0)])
    watch.expect(2.0)
    watch.expect(2.0)
    watch.did(1.0)
    assert told[-1] == (1.0, 4.0) and len(signs) == 2
    with watch.piece(1.0) as alive:
        alive()
    assert told[1:] == [(1.0, 4.0), (1.1, 4.0), (2.0, 4.0)]
    short = Watch(step=lambda done, total: told.append((done, total)))
    short.expect(0.5)
    short.did(0.25)
    assert told[-1] == (0.25, 0.5)
