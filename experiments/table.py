"""The published number beside ours, and whether it is met; and the command line of what finds them."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pedjax
from pedjax.output import folder, write_table
from pedjax.runtime import default_cache

Row = dict[str, Any]
Part = Callable[[range, Path], list[Row]]


def row(name: str, what: str, published: str, ours: str, met: bool | None) -> Row:
    """A line of the table, printed at once; `met` is None where nothing is asked."""
    mark = {True: "yes", False: "no", None: "-"}[met]
    print(f"{name:6} {what:44} {published:44} {ours:58} {mark}", flush=True)
    return {"id": name, "what": what, "published": published, "ours": ours, "met": mark}


def main_of(
    about: str, parts: Mapping[str, Part], out: Path, first_seed: int, walks: Callable[[str], int]
) -> None:
    """The command line of an experiment of several parts, each with seeds from `first_seed` on and as many
    walks as it asks for. Lines are written to `PART_told.csv`, and all of them to a table with the name of
    `out`."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", help=f"which: {', '.join(parts)} (all)")
    parser.add_argument("--walks", type=int, help="seeds of each place")
    parser.add_argument("--first-seed", type=int, default=first_seed)
    parser.add_argument("--out", type=Path, default=out)
    args = parser.parse_args()
    if unknown := set(args.parts) - set(parts):
        parser.error(f"there is no part {', '.join(sorted(unknown))}; choose from {', '.join(parts)}")
    pedjax.configure(cache=default_cache())
    where = folder(args.out)
    told: list[Row] = []
    for part in args.parts or parts:
        seeds = range(args.first_seed, args.first_seed + (args.walks or walks(part)))
        rows = parts[part](seeds, where)
        told += rows
        for name, some in ((f"{part}_told", rows), (out.name, told)):
            write_table(where / f"{name}.csv", {key: [line[key] for line in some] for key in some[0]})
