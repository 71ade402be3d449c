"""A sweep's report as tables, and as lines for the terminal."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from pedjax.evaluation.scores import unit_of
from pedjax.sweeping.effects import Effects
from pedjax.sweeping.report import NEAR, QUANTILES, Bins, Edge, Marginal, Pair, Report


def report_tables(report: Report) -> dict[str, dict[str, list[Any]]]:
    """Tables by name, each of columns of equal length, ready for `output.write_table`."""
    runs, found = report.runs, report.effects
    tables: dict[str, dict[str, list[Any]]] = {}
    tables["best"] = {
        "run": runs.run[report.best].tolist(),
        runs.name: runs.score[report.best].tolist(),
        **{path: values[report.best].tolist() for path, values in report.values.items()},
    }
    tables["effects"] = {
        "parameter": [*found.names, "unexplained"],
        "main": [*found.main.tolist(), found.unexplained],
        "main_error": [*found.main_error.tolist(), 0.0],
        "total": [*found.total.tolist(), found.unexplained],
        "total_error": [*found.total_error.tolist(), 0.0],
    }
    couples = list(itertools.combinations(range(len(found.names)), 2))
    tables["interactions"] = {
        "first": [found.names[i] for i, _ in couples],
        "second": [found.names[j] for _, j in couples],
        "share": [float(found.pair[i, j]) for i, j in couples],
    }
    unit = report.runs.unit
    tables["marginals"] = _stacked([_marginal_table(path, m, unit) for path, m in report.marginals.items()])
    tables["pairs"] = _stacked([_pair_table(a, b, pair, unit) for (a, b), pair in report.pairs.items()])
    tables["optimum"] = {
        "parameter": list(report.spans),
        "unit": [axis.unit for axis in report.axes if axis.path in report.spans],
        "best": [float(report.values[path][report.best[0]]) for path in report.spans],
        "near_low": [span.low for span in report.spans.values()],
        "near_high": [span.high for span in report.spans.values()],
        "near_share_of_range": [span.share for span in report.spans.values()],
    }
    tables["edges"] = {name: [getattr(edge, name) for edge in report.edges] for name in Edge._fields}
    tables["recordings"] = {
        "recording": [each.recording for each in report.regrets],
        "own_best_run": [each.run for each in report.regrets],
        f"own_best_{report.runs.unit}": [each.own for each in report.regrets],
        f"at_overall_best_{report.runs.unit}": [each.at for each in report.regrets],
        f"regret_{report.runs.unit}": [each.at - each.own for each in report.regrets],
    }
    if report.pareto is not None:
        place = report.pareto.place
        tables["pareto"] = {
            "run": report.pareto.run.tolist(),
            report.pareto.names[0]: report.pareto.first[place].tolist(),
            report.pareto.names[1]: report.pareto.second[place].tolist(),
            **{path: values[place].tolist() for path, values in report.values.items()},
        }
    return tables


def _stacked(parts: Sequence[dict[str, list[Any]]]) -> dict[str, list[Any]]:
    return {name: [x for part in parts for x in part[name]] for name in parts[0]} if parts else {}


def _names_of(bins: Bins) -> list[str]:
    return list(bins.labels) if bins.labels is not None else [f"{centre:.9g}" for centre in bins.centres]


def _marginal_table(path: str, marginal: Marginal, unit: str) -> dict[str, list[Any]]:
    bins = marginal.bins
    quantiles = {
        f"q{100 * q:02.0f}_{unit}": row.tolist() for q, row in zip(QUANTILES, marginal.quantiles, strict=True)
    }
    return {
        "parameter": [path] * len(marginal.count),
        "centre": _names_of(bins),
        "low": bins.edges[:-1].tolist(),
        "high": bins.edges[1:].tolist(),
        "runs": marginal.count.tolist(),
        "diverged_share": marginal.diverged.tolist(),
        f"minimum_{unit}": marginal.minimum.tolist(),
        **quantiles,
    }


def _pair_table(first: str, second: str, pair: Pair, unit: str) -> dict[str, list[Any]]:
    x, y = _names_of(pair.x), _names_of(pair.y)
    return {
        "first": [first] * pair.count.size,
        "second": [second] * pair.count.size,
        "first_centre": [a for a in x for _ in y],
        "second_centre": [b for _ in x for b in y],
        "runs": pair.count.ravel().tolist(),
        "diverged_share": pair.diverged.ravel().tolist(),
        f"median_{unit}": pair.median.ravel().tolist(),
        f"minimum_{unit}": pair.minimum.ravel().tolist(),
    }


def describe(report: Report) -> list[str]:
    """The report in at most 40 lines for the terminal."""
    runs, found = report.runs, report.effects
    swept = _many(len(report.axes), "parameter") + (
        f" and {_many(len(report.settings), 'setting')}" if report.settings else ""
    )
    lines = [f"{_many(len(runs.run), 'run')} over {swept} on {_many(len(runs.recordings), 'recording')}"]
    bad, cut = int(runs.diverged.sum()), int((runs.incomplete & ~runs.diverged).sum())
    lines[0] += f"; {bad} diverged ({bad / len(runs.run):.1%})" if bad else "; none diverged"
    if cut:
        lines.append(f"{_many(cut, 'run')} cut off before the last recording, left out")
    if not len(report.best):
        return [*lines, "no run got through all recordings: nothing more to say"]
    score = runs.score[runs.finite]
    lines.append(
        f"{runs.name}, mean over recordings: best {score.min():.4g} {runs.unit} "
        f"(run {runs.run[report.best[0]]}), best 1% below {np.quantile(score, 0.01):.4g} {runs.unit}, "
        f"median {np.median(score):.4g} {runs.unit}"
    )
    trust = "" if np.isnan(found.q2) else f", {max(found.q2, 0):.1%} of it predicted in runs left out"
    lines.append(f"variance of {'log10 score' if found.scale == 'log' else 'the score'}{trust}: {found.note}")
    lines += _optimum_lines(report)
    lines += _interaction_lines(found)
    lines += _edge_lines(report)
    lines += _regret_lines(report)
    if report.pareto is not None and len(report.pareto.place):
        first, second = report.pareto.first[report.pareto.place], report.pareto.second[report.pareto.place]
        a, b = report.pareto.names
        u, v = unit_of(a), unit_of(b)
        ends = f"{first[0]:.4g} {u} and {second[0]:.4g} {v}"
        if len(first) > 1:
            ends += f" to {first[-1]:.4g} {u} and {second[-1]:.4g} {v}"
        lines.append(f"{a} against {b}: {_many(len(first), 'run')} that no other beats in both, {ends}")
    return lines


def with_unit(number: str, unit: str) -> str:
    """A number with its unit, if it has one."""
    return number if unit in ("", "1", "-") else f"{number} {unit}"


def _many(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _optimum_lines(report: Report, most: int = 12) -> list[str]:
    found, units = report.effects, {axis.path: axis.unit for axis in report.axes}
    plural = "run lies" if report.near == 1 else "runs lie"
    head = f"{report.near} {plural} within {NEAR:.0%} of the best"
    rows: list[tuple[str, ...]] = [("", "best", "near the best", "of range", "alone", "total")]
    for i in found.order[:most]:
        path = found.names[i]
        value = report.values[path][report.best[0]]
        shares = tuple("-" if np.isnan(x) else f"{x:.1%}" for x in (found.main[i], found.total[i]))
        if path in report.spans:
            span = report.spans[path]
            around = (with_unit(f"{span.low:.4g} to {span.high:.4g}", units[path]), f"{span.share:.0%}")
            rows.append((path, f"{value:.4g}", *around, *shares))
        else:
            some = ", ".join(str(choice) for choice in report.choices[path])
            rows.append((path, str(value), some, "", *shares))
    widths = [max(len(row[k]) for row in rows) for k in range(6)]
    lines = []
    for row in rows:
        left = f"  {row[0]:<{widths[0]}}  {row[1]:>{widths[1]}}  {row[2]:<{widths[2]}}"
        lines.append(
            left + "".join(f"  {cell:>{width}}" for cell, width in zip(row[3:], widths[3:], strict=True))
        )
    if len(found.names) > most:
        lines.append(f"  and {len(found.names) - most} that matter less")
    return [head, *lines]


def _interaction_lines(found: Effects, most: int = 4) -> list[str]:
    couples = itertools.combinations(range(len(found.names)), 2)
    strong = [(float(found.pair[i, j]), i, j) for i, j in couples if found.pair[i, j] >= 0.01]
    return [
        f"  {found.names[i]} with {found.names[j]}: {share:.1%} beyond the two"
        for share, i, j in sorted(strong, reverse=True)[:most]
    ]


def _edge_lines(report: Report, most: int = 5) -> list[str]:
    weight = dict(zip(report.effects.names, np.nan_to_num(report.effects.total), strict=True))
    units = {axis.path: axis.unit for axis in report.axes}
    ordered = sorted(report.edges, key=lambda edge: (not edge.crowd, -weight[edge.path]))
    lines = []
    for edge in ordered[:most]:
        who = "the best runs lie" if edge.crowd else "the best run alone lies"
        lines.append(
            f"{edge.path}: {who} at the {edge.side} end of the range "
            f"({with_unit(f'{edge.value:.4g}', units[edge.path])}); "
            + ("widen it" if edge.crowd else "perhaps by chance")
        )
    return [*lines, f"and {len(ordered) - most} more at an end"] if len(ordered) > most else lines


def _regret_lines(report: Report, most: int = 3) -> list[str]:
    if len(report.regrets) < 2:
        return []
    unit = report.runs.unit
    own = float(np.mean([each.own for each in report.regrets]))
    at = float(np.mean([each.at for each in report.regrets]))
    lines = [
        f"each recording with its own best run would have {own:.4g} {unit} instead of {at:.4g} {unit}; "
        "most to gain:"
    ]
    return lines + [
        f"  {each.recording}: {each.own:.4g} {unit} (run {each.run}) instead of {each.at:.4g} {unit}"
        for each in report.regrets[:most]
    ]
