"""Which parameters matter: shares of the variance of a score, alone and in pairs.

The score is regressed on products of polynomials that are orthonormal over the swept ranges (Legendre)
where the runs fill them evenly, else over the runs themselves, so the variance that a parameter or a pair
explains is the sum of its squared coefficients. Terms enter one at a time, the most telling first; how
many, and up to which degree, is decided by runs that were left out, selection included. One pass over the
runs collects everything that is needed.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from pedjax.errors import InputError, suggest
from pedjax.sweeping.designs import Axis

DEGREES = (1, 2, 3, 4, 5, 6, 8, 10, 12, 14, 16)
"""Total degrees that are tried."""

_MOST_TERMS = 1500
_MOST_STEPS = 400
_WORK = 3e11
"""Multiplications that the one pass over the runs may take; beyond, it takes a random part of them."""
_PARTNERS = 8
"""Where there are more factors, pairs of higher degree are looked for among this many of the strongest."""
_FEWEST = 10
"""Finite runs below which nothing is said."""


@dataclass(frozen=True)
class Effects:
    """Shares of the variance of the score (`scale`: of its log10 or itself) over runs that did not diverge.

    `main (F,)` is what each of the F parameters and settings `names` explains alone, `pair (F, F)`,
    symmetric, what two explain together beyond that, `total (F,)` the main share and all pairs of one. All
    main shares, every pair once and `unexplained` add up to 1; what takes three at once, or more runs to
    see, is unexplained, so a total is a lower bound. `main_error` and `total_error (F,)` are standard
    errors (jackknife).

    `q2` is the share of variance predicted in runs that were left out, with `terms` terms of degree `degree`,
    from `used` different runs of `runs`, `diverged` of which diverged. `even` says that the parameters vary
    independently over the runs, as in every design of the package; the shares are then Sobol' indices. In a
    list of one's own, or where whole corners diverged, they do not: the shares are then covariances of each
    part with the score among the runs at hand, and parameters that vary together share theirs in a way that
    no data can settle. `note` says in words how far to trust all this; where too few runs are left the shares
    are NaN.
    """

    names: tuple[str, ...]
    main: np.ndarray
    pair: np.ndarray
    total: np.ndarray
    main_error: np.ndarray
    total_error: np.ndarray
    unexplained: float
    q2: float
    degree: int
    terms: int
    runs: int
    used: int
    diverged: int
    scale: str
    even: bool
    note: str

    @property
    def order(self) -> list[int]:
        """Rows of `names` from the largest total share to the smallest."""
        return [int(i) for i in np.argsort(-np.nan_to_num(self.total), kind="stable")]


def effects(
    values: Mapping[str, np.ndarray],
    score: np.ndarray,
    axes: Sequence[Axis],
    settings: Mapping[str, Sequence[Any]] | None = None,
    *,
    scale: Literal["log", "linear"] = "log",
    seed: int = 0,
) -> Effects:
    """Variance shares of a score `(N,)` m, not finite where the run diverged, over `values[path] (N,)`.

    Diverged runs are left out, and counted. `settings` are treated as categories. Repeated runs count once.
    The seed decides on the runs left out together, and on those taken where there are too many.
    """
    if scale not in ("log", "linear"):
        raise InputError(f"scale '{scale}' is unknown{suggest(scale, ('log', 'linear'))}")
    names = (*(axis.path for axis in axes), *(settings or {}))
    if not names:
        raise InputError("nothing was swept: no parameter and no setting")
    score = np.asarray(score, float)
    finite = np.flatnonzero(np.isfinite(score))
    counts = {"runs": len(score), "diverged": len(score) - len(finite), "scale": scale}
    if len(finite) < _FEWEST:
        return _nothing(names, np.nan, len(finite), f"only {len(finite)} finite runs: too few to say", counts)
    rng = np.random.default_rng(seed)
    rows = _distinct(values, names, rng.permutation(finite)[: _rows_at_most(len(finite), len(names))])
    rng.shuffle(rows)
    if len(rows) < _FEWEST:
        return _nothing(names, np.nan, len(rows), f"only {len(rows)} different runs: too few to say", counts)
    y = score[rows]
    if scale == "log":
        positive = y[y > 0]
        y = np.log10(np.maximum(y, positive.min() if len(positive) else 1.0))
    spread = y.std()
    if not spread > 1e-12 * max(np.abs(y).max(), 1e-300):
        return _nothing(names, 0.0, len(rows), "the score is the same in every run", counts)
    factors = [_polynomials(axis, np.asarray(values[axis.path], float)[rows]) for axis in axes]
    factors += [_categories(coded(np.asarray(values[path])[rows])[1]) for path in settings or {}]
    y = (y - y.mean()) / spread
    terms = _dictionary(factors, len(rows), range(len(factors)))
    found = _fit(names, terms, _collect(factors, terms, y), counts)
    strong = [i for i in found.order[:_PARTNERS] if found.total[i] > 0.005]
    if len(names) <= _PARTNERS or found.q2 < 0.2 or len(strong) < 2:
        return found
    terms = _dictionary(factors, len(rows), strong)
    return max(found, _fit(names, terms, _collect(factors, terms, y), counts), key=lambda each: each.q2)


def coded(column: Any, known: Sequence[Any] = ()) -> tuple[list[Any], np.ndarray]:
    """Different entries of a column, those `known` first, and the place `(N,)` of each row's among them."""
    count = itertools.count()
    place: defaultdict[Any, int] = defaultdict(lambda: next(count))
    for value in known:
        place[value]
    index = np.fromiter(map(place.__getitem__, np.asarray(column).tolist()), np.int64, len(column))
    return list(place), index


class _Factor(NamedTuple):
    """A parameter or setting: `scaled (N,)`, its functions `turn (K+1, K)`, and their `degrees (K,)`."""

    scaled: np.ndarray
    turn: np.ndarray
    degrees: np.ndarray

    def functions(self, rows: slice) -> np.ndarray:
        """Functions `(n, K)` of some rows, orthonormal and of mean zero over all of them."""
        return _raw(self.scaled[rows], len(self.turn)) @ self.turn


class _Sums(NamedTuple):
    """Sums over the runs of each fold: terms by terms, terms by score, score squared, and the runs."""

    gram: np.ndarray
    moment: np.ndarray
    square: np.ndarray
    runs: np.ndarray

    def over(self, folds: Sequence[int]) -> tuple[np.ndarray, np.ndarray, float, int]:
        which = list(folds)
        return (
            self.gram[which].sum(axis=0),
            self.moment[which].sum(axis=0),
            float(self.square[which].sum()),
            int(self.runs[which].sum()),
        )


class _Term(NamedTuple):
    """Function `a` of factor `i`, times function `b` of factor `j`; j = -1: alone; i = -1: the constant."""

    i: int
    a: int
    j: int
    b: int
    degree: int


def _raw(scaled: np.ndarray, count: int) -> np.ndarray:
    if scaled.dtype.kind == "i":
        return np.column_stack([np.ones(len(scaled)), scaled[:, None] == np.arange(1, count)])
    return np.polynomial.legendre.legvander(scaled, count - 1)


def _polynomials(axis: Axis, values: np.ndarray) -> _Factor:
    """Legendre polynomials over the range where the runs fill it evenly, else their own over the runs."""
    own = axis.forward(values)
    if not own.max() > own.min():
        return _Factor(own, np.zeros((1, 0)), np.zeros(0, int))
    low, high = axis.forward(np.array([axis.low, axis.high]))
    scaled = _between(own, own.min(), own.max())
    levels = len(np.unique(np.round(scaled, 9)))
    if levels > 20 and high > low and _fills(_between(own, low, high)):
        scaled, degrees = _between(own, low, high), np.arange(1, DEGREES[-1] + 1)
        return _Factor(scaled, np.diag(np.sqrt(2 * np.arange(DEGREES[-1] + 1) + 1.0))[:, 1:], degrees)
    return _orthonormal(scaled, min(DEGREES[-1], levels - 1), graded=True)


def _between(own: np.ndarray, low: float, high: float) -> np.ndarray:
    return (2 * own - low - high) / (high - low)


def _fills(scaled: np.ndarray) -> bool:
    """Whether numbers may well be even over -1 to 1 (Kolmogorov-Smirnov, one in a hundred is wrongly not)."""
    place = (np.sort(scaled) + 1) / 2
    steps = np.arange(len(place) + 1) / len(place)
    far = max(np.abs(place - steps[1:]).max(), np.abs(place - steps[:-1]).max())
    return bool(far * np.sqrt(len(place)) < 1.63 and place[0] > -1e-9 and place[-1] < 1 + 1e-9)


def _categories(index: np.ndarray) -> _Factor:
    _, index = np.unique(index, return_inverse=True)
    return _orthonormal(index, int(index.max()), graded=False)


def _orthonormal(scaled: np.ndarray, count: int, graded: bool) -> _Factor:
    corner = np.linalg.qr(_raw(scaled, count + 1), mode="r") / np.sqrt(len(scaled))
    sound = np.abs(np.diag(corner)) > 1e-5
    count = int(np.argmin(sound)) - 1 if not sound.all() else count
    corner = corner[: count + 1, : count + 1]
    turn = solve_triangular(corner, np.eye(count + 1))[:, 1:]
    return _Factor(scaled, turn, np.arange(1, count + 1) if graded else np.ones(count, int))


def _rows_at_most(runs: int, factors: int) -> int:
    terms = min(_MOST_TERMS, 16 * factors + 66 * factors * (factors - 1) // 2)
    return min(runs, max(int(_WORK / terms**2), 1000))


def _distinct(values: Mapping[str, np.ndarray], names: Sequence[str], rows: np.ndarray) -> np.ndarray:
    """The rows less those that repeat all values of another: they would be fitted and left out at once."""
    table = [_numbers(np.asarray(values[name])[rows]) for name in names]
    _, first = np.unique(np.column_stack(table), axis=0, return_index=True)
    return rows[np.sort(first)]


def _numbers(column: np.ndarray) -> np.ndarray:
    return column.astype(float) if column.dtype.kind in "fiub" else coded(column)[1].astype(float)


def _dictionary(factors: Sequence[_Factor], runs: int, partners: Sequence[int]) -> list[_Term]:
    """As many terms as the runs can bear: functions of one factor first, then products between partners."""
    most = min(_MOST_TERMS, 4 * runs)
    alone = max(min(DEGREES[-1], most // (2 * len(factors))), 1)
    terms = [_Term(-1, 0, -1, 0, 0)]
    for i, factor in enumerate(factors):
        terms += [_Term(i, a, -1, 0, int(d)) for a, d in enumerate(factor.degrees) if d <= alone]
    for degree in range(2, 13):
        more = list(_products(factors, partners, degree))
        if len(terms) + len(more) > most:
            break
        terms += more
    return terms


def _products(factors: Sequence[_Factor], partners: Sequence[int], degree: int) -> Iterator[_Term]:
    for i, j in itertools.combinations(sorted(partners), 2):
        for a, b in itertools.product(range(len(factors[i].degrees)), range(len(factors[j].degrees))):
            if factors[i].degrees[a] + factors[j].degrees[b] == degree:
                yield _Term(i, a, j, b, degree)


def _collect(factors: Sequence[_Factor], terms: Sequence[_Term], y: np.ndarray) -> _Sums:
    """Normal equations of each fold of runs, a block of rows at a time."""
    folds = 10 if len(y) < 300 else 5
    edges = np.linspace(0, len(y), folds + 1).astype(int)
    gram = np.zeros((folds, len(terms), len(terms)))
    moment = np.zeros((folds, len(terms)))
    step = max(2**21 // len(terms), 256)
    for k, (start, stop) in enumerate(itertools.pairwise(edges)):
        for low in range(start, stop, step):
            rows = slice(low, min(low + step, stop))
            basis = [factor.functions(rows).T for factor in factors]
            x = np.ones((len(terms), rows.stop - rows.start))
            for row, term in zip(x[1:], terms[1:], strict=True):
                row[:] = basis[term.i][term.a]
                if term.j >= 0:
                    row *= basis[term.j][term.b]
            gram[k] += x @ x.T
            moment[k] += x @ y[rows]
    square = np.add.reduceat(y**2, edges[:-1])
    return _Sums(gram, moment, square, np.diff(edges))


def _forward(gram: np.ndarray, moment: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Terms in the order in which each takes away most of what is left, the constant first.

    Returns their indices `(K,)`, and the triangle `(K, K)` and right side `(K,)` whose leading parts give the
    coefficients of every shorter model.
    """
    left, residual = np.diag(gram).copy(), moment.copy()
    floor = 1e-8 * left.max()
    factor = np.empty((steps, len(gram)))
    gain = np.empty(steps)
    chosen: list[int] = []
    for k in range(steps):
        worth = np.where(left > floor, residual**2 / np.maximum(left, floor), -1.0)
        j = int(np.argmax(worth)) if k else 0
        if worth[j] < 0:
            break
        root = np.sqrt(left[j])
        factor[k] = (gram[j] - factor[:k, j] @ factor[:k]) / root
        gain[k] = residual[j] / root
        residual -= gain[k] * factor[k]
        left -= factor[k] ** 2
        left[j] = 0.0
        chosen.append(j)
    return np.array(chosen), factor[: len(chosen), chosen], gain[: len(chosen)]


def _solved(path: tuple[np.ndarray, np.ndarray, np.ndarray], size: int, width: int) -> np.ndarray:
    chosen, triangle, gain = path
    size = min(size, len(chosen))
    coefficients = np.zeros(width)
    coefficients[chosen[:size]] = solve_triangular(triangle[:size, :size], gain[:size])
    return coefficients


def _sizes(most: int) -> list[int]:
    few = range(1, min(most, 12) + 1)
    return [*few, *sorted({int(size) for size in np.geomspace(13, max(most, 13), 24)} if most > 12 else ())]


def _fit(names: tuple[str, ...], terms: Sequence[_Term], sums: _Sums, counts: dict[str, Any]) -> Effects:
    folds = range(len(sums.runs))
    runs = int(sums.runs.sum())
    degrees = np.array([term.degree for term in terms])
    rests = [sums.over([f for f in folds if f != k]) for k in folds]
    tried: dict[tuple[int, int], float] = {}
    for d, degree in enumerate(DEGREES):
        if (d and not (degrees > DEGREES[d - 1]).any()) or _idle(tried, DEGREES[:d]):
            break
        inside = np.flatnonzero(degrees <= degree)
        most = min(len(inside), _MOST_STEPS, max(min(rest[3] for rest in rests) // 3, 8))
        for k in folds:
            gram, moment = rests[k][0][np.ix_(inside, inside)], rests[k][1][inside]
            own, right = sums.gram[k][np.ix_(inside, inside)], sums.moment[k][inside]
            path = _forward(gram, moment, most)
            for size in _sizes(most):
                c = _solved(path, size, len(inside))
                s = np.flatnonzero(c)
                error = sums.square[k] - 2 * c[s] @ right[s] + c[s] @ own[np.ix_(s, s)] @ c[s]
                tried[degree, size] = tried.get((degree, size), 0.0) + max(error, 0.0)
    degree, size = min(tried, key=lambda key: (tried[key], key))
    q2 = 1 - float(tried[degree, size] / sums.square.sum())
    inside = np.flatnonzero(degrees <= degree)
    kept = [term for term in terms if term.degree <= degree]
    whole = sums.over(folds)
    even = _independent(terms, whole[0] / runs, runs)
    left = float(tried[degree, size] / runs)
    main, pair = _shares(len(names), kept, inside, whole, size, left, even)
    each = [_shares(len(names), kept, inside, rest, size, left, even) for rest in rests]
    total = main + pair.sum(axis=1)
    return Effects(
        names=names,
        main=main,
        pair=pair,
        total=total,
        main_error=_jackknife(np.array([m for m, _ in each])),
        total_error=_jackknife(np.array([m + p.sum(axis=1) for m, p in each])),
        unexplained=min(1 - q2, 1.0),
        q2=q2,
        degree=degree,
        terms=size - 1,
        used=runs,
        even=even,
        note=_note(q2, even, runs),
        **counts,
    )


def _idle(tried: Mapping[tuple[int, int], float], degrees: Sequence[int]) -> bool:
    """Whether the last three degrees brought nothing over those before."""
    best = [min(error for (d, _), error in tried.items() if d == degree) for degree in degrees]
    return len(best) > 4 and min(best[-3:]) > 0.999 * min(best[:-3])


def _shares(
    factors: int,
    terms: Sequence[_Term],
    inside: np.ndarray,
    sums: tuple[np.ndarray, np.ndarray, float, int],
    size: int,
    left: float,
    even: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Shares of each factor `(F,)` and of each pair `(F, F)`, where a share `left` is not explained.

    Squared coefficients less what the unexplained part adds to them on average.
    """
    gram, moment, runs = sums[0][np.ix_(inside, inside)], sums[1][inside], sums[3]
    c = _solved(_forward(gram, moment, size), size, len(inside))
    centred = gram / runs - np.outer(gram[0], gram[0]) / runs**2
    power = c**2 if even else c * (centred @ c)
    power = np.where(c != 0, power - left / runs, 0.0)
    main, pair = np.zeros(factors), np.zeros((factors, factors))
    for term, p in zip(terms[1:], power[1:], strict=True):
        if term.j < 0:
            main[term.i] += p
        else:
            pair[term.i, term.j] += p
    main, pair = np.maximum(main, 0.0), np.maximum(pair, 0.0)
    explained = main.sum() + pair.sum()
    fair = max(1 - left, 0.0) / explained if explained > 0 else 0.0
    return main * fair, (pair + pair.T) * fair


def _independent(terms: Sequence[_Term], gram: np.ndarray, runs: int) -> bool:
    """Whether lines and parabolas of different factors are uncorrelated over the runs."""
    low = [t for t, term in enumerate(terms) if term.i >= 0 and term.j < 0 and term.a < 2]
    factor = np.array([terms[t].i for t in low], int)
    across = np.abs(gram[np.ix_(low, low)])[factor[:, None] != factor]
    if not len(across):
        return True
    by_chance = (np.sqrt(np.log(len(across))) + 3) / np.sqrt(runs)
    return bool(across.max() < max(0.1, by_chance))


def _jackknife(each: np.ndarray) -> np.ndarray:
    folds = len(each)
    return np.sqrt((folds - 1) / folds * ((each - each.mean(axis=0)) ** 2).sum(axis=0))


def _note(q2: float, even: bool, runs: int) -> str:
    if q2 < 0.2:
        note = f"{runs} runs are too few, or the score too rough, to say what matters"
    elif q2 < 0.5:
        note = "shares are a hint only: more runs, or narrower ranges, would tell more"
    elif q2 < 0.8:
        note = "shares are rough"
    else:
        note = "shares are sound"
    return note if even else f"{note}; parameters do not vary independently over these runs"


def _nothing(names: tuple[str, ...], share: float, used: int, note: str, counts: dict[str, Any]) -> Effects:
    none = np.full(len(names), share)
    pair = np.full((len(names), len(names)), share)
    return Effects(
        names=names,
        main=none,
        pair=pair,
        total=none,
        main_error=none,
        total_error=none,
        unexplained=share,
        q2=np.nan,
        degree=0,
        terms=0,
        used=used,
        even=True,
        note=note,
        **counts,
    )
