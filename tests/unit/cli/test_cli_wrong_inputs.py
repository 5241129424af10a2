"""Wrong inputs: each is answered in two lines at most, with the option's name and what to type."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import get_args

import pytest

from pdcd.cli.main import main
from pdcd.meant import suggest_number, suggest_pair, suggest_word
from pdcd.words import GoalName

CONFIGS = {
    "slow": "[mask]\nrise_s = 4",
    "size": '[projector]\nsize_px = "1920x1080"',
    "key": "[mask]\nrise = 1",
    "none": "mask = [",
    "photo": '[[photo]]\ngaol = "white"',
    "plain": 'scene = "open-book"',
    "word": '[schedule]\nfamily = "hadamrd"',
    "clock": '[camera]\ndriver = "ptp"',
    "output": '[rig]\nclock = "real"\n[display]\ndriver = "x11"\n'
    '[display.options]\nprojector = "HDMI-1"\nmask = "HDMI-1"',
}
"""Files of configurations by their names."""

ALL_GOALS = "white, indirect, direct"
WRONG: dict[str, tuple[int, str, str]] = {
    # Commands and goals.
    "": (2, "COMMAND", "type one of serve, capture"),
    "--verison": (2, "--verison", "type --version)"),
    "runs --newest 5": (2, "--newest", "type pdcd runs --help)"),
    "runs o": (2, "'o'", "type pdcd runs --state-dir o)"),
    "config check slow.toml": (2, "'slow.toml'", "type --config slow.toml)"),
    "capture": (2, "GOAL", f"type one of {ALL_GOALS}"),
    "capture indirec": (2, "GOAL", "type indirect)"),
    "capture sideways": (2, "GOAL", f"type one of {ALL_GOALS}"),
    "capture indirect direct": (2, "'direct'", "type pdcd capture --help"),
    "show gird": (2, "PATTERN", "type grid)"),
    "completion tcsh": (2, "shell", "type one of bash, zsh, fish"),
    "calibrate geometri --local": (2, "geometri", "steps are sensor, light, geometry"),
    "figures 99 --out d": (2, "figure 99", "one of 1, 5, 7"),
    "wait": (2, "JOB", "type pdcd wait JOB"),
    # Options that there are not, and values that were left out.
    "capture indirect --code 64": (2, "--code", "type --codes)"),
    "capture --goal indirect": (2, "--goal", "type pdcd capture GOAL, without --goal)"),
    "capture indirect --iso 100": (2, "--iso", "type pdcd capture --help)"),
    "capture indirect -codes 64": (2, "-codes", "type --codes)"),
    "capture indirect --codes": (2, "--codes", "type --codes K)"),
    "export r": (2, "--format", "type --format {exr,tiff16"),
    "row r": (2, "--cell", "type --cell ROW COLUMN)"),
    "capture off-diagonal --shift 0,1": (2, "--shift", "type --shift DOWN RIGHT)"),
    # Words in the place of others.
    "export r --format tif": (2, "--format", "type tiff16)"),
    "capture indirect --family hadamrd": (2, "--family", "type hadamard)"),
    "capture indirect --prior scene:book --local": (2, "prior", "open-book"),
    "capture indirect --prior gauss --local": (2, "--prior takes", "scene:NAME, decay:CELLS"),
    "capture indirect --prior decay:x --local": (2, "prior", "decay:3"),
    # Numbers.
    "capture indirect --codes many": (2, "--codes", "a whole number from 1 to 65536"),
    "capture indirect --codes 1e3": (2, "--codes", "type --codes 1000)"),
    "capture indirect --codes 64.0": (2, "--codes", "type --codes 64)"),
    "capture indirect --codes 1,024": (2, "--codes", "type --codes 1024)"),
    "capture indirect --codes 0": (2, "--codes", "takes a whole number from 1 to 65536"),
    "capture indirect --error 1": (2, "--error takes", "type --error 1% for 0.01)"),
    "capture fraction --p 50": (2, "--p takes", "type --p 50% for 0.5)"),
    "capture indirect --error 1.5%%": (2, "--error takes", "type --error 0.015)"),
    "capture indirect --error 5 %": (2, "%", "such as 5%"),
    "capture indirect --exposure 30s": (2, "--exposure takes", "type --exposure 30)"),
    "capture indirect --exposure 1/30": (2, "--exposure takes", "type --exposure 0.0333333)"),
    "capture indirect --seconds 2m": (2, "--seconds takes", "type --seconds 120)"),
    "capture indirect --seconds 1:30": (2, "--seconds takes", "type --seconds 90)"),
    "capture indirect --seconds 0,5": (2, "--seconds takes", "type --seconds 0.5)"),
    "transport --rows 12-20": (2, "--rows takes", "type --rows 12 20)"),
    "capture indirect --pilot some": (2, "--pilot takes", "4096 or auto"),
    "capture indirect --seed -1": (2, "--seed takes", "from 0 to"),
    "virtual-camera --port http": (2, "--port takes", "type --port N)"),
    "virtual-camera --port 99999": (2, "--port", "between 0 and 65535"),
    "snr --iso 123": (2, "ISO 123", "choose one of 100, 200"),
    "runs --since yesterday": (2, "--since", "2026-01-31"),
    # Texts and files.
    "capture indirect --name a/b": (2, "--name takes", "letters, digits"),
    "capture indirect --tag 'two words'": (2, "--tag takes", "letters, digits"),
    "capture illuminated --illumination no.png --local": (2, "--illumination", "see whether it is"),
    "capture indirect --codes-from slow.toml --local": (2, "--codes-from", "numpy.savez"),
    "capture indirect --config gone.toml": (2, "--config", "give an existing file"),
    # What goes with nothing else that was typed.
    "capture white --radius 3 --local": (2, "takes no --radius", "leave it out"),
    "capture long-range --local": (2, "--radius", "give --radius, which takes a whole number"),
    "capture indirect --out slow.toml --local": (2, "--out", "name another folder"),
    "compare white --local": (2, "white", "it does direct, indirect, fraction"),
    "capture indirect --local --detach": (2, "--detach", "no daemon"),
    "runs prune": (2, "runs", "--older-than, --failed and --keep"),
    "web --host 0.0.0.0": (2, "0.0.0.0", "leave --host out"),
    # Folders that are no runs.
    "decode o": (5, "o holds runs", "such as o/20260102T000000Z-0000"),
    "report o": (5, "o holds runs", "such as o/20260102T000000Z-0000"),
    "decode gone": (5, "gone", "see pdcd runs"),
    "report slow.toml": (5, "slow.toml is a file", "name the folder"),
    "batch slow.toml --local": (2, "mask", "[[photo]] for each"),
    "batch photo.toml --local": (2, "gaol", "is goal meant?"),
    "runs show nope": (2, "nope", "see pdcd runs"),
    # Configurations.
    "config check --config slow.toml": (2, "mask.rise_s", "write 0.004"),
    "config check --config size.toml": (2, "projector.size_px", "write size_px = [1920, 1080]"),
    "config check --config key.toml": (2, "mask.rise", "is rise_s meant?"),
    "config check --config plain.toml": (2, "scene", "write [scene]"),
    "config check --config none.toml": (2, "none.toml", "pdcd config show"),
    "config check --config word.toml": (2, "schedule.family", 'write family = "hadamard"'),
    "config check --config clock.toml": (2, "camera", 'set rig.clock = "real"'),
    "config check --config output.toml": (2, "HDMI-1", "name the one of the mask"),
}
"""By what was typed: exit code, which option it is about, and what to do."""


@pytest.fixture(autouse=True)
def _here(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in CONFIGS.items():
        Path(f"{name}.toml").write_text(text)
    for day in (1, 2):
        run = Path(f"o/2026010{day}T000000Z-0000")
        run.mkdir(parents=True)
        (run / "capture.json").write_text("{}")


@pytest.mark.parametrize("line", WRONG)
def test_a_wrong_input_is_answered_in_two_lines(
    line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, named, advice = WRONG[line]
    try:
        found = main(shlex.split(line))
    except SystemExit as ended:
        assert isinstance(ended.code, int)
        found = ended.code
    lines = [each for each in capsys.readouterr().err.splitlines() if "planning" not in each]
    assert found == code and 1 <= len(lines) <= 2
    last = lines[-1] if lines[-1].startswith("pdcd") else " ".join(lines)
    assert named in last and advice in last, last
    if len(lines) == 2 and lines[0].startswith("usage"):
        command = "" if named == "COMMAND" or line.startswith("-") else line.split()[0]
        assert lines[0].startswith(f"usage: pdcd {command}")


def test_a_folder_of_runs_is_told_from_a_damaged_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", "o", "--json"]) == 5
    (finding,) = json.loads(capsys.readouterr().out)["findings"]
    assert finding["detail"].endswith("this folder holds runs, such as 20260102T000000Z-0000")


def test_what_was_meant_is_guessed_only_where_it_is_near() -> None:
    assert suggest_word("diagnal", get_args(GoalName)) == "diagonal"
    assert suggest_word("sideways", get_args(GoalName)) == ""
    assert suggest_pair("1920 x 1080") == ("1920", "1080") and suggest_pair("1.5x2") is None
    for text, whole, number in (
        ("30 s", False, "30"), ("250ms", False, "0.25"), ("2h", True, "7200"),
        ("50%", False, "0.5"),
        ("1/0", False, ""), ("1,5", True, ""), ("1.5", True, ""), ("x", False, ""), ("", True, ""),
        ("nan", False, ""), ("1e99", True, ""),
    ):  # fmt: skip
        assert suggest_number(text, whole=whole) == number, text
