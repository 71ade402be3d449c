"""The tables of docs/wang2018.md, from what the experiments wrote.

python -m experiments.wang --out out/wang
python -m experiments.wang.guide out/wang [FOLDER ...]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from experiments.guide import DOCS, Guide, Line, against, write

WAYS = ("triad", "weighted", "gauss_newton", "gda", "agda", "agda fixed")
VARIANTS = (
    "ZUPT", "ZUPT + start", "ZUPT + start, rest", "alpha zero", "improved", "improved, law as printed",
    "best", "best, no rest",
)  # fmt: skip


def stands(found: Sequence[Line]) -> str:
    """Heading median, 90 %, and the tilt's median, by disturbance and way, deg."""
    rows = ["| disturbance | " + " | ".join(WAYS) + " |", "|---" * (len(WAYS) + 1) + "|"]
    for name in dict.fromkeys(x["disturbance"] for x in found):
        of = {x["way"]: x for x in found if x["disturbance"] == name}
        cells = [
            f"{of[w]['heading_median']:.2f}, {of[w]['heading_p90']:.1f}; {of[w]['tilt_median']:.2f}"
            for w in WAYS
        ]
        rows.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(rows)


def noise(found: Sequence[Line]) -> str:
    rows = ["| law | none | short | long | gain back after two looks | least noise, of R |", "|---" * 6 + "|"]
    for x in found:
        numbers = f"{x['none']:.2f} | {x['short']:.2f} | {x['long']:.2f} | {100 * x['gain_back']:.0f} %"
        rows.append(f"| {x['law']} | {numbers} | {x['least_noise_of_R']:.2f} |")
    return "\n".join(rows)


def walks(found: Sequence[Line]) -> str:
    """Median and 90 % of RMS, by path and variant, and the share of walks better than alpha zero."""
    places = list(dict.fromkeys((x["condition"], x["path"]) for x in found))
    of = {(x["condition"], x["path"], x["variant"]): x for x in found}
    rows = ["| | " + " | ".join(VARIANTS) + " |", "|---" * (len(VARIANTS) + 1) + "|"]
    for place in places:
        cells = []
        for variant in VARIANTS:
            x = of[(*place, variant)]
            cells.append(
                f"{x['rms_median_m']:.2f} ({x['rms_p90_m']:.2f}), {100 * x['better_than_alpha_zero']:.0f} %"
            )
        rows.append(f"| {', '.join(place)} | {' | '.join(cells)} |")
    return "\n".join(rows)


def broad(found: Sequence[Line]) -> str:
    """Tilt and heading of each still window by each method, deg."""
    methods = ("triad", "weighted", "gauss_newton", "gda", "agda")
    rows = ["| trial, from | " + " | ".join(methods) + " |", "|---" * (len(methods) + 1) + "|"]
    for x in found:
        cells = [f"{x[f'{m}_tilt']:.2f}, {x[f'{m}_heading']:+.2f}" for m in methods]
        rows.append(f"| {x['trial']}, {x['from_s']:.0f} s | {' | '.join(cells)} |")
    return "\n".join(rows)


def recorded(found: Sequence[Line]) -> str:
    """Errors of each walk and loop with each preset, m, and their means."""
    names = [key for key in found[0] if key not in ("recording", "kind")]
    rows = ["| | " + " | ".join(f"`{n}`" for n in names) + " |", "|---" * (len(names) + 1) + "|"]
    for kind in dict.fromkeys(x["kind"] for x in found):
        some = [x for x in found if x["kind"] == kind]
        for x in some:
            name = (
                str(x["recording"]).replace("SensorConnectData_", "").replace("Measurement_100521_", "loop ")
            )
            rows.append(f"| {name.replace('_data_inert', '')} | {' | '.join(f'{x[n]:.2f}' for n in names)} |")
        means = " | ".join(f"**{np.mean([x[n] for x in some]):.2f}**" for n in names)
        rows.append(f"| mean of {len(some)} {kind}s | {means} |")
    return "\n".join(rows)


def _blocks(known: Mapping[str, list[Line]]) -> dict[str, str]:
    return {
        "stands": stands(known["wang_alignment"]),
        "branch": against(known["wang_branch_told"]),
        "noise": noise(known["wang_noise"]),
        "walks": walks(known["wang_walks"]),
        "broad": broad(known["wang_broad"]),
        "recorded": recorded(known["wang_presets"]),
        "alignment told": against(known["wang_alignment_told"]),
        "walks told": against(known["wang_walks_told"]),
    }


WRITTEN = ("alignment", "branch_told", "noise", "walks", "alignment_told", "walks_told", "broad", "presets")
GUIDE = Guide(DOCS / "wang2018.md", {f"wang_{name}": name for name in WRITTEN}, _blocks)


if __name__ == "__main__":
    write(__doc__, GUIDE)
