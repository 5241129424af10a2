"""From the pictures of a run to the verdict on it.

Each group of causes has a module that computes its figures: shots, panels, matrices, the answer.
Findings that explain why a photo is bad come before those that follow from them.
"""

from __future__ import annotations

import itertools

from pdcd.pictures.decoded_run import DecodedRun
from pdcd.probing.deviation import Deviation
from pdcd.protocol.result import Quality
from pdcd.runs.record import RunRecord
from pdcd.verdict.answer import judge_answer
from pdcd.verdict.causes import VerdictFinding, combine_findings
from pdcd.verdict.evidence import Evidence
from pdcd.verdict.matrices import judge_matrices
from pdcd.verdict.panels import judge_panels
from pdcd.verdict.shots import judge_shots


def assess_run(record: RunRecord, decoded: DecodedRun, deviations: dict[str, Deviation]) -> Quality:
    """The verdict on a run that was decoded; `deviations` are those of its photos. Called by the
    worker, once the pictures are made."""
    if record.cells is None:
        return combine_findings([])
    seen = Evidence(record, record.cells, decoded, deviations)
    looks = (judge_shots, judge_panels, judge_matrices, judge_answer)
    return combine_findings(itertools.chain.from_iterable(look(seen) for look in looks))


def assess_places(record: RunRecord, decoded: DecodedRun) -> list[VerdictFinding]:
    """The part of the verdict that is about where panels and camera are. For the acceptance test of
    a bench, which has a row for it."""
    if record.cells is None:
        return []
    return list(judge_panels(Evidence(record, record.cells, decoded, {})))
