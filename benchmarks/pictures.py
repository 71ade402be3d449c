"""The rate against the number of lanes."""

from __future__ import annotations

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
