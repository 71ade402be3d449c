"""What a sweep says: the best runs, what each parameter does, how flat the optimum is, how far to trust it.

Everything starts from `columns`, the table of a sweep with one row for each run on each recording: `run`,
`recording`, `healthy`, one column for each swept parameter and setting, and scores in m.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from pedjax.errors import InputError, suggest
from pedjax.evaluation.scores import is_score, unit_of
from pedjax.sweeping.designs import Axis
from pedjax.sweeping.effects import Effects, coded, effects

QUANTILES = (0.05, 0.25, 0.5, 0.75)
NEAR = 0.05
"""Runs whose score is at most this share above the best count as equally good."""
SHOWN = 8
"""Parameters, the most telling ones, whose pairs are mapped."""

_AT_EDGE = 0.02
_CROWD_AT_EDGE = 0.1

Columns = Mapping[str, np.ndarray]


class RunScores(NamedTuple):
    """One score `name` of each of N runs, in order of their numbers `run (N,)`, in its `unit`.

    `score (N,)` is the mean over recordings, NaN where the run `diverged (N,)` on any of them or is
    `incomplete (N,)`, cut off before it saw all; `each (N, R)` is the score on each of `recordings`, those
    that have it at all; `row (N,)` a row of the columns that belongs to the run.
    """

    name: str
    run: np.ndarray
    row: np.ndarray
    score: np.ndarray
    diverged: np.ndarray
    incomplete: np.ndarray
    recordings: tuple[str, ...]
    each: np.ndarray

    @property
    def unit(self) -> str:
        """Of the score."""
        return unit_of(self.name)

    @property
    def finite(self) -> np.ndarray:
        """Places of the runs that have a score."""
        return np.flatnonzero(np.isfinite(self.score))


@dataclass(frozen=True)
class Bins:
    """Bins along a parameter, between `edges (B+1,)` in its unit, and the bin `index (N,)` of every run.

    A setting has `labels`, one a bin, and edges half-way between 0, 1, ...
    """

    path: str
    unit: str
    log: bool
    edges: np.ndarray
    index: np.ndarray
    labels: tuple[str, ...] | None

    @property
    def centres(self) -> np.ndarray:
        """Middles of the bins `(B,)` on the parameter's own scale."""
        low, high = self.edges[:-1], self.edges[1:]
        return np.sqrt(low * high) if self.log else (low + high) / 2


@dataclass(frozen=True)
class Marginal:
    """Score over one parameter: `count (B,)` runs in each of the `bins`, the `diverged (B,)` share of them.

    Of the others `quantiles (4, B)` at `QUANTILES`, and the `minimum (B,)`; NaN where a bin is empty.
    """

    bins: Bins
    count: np.ndarray
    diverged: np.ndarray
    quantiles: np.ndarray
    minimum: np.ndarray


@dataclass(frozen=True)
class Pair:
    """Score over two parameters: `count`, `diverged` share, `median` and `minimum`, each `(Bx, By)`."""

    x: Bins
    y: Bins
    count: np.ndarray
    diverged: np.ndarray
    median: np.ndarray
    minimum: np.ndarray


class Pareto(NamedTuple):
    """Runs that no other beats in both scores `names`: `place (K,)` among all runs, and number `run (K,)`.

    `first` and `second (N,)` m are the two scores of all runs.
    """

    names: tuple[str, str]
    place: np.ndarray
    run: np.ndarray
    first: np.ndarray
    second: np.ndarray


class Edge(NamedTuple):
    """A parameter whose optimum lies at one `side` of the range swept, `low` or `high`.

    `value` is the best run's; `best`: that lies there; `crowd`: so does the median of the best
    hundredth of runs (10 to 100 of them), which chance does not explain.
    """

    path: str
    side: str
    value: float
    best: bool
    crowd: bool


class Span(NamedTuple):
    """Values of a parameter among the runs near the best: `low` to `high`, a `share` of the range swept."""

    low: float
    high: float
    share: float


class Regret(NamedTuple):
    """A recording: its own best `run`, its score m there, `own`, and `at` the run that is best over all."""

    recording: str
    run: int
    own: float
    at: float


@dataclass(frozen=True)
class Report:
    """All that is known of a sweep; `values[path] (N,)` of the runs, `best` their places, the best first.

    `near` counts the runs within `NEAR` of the best, `spans` says where they lie, `choices` which settings
    they have.
    """

    axes: tuple[Axis, ...]
    settings: dict[str, tuple[Any, ...]]
    runs: RunScores
    values: dict[str, np.ndarray]
    best: np.ndarray
    effects: Effects
    marginals: dict[str, Marginal]
    pairs: dict[tuple[str, str], Pair]
    edges: tuple[Edge, ...]
    near: int
    spans: dict[str, Span]
    choices: dict[str, tuple[Any, ...]]
    regrets: tuple[Regret, ...]
    pareto: Pareto | None


def analyse(
    columns: Columns,
    axes: Sequence[Axis],
    settings: Mapping[str, Sequence[Any]] | None = None,
    *,
    score: str = "armse_m",
    second: str | None = None,
    scale: Literal["log", "linear"] = "log",
    count: int = 20,
) -> Report:
    """Everything about one score of a sweep, and its trade against a `second` one.

    `scale` is that of the score whose variance is shared out; `count` the best runs kept. Without `second` it
    is the final error, or the largest, whichever the sweep has.
    """
    choices = {path: tuple(known) for path, known in (settings or {}).items()}
    swept = (*(axis.path for axis in axes), *choices)
    for path in swept:
        if path not in columns:
            raise InputError(f"the sweep has no column '{path}'{suggest(path, columns)}")
    runs = per_run(columns, score)
    values = {path: np.asarray(columns[path])[runs.row] for path in swept}
    whole = runs.diverged | ~runs.incomplete
    found = effects({k: v[whole] for k, v in values.items()}, runs.score[whole], axes, choices, scale=scale)
    spans, chosen, close = near(runs, values, axes, choices)
    return Report(
        axes=tuple(axes),
        settings=choices,
        runs=runs,
        values=values,
        best=best(runs, count),
        effects=found,
        marginals=marginals(runs, values, axes, choices),
        pairs=pairs(runs, values, axes, choices, [found.names[i] for i in found.order[:SHOWN]]),
        edges=interior(runs, values, axes),
        near=close,
        spans=spans,
        choices=chosen,
        regrets=regrets(runs),
        pareto=_trade(columns, score, second),
    )


def per_run(columns: Columns, score: str) -> RunScores:
    """Mean over recordings of one score for every run; a row that comes twice counts as it came last."""
    known = [name for name in columns if is_score(name)]
    if score not in known:
        raise InputError(f"score '{score}' is not in the sweep{suggest(score, known)}")
    value = np.asarray(columns[score], float)
    if not len(value):
        raise InputError("the sweep holds no runs")
    healthy = np.asarray(columns["healthy"], bool) if "healthy" in columns else np.isfinite(value)
    run, row, index = np.unique(np.asarray(columns["run"]), return_index=True, return_inverse=True)
    recordings, code = coded(columns["recording"])
    each = np.full((len(run), len(recordings)), np.nan)
    seen = np.zeros(each.shape, bool)
    well = np.zeros(each.shape, bool)
    seen[index, code] = True
    well[index, code] = healthy
    each[index, code] = np.where(healthy & np.isfinite(value), value, np.nan)
    # a recording without this score (heights unknown, say) has none in any run, healthy or not
    scored = np.isfinite(each).any(axis=0) | ~well.any(axis=0)
    if not scored.any():
        raise InputError(f"score '{score}' has no value in this sweep; choose another one")
    each, seen = each[:, scored], seen[:, scored]
    return RunScores(
        name=score,
        run=run,
        row=row,
        score=each.mean(axis=1),
        diverged=(seen & np.isnan(each)).any(axis=1),
        incomplete=np.asarray(~seen.all(axis=1)),
        recordings=tuple(str(r) for r, s in zip(recordings, scored, strict=True) if s),
        each=each,
    )


def best(runs: RunScores, count: int = 20) -> np.ndarray:
    """Places of the best runs `(count,)`, the best first, of equal ones the first."""
    places = runs.finite
    if count < len(places):
        worst = np.partition(runs.score[places], count - 1)[count - 1]
        places = places[runs.score[places] <= worst]
    return places[np.argsort(runs.score[places], kind="stable")][:count]


def marginals(
    runs: RunScores,
    values: Mapping[str, np.ndarray],
    axes: Sequence[Axis],
    settings: Mapping[str, Sequence[Any]] | None = None,
) -> dict[str, Marginal]:
    """Score over each parameter and setting alone, whatever the others are."""
    most = int(np.clip(np.sqrt(len(runs.run)) / 1.5, 3, 40))
    made = {}
    for path, bins in _all_bins(values, axes, settings or {}, most).items():
        count = len(bins.edges) - 1
        diverged, total = _diverged(runs, bins.index, count)
        quantiles, minimum = _quantiles(runs, bins.index, count, QUANTILES)
        made[path] = Marginal(bins, total, diverged, quantiles, minimum)
    return made


def pairs(
    runs: RunScores,
    values: Mapping[str, np.ndarray],
    axes: Sequence[Axis],
    settings: Mapping[str, Sequence[Any]] | None = None,
    names: Sequence[str] | None = None,
) -> dict[tuple[str, str], Pair]:
    """Score over every two of `names` (default: all), in that order."""
    most = int(np.clip(np.sqrt(len(runs.run) / 10), 3, 32))
    bins = _all_bins(values, axes, settings or {}, most)
    made = {}
    for a, b in itertools.combinations(bins if names is None else names, 2):
        x, y = bins[a], bins[b]
        shape = (len(x.edges) - 1, len(y.edges) - 1)
        index = x.index * shape[1] + y.index
        diverged, total = _diverged(runs, index, shape[0] * shape[1])
        quantiles, minimum = _quantiles(runs, index, shape[0] * shape[1], (0.5,))
        maps = (total, diverged, quantiles[0], minimum)
        made[a, b] = Pair(x, y, *(flat.reshape(shape) for flat in maps))
    return made


def pareto(columns: Columns, first: str, second: str) -> Pareto:
    """Runs that no other run beats in one score without losing in the other, by the first score.

    Equal runs are kept together.
    """
    one, two = per_run(columns, first), per_run(columns, second)
    place = np.flatnonzero(np.isfinite(one.score) & np.isfinite(two.score))
    a, b = one.score[place], two.score[place]
    order = np.lexsort((b, a))
    a, b = a[order], b[order]
    start = np.flatnonzero(np.diff(a, prepend=-np.inf) > 0)
    lowest = b[start]
    before = np.minimum.accumulate(np.append(np.inf, lowest))[:-1]
    group = np.repeat(np.arange(len(start)), np.diff(np.append(start, len(a))))
    keep = place[order[(lowest < before)[group] & (b == lowest[group])]]
    return Pareto((first, second), keep, one.run[keep], one.score, two.score)


def interior(runs: RunScores, values: Mapping[str, np.ndarray], axes: Sequence[Axis]) -> tuple[Edge, ...]:
    """Parameters whose optimum may lie outside the range that was swept."""
    finite = runs.finite
    top = best(runs, int(np.clip(len(finite) // 100, 10, 100)))
    found = []
    for axis in axes:
        low, high = axis.forward(np.array([axis.low, axis.high]))
        if not len(finite) or not high > low:
            continue
        place = (axis.forward(values[axis.path][top]) - low) / (high - low)
        crowd = float(np.median(place)) if len(finite) >= 3 * len(top) else 0.5
        for side, at, centre in (("low", place[0], crowd), ("high", 1 - place[0], 1 - crowd)):
            if at < _AT_EDGE or centre < _CROWD_AT_EDGE:
                value = float(values[axis.path][top[0]])
                found.append(Edge(axis.path, side, value, bool(at < _AT_EDGE), centre < _CROWD_AT_EDGE))
    return tuple(found)


def near(
    runs: RunScores,
    values: Mapping[str, np.ndarray],
    axes: Sequence[Axis],
    settings: Mapping[str, Sequence[Any]] | None = None,
    within: float = NEAR,
) -> tuple[dict[str, Span], dict[str, tuple[Any, ...]], int]:
    """How flat the optimum is: spans of parameters and choices of settings among runs near the best.

    Near is a score of at most 1 + `within` times the best; the number of such runs comes last.
    """
    finite = runs.finite
    if not len(finite):
        return {}, {}, 0
    close = finite[runs.score[finite] <= (1 + within) * runs.score[finite].min()]
    spans = {}
    for axis in axes:
        some = values[axis.path][close]
        ends = axis.forward(np.array([some.min(), some.max(), axis.low, axis.high]))
        share = (ends[1] - ends[0]) / (ends[3] - ends[2]) if ends[3] > ends[2] else 0.0
        spans[axis.path] = Span(float(some.min()), float(some.max()), float(share))
    choices = {}
    for path, known in (settings or {}).items():
        labels, index = coded(values[path][close], known)
        choices[path] = tuple(labels[i] for i in np.unique(index))
    return spans, choices, len(close)


def regrets(runs: RunScores) -> tuple[Regret, ...]:
    """What each recording loses by the run that is best over all of them, the greatest loss first."""
    if not len(runs.finite):
        return ()
    overall = best(runs, 1)[0]
    own = np.nanargmin(runs.each, axis=0)
    made = [
        Regret(name, int(runs.run[k]), float(runs.each[k, r]), float(runs.each[overall, r]))
        for r, (name, k) in enumerate(zip(runs.recordings, own, strict=True))
    ]
    return tuple(sorted(made, key=lambda each: each.own - each.at))


def _trade(columns: Columns, score: str, second: str | None) -> Pareto | None:
    if second is not None:
        return pareto(columns, score, second)
    for other in ("final_2d_m", "max_2d_m"):
        if other in columns and other != score and np.isfinite(columns[other]).any():
            return pareto(columns, score, other)
    return None


def _all_bins(
    values: Mapping[str, np.ndarray], axes: Sequence[Axis], settings: Mapping[str, Sequence[Any]], most: int
) -> dict[str, Bins]:
    made = {axis.path: _bins(axis, values[axis.path], most) for axis in axes}
    for path, known in settings.items():
        labels, index = coded(values[path], known)
        edges = np.arange(len(labels) + 1) - 0.5
        made[path] = Bins(path, "", False, edges, index, tuple(str(label) for label in labels))
    return made


def _bins(axis: Axis, values: np.ndarray, most: int) -> Bins:
    """One bin a value where these are few, as on a grid, else equal ones on the parameter's own scale."""
    own = axis.forward(values)
    levels = np.unique(own[: 50 * most]) if len(own) > 50 * most else np.unique(own)
    if len(levels) <= 2 * most:
        levels = np.unique(own)
    if len(levels) <= 2 * most:
        step = np.diff(levels)
        step = step if len(step) else np.array([1.0])
        inner = (levels[1:] + levels[:-1]) / 2
        edges = np.concatenate([[levels[0] - step[0] / 2], inner, [levels[-1] + step[-1] / 2]])
    else:
        ends = axis.forward(np.array([axis.low, axis.high]))
        edges = np.linspace(min(ends[0], own.min()), max(ends[1], own.max()), most + 1)
    index = np.clip(np.searchsorted(edges, own, side="right") - 1, 0, len(edges) - 2)
    return Bins(axis.path, axis.unit, axis.log, np.exp(edges) if axis.log else edges, index, None)


def _diverged(runs: RunScores, index: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Share of diverged runs and number of all in each bin, less incomplete ones."""
    bad = np.bincount(index[runs.diverged], minlength=count)
    total = bad + np.bincount(index[runs.finite], minlength=count)
    return np.where(total > 0, bad / np.maximum(total, 1), np.nan), total


def _quantiles(
    runs: RunScores, index: np.ndarray, count: int, wanted: Sequence[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Quantiles `(Q, count)` and minimum `(count,)` of the score in each bin."""
    finite = runs.finite
    order = np.lexsort((runs.score[finite], index[finite]))
    score = runs.score[finite][order]
    size = np.bincount(index[finite], minlength=count)
    start = np.cumsum(size) - size
    full = size > 0
    out = np.full((len(wanted) + 1, count), np.nan)
    for k, quantile in enumerate((*wanted, 0.0)):
        place = start[full] + quantile * (size[full] - 1)
        low = place.astype(int)
        high = np.minimum(low + 1, (start + size - 1)[full])
        out[k, full] = score[low] + (place - low) * (score[high] - score[low])
    return out[:-1], out[-1]
