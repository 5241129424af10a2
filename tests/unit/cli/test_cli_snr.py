"""`pdcd snr`: its tables, its JSON object and its refusals."""

from __future__ import annotations

import json
import math
import re

import pytest

from pdcd.cli.main import main
from pdcd.sensor.appendix import compute_appendix_rows


def test_command_prints_all_three_tables(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["snr"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for row, line in zip(compute_appendix_rows(), lines[2:], strict=False):
        assert re.split(r"\s{2,}", line)[:2] == [row.quantity, row.printed]
    assert "sensor modern: Modern low-noise sensor, round numbers, estimated" in lines
    assert any(line.startswith("masked sum") and "18.76 dB" in line for line in lines)
    even = ["1", "1", "never", "< 0.0542 e-", "< 4.96 e-", "< 4.96 e-"]
    assert re.split(r"\s{2,}", lines[-4]) == even


def test_command_says_when_the_mask_never_pays(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["snr", "--codes", "2", "--json"]) == 0
    ideal = json.loads(capsys.readouterr().out)["break_even"][0]
    assert (ideal["read_noise_e"], ideal["verdict"]) == (None, "at any read noise")


def test_command_prints_one_json_object(capsys: pytest.CaptureFixture[str]) -> None:
    line = ["snr", "--profile", "mark2", "--iso", "1600", "--codes", "128", "--exposure", "6"]
    assert main([*line, "--signal", "900", "--transmission", "0.8", "--json"]) == 0
    out = capsys.readouterr().out
    assert out.count("\n") == 1
    told = json.loads(out)
    assert [row["quantity"] for row in told["appendix"]] == [
        row.quantity for row in compute_appendix_rows()
    ]
    assert (told["profile"], told["estimated"], told["iso"]) == ("mark2", True, 1600)
    assert told["pixel"] == {
        "signal_e": 900.0, "exposure_s": 6.0, "codes": 128, "dark_e_per_s": 0.25
    }  # fmt: skip
    photo = told["rows"][0]
    assert photo["signal_e"] == pytest.approx(720.0)
    assert photo["paper_db"] == pytest.approx(
        10 * math.log10(720 / math.sqrt(720 + 3.9**2 + (0.25 * 6) ** 2))
    )
    masks = {(row["light"], row["transmission"]) for row in told["break_even"]}
    assert masks == {(light, mask) for light in (1.0, 0.1) for mask in (1.0, 0.8, 0.5)}
    for row in told["break_even"]:
        read_noise_e = row["read_noise_e"]
        meets = f"below {read_noise_e:.3g} e-" if read_noise_e else "never"
        assert row["verdict"] == meets
        ideal_by_the_paper = ("masked", "paper", 1.0)
        assert (meets == "never") == (
            (row["goal"], row["thermal"], row["transmission"]) == ideal_by_the_paper
        )
