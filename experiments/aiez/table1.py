"""Table I: 515.5 m, three rounds of a teaching building in seven minutes; from printed to corrected.

Every rung is one change. Told are the horizontal error at the end in m (median, 90 %, worst), in % of the
distance, and on how many walks it is smaller than plain IEZ's; with the first yaw given, and from the field.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from experiments.aiez import made
from experiments.table import Row, row
from pedjax.output import write_table

DISTANCE = 515.5
PUBLISHED = {"IEZ": (9.49, 1.84), "IEZ + QMD": (7.09, 1.38), "AIEZ": (0.79, 0.15)}
"""End error in m and in % of the distance."""

_ATTITUDE = {"compass.looking.levelling": "attitude", "tilt.rows": "none"}
_SKIP = {**_ATTITUDE, "heuristic.hdr.on_curve": "skip"}
RUNGS: dict[str, tuple[str, dict[str, Any]]] = {
    "IEZ": ("aiez_iez", {}),
    "IEZ + QMD": ("aiez_qmd", {}),
    "as printed": ("aiez_published", {"tilt.rows": "printed"}),
    "tilt rows with M": ("aiez_published", {}),
    "levelled by attitude": ("aiez_published", _ATTITUDE),
    "no row on curves": ("aiez_published", _SKIP),
    "gate with the yaw's variance": ("aiez_published", {**_SKIP, "field.aiez.yaw_variance": True}),
    "one look a stance": (
        "aiez",
        {"compass.recovery": "none", "heuristic.form": "none", "initial.bias": "zero"},
    ),
    "rivals": ("aiez", {"heuristic.form": "none", "initial.bias": "zero"}),
    "first bias from rest": ("aiez", {"heuristic.form": "none"}),
    "AIEZ": ("aiez", {}),
    "AIEZ, directions": ("aiez", {"heuristic.form": "von_mises"}),
    "AIEZ, every look, tail 4": ("aiez", {"field.aiez.threshold": 1e6, "compass.tail": 4.0}),
}


def run(seeds: range, out: Path) -> list[Row]:
    ends: dict[tuple[str, str], list[float]] = {}
    for seed in tqdm(seeds, "Table I"):
        walked = made.walk("teaching-building", seed)
        for start, given in (("given", made.given_yaw(walked)), ("field", {})):
            for name, (preset, changes) in RUNGS.items():
                track = made.run(walked.recording, preset, changes, given)
                ends.setdefault((start, name), []).append(made.end_error(walked, track))
    found = {key: np.array(x) for key, x in ends.items()}
    lines = []
    for (start, name), x in found.items():
        better = float((x < found[start, "IEZ"]).mean())
        lines.append(
            {
                "first_yaw": start, "rung": name, "walks": len(x), "median_m": np.median(x),
                "median_percent": 100 * np.median(x) / DISTANCE, "p90_m": np.quantile(x, 0.9),
                "worst_m": x.max(), "mean_m": x.mean(), "better_than_iez": better,
            }
        )  # fmt: skip
        print(*(f"{v:.2f}" if isinstance(v, float) else v for v in lines[-1].values()), sep="  ", flush=True)
    write_table(out / "table1.csv", {key: [line[key] for line in lines] for key in lines[0]})

    def told(name: str, start: str = "given") -> str:
        x = found[start, name]
        return (
            f"{np.median(x):.2f} m, {100 * np.median(x) / DISTANCE:.2f} %, 90 %: {np.quantile(x, 0.9):.2f} m"
        )

    middle = {name: float(np.median(found["given", name])) for name in RUNGS}
    aiez, field = found["given", "AIEZ"], found["field", "AIEZ"]
    ordered = middle["IEZ"] > middle["IEZ + QMD"] > middle["AIEZ"]
    rows = []
    for name, (metres, percent) in PUBLISHED.items():
        rows.append(row("T1", f"{name}, {len(aiez)} walks", f"{metres} m, {percent} %", told(name), None))
    near = float((aiez <= 0.0035 * DISTANCE).mean())
    better = float((aiez < found["given", "IEZ"]).mean())
    share = middle["AIEZ"] / middle["IEZ"]
    order = " > ".join(f"{middle[name]:.2f}" for name in PUBLISHED)
    good = middle["AIEZ"] <= 0.0015 * DISTANCE and near >= 0.9
    directed = middle["AIEZ, directions"] <= 0.0015 * DISTANCE
    limits = "at most 0.15 %; 90 % within 0.35 %"
    of_field = bool(np.median(field) <= 0.002 * DISTANCE)
    rows += [
        row("T1", "order of medians", "IEZ > IEZ + QMD > AIEZ", order, ordered),
        row("T1", "AIEZ of IEZ, medians", "at most 0.10", f"{share:.3f}", share <= 0.1),
        row("T1", "AIEZ, first yaw given", limits, f"{told('AIEZ')}; {100 * near:.0f} %", good),
        row("T1", "AIEZ, first yaw from the field", "at most 0.2 %", told("AIEZ", "field"), of_field),
        row("T1", "AIEZ with dominant directions", "at most 0.15 %", told("AIEZ, directions"), directed),
        row("T1", "AIEZ better than IEZ", "on 90 % of walks", f"{100 * better:.0f} %", better >= 0.9),
    ]
    return rows
