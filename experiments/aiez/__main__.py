"""AIEZ, its figures and table: the published number beside ours, and whether what was wanted is met.

    python -m experiments.aiez [table1] [magnet] [lockout] [straight] [wayback]
        [--walks 18] [--first-seed 700] [--out DIR]

Simulated walks take the place of the paper's, which are not public. Nothing is tuned here: presets,
thresholds and defaults were chosen on seeds 0 to 11. Table I takes 50 walks unless --walks says otherwise.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import pedjax
from experiments.aiez import lockout, magnet, straight, table1, wayback
from experiments.table import Row
from pedjax.output import folder, write_table
from pedjax.runtime import default_cache

PARTS: dict[str, Callable[[range, Path], list[Row]]] = {
    "table1": table1.run,
    "magnet": magnet.run,
    "lockout": lockout.run,
    "straight": straight.run,
    "wayback": wayback.run,
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", help=f"which: {', '.join(PARTS)} (all)")
    parser.add_argument("--walks", type=int, help="seeds of each place (18; Table I: 50)")
    parser.add_argument("--first-seed", type=int, default=700)
    parser.add_argument("--out", type=Path, default=Path("out/aiez"))
    args = parser.parse_args()
    if unknown := set(args.parts) - set(PARTS):
        parser.error(f"there is no part {', '.join(sorted(unknown))}; choose from {', '.join(PARTS)}")
    pedjax.configure(cache=default_cache())
    out = folder(args.out)
    for part in args.parts or PARTS:
        walks = args.walks or (50 if part == "table1" else 18)
        rows = PARTS[part](range(args.first_seed, args.first_seed + walks), out)
        write_table(out / f"{part}_told.csv", {key: [line[key] for line in rows] for key in rows[0]})


if __name__ == "__main__":
    main()
