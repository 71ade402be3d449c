"""The rate against the number of lanes, on a core and on a GPU."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure


def lanes_figure(found: dict[str, Any]) -> Figure:
    """Steps/s on one core for each precision, the chosen number marked, the hand-written kernel dashed."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    ax = figure.subplots()
    for name, colour in (("float32", "C0"), ("float64", "C1")):
        widths = [int(w) for w in found[name]]
        rates = [r / 1e6 for r in found[name].values()]
        ax.plot(widths, rates, "o-", ms=4, color=colour, label=f"pedjax, {name}")
        chosen = found[f"{name}_chosen"]
        ax.plot(
            chosen, rates[widths.index(chosen)], "*", ms=15, color=colour, label=f"chosen: {chosen} lanes"
        )
    if "limit" in found:
        best = max(found["limit"].values()) / 1e6
        ax.axhline(best, color="0.4", ls="--", lw=1, label="hand-written C kernel, float32")
    ax.set_xscale("log", base=2)
    ax.set_xlabel("parameter sets side by side (lanes)")
    ax.set_ylabel("M filter steps/s on one core")
    ax.set_ylim(bottom=0)
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8)
    return figure


_RATE = re.compile(r"(kernel|scan) (\w+) (float\d\d), ([\d,]+) lanes")


def gpu_figure(rows: Mapping[str, str]) -> Figure:
    """Steps/s on a GPU for each system and precision, of kernel and scan, the hand-written kernel dashed."""
    curves: dict[str, list[tuple[int, float]]] = {}
    for title, told in rows.items():
        found, rate = _RATE.fullmatch(title), re.search(r"([\d,.]+) M steps/s", told)
        if found and rate:
            how, system, precision, lanes = found.groups()
            point = int(lanes.replace(",", "")), float(rate[1].replace(",", ""))
            curves.setdefault(f"{how}, {system}, {precision}", []).append(point)
    figure = Figure(figsize=(7, 4), layout="constrained")
    ax = figure.subplots()
    for k, (label, points) in enumerate(curves.items()):
        ax.plot(*zip(*sorted(points), strict=True), "o-", ms=5, color=f"C{k}", label=label)
    beside = re.search(r"([\d.]+) M steps/s", rows.get("hand-written kernel", ""))
    if beside:
        ax.axhline(float(beside[1]), color="0.4", ls="--", lw=1, label="hand-written CUDA kernel, float32")
    ax.set_xscale("log", base=2)
    ax.set_yscale("log")
    ax.set_xlabel("parameter sets side by side (lanes)")
    ax.set_ylabel("M filter steps/s")
    ax.set_title(rows.get("device", ""), fontsize=9)
    ax.grid(alpha=0.3, which="both")
    ax.legend(fontsize=8)
    return figure
