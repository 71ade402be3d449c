"""The tables of docs/ma2018.md, from what the experiments wrote.

    python -m experiments.ma2018 --out out/ma2018
    python -m experiments.ma2018.guide out/ma2018 [FOLDER ...]

Copies the tables to docs/tables and writes them into the guide, each where a comment names it. A test holds
the guide to docs/tables.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from experiments.guide import DOCS, Guide, Line, against, write
from experiments.ma2018 import spread

DETECTORS = ("qsf", "iqsf", "ma", "vector")
TOLD = ("T1", "T1b", "F7", "C", "F10", "F12", "F13,14", "F15,16", "S")


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


def _blocks(known: Mapping[str, list[Line]]) -> dict[str, str]:
    return {
        "spread": spread.markdown(known["spread"]).strip(),
        "areas": areas(known["detection_areas"]),
        "rates": rates(known["detection_turns"]),
        "against": against(known["ma2018"], TOLD),
    }


WRITTEN = ("spread", "detection_areas", "detection_turns", "ma2018")
GUIDE = Guide(DOCS / "ma2018.md", {name: name for name in WRITTEN}, _blocks)


if __name__ == "__main__":
    write(__doc__, GUIDE)
