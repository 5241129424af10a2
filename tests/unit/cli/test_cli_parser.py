"""What can be typed: every command, option and value."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import pytest

from pdcd.cli.parser import EXIT_CODES, actions_of, build_parser, list_subparsers

PARSER = build_parser()
EVERY = {command.prog.removeprefix("pdcd "): command for command in list_subparsers(PARSER)}


def test_every_command_says_what_it_does_and_how_it_may_end() -> None:
    assert PARSER.prog == "pdcd" and PARSER.epilog == EXIT_CODES
    assert PARSER.description is not None and "projector" in PARSER.description
    for name, parser in EVERY.items():
        assert parser.description and parser.epilog == EXIT_CODES, name


def test_no_help_has_a_mark_of_the_table() -> None:
    for name, parser in EVERY.items():
        usage = " ".join(parser.format_usage().split())
        assert usage.startswith(f"usage: pdcd {name} "), usage
        for action in actions_of(parser):
            assert not {*"<>@!="} & {*str(action.help)}, (name, action.dest)


@pytest.mark.parametrize(
    "line",
    ["--vers", "serve --sock x", "capture white --loc", "runs --stat x",
     "runs show r --js", "doctor", "doctor trigger --cl", "figures", "row f", "export f",
     "row f --cell 1", "wait", "", "show stripes", "export f --format gif", "completion sh",
     "capture white --guards --no-guards",
     "capture white --no-guards --schedule full", "capture white --method dark",
     "transport --method pairs", "transport white",
     "capture white --plane 1 2", "capture white --shift 1", "capture white --keep up",
     "runs --goal sideways", "web --port x", "row f --cell a b", "snr --iso 1.5",
     "capture white --pilot much", "capture white --codes 1.5"],
)  # fmt: skip
def test_what_is_cut_short_missing_or_unknown_is_refused(line: str) -> None:
    with pytest.raises(SystemExit) as end:
        PARSER.parse_args(line.split())
    assert end.value.code == 2


def test_two_dashes_are_the_value_of_no_option(capsys: pytest.CaptureFixture[str]) -> None:
    for name, command in EVERY.items():
        for action in actions_of(command):
            if action.option_strings and action.nargs != 0:
                option = action.option_strings[-1]
                with pytest.raises(SystemExit) as end:
                    PARSER.parse_args([*name.split(), f"{option}=--"])
                said = " ".join(capsys.readouterr().err.split())
                assert end.value.code == 2, (name, option)
                # Of several values it is too few.
                assert f"{'/'.join(action.option_strings)} takes " in said, said


def test_every_command_has_a_function() -> None:
    found = {str(parser.get_default("run")) for parser in EVERY.values()} - {"None", "-"}
    assert len(found) > 20
    for place in found:
        module, _, function = place.partition(":")
        assert callable(getattr(importlib.import_module(f"pdcd.cli.{module}"), function)), place


def test_a_plan_takes_what_a_capture_takes() -> None:
    planned, taken = (
        vars(PARSER.parse_args([command, "white"])) for command in ("plan", "capture")
    )
    del planned["run"]
    del planned["command"]
    assert planned == {name: taken[name] for name in planned}
    assert set(taken) - set(planned) == {"out", "detach", "command", "run"} - set(planned)


TYPED: dict[str, dict[str, Any]] = {
    "capture white --config c --socket s --json --local --codes 4 --pilot 8 --smooth --parts 2": {
        "config": Path("c"), "socket": Path("s"), "json": True, "local": True, "codes": 4,
        "pilot": 8, "smooth": True, "parts": 2,
    },
    "capture white --pilot auto --parts auto --no-smooth --until-error 2% --error 50%": {
        "pilot": "auto", "parts": "auto", "smooth": False, "until_error": 0.02, "error": 0.5,
    },
    "capture white --confidence 95% --seconds 1.5 --prior p --repeat 3 --shift -1 2 --radius 4": {
        "confidence": 0.95, "seconds": 1.5, "prior": "p", "repeat": 3, "shift": [-1, 2],
        "radius": 4,
    },
    "capture white --mix 0.5 -1 --period 8 --disparity 3 --plane 1 2 3 4 5 6 7 8 9.5 --keep in": {
        "mix": [0.5, -1.0], "period": 8, "disparity": [3], "keep": "in",
        "plane": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.5],
    },
    "capture white --disparity 3 4 --rows 1 2 --masked --equal-brightness --exposure 0.5": {
        "disparity": [3, 4], "rows": [1, 2], "masked": True, "equal_brightness": True,
        "exposure_s": 0.5,
    },
    "capture white --illumination a --warp b --warp-b c --region-a d --region-b e --p 25%": {
        "illumination": Path("a"), "warp": Path("b"), "warp_b": Path("c"), "region_a": Path("d"),
        "region_b": Path("e"), "p": 0.25,
    },
    "capture white --disparities f --kernel g --matrix h --guards --tag a --tag b --seed 3": {
        "disparities": Path("f"), "kernel": Path("g"), "matrix": Path("h"), "guards": True,
        "tags": ["a", "b"], "seed": 3,
    },
    "capture white --no-guards --no-white --white-patch 0 0.5 --out d --detach --queue": {
        "guards": False, "white": False, "white_patch": [0.0, 0.5], "out": Path("d"),
        "detach": True, "queue": True,
    },
    "plan white --schedule lag --name n --note t --queue": {
        "guards": "lag", "name": "n", "note": "t", "queue": True,
    },
    "runs --config c --socket s --json show R --json": {
        "config": Path("c"), "socket": Path("s"), "json": True, "run_name": "R",
    },
    "runs show R --config c --socket s --state-dir d --json": {
        "config": Path("c"), "socket": Path("s"), "state_dir": Path("d"), "json": True,
    },
    "export F --format npz --picture a --picture b --out d --upright --range 0 2 --force": {
        "format": "npz", "picture": ["a", "b"], "out": Path("d"), "upright": True,
        "range": [0.0, 2.0], "force": True,
    },
    "virtual-camera --port 1 --scene book --small": {"port": 1, "scene": "book", "small": True},
    "figures 1 appendix --out d --full --no-plots --workers 3": {
        "number": ["1", "appendix"], "full": True, "plots": False, "workers": 3,
    },
}  # fmt: skip


@pytest.mark.parametrize("line", TYPED)
def test_what_is_typed_arrives_as_what_it_is(line: str) -> None:
    told = vars(PARSER.parse_args(line.split()))
    wanted = TYPED[line]
    assert {name: told[name] for name in wanted} == wanted
    assert {name: type(told[name]) for name in wanted} == {
        name: type(value) for name, value in wanted.items()
    }
