"""What can be typed: every command, option and value, and what is taken where nothing is said."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import pytest

from pdcd.cli.parser import EXIT_CODES, actions_of, build_parser, list_subparsers

"""By command: its arguments, then its options, group by group."""
PARSER = build_parser()
EVERY = {command.prog.removeprefix("pdcd "): command for command in list_subparsers(PARSER)}
"""What its name or its choices alone explain."""


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


NOTHING: dict[str, Any] = dict.fromkeys(
    """config socket codes pilot smooth grey_masks parts until_error error confidence seconds prior
    codes_from shift radius mix period disparity plane keep rows illumination warp warp_b region_a
    region_b disparities kernel matrix family p exposure_s window guards black_level normalise
    white_patch name tags out""".split()
)
USUAL = {
    **NOTHING, "local": False, "repeat": 1, "masked": None, "equal_brightness": False, "seed": 0,
    "white": True, "note": "", "keep_raw": None,
}  # fmt: skip
ANY_RIG: dict[str, Any] = {"config": None, "socket": None}
LISTED: dict[str, Any] = {
    **ANY_RIG, "state_dir": None, "list_goal": None, "list_since": None, "list_tags": None,
    "list_failed": False, "list_all": False,
}  # fmt: skip
FILTERED = {"goal": None, "since": None, "tags": None, "failed": False}
EXPORTED = {
    "format": "exr", "picture": None, "out": Path(), "upright": False, "white_patch": None,
    "range": None, "force": False,
}  # fmt: skip
DEFAULTS: dict[str, dict[str, Any]] = {
    "serve": {**ANY_RIG, "state_dir": None, "background": False, "verbose": False},
    "capture white": {**USUAL, "goal": "white", "method": "coded", "detach": False, "queue": False},
    "transport": {**USUAL, "goal": "transport", "detach": False, "queue": False},
    "compare direct": {**USUAL, "goal": "direct"},
    "demo": {"out": Path("demo"), "codes": None, "seed": 0},
    "status": ANY_RIG,
    "watch": {**ANY_RIG, "job": None},
    "cancel": {**ANY_RIG, "job": None},
    "runs": {**LISTED, "runs_command": None},
    "runs show R": {**LISTED, "runs_command": "show", "run_name": "R"},
    "runs export R --format exr": {**LISTED, "runs_command": "export", "run_name": "R", **EXPORTED},
    "runs verify": {**LISTED, "runs_command": "verify", "run_name": [], **FILTERED},
    "runs prune": {
        **LISTED, "runs_command": "prune", **FILTERED, "older_than": None, "keep": None,
        "dry_run": False, "yes": False,
    },
    "wait J": {**ANY_RIG, "job": "J"},
    "web": {**ANY_RIG, "state_dir": None, "host": "127.0.0.1", "port": 8137},
    "drivers": {},
    "doctor display": {"doctor_command": "display", "config": None, "display": None},
    "doctor camera": {"doctor_command": "camera", "config": None, "raw": None},
    "doctor trigger": {"doctor_command": "trigger", "config": None, "click": False, "seconds": 1.0},
    "doctor bench": {"doctor_command": "bench", "config": None, "page": None, "out": None},
    "calibrate": {
        **ANY_RIG, "step": [], "scene": False, "marks": "auto", "anew": False, "again": None,
        "out": None, "yes": False, "queue": False, "local": False,
    },
    "show": {
        **ANY_RIG, "pattern": "grid", "index": 0, "loop": False, "out": None, "seconds": None,
        "detach": False,
    },
    "timing": {"frames": 3000, "out": None, "config": None},
    "config check": {"action": "check", "config": None},
    "decode F": {"folder": Path("F"), "partial": False, "out": None},
    "verify F": {"folder": [Path("F")], "manifest_sha256": None},
    "export F --format exr": {"folder": Path("F"), **EXPORTED},
    "report F": {"folder": Path("F"), "out": None},
    "row F --cell 1 2": {"folder": Path("F"), "cell": [1, 2], "photo": None, "out": None},
    "virtual-camera": {"port": 15740, "scene": "chart", "small": False},
    "figures --out D": {
        "number": [], "out": Path("D"), "quick": False, "full": False, "plots": True,
        "workers": None, "profile": "450d",
    },
    "snr": {
        "profile": "modern", "iso": None, "codes": 512, "exposure": 30.0, "signal": None,
        "transmission": 1.0,
    },
    "version": {},
    "completion zsh": {"shell": "zsh"},
    "man": {},
}  # fmt: skip


@pytest.mark.parametrize("line", DEFAULTS)
def test_what_is_not_typed_is_left_as_documented(line: str) -> None:
    told = vars(PARSER.parse_args(line.split()))
    module, _, function = told.pop("run").partition(":")
    assert callable(getattr(importlib.import_module(f"pdcd.cli.{module}"), function))
    assert told == {**DEFAULTS[line], "json": False, "command": line.split()[0]}


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
    "capture white --pilot auto --parts auto --no-smooth --until-error 2% --error 0.5": {
        "pilot": "auto", "parts": "auto", "smooth": False, "until_error": 0.02, "error": 0.5,
    },
    "capture long-range --no-grey-masks": {"goal": "long-range", "grey_masks": False},
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
    "compare white --out d": {"out": Path("d")},
    "transport --rows 3 --masked": {"rows": [3], "masked": True},
    "serve -v --state-dir d": {"verbose": True, "state_dir": Path("d")},
    "demo --out d --codes 8 --seed 3": {"out": Path("d"), "codes": 8, "seed": 3},
    "runs --all --goal white --since 1d --tag a --failed --state-dir d": {
        "list_all": True, "list_goal": "white", "list_since": "1d", "list_tags": ["a"],
        "list_failed": True, "state_dir": Path("d"),
    },
    "runs --config c --socket s --json show R --json": {
        "config": Path("c"), "socket": Path("s"), "json": True, "run_name": "R",
    },
    "runs show R --config c --socket s --state-dir d --json": {
        "config": Path("c"), "socket": Path("s"), "state_dir": Path("d"), "json": True,
    },
    "runs prune --goal white --since 1d --tag a --tag b --failed --older-than 2w --keep 3": {
        "goal": "white", "since": "1d", "tags": ["a", "b"], "failed": True, "older_than": "2w",
        "keep": 3,
    },
    "runs prune --dry-run --yes": {"dry_run": True, "yes": True},
    "runs verify a b": {"run_name": ["a", "b"]},
    "web --state-dir d --host ::1 --port 0": {"state_dir": Path("d"), "host": "::1", "port": 0},
    "doctor display --display :7 --config c --json": {
        "display": ":7", "config": Path("c"), "json": True,
    },
    "doctor camera --raw r": {"raw": Path("r")},
    "doctor trigger --click --seconds 2": {"click": True, "seconds": 2.0},
    "calibrate lag --scene --marks xor --anew --again f --out d --yes --queue --local": {
        "step": ["lag"], "scene": True, "marks": "xor", "anew": True, "again": Path("f"),
        "out": Path("d"), "yes": True, "queue": True, "local": True,
    },
    "show code --index 3 --loop --out p --seconds 2 --detach": {
        "pattern": "code", "index": 3, "loop": True, "out": Path("p"), "seconds": 2.0,
        "detach": True,
    },
    "timing --frames 9 --out p --config c": {"frames": 9, "out": Path("p"), "config": Path("c")},
    "config show --config c": {"action": "show", "config": Path("c")},
    "decode F --partial --out d --json": {"partial": True, "out": Path("d"), "json": True},
    "verify F G --manifest-sha256 ab": {"folder": [Path("F"), Path("G")], "manifest_sha256": "ab"},
    "export F --format npz --picture a --picture b --out d --upright --range 0 2 --force": {
        "format": "npz", "picture": ["a", "b"], "out": Path("d"), "upright": True,
        "range": [0.0, 2.0], "force": True,
    },
    "report F --out f": {"out": Path("f")},
    "row F --cell 1 2 --photo p --out f": {"photo": "p", "out": Path("f")},
    "virtual-camera --port 1 --scene book --small": {"port": 1, "scene": "book", "small": True},
    "figures 1 appendix --out d --full --no-plots --workers 3": {
        "number": ["1", "appendix"], "full": True, "plots": False, "workers": 3,
    },
    "figures --out d --quick": {"quick": True},
    "snr --profile p --iso 100 --codes 4 --exposure 2 --signal 5 --transmission 80%": {
        "profile": "p", "iso": 100, "codes": 4, "exposure": 2.0, "signal": 5.0,
        "transmission": 0.8,
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
