"""What other commands make of finished runs, what they say without one, and `import pdcd`."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from tests.goldens.case import Bench, Case
from tests.goldens.keep import keep_export, keep_file, keep_run

BOOK = '[scene]\nkind = "open-book"\ngrid = [12, 16]\n'
PATTERNS = (
    "black", "white", "checker", "grid", "code", "projector", "mask", "pixels", "wedge", "star",
    "dots", "letter", "flash", "edge", "bar",
)  # fmt: skip
REFUSED = {
    "goal": "capture nonsense --local --json",
    "option": "capture indirect --nonsense --local --json",
    "number": "capture indirect --codes 0 --local --json",
    "no-file": "capture illuminated --illumination missing.npy --local --json",
    "no-config": "plan indirect --config missing.toml --local --json",
    "bad-config": "plan indirect --config bad.toml --local --json",
    "bad-text": "config check --config text.toml",
    "no-daemon": "status --socket nowhere --json",
    "no-run": "verify nowhere --json",
    "no-command": "nonsense",
    "local-socket": "capture indirect --local --socket s --json",
}


def cases() -> list[Case]:
    """All of them."""
    return [
        Case("commands/of-a-run", _take_run, 4.0),
        Case("commands/cut-run", _take_cut_run, 2.0),
        Case("commands/compare", _take_compare, 3.0),
        Case("commands/transport", _take_transport, 2.0),
        Case("commands/tables", _take_tables, 2.0),
        Case("commands/show", _take_shown, 5.0),
        Case("commands/refused", _take_refused, 1.0),
        Case("commands/python", _take_python, 4.0),
        Case("commands/sweep", _take_sweep, 4.0),
    ]


def _capture(bench: Bench, *words: str, tables: str = "") -> Path:
    bench.write("bench.toml", tables + BOOK)
    options = ["--local", "--json", "--config", "bench.toml", "--out", "runs"]
    said = bench.pdcd("capture", *words, *options)
    if said.folder is None:
        raise RuntimeError(said.err)
    return said.folder


def _take_run(bench: Bench) -> None:
    """Decode, verify, export, look at and list one run; then spoil it."""
    run = _capture(bench, *"indirect --codes 32 --parts 4 --name first --tag a".split())
    keep_run(bench, run)
    for name, words in {
        "decode": ("decode", str(run)),
        "verify": ("verify", str(run)),
        "row": ("row", str(run), "--cell", "5", "7", "--out", "row.png"),
        "row-white": ("row", str(run), "--cell", "0", "0", "--photo", "white", "--out", "w.png"),
        "report": ("report", str(run), "--out", "page.html"),
        "runs": ("runs", "--state-dir", "runs", "--all"),
        "runs-show": ("runs", "show", str(run)),
        "runs-tag": ("runs", "--state-dir", "runs", "--tag", "b"),
    }.items():
        bench.keep_said(name, bench.pdcd(*words, "--json"))
    for kind in ("exr", "tiff16", "png16", "npz"):
        for upright in ((), ("--upright",)):
            name = "-".join((kind, *upright)).replace("---", "-")
            options = ("--format", kind, "--out", name, *upright)
            said = bench.pdcd("export", str(run), *options, "--json")
            for path in sorted((bench.scratch / name).iterdir()):
                keep_export(bench, f"export/{name}/{path.name.removeprefix(run.name)}", path)
            bench.keep_said(f"export/{name}", said)
    for name in ("row.png", "w.png"):
        bench.keep_bytes(name, (bench.scratch / name).read_bytes())
    keep_file(bench, "page.html", (bench.scratch / "page.html").read_bytes(), page=True)
    with (run / "frames.csv").open("a") as file:
        file.write(" ")
    bench.keep_said("verify-spoilt", bench.pdcd("verify", str(run), "--json"))
    bench.keep_said("decode-spoilt", bench.pdcd("decode", str(run), "--json"))


def _take_cut_run(bench: Bench) -> None:
    """What is left of a run that failed, and what can be made of it."""
    tables = "[display.faults]\ndropped = [5]\nexposures = 0\n"
    bench.write("bench.toml", tables + BOOK)
    words = "capture indirect --codes 32 --parts 4 --local --json --out runs --config bench.toml"
    bench.keep_said("capture", bench.pdcd(*words.split()))
    (left,) = sorted((bench.scratch / "runs").iterdir())
    keep_run(bench, left, "left")
    out = ("--out", "made", "--json")
    said = bench.pdcd("decode", "--partial", str(left), *out)
    bench.keep_said("decode", said)
    if said.folder is not None:
        keep_run(bench, said.folder, "decoded")
    bench.keep_said("plain-decode", bench.pdcd("decode", str(left), "--json"))
    prune = bench.pdcd("runs", "prune", "--failed", "--state-dir", "runs", "--json")
    bench.keep_said("prune", prune)


def _take_compare(bench: Bench) -> None:
    """Every method, side by side."""
    bench.write("bench.toml", BOOK)
    words = "compare indirect --codes 16 --local --json --config bench.toml --out runs"
    bench.keep_said("compare", bench.pdcd(*words.split()))
    for run in (bench.scratch / "runs").glob("*Z-*"):
        asked = json.loads((run / "capture.json").read_bytes())["request"]
        keep_run(bench, run, f"run-{asked['goal']}-{asked['method']}")


def _take_transport(bench: Bench) -> None:
    """Entries of T by the command of their own."""
    bench.write("bench.toml", BOOK)
    words = "transport --rows 2 4 --local --json --config bench.toml --out runs"
    said = bench.pdcd(*words.split())
    bench.keep_said("transport", said)
    if said.folder is not None:
        keep_run(bench, said.folder)


def _take_tables(bench: Bench) -> None:
    """Tables of numbers, and the configuration."""
    bench.write("bench.toml", BOOK)
    for name, words in {
        "snr": "snr --json",
        "snr-450d": "snr --profile 450d --codes 256 --exposure 10 --transmission 30% --json",
        "config": "config show --config bench.toml",
        "config-schema": "config schema",
        "drivers": "drivers --json",
    }.items():
        said = bench.pdcd(*words.split())
        bench.keep_said(name, said)
        if not name.endswith(("schema", "drivers")):
            bench.keep_text(f"{name}.txt", said.out)


def _take_shown(bench: Bench) -> None:
    """Patterns on the mock panels, as pictures."""
    panels = "[projector]\nsize_px = [256, 192]\n[mask]\nsize_px = [400, 300]\n"
    bench.write("bench.toml", panels + BOOK)
    for pattern in PATTERNS:
        words = ("show", pattern, "--config", "bench.toml", "--out", f"{pattern}.png", "--json")
        bench.keep_said(pattern, bench.pdcd(*words))
        path = bench.scratch / f"{pattern}.png"
        if path.exists():
            bench.keep_bytes(path.name, path.read_bytes())
    moved = '[mask.place]\nflip = "horizontal"\nturn_deg = 3.0\n'
    bench.write("moved.toml", panels + moved + BOOK)
    moved_words = "show code --index 3 --config moved.toml --out moved.png --json"
    bench.keep_said("moved", bench.pdcd(*moved_words.split()))
    bench.keep_bytes("moved.png", (bench.scratch / "moved.png").read_bytes())


def _take_refused(bench: Bench) -> None:
    """What cannot be done ends with its exit code."""
    bench.write("bad.toml", "[camera]\nnoise = 3\n[nonsense]\nkey = 1\n[mask]\nrise = 2\n")
    bench.write("text.toml", "[camera\n")
    for name, words in REFUSED.items():
        bench.keep_said(name, bench.pdcd(*words.split()))


def _take_python(bench: Bench) -> None:
    """What `import pdcd` gives of a run, with every event of a capture."""
    import pdcd

    tables = {"scene": {"kind": "open-book", "grid": [12, 16]}}
    events: list[Any] = []
    with pdcd.local(tables, folder="runs") as rig:
        plan = rig.plan("indirect", codes=32, parts=4)
        run = rig.capture("indirect", codes=32, parts=4, progress=events.append)
        bench.keep_json("described", rig.described())
        try:
            rig.capture("indirekt", code=3)  # type: ignore[arg-type, call-arg]
        except pdcd.errors.RequestError as err:
            bench.keep_json("error", {"kind": err.kind, "message": err.message, "hint": err.hint})
    bench.keep_json("plan", msgspec.to_builtins(plan))
    bench.keep_json("events", [{"type": e.type, **msgspec.to_builtins(e)} for e in events])
    bench.keep_json("summary", msgspec.to_builtins(dict(run.summary)))
    again = {"all": run.decode(progress=False), "half": run.decode(parts=2, progress=False)}
    again["plain"] = run.decode(smooth=False, normalise="scalar", progress=False)
    row = run.row(5, 7)
    arrays: dict[str, Any] = {"image": run.image, "sigma": run.sigma, "truth": run.truth}
    arrays |= {f"picture-{name}": picture for name, picture in run.pictures.items()}
    arrays |= {"wanted": row.wanted, "realised": row.realised}
    for name, made in again.items():
        arrays |= {f"{name}-image": made.image, f"{name}-sigma": made.sigma}
    for name, codes in run.codes.items():
        arrays |= {f"{name}-projector": codes.projector, f"{name}-mask": codes.mask}
    bench.keep_arrays("arrays", {name: one for name, one in arrays.items() if one is not None})
    columns = {name: np.asarray(column) for name, column in run.frames.items()}
    bench.keep_arrays("frames", {n: c for n, c in columns.items() if c.dtype.kind != "O"})


def _take_sweep(bench: Bench) -> None:
    """Many captures in processes of their own, and their table."""
    import pdcd

    requests = [
        {"goal": goal, "codes": 16, "parts": parts, "config": {"scene": {"kind": kind}}}
        for kind in ("wax-disk", "open-book")
        for goal, parts in (("indirect", 1), ("direct", 4))
    ]
    tables = {"scene": {"grid": [12, 16]}}
    table = pdcd.sweep(tables, requests, workers=1, folder="sweep", progress=False)
    bench.keep_json("table", msgspec.to_builtins([dict(row) for row in table]))
    shutil.rmtree(bench.scratch / "sweep")
