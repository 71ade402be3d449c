"""A big sweep: score over each parameter, over pairs of them, shares of its variance, the trade of two."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, MaxNLocator, NullFormatter, NullLocator

from pedjax.errors import InputError, suggest
from pedjax.evaluation.scores import unit_of
from pedjax.sweeping.report import SHOWN, Bins, Marginal, Report
from pedjax.sweeping.telling import with_unit

_DOTS = 4000
"""More runs than this are drawn as a density."""
_GREYS = ListedColormap(np.repeat(np.linspace(0.96, 0.6, 64)[:, None], 3, axis=1), "light greys")
_WIDE = 8.0
"""A ratio of scores beyond which their scale is logarithmic."""


def marginal_figure(report: Report) -> Figure:
    """Score of all runs over each parameter, the most telling first, with quantiles, minimum and best run."""
    names = [report.effects.names[i] for i in report.effects.order]
    columns = min(len(names), 4)
    rows = math.ceil(len(names) / columns)
    figure = Figure(figsize=(max(3.5 * columns, 6.0), 3.1 * rows + 0.8), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    if not len(report.best):
        return _empty(figure)
    limits, best = _limits(report), report.best[0]
    for ax, path in zip(grid.flat, names, strict=False):
        bins = report.marginals[path].bins
        _horizontal(ax, bins)
        _cloud(ax, report, path, limits)
        _curves(ax, report.marginals[path])
        x, y = (bins.index if bins.labels else report.values[path])[best], report.runs.score[best]
        ax.plot(x, y, "*", ms=13, color="C3", mec="w", zorder=5, clip_on=False, label="best run")
        _score_axis(ax, limits)
    for ax in grid.flat[len(names) :]:
        ax.set_visible(False)
    for row in grid:
        row[0].set_ylabel(_titled(report.runs.name))
    handles, labels = _legend(grid.flat[: len(names)])
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), fontsize=8, frameon=False)
    return figure


def pair_figure(report: Report, shown: str = "minimum") -> Figure:
    """Maps of the `minimum` or `median` score over every two of the most telling parameters.

    The diagonal has the score over one parameter alone; white cells hold no run that got through.
    """
    if shown not in ("minimum", "median"):
        raise InputError(f"map of '{shown}' is unknown{suggest(shown, ('minimum', 'median'))}")
    names = [report.effects.names[i] for i in report.effects.order[:SHOWN]]
    size = len(names)
    side = max(1.9 * size + 0.8, 5.0)
    figure = Figure(figsize=(side, side), layout="constrained")
    if not len(report.best):
        return _empty(figure)
    grid = figure.subplots(size, size, squeeze=False, gridspec_kw={"wspace": 0.08})
    maps = [getattr(pair, shown).ravel() for pair in report.pairs.values()]
    norm = _norm(np.concatenate(maps)) if maps else None
    limits = _limits(report)
    mesh: QuadMesh | None = None
    for (row, column), ax in np.ndenumerate(grid):
        if row < column:
            ax.set_visible(False)
            continue
        x, y = report.marginals[names[column]].bins, report.marginals[names[row]].bins
        _scale(ax.xaxis, x, ticks=row == size - 1)
        if row == column:
            _curves(ax, report.marginals[names[row]])
            _score_axis(ax, limits)
            ax.tick_params(labelleft=row == 0)
        else:
            mesh = _map(ax, report, (names[column], names[row]), shown, norm)
            _scale(ax.yaxis, y, ticks=column == 0)
        ax.tick_params(labelsize=7)
        if row == size - 1:
            ax.set_xlabel(_label(x, 16), fontsize=8)
        if column == 0:
            ax.set_ylabel(_label(y, 16) if row else _titled(report.runs.name), fontsize=8)
    if mesh is not None:
        bar = figure.colorbar(mesh, cax=figure.add_axes((0.58, 0.95, 0.38, 0.012)), orientation="horizontal")
        bar.set_label(f"{shown} {_titled(report.runs.name)}", fontsize=8)
        bar.ax.tick_params(labelsize=7)
        if isinstance(norm, LogNorm):
            _decimal_ticks(bar.ax.xaxis, *bar.ax.get_xlim())
        handles, labels = grid[0, 0].get_legend_handles_labels()
        place = (0.97, 0.93 - 0.35 / side)
        figure.legend(handles, labels, loc="upper right", bbox_to_anchor=place, fontsize=8, frameon=False)
    return figure


def _map(ax: Axes, report: Report, key: tuple[str, str], shown: str, norm: Normalize | None) -> QuadMesh:
    pair, best = report.pairs[key], report.best[0]
    values = getattr(pair, shown).T
    mesh = ax.pcolormesh(pair.x.edges, pair.y.edges, values, norm=norm, cmap="viridis_r", rasterized=True)
    x, y = (bins.index if bins.labels else report.values[bins.path] for bins in (pair.x, pair.y))
    ax.plot(x[best], y[best], "*", ms=10, color="C3", mec="w", mew=0.6, clip_on=False)
    return mesh


def effects_figure(report: Report) -> Figure:
    """Shares of the variance of the score: of each parameter, alone and with one other, and of none."""
    found = report.effects
    order = found.order[:20]
    names = [found.names[i] for i in order]
    left = len(found.names) - len(names)
    if left:
        names[-1] += f" (and {left} that matter less)"
    figure = Figure(figsize=(8.5, 0.34 * len(names) + 1.9), layout="constrained")
    ax = figure.subplots()
    place = np.arange(len(names))
    main, total = np.nan_to_num(found.main[order]), np.nan_to_num(found.total[order])
    ax.barh(place, 100 * main, color="C0", label="alone")
    ax.barh(place, 100 * (total - main), left=100 * main, color="C1", label="together with one other")
    error = 100 * np.nan_to_num(found.total_error[order])
    ax.errorbar(100 * total, place, xerr=error, fmt="none", ecolor="0.2", elinewidth=1, capsize=2)
    ax.barh(len(names), 100 * np.nan_to_num(found.unexplained), color="0.7", label="not explained")
    ax.set_yticks([*place, len(names)], [*names, "not explained"], fontsize=8)
    ax.invert_yaxis()
    ax.set_xlim(0, None if (total + error / 100).max() > 0.02 else 100)
    what = "log₁₀ score" if found.scale == "log" else "score"
    ax.set_xlabel(f"share of the variance of the {what} (%)")
    ax.grid(alpha=0.3, axis="x")
    figure.legend(fontsize=8, loc="outside lower center", ncols=3, frameon=False)
    predicted = "" if np.isnan(found.q2) else f"; {100 * max(found.q2, 0):.1f} % predicted in runs left out"
    bad = f", {found.diverged} more diverged" if found.diverged else ""
    figure.suptitle(f"{found.runs - found.diverged} runs{bad}{predicted}\n{found.note}", fontsize=9)
    return figure


def pareto_figure(report: Report) -> Figure:
    """One score of all runs over another with the runs that no other beats in both, whole and from near."""
    figure = Figure(figsize=(10.5, 4.6), layout="constrained")
    trade = report.pareto
    if trade is None or not len(trade.place):
        return _empty(figure)
    both = np.isfinite(trade.first) & np.isfinite(trade.second)
    x, y = trade.first[both], trade.second[both]
    front = trade.first[trade.place], trade.second[trade.place]
    best = report.best[:1]
    for ax, close in zip(figure.subplots(1, 2), (False, True), strict=True):
        inside = np.ones(len(x), bool)
        if close:
            inside = (x <= 1.5 * front[0].max()) & (y <= 1.5 * front[1].max())
        _dots(ax, x[inside], y[inside])
        ax.step(*front, where="post", color="C0", lw=1)
        ax.plot(*front, "o", ms=4, color="C0", label=f"not beaten in both ({len(trade.place)})")
        ax.plot(trade.first[best], trade.second[best], "*", ms=14, color="C3", mec="w", label="best run")
        ax.set_xlabel(_titled(trade.names[0]))
        ax.set_ylabel(_titled(trade.names[1]))
        ax.set_title("near the best" if close else "all runs", fontsize=9)
        ax.grid(alpha=0.3)
    ax.legend(fontsize=8)
    return figure


def _dots(ax: Axes, x: np.ndarray, y: np.ndarray) -> None:
    """Runs as dots, or as a density where they are many, on log scales where they spread far."""
    scales: list[Any] = ["log" if _is_wide(each) else "linear" for each in (x, y)]
    if len(x) > _DOTS:
        ax.hexbin(
            x, y, xscale=scales[0], yscale=scales[1], gridsize=60, bins="log", mincnt=1, cmap=_GREYS, lw=0
        )
    else:
        ax.plot(x, y, ".", ms=4, color="0.65", mec="none", label="runs")
    for axis, scale, values in ((ax.xaxis, scales[0], x), (ax.yaxis, scales[1], y)):
        ax.set(**{f"{axis.axis_name}scale": scale})
        if scale == "log":
            _decimal_ticks(axis, values.min(), values.max())


def _empty(figure: Figure) -> Figure:
    figure.clear()
    figure.text(0.5, 0.5, "no run got through all recordings", ha="center", va="center")
    return figure


def _cloud(ax: Axes, report: Report, path: str, limits: tuple[float, float]) -> None:
    bins, places = report.marginals[path].bins, report.runs.finite
    score = report.runs.score[places]
    inside = score <= limits[1]
    score, places = score[inside], places[inside]
    if bins.labels is not None:
        x = bins.index[places] + np.random.default_rng(0).uniform(-0.3, 0.3, len(places))
    else:
        x = report.values[path][places]
    if len(score) > _DOTS:
        kind: tuple[Any, Any] = ("log" if bins.log else "linear", "log" if _is_wide(score) else "linear")
        ax.hexbin(
            x,
            score,
            xscale=kind[0],
            yscale=kind[1],
            gridsize=(40, 30),
            bins="log",
            mincnt=1,
            cmap=_GREYS,
            lw=0,
        )
    else:
        size = 3 if len(score) > 300 else 6
        ax.plot(x, score, ".", ms=size, color="0.5", alpha=0.6, mec="none", zorder=1, label="runs")


def _curves(ax: Axes, marginal: Marginal) -> None:
    """Median, middle half, lowest twentieth and minimum over the bins, and the share diverged on top."""
    bins, (q05, q25, q50, q75) = marginal.bins, marginal.quantiles
    if bins.labels is not None:
        x = np.arange(len(bins.labels))
        ax.vlines(x, q25, q75, color="C0", lw=12, alpha=0.3, label="middle half")
        for values, style, label in (
            (q50, "C0_", "median"),
            (q05, "C2_", "best 5 %"),
            (marginal.minimum, "C3_", "best"),
        ):
            ax.plot(x, values, style, ms=14, mew=1.6, label=label)
    else:
        x = bins.centres
        ax.fill_between(x, q25, q75, color="C0", alpha=0.3, lw=0, label="middle half")
        ax.plot(x, q50, color="C0", lw=1.6, label="median")
        ax.plot(x, q05, color="C2", lw=1.2, label="best 5 %")
        ax.plot(x, marginal.minimum, color="C3", lw=1.2, label="best")
    if np.nan_to_num(marginal.diverged).max() > 0:
        share = 1 - 0.3 * np.nan_to_num(marginal.diverged)
        look: dict[str, Any] = {
            "color": "k",
            "alpha": 0.35,
            "lw": 0,
            "transform": ax.get_xaxis_transform(),
            "zorder": 3,
        }
        ax.fill_between(
            bins.edges,
            np.append(share, share[-1]),
            1.0,
            step="post",
            label="diverged (from the top)",
            **look,
        )


def _limits(report: Report) -> tuple[float, float]:
    """Score shown: from the best to what nearly all runs reach."""
    score = report.runs.score[report.runs.finite]
    low, high = float(score.min()), float(np.quantile(score, 0.99 if len(score) > 1000 else 1.0))
    return low, max(high, low + max(abs(low), 1e-12) * 1e-3)


def _is_wide(values: np.ndarray) -> bool:
    return bool(values.min() > 0 and np.quantile(values, 0.99) > _WIDE * values.min())


def _score_axis(ax: Axes, limits: tuple[float, float]) -> None:
    low, high = limits
    if low > 0 and high > _WIDE * low:
        ax.set_yscale("log")
        room = (high / low) ** 0.06
        ax.set_ylim(low / room, high * room**2)
        _decimal_ticks(ax.yaxis, low, high)
    else:
        room = 0.06 * (high - low)
        ax.set_ylim(low - room, high + 2 * room)
    ax.grid(alpha=0.3)


def _decimal_ticks(axis: Any, low: float, high: float) -> None:
    """Ticks at 1, 2, 5 of each decade, or decades only over a wide range, written out as numbers."""
    decades = math.log10(high / low)
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if decades < 2.5 else (1.0,)))
    axis.set_major_formatter(lambda x, _: f"{x:g}")
    axis.set_minor_formatter(NullFormatter())


def _norm(values: np.ndarray) -> Normalize:
    values = values[np.isfinite(values)]
    low, high = float(values.min()), float(np.quantile(values, 0.98))
    high = max(high, low * (1 + 1e-3), low + 1e-12)
    return LogNorm(low, high) if _is_wide(values) else Normalize(low, high)


def _plain(score: str) -> str:
    return score.removesuffix(f"_{unit_of(score)}")


def _titled(score: str) -> str:
    return f"{_plain(score)} ({unit_of(score)})"


def _label(bins: Bins, most: int) -> str:
    """The path, broken before its last part where it is longer than `most` letters, and the unit."""
    unit = with_unit("", bins.unit).strip().replace("^2", "²").replace("^3", "³").replace("^4", "⁴")
    unit = unit.replace("sqrt(Hz)", "√Hz")
    *groups, name = bins.path.split(".")
    text = ".".join(groups) + ".\n" + name if groups and len(bins.path) > most else bins.path
    if not unit:
        return text
    return f"{text}\n({unit})" if len(text.split("\n")[-1]) + len(unit) > most + 12 else f"{text} ({unit})"


def _horizontal(ax: Axes, bins: Bins) -> None:
    _scale(ax.xaxis, bins, ticks=True)
    ax.set_xlabel(_label(bins, 30), fontsize=8)
    ax.tick_params(labelsize=7)


def _scale(axis: Any, bins: Bins, ticks: bool) -> None:
    """Scale, limits and ticks of an axis along a parameter."""
    axis.axes.set(**{f"{axis.axis_name}scale": "log" if bins.log else "linear"})
    axis.axes.set(**{f"{axis.axis_name}lim": (bins.edges[0], bins.edges[-1])})
    if bins.labels is not None:
        axis.set_ticks(range(len(bins.labels)), [label[:10] for label in bins.labels])
    elif bins.log:
        decades = math.log10(bins.edges[-1] / bins.edges[0])
        if decades < 1.5:
            _decimal_ticks(axis, bins.edges[0], bins.edges[-1])
        else:
            axis.set_major_locator(LogLocator(numticks=5))
            axis.set_major_formatter(LogFormatterSciNotation())
            axis.set_minor_formatter(NullFormatter())
        if decades > 4:
            axis.set_minor_locator(NullLocator())
    else:
        axis.set_major_locator(MaxNLocator(4))
    if not ticks:
        axis.set_tick_params(labelbottom=False, labelleft=False)


def _legend(axes: Any) -> tuple[list[Any], list[str]]:
    """One handle for each label over several panels."""
    found: dict[str, Any] = {}
    for ax in sorted(axes, key=lambda each: not each.lines):
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    return list(found.values()), list(found)
