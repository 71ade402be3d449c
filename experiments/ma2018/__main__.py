"""Ma 2018, its tables and figures: the published number beside ours, and whether it is met.

    python -m experiments.ma2018 [calibration] [detection] [figures] [spread]
        [--walks 18] [--first-seed 400]

Simulated walks take the place of the paper's, which are not public: the calibration loop and free turning
(Table 1, Figs. 6, 7), the office (Figs. 3, 10, 11) and malls (Figs. 12, 15, 16), and the detectors in both
(Figs. 8, 13, 14). Nothing is tuned here; thresholds were chosen on other seeds.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import pedjax
from experiments.ma2018 import calibration, detection, figures, spread
from experiments.table import Row
from pedjax.output import folder, write_table
from pedjax.runtime import default_cache

PARTS: dict[str, Callable[[range, Path], list[Row]]] = {
    "calibration": calibration.run,
    "detection": detection.run,
    "figures": figures.run,
    "spread": spread.run,
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", help=f"which: {', '.join(PARTS)} (all)")
    parser.add_argument("--walks", type=int, default=18, help="seeds of each place")
    parser.add_argument("--first-seed", type=int, default=400)
    parser.add_argument("--out", type=Path, default=Path("out/ma2018"))
    args = parser.parse_args()
    if unknown := set(args.parts) - set(PARTS):
        parser.error(f"there is no part {', '.join(sorted(unknown))}; choose from {', '.join(PARTS)}")
    pedjax.configure(cache=default_cache())
    out = folder(args.out)
    seeds = range(args.first_seed, args.first_seed + args.walks)
    rows = [line for part in args.parts or PARTS for line in PARTS[part](seeds, out)]
    write_table(out / "ma2018.csv", {key: [line[key] for line in rows] for key in rows[0]})


if __name__ == "__main__":
    main()
