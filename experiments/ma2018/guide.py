"""The tables of docs/ma2018.md, from what the experiments wrote.

    python -m experiments.ma2018 --out out/ma2018
    python -m experiments.ma2018.guide out/ma2018 [FOLDER ...]

Copies the tables to docs/tables and writes them into the guide, each where a comment names it. A test holds
the guide to docs/tables.
"""

from __future__ import annotations

import argparse
import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments.ma2018 import spread

ROOT = Path(__file__).parents[2]
GUIDE, TABLES = ROOT / "docs" / "ma2018.md", ROOT / "docs" / "tables"
WRITTEN = ("spread", "detection_areas", "detection_turns", "ma2018")
DETECTORS = ("qsf", "iqsf", "ma", "vector")
TOLD = ("T1", "T1b", "F7", "C", "F10", "F12", "F13,14", "F15,16", "S")

Line = dict[str, Any]


def lines(path: Path) -> list[Line]:
    """Rows of a table, numbers as numbers."""

    def value(text: str) -> Any:
        try:
            return float(text)
        except ValueError:
            return text

    with path.open(encoding="utf-8", newline="") as file:
        return [{key: value(x) for key, x in row.items()} for row in csv.DictReader(file)]


def areas(found: Sequence[Line]) -> str:
    """Areas under the curves at 3 µT and 5 degrees."""
    rows = ["| | qsf | iqsf | ma | vector | vector less ma |", "|---|---|---|---|---|---|"]
    own = [x for x in found if x["field_uT"] == 3.0 and x["part"] != "all"]
    for where in dict.fromkeys((x["scenario"], x["part"]) for x in own):
        of = {x["detector"]: x for x in own if (x["scenario"], x["part"]) == where}
        cells = [f"{of[n]['auc']:.3f}" for n in ("qsf", "iqsf")]
        cells += [_interval(of[n], "auc") for n in ("ma", "vector")]
        counts = f"{of['ma']['quasi_static']:.0f} of {of['ma']['windows']:.0f}"
        name = f"{where[0].replace('-loop', '')}, {where[1]} ({counts})"
        rows.append(f"| {name} | {' | '.join(cells)} | {_interval(of['vector'], 'auc_less_ma')} |")
    return "\n".join(rows)


def _interval(line: Line, name: str) -> str:
    if not np.isfinite(line[f"{name}_low"]):
        return f"{line[name]:.3f} [?]"
    return f"{line[name]:.3f} [{line[f'{name}_low']:.3f}, {line[f'{name}_high']:.3f}]"


def rates(found: Sequence[Line]) -> str:
    """Found and false from 20 degrees of turn in a window on."""
    rows = ["| | qsf | iqsf | ma | vector |", "|---|---|---|---|---|"]
    for scenario in dict.fromkeys(x["scenario"] for x in found):
        cells = []
        for detector in DETECTORS:
            own = [x for x in found if (x["scenario"], x["detector"]) == (scenario, detector)]
            own = [x for x in own if x["turn_from"] >= 20]
            both = []
            for title in ("detection", "false_alarm"):
                some = [x for x in own if x[f"{title}_windows"]]
                weights = [x[f"{title}_windows"] for x in some]
                both.append(f"{np.average([x[title] for x in some], weights=weights):.2f}")
            cells.append(", ".join(both))
        rows.append(f"| {scenario.replace('-loop', '')} | {' | '.join(cells)} |")
    return "\n".join(rows)


def against(found: Sequence[Line]) -> str:
    """The published number beside ours."""
    rows = ["| | | published | here | met |", "|---|---|---|---|---|"]
    for x in found:
        if x["id"] in TOLD:
            rows.append(f"| {x['id']} | {x['what']} | {x['published']} | {x['ours']} | {x['met']} |")
    return "\n".join(rows)


def blocks(tables: Path = TABLES) -> dict[str, str]:
    """Each table of the guide by the name in its comment."""
    known = {name: lines(tables / f"{name}.csv") for name in WRITTEN}
    return {
        "spread": spread.markdown(known["spread"]).strip(),
        "areas": areas(known["detection_areas"]),
        "rates": rates(known["detection_turns"]),
        "against": against(known["ma2018"]),
    }


def with_blocks(text: str, made: dict[str, str]) -> str:
    """The guide with its tables written anew."""
    for name, table in made.items():
        mark = re.compile(rf"(<!-- {name} -->\n\n).*?(\n\n<!-- end -->)", re.S)
        text, count = mark.subn(lambda m, table=table: m[1] + table + m[2], text)  # type: ignore[misc]
        if count != 1:
            raise ValueError(f"the guide needs one comment <!-- {name} --> with its <!-- end -->")
    return text


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path, help="where the parts were written")
    args = parser.parse_args()
    TABLES.mkdir(exist_ok=True)
    for name in WRITTEN:
        parts = [path for folder in args.folders if (path := folder / f"{name}.csv").exists()]
        texts = [path.read_text(encoding="utf-8").splitlines() for path in parts]
        whole = list(dict.fromkeys([texts[0][0], *(line for text in texts for line in text[1:])]))
        (TABLES / f"{name}.csv").write_text("\n".join(whole) + "\n", encoding="utf-8")
    GUIDE.write_text(with_blocks(GUIDE.read_text(encoding="utf-8"), blocks()), encoding="utf-8")


if __name__ == "__main__":
    main()
