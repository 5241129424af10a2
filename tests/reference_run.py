"""The reference run of the repository: take it again, and write what it is expected to give.

`python -m tests.reference_run` takes it anew by `examples/reference-run/bench.toml`, puts it in
place of the one that is there, and writes `expected.json` beside it.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import pdcd
from pdcd.api.run import Run
from tests.places import ROOT

FOLDER = ROOT / "examples" / "reference-run"
RUN, EXPECTED, BENCH = FOLDER / "run", FOLDER / "expected.json", FOLDER / "bench.toml"
PANELS = ("projector", "mask")
SUMMARY = (
    "codes", "parts", "exposure_s", "missed_refreshes", "sigma_kind", "rms_sigma",
    "rms_error_quads", "rms_error_cells",
)  # fmt: skip
ASKED: dict[str, Any] = {"codes": 128, "pilot": 0, "parts": 4, "seed": 0}


def take_run() -> Run:
    """Take the photo of the reference run; it goes below the usual state folder."""
    with pdcd.local(BENCH) as bench:
        return bench.capture("indirect", progress=False, **ASKED)


def measure_pictures(pictures: Mapping[str, NDArray[Any]]) -> dict[str, dict[str, float]]:
    """A few numbers of every picture, in scene units, float64."""
    return {
        name: {
            "mean": float(np.mean(picture, dtype=np.float64)),
            "rms": float(np.sqrt(np.mean(np.square(picture, dtype=np.float64)))),
            "least": float(np.min(picture)),
            "most": float(np.max(picture)),
        }
        for name, picture in sorted(pictures.items())
    }


def describe_run(run: Run) -> dict[str, Any]:
    """What is expected of a run."""
    return {
        "job": run.job,
        "manifest_sha256": run.manifest_sha256,
        "codes_sha256": _hash(
            {
                f"{name}.{panel}": getattr(one, panel)
                for name, one in run.codes.items()
                for panel in PANELS
            }
        ),
        "frames_sha256": _hash(run.frames),
        "verdict": run.verdict,
        "summary": {name: run.summary[name] for name in SUMMARY},
        "pictures": measure_pictures(run.pictures),
        "sigma_rms": float(np.sqrt(np.mean(run.sigma**2))),
    }


def _hash(arrays: Mapping[str, NDArray[Any]]) -> str:
    """Of what every machine makes alike: names and numbers, whatever the file they came in."""
    digest = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        plain = array.astype("<U32" if array.dtype.kind == "U" else "<i8")
        digest.update(name.encode() + str(plain.shape).encode() + plain.tobytes())
    return digest.hexdigest()


def main() -> None:
    """Take the run anew. Its state folder is the default one, so that no path gets into it."""
    with tempfile.TemporaryDirectory() as home:
        os.environ["XDG_STATE_HOME"] = home
        run = take_run()
        shutil.rmtree(RUN, ignore_errors=True)
        shutil.copytree(run.folder, RUN, ignore=shutil.ignore_patterns("report.html"))
    EXPECTED.write_text(json.dumps(describe_run(pdcd.open(RUN)), indent=1) + "\n")


if __name__ == "__main__":
    main()
