"""Entry point: ``python -m tests.strangers --count 20 --out FOLDER`` (make strangers).

Prints a line for each bench as it is done, then which rules were broken. What is done is kept in
FOLDER/found.jsonl and not done again.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from pathlib import Path

from tests import world


def main() -> int:
    """Judge benches; 1 where a rule is broken."""
    world.enter()
    from tests.strangers import benches

    benches.install()
    from tests.strangers.judge import judge
    from tests.strangers.rules import HEAD, broken, line, summary

    parser = argparse.ArgumentParser(prog="python -m tests.strangers", description=__doc__)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0, help="of the first bench")
    parser.add_argument("--small", action="store_true", help="fewer pixels throughout")
    parser.add_argument("--spoilt", type=int, default=2, help="spoilt photos of each bench")
    parser.add_argument("--keep", action="store_true", help="keep the folders of the benches")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    kept = args.out / "found.jsonl"
    lines = kept.read_text().splitlines() if kept.exists() else []
    found = {entry["seed"]: entry for entry in map(json.loads, lines)}
    sys.stdout.write(HEAD)
    entries = []
    for seed in range(args.seed, args.seed + args.count):
        if seed not in found:
            folder = args.out / f"bench-{seed}"
            found[seed] = judge(seed, folder.absolute(), small=args.small, spoilt=args.spoilt)
            with kept.open("a") as file:
                file.write(json.dumps(found[seed]) + "\n")
            if not args.keep:
                shutil.rmtree(folder)
        entries.append(found[seed])
        sys.stdout.write(line(found[seed]))
        sys.stdout.flush()
    sys.stdout.write(summary(entries))
    return 1 if any(broken(entry) for entry in entries) else 0


if __name__ == "__main__":
    sys.exit(main())
