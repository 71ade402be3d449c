"""Tuning, ROC, and the sigmas of field detectors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from pedjax.detection.bands import Banded
from pedjax.detection.sigmas import FieldSigmas
from pedjax.evaluation.scores import score_kind

if TYPE_CHECKING:
    from pedjax.tuning import Tuned


def tuning_history(tuned: Tuned) -> Figure:
    """Hard-gate loss of every start over iterations, and the errors before and after."""
    unit = score_kind(tuned.loss).unit
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    curve, pairs = figure.subplots(1, 2, width_ratios=[3, 2])
    rows = [row for row in tuned.history if row["iteration"] >= 0]
    steps = [row["iteration"] for row in rows]
    for key, style in (("training", "-"), ("validation", "--")):
        if rows and key in rows[0]:
            for s, series in enumerate(zip(*[row[key] for row in rows], strict=True)):
                label = key if s == 0 else None
                curve.plot(steps, series, style, marker=".", lw=1, color=f"C{s}", label=label)
    curve.set_yscale("log")
    curve.set_xlabel("iteration (a colour a start)")
    curve.set_ylabel(f"mean {tuned.loss}, hard gate ({unit})")
    curve.grid(alpha=0.3, which="both")
    curve.legend(fontsize=8)
    for key, colour in (("tuned_on", "C0"), ("held_back", "C1")):
        if key in tuned.after:
            before, after = list(tuned.before[key].values()), list(tuned.after[key].values())
            label = f"{key.replace('_', ' ')}: {np.mean(before):.3f} to {np.mean(after):.3f} {unit}"
            pairs.plot(before, after, "o", ms=5, color=colour, alpha=0.8, label=label)
    low, high = pairs.get_xlim()[0], pairs.get_xlim()[1]
    ends = [max(low, 1e-3), high]
    pairs.plot(ends, ends, color="0.5", lw=0.8)
    pairs.set_xscale("log")
    pairs.set_yscale("log")
    pairs.set_xlabel(f"{tuned.loss} before ({unit})")
    pairs.set_ylabel(f"{tuned.loss} after ({unit})")
    pairs.grid(alpha=0.3, which="both")
    pairs.legend(fontsize=8)
    figure.suptitle(f"tuning of {len(tuned.names)} parameters")
    return figure


def roc_curves(curves: Mapping[str, Mapping[str, Banded]]) -> Figure:
    """Detection over false alarm by part and detector, with 95 % bands where there are enough walks for them,
    linear and logarithmic."""
    figure = Figure(
        figsize=(4.5 * max(len(curves), 2), 4.4 if len(curves) == 1 else 8.4), layout="constrained"
    )
    axes = figure.subplots(1, 2)[:, None] if len(curves) == 1 else figure.subplots(2, len(curves))
    for (part, each), linear, low in zip(curves.items(), axes[0], axes[1], strict=True):
        for k, (name, found) in enumerate(each.items()):
            band = found.band
            for ax in (linear, low):
                shown = (band.p_false_alarm, band.p_detection, band.low, band.high)
                alarm, detected, under, over = (np.append(0.0, x) for x in shown)
                ax.plot(alarm, detected, lw=1.3, color=f"C{k}", label=f"{name}, AUC {found.auc}")
                if np.isfinite(band.low).all():
                    ax.fill_between(alarm, under, over, color=f"C{k}", alpha=0.15, lw=0)
        low.set_xscale("log")
        low.set_xlim(1e-4, 1)
        for ax in (linear, low):
            ax.set_xlabel("probability of false alarm")
            ax.set_ylabel("probability of detection")
            ax.set_ylim(0, 1.02)
            ax.grid(alpha=0.3)
        linear.legend(fontsize=8, loc="lower right")
        if len(curves) > 1:
            linear.set_title(part, fontsize=10)
    return figure


def field_changes(
    found: FieldSigmas, keep: float, before: Mapping[str, float], unit: Mapping[str, str]
) -> Figure:
    """How often the field changed by how much from look to look, a panel a sigma: in all windows, in those
    that count as quasi-static (of which `keep` is the part below the quantile), and the Gaussians of the new
    sigma, of the one `before`, and of the true label where it is known."""
    names = list(found.changes)
    figure = Figure(figsize=(max(4.6 * len(names), 7.0), 4.2), layout="constrained")
    axes = figure.subplots(1, len(names), squeeze=False)[0]
    for ax, name in zip(axes, names, strict=True):
        changes, sigma = found.changes[name], found.fit.sigma[name]
        edges = np.linspace(-6, 6, 61) * sigma
        used = changes[:, found.fit.used].ravel()
        ax.hist(changes.ravel(), edges, color="0.8", label="all windows")
        ax.hist(used, edges, color="C0", alpha=0.6, label="counted as quasi-static")
        fine = np.linspace(edges[0], edges[-1], 400)
        curves = {"fitted": (sigma, "k-"), "before": (before[name], "C1--")}
        if found.by_truth:
            curves["by truth"] = (found.by_truth[name], "C2:")
        for label, (value, style) in curves.items():
            density = np.exp(-0.5 * (fine / value) ** 2) / (np.sqrt(2 * np.pi) * value)
            height = len(used) / keep * (edges[1] - edges[0]) * density  # as many changes, uncut
            ax.plot(fine, height, style, lw=1.4, label=f"{label}: {value:.3g} {unit[name]}")
        tallest = np.histogram(changes, edges)[0].max()
        ax.set_ylim(0, 1.6 * tallest)  # room for the legend; a narrow Gaussian may leave it
        ax.set_xlim(edges[0], edges[-1])
        ax.set_xlabel(f"change, {name.removeprefix('sigma_')} ({unit[name]})")
        ax.grid(alpha=0.3)
        ax.legend(fontsize=8, loc="upper left")
    axes[0].set_ylabel("changes from look to look")
    part = f"{found.fit.used.sum()} of {len(found.fit.used)} windows"
    figure.suptitle(f"{found.detector}: {part} counted as quasi-static", fontsize=11)
    return figure
