"""A calibration before and after: the cloud in three projections with |m|, or the loop with its headings."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

_BEFORE, _AFTER = "0.65", "C0"
_MOST_POINTS = 3000


def cloud_figure(before: np.ndarray, after: np.ndarray, strength: float, title: str = "") -> Figure:
    """`before`, `after (N, 3)` µT: projections, the raw cloud about its own middle, with the circle of the
    field `strength` µT, and histograms of |m|."""
    figure = Figure(figsize=(13.2, 3.7), layout="constrained")
    axes = figure.subplots(1, 4, width_ratios=(1, 1, 1, 1.15))
    every = max(len(before) // _MOST_POINTS, 1)
    middle = 0.5 * (before.max(axis=0) + before.min(axis=0))
    shifted = before[::every] - middle
    for ax, (i, j) in zip(axes[:3], ((0, 1), (0, 2), (1, 2)), strict=True):
        ax.plot(shifted[:, i], shifted[:, j], ".", ms=2, color=_BEFORE, label="raw, moved to 0")
        ax.plot(after[::every, i], after[::every, j], ".", ms=2, color=_AFTER, label="calibrated")
        _circle(ax, strength)
        ax.set_xlabel(f"{'xyz'[i]} (µT)")
        ax.set_ylabel(f"{'xyz'[j]} (µT)")
    axes[0].legend(fontsize=7, loc="upper right", markerscale=4)
    size_before, size_after = (np.linalg.norm(x, axis=1) for x in (before - middle, after))
    ends = (min(size_before.min(), size_after.min()), max(size_before.max(), size_after.max()))
    bins = np.linspace(*ends, 60) if ends[1] > ends[0] else 10
    axes[3].hist(size_before, bins, color=_BEFORE, label=f"raw, moved to 0: std {size_before.std():.2f} µT")
    axes[3].hist(
        size_after, bins, color=_AFTER, alpha=0.8, label=f"calibrated: std {size_after.std():.2f} µT"
    )
    axes[3].axvline(strength, color="k", lw=1)
    axes[3].set_xlabel("|m| (µT)")
    axes[3].set_ylabel("samples")
    axes[3].legend(fontsize=7)
    return _named(figure, title)


def loop_figure(
    before: np.ndarray, after: np.ndarray, turn: np.ndarray, strength: float, title: str = ""
) -> Figure:
    """`before`, `after (K, 2)` µT of the stances, `turn (K,)` rad the gyroscope's yaw: the points, their
    headings along the walk, and those against the gyroscope's."""
    figure = Figure(figsize=(12.6, 4.0), layout="constrained")
    points, course, against = figure.subplots(1, 3)
    for xy, colour, label in ((before, _BEFORE, "before"), (after, _AFTER, "after")):
        points.plot(*xy.T, ".-", lw=0.5, ms=6, color=colour, label=label)
        yaw = np.unwrap(np.arctan2(xy[:, 0], xy[:, 1]))
        apart = yaw - turn
        apart = np.rad2deg(np.angle(np.exp(1j * (apart - np.angle(np.exp(1j * apart).mean())))))
        course.plot(np.rad2deg(yaw - yaw[0]), ".-", lw=0.8, color=colour, label=label)
        against.plot(np.rad2deg(turn - turn[0]), apart, ".", color=colour, label=label)
    course.plot(np.rad2deg(turn - turn[0]), color="k", lw=1, label="gyroscope")
    _circle(points, strength)
    points.set_xlabel("levelled x (µT)")
    points.set_ylabel("levelled y (µT)")
    course.set_xlabel("stance")
    course.set_ylabel("heading since the first (deg)")
    against.set_xlabel("heading by the gyroscope (deg)")
    against.set_ylabel("magnetic less gyroscope (deg)")
    for ax in (points, course, against):
        ax.legend(fontsize=8)
    for ax in (course, against):
        ax.grid(alpha=0.3, lw=0.5)
    return _named(figure, title)


def _circle(ax: Axes, radius: float) -> None:
    around = np.linspace(0, 2 * np.pi, 200)
    ax.plot(radius * np.cos(around), radius * np.sin(around), color="k", lw=1)
    ax.set_aspect("equal", adjustable="datalim")
    ax.grid(alpha=0.3, lw=0.5)


def _named(figure: Figure, title: str) -> Figure:
    if title:
        figure.suptitle(title, fontsize=11)
    return figure
