"""Allan deviation of every channel with its band, its fit, and the parts of the fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from pedjax.evaluation.allan import AllanCurve
from pedjax.evaluation.noise import TERMS, Noise

_COLOURS = dict(zip(TERMS, ("C4", "C0", "C2", "C3", "C5", "C1"), strict=True))


def allan_figure(
    curve: AllanCurve,
    noises: Sequence[Noise],
    names: Sequence[str],
    unit: str,
    scale: float = 1.0,
    labels: Sequence[Mapping[str, str]] | None = None,
    title: str = "",
) -> Figure:
    """Log-log curves, a panel a channel: `curve` with its 68 % band, the sum and the parts of `noises`.

    `names` of the channels; deviations are drawn `scale` times their value, in `unit`; `labels` says of
    each channel what each of its terms amounts to. The lowest point of a curve has a mark.
    """
    count = len(names)
    figure = Figure(figsize=(4.4 * count + 0.4, 4.6), layout="constrained")
    axes = figure.subplots(1, count, sharex=True, sharey=True, squeeze=False)[0]
    low, high = curve.band()
    fine = np.geomspace(curve.tau[0], curve.tau[-1], 300)
    for c, (ax, noise, name) in enumerate(zip(axes, noises, names, strict=True)):
        measured = scale * curve.deviation[:, c]
        ax.fill_between(curve.tau, scale * low[:, c], scale * high[:, c], color="0.75", lw=0, label="68 %")
        ax.plot(curve.tau, measured, ".", color="0.15", ms=4, label="measured")
        ax.plot(fine, scale * noise.deviation(fine), color="k", lw=1.1, label="fit")
        for term, part in noise.parts(fine).items():
            said = labels[c].get(term, "") if labels is not None else ""
            label = f"{term.replace('_', ' ')} {said}".rstrip()
            ax.plot(fine, scale * part, "--", lw=1.1, color=_COLOURS[term], label=label)
        lowest = measured.argmin()
        ax.plot(curve.tau[lowest], measured[lowest], "v", ms=7, mfc="none", color="0.15")
        ax.set_title(name, fontsize=10)
        ax.set_xlabel("cluster time (s)")
        ax.grid(alpha=0.3, which="both", lw=0.5)
        ax.legend(fontsize=7, loc="best")
    axes[0].set_xscale("log")
    axes[0].set_yscale("log")
    axes[0].set_ylim(scale * curve.deviation.min() / 4, scale * high[0].max() * 2)
    axes[0].set_ylabel(f"Allan deviation ({unit})")
    if title:
        figure.suptitle(title, fontsize=11)
    return figure
