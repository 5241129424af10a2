"""Options of a driver: read into its struct, every fault named by its key."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
import pytest
from msgspec import Meta

from pdcd.bench.reading import read_options
from pdcd.errors import ConfigError


class Options(msgspec.Struct, frozen=True, kw_only=True):
    port: str
    baud: Annotated[int, Meta(ge=50)] = 9600
    line: Literal["rts", "dtr"] = "rts"
    places: dict[str, tuple[int, int]] = msgspec.field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.port == self.line:
            raise ValueError("port and line must differ")


def read(**given: Any) -> Options:
    return read_options(
        given, Options, table="trigger.options", device="shutter", hint="see cameras.md"
    )


def test_what_is_left_out_has_its_default() -> None:
    assert read(port="/dev/x", places={"a": [1, 2]}) == Options(port="/dev/x", places={"a": (1, 2)})


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"port": "p", "bauds": 1}, "bauds: no such key; is baud meant?"),
        ({"port": "p", "zzz": 1}, "zzz: no such key; known are port, baud, line, places"),
        ({}, "port: must be given"),
        ({"port": "p", "baud": "fast"}, "baud: expected int, got str"),
        ({"port": "p", "baud": 1}, "baud: expected int >= 50"),
        (
            {"port": "p", "line": "cts"},
            "line: invalid enum value 'cts'; allowed are rts, dtr; write line = \"rts\"",
        ),
        ({"port": "p", "places": {"a": [1, "b"]}}, "places[1]: expected int, got str"),
        ({"port": "rts"}, "port and line must differ"),
    ],
)
def test_a_fault_names_table_key_device_and_hint(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read(**given)
    assert caught.value.message == f"[trigger.options] {message}"
    assert (caught.value.device, caught.value.hint) == ("shutter", "see cameras.md")


def test_all_faults_are_told_at_once() -> None:
    with pytest.raises(ConfigError) as caught:
        read(bauds=1, line="cts")
    assert caught.value.message.splitlines() == [
        "[trigger.options] bauds: no such key; is baud meant?",
        "  [trigger.options] line: invalid enum value 'cts'; allowed are rts, dtr; "
        'write line = "rts"',
        "  [trigger.options] port: must be given",
    ]
