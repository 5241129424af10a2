"""The soak's own parts: orders to devices, processes as the kernel shows them, the table."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pdcd.errors import DeviceLost
from pdcd.recipes.goals import KEEPS, OFF_AXIS_GOALS
from tests.bench.report import write, write_soak
from tests.soak import processes
from tests.soak.daemon import FAULT, Faulty
from tests.soak.lapse import Lapse, stolen_s
from tests.soak.tally import Tally
from tests.soak.wanted import requests


class Shutter:
    """A device with one call and one property."""

    maturity = "stable"

    def open(self) -> int:
        return 7


@pytest.mark.parametrize(("how", "error"), [("raise", DeviceLost), ("crash", RuntimeError)])
def test_an_order_spoils_the_call_that_it_names_and_counts_once(
    tmp_path: Path, how: str, error: type[Exception]
) -> None:
    order = tmp_path / FAULT
    device = Faulty(Shutter(), "shutter", order)
    order.write_text(json.dumps({"role": "display", "call": "open", "how": how}))
    assert device.open() == 7 and device.maturity == "stable"
    order.write_text(json.dumps({"role": "shutter", "call": "open", "how": how}))
    with pytest.raises(error):
        device.open()
    assert device.open() == 7 and not order.exists()


def test_a_family_is_seen_and_its_end_too_whatever_its_name() -> None:
    strange = "open('/proc/self/comm', 'wb').write(b'\\xff) Z'); input()"
    with subprocess.Popen([sys.executable, "-c", strange, b"\xff"], stdin=subprocess.PIPE) as child:
        comm = Path(f"/proc/{child.pid}/comm")
        while not comm.read_bytes().startswith(b"\xff"):
            time.sleep(0.01)
        assert child.pid in processes.family(os.getpid())
        assert processes.gone({child.pid}, 0.0) == {child.pid}
        child.communicate(b"\n")
        assert processes.gone({child.pid}, 10.0) == set()


def test_the_table_tells_counts_and_names_what_broke(tmp_path: Path) -> None:
    tally = Tally(captures=3, kills=2, answers_s=[0.001] * 98 + [0.2, 0.4])
    tally.row("kill -9 the daemon").ends["failed"] += 1
    tally.promise(True, "kept")
    tally.promise(False, "a shutter stayed open")
    table = tally.table()
    assert "1 ms / 200 ms / 400 ms, 100 answers" in table
    assert "| kill -9 the daemon | 0 | 0 / 1 / 0 |" in table
    assert "BROKEN: a shutter stayed open" in table and "kept" not in table
    report = tmp_path / "report.md"
    report.write_text("# Report\n\nfigures\n\n## Soak\n\nof last time\n")
    write_soak(report, table)
    assert report.read_text() == f"# Report\n\nfigures\n\n## Soak\n\n{table}"


def test_a_new_report_keeps_what_others_have_measured(tmp_path: Path) -> None:
    report = tmp_path / "report.md"
    kept = "## By subject\n\n### Planning\n\n## Soak\n\nof last time\n"
    report.write_text(f"# Report\n\nold figures\n\n{kept}")
    write(report, [], [], "plots")
    told = report.read_text()
    assert told.endswith(f"\n\n{kept}") and "old figures" not in told


def test_honest_clients_want_every_goal_of_their_bench() -> None:
    assert {request.goal for request in requests()} == set(KEEPS) - set(OFF_AXIS_GOALS)


def test_time_that_the_host_withholds_counts_for_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    withheld_s = 0.0
    monkeypatch.setattr("tests.soak.lapse.stolen_s", lambda: withheld_s)
    lapse = Lapse()
    time.sleep(0.02)
    assert 0.02 <= lapse.own_s <= lapse.whole_s
    withheld_s = 0.015
    assert lapse.own_s <= lapse.whole_s - 0.0149
    withheld_s = 60.0
    assert lapse.own_s == 0.0
    monkeypatch.undo()
    assert 0.0 <= stolen_s() < time.clock_gettime(time.CLOCK_BOOTTIME)
