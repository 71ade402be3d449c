"""Noise of a sensor at rest from its Allan curve: what can be read off, and what a fit finds.

Six terms, each a part of the Allan variance (IEEE Std 952, annex C; u is the samples' unit):

    quantisation      Q  u s          3 Q² / tau²
    white             N  u sqrt(s)    N² / tau
    flicker           B  u            B² 2 ln 2 / pi
    random_walk       K  u / sqrt(s)  K² tau / 3
    ramp              R  u / s        R² tau² / 2
    gauss_markov      s  u, T  s      s² (2 x - 3 + 4 exp(-x) - exp(-2 x)) / x²,  x = tau / T

Points of one curve share their samples, so their errors go together. The fit therefore takes the
covariance that the model itself predicts between all points of the curve, for this length of recording.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from scipy.special import digamma, polygamma
from scipy.stats import chi2 as chi_square

from pedjax.errors import InputError, suggest
from pedjax.evaluation.allan import AllanCurve, local_slopes

TERMS: dict[str, tuple[str, ...]] = {
    "quantisation": ("quantisation",),
    "white": ("white",),
    "flicker": ("bias_instability",),
    "random_walk": ("random_walk",),
    "ramp": ("ramp",),
    "gauss_markov": ("gauss_markov_std", "gauss_markov_time"),
}
"""The parameters of each term."""

PARAMETERS: tuple[str, ...] = tuple(name for names in TERMS.values() for name in names)
"""Q, N, B, K, R, s and T in the units above; one vector of them describes a noise."""

IEEE_FACTOR = float(np.sqrt(2 * np.log(2) / np.pi))
"""0.664: the flat part of the deviation over the bias instability B (IEEE Std 952, C.1.3)."""

_OWNER = np.array([i for i, names in enumerate(TERMS.values()) for _ in names])  # the term of a parameter
_TIME = PARAMETERS.index("gauss_markov_time")
_STARTS = 3  # correlation times to start from
_MOST_STEPS = 60
_OUTSIDE = 1e9  # cost of a correlation time that lies outside the curve
_JUDGED = 5  # sets of terms that are compared each with its own covariance
_ROUNDING = 2e-3  # least part of a correlation between points: what quadrature and sampling leave unsaid
_SPACING = 2**0.5  # least ratio of neighbouring cluster times in a fit
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


# ------------------------------------------------------------------------------------------- readings


class Readings(NamedTuple):
    """What is read off a curve, one value a channel `(D,)`, NaN where the curve has no such part.

    `white` N (u sqrt(s)), `instability` (u) at `instability_tau` (s), `random_walk` K (u / sqrt(s)).
    Where `at_end` the curve still falls at its last point: the instability is only an upper bound.
    """

    white: np.ndarray
    instability: np.ndarray
    instability_tau: np.ndarray
    at_end: np.ndarray
    random_walk: np.ndarray


def read_off(curve: AllanCurve, instability: Literal["ieee", "direct"] = "ieee") -> Readings:
    """N, K and the bias instability by the rules of IEEE Std 952.

    N is the value at 1 s of a line of slope -1/2 through the longest stretch of the curve with that slope,
    K the value at 3 s of a line of slope +1/2. The instability is the minimum: over 0.664 for `ieee`, as it
    is for `direct` (the usual data sheet, and Muñoz Diaz 2017).
    """
    if instability not in ("ieee", "direct"):
        raise InputError(f"reading '{instability}' is unknown{suggest(instability, ('ieee', 'direct'))}")
    lowest = curve.deviation.argmin(axis=0)
    minimum = curve.deviation.min(axis=0)
    before = np.arange(len(curve.tau))[:, None] <= lowest
    return Readings(
        _on_slope(curve, -0.5, 1.0, before, 0.05),
        minimum / (IEEE_FACTOR if instability == "ieee" else 1.0),
        curve.tau[lowest],
        lowest == len(curve.tau) - 1,
        _on_slope(curve, 0.5, 3.0, ~before, 0.1),
    )


def _on_slope(curve: AllanCurve, slope: float, at: float, where: np.ndarray, within: float) -> np.ndarray:
    """Value `(D,)` at time `at` of a line of that slope through the longest run of points whose own slope
    lies `within` so much of it, or NaN."""
    fits = where & (np.abs(local_slopes(curve.tau, curve.deviation) - slope) < within)
    read = np.log(curve.deviation) + slope * np.log(at / curve.tau)[:, None]
    found = np.full(fits.shape[1], np.nan)
    for c, column in enumerate(fits.T):
        groups = itertools.groupby(range(len(column)), column.__getitem__)
        run = max((list(rows) for fit, rows in groups if fit), key=len, default=[])
        if run:
            found[c] = np.exp(np.average(read[run, c], weights=curve.edf[run, c]))
    return found


class PublishedGaussMarkov(NamedTuple):
    """`std (D,)` u, `time (D,)` s, `coefficient (D,)` c = exp(-1 / (time rate)) of one sample to the next
    and `driving (D,)` u, the deviation std sqrt(1 - c²) of what is added in each."""

    std: np.ndarray
    time: np.ndarray
    coefficient: np.ndarray
    driving: np.ndarray


def published_gauss_markov(curve: AllanCurve) -> PublishedGaussMarkov:
    """First-order Gauss-Markov bias as Muñoz Diaz 2017 (Eq. 24, 25) reads it: std and time of the minimum.

    For comparison only: it recovers neither. With white noise of 0.0141 u sqrt(s), a process of 300 s and
    0.01 u has its minimum at 33 s and 0.0036 u: a ninth of the time and a third of the std. A longer record
    may have a lower end, beyond the peak of the process (at 1.893 T, 0.617 s). Use `identify`. Eq. 24 is an
    image that is lost; `driving` is what keeps the stationary std equal to B.
    """
    lowest = curve.deviation.argmin(axis=0)
    std = curve.deviation[lowest, np.arange(curve.deviation.shape[1])]
    time = curve.tau[lowest]
    coefficient = np.exp(-1 / (time * curve.rate))
    return PublishedGaussMarkov(std, time, coefficient, std * np.sqrt(1 - coefficient**2))


# ---------------------------------------------------------------------------------------------- model


def allan_parts(values: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Allan variance `(..., K, 6)` of each term at `tau (K,)` for `values (..., 7)` ordered as PARAMETERS."""
    q, n, b, k, r, s, time = (v[..., None] for v in np.moveaxis(np.asarray(values, float), -1, 0))
    tau = np.asarray(tau, float)
    parts = [
        3 * (q / tau) ** 2,
        n**2 / tau,
        (b * IEEE_FACTOR) ** 2 + 0 * tau,
        k**2 * tau / 3,
        (r * tau) ** 2 / 2,
        s**2 * _gauss_markov(tau / time)[0],
    ]
    return np.stack(parts, axis=-1)


def _gauss_markov(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Allan variance of unit std at x = tau / T, and its derivative with respect to ln T."""
    series = x * (2 / 3 - x * (1 / 2 - x * (7 / 30 - x / 12)))
    slope = x * (-2 / 3 + x * (1 - x * (7 / 10 - x / 3)))
    safe = np.maximum(x, 0.01)
    closed = (2 * safe - 3 + 4 * np.exp(-safe) - np.exp(-2 * safe)) / safe**2
    closed_slope = 2 * closed - 2 * np.expm1(-safe) ** 2 / safe
    return np.where(x < 0.01, series, closed), np.where(x < 0.01, slope, closed_slope)


def _structure(values: np.ndarray, lag: np.ndarray) -> np.ndarray:
    """Generalised covariance of the integrated noise at `lag` s, defined up to what no second difference
    sees (even polynomials up to t²); the ramp, which is no noise, is left out."""
    q, n, b, k, _, s, time = values
    lag = np.abs(lag)
    total = k**2 / 12 * lag**3 - n**2 / 2 * lag
    if q > 0:
        total += q**2 * (lag == 0)
    if b > 0:
        total += b**2 / (2 * np.pi) * lag**2 * np.log(np.where(lag > 0, lag, 1.0))
    if s > 0:
        total -= (s * time) ** 2 * (lag / time + np.expm1(-lag / time))
    return total


def point_covariance(values: np.ndarray, curve: AllanCurve) -> np.ndarray:
    """Covariance `(K, K)` of the logarithms of the overlapping Allan variances of a noise with these values.

    For Gaussian noise, with g_ab(l) the covariance of second differences l samples apart at sizes a and b
    (M_a and M_b of them), cov(V_a, V_b) = 1 / (2 M_a M_b) sum_l n_ab(l) g_ab(l)², where n_ab(l) counts the
    pairs. The sum is over all lags: one by one near the kinks of g, by Gauss-Legendre between them. The
    scaling to logarithms is that of chi-square with the degrees of freedom that follow.
    """
    m, rate = curve.size.astype(float), curve.rate
    first, second = np.triu_indices(len(m))
    a, b = m[first], m[second]
    many_a, many_b = curve.samples + 1 - 2 * a, curve.samples + 1 - 2 * b
    steps = np.array([(i, j) for i in range(3) for j in range(3)], float)
    kinks = a[:, None] * steps[:, 0] - b[:, None] * steps[:, 1]
    low, high = 1 - many_a, many_b - 1
    kinks = np.concatenate([kinks, np.stack([low, high, 0 * a, many_b - many_a], axis=1)], axis=1)
    kinks = np.sort(np.clip(kinks, low[:, None], high[:, None]), axis=1)
    lag, weight = _lags(kinks)
    count = np.minimum(many_a[:, None], many_b[:, None] - lag) - np.maximum(0.0, -lag)
    weight = weight * np.maximum(count, 0.0) / (many_a * many_b)[:, None]
    taps = np.array([1.0, -2.0, 1.0])
    covariance = np.zeros_like(lag)
    for i, j in steps.astype(int):
        at = (lag + (j * b - i * a)[:, None]) / rate
        covariance += taps[i] * taps[j] * _structure(values, at)
    covariance *= (rate**2 / (a * b))[:, None]
    shared = 0.5 * np.sum(weight * covariance**2, axis=1)
    ramp = values[4] / rate
    shared += ramp**2 * a * b * np.sum(weight * covariance, axis=1)
    full = np.zeros((len(m), len(m)))
    full[first, second] = full[second, first] = shared
    variance = allan_parts(values, curve.tau).sum(axis=-1)
    edf = np.maximum(2 * variance**2 / np.diag(full), 0.5)
    spread = np.sqrt(polygamma(1, edf / 2))
    scale = np.sqrt(np.diag(full))
    parts, axes = np.linalg.eigh(full / np.outer(scale, scale))
    correlation = (axes * np.maximum(parts, _ROUNDING)) @ axes.T
    return correlation * np.outer(spread, spread)


def _lags(kinks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lags and weights that sum a function over the whole numbers from the first to the last kink."""
    gap = np.diff(kinks, axis=1)
    single = np.concatenate([np.ones_like(kinks[:, :1]), (gap > 0).astype(float)], axis=1)
    inside = np.maximum(gap - 1, 0)[..., None]  # whole numbers strictly between two kinks
    left = kinks[:, :-1, None]
    nodes = len(_NODES)
    one_by_one = np.arange(1, nodes + 1.0)
    short = inside <= nodes
    lag = np.where(short, left + one_by_one, left + 0.5 + inside * (_NODES + 1) / 2)
    weight = np.where(short, one_by_one <= inside, inside * _WEIGHTS / 2)
    return (
        np.concatenate([kinks, lag.reshape(len(kinks), -1)], axis=1),
        np.concatenate([single, weight.reshape(len(kinks), -1)], axis=1),
    )


# ------------------------------------------------------------------------------------- identification


class Noise(NamedTuple):
    """The noise of one channel, as `identify` finds it.

    `terms` that are present; `values` and `sigmas` of their parameters by name (units above; the sigmas
    take the choice of terms for granted); `support` of every candidate, between 0 and 1: the share of
    the best fits that have it, each weighted by exp(-BIC / 2). `chi2` of the chosen fit with `dof` degrees of
    freedom; `misfit`, the relative error of the deviations that no model explains (0: chance explains all).
    """

    terms: tuple[str, ...]
    values: dict[str, float]
    sigmas: dict[str, float]
    support: dict[str, float]
    chi2: float
    dof: int
    misfit: float

    def vector(self) -> np.ndarray:
        """All seven values, ordered as PARAMETERS; zero where absent."""
        absent = dict.fromkeys(PARAMETERS, 0.0) | {"gauss_markov_time": 1.0}
        return np.array([(absent | self.values)[name] for name in PARAMETERS])

    def parts(self, tau: np.ndarray) -> dict[str, np.ndarray]:
        """Allan deviation of each present term at `tau (K,)`."""
        parts = np.sqrt(allan_parts(self.vector(), tau))
        return {name: parts[:, i] for i, name in enumerate(TERMS) if name in self.terms}

    def deviation(self, tau: np.ndarray) -> np.ndarray:
        """Allan deviation of all of them together."""
        return np.sqrt(allan_parts(self.vector(), tau).sum(axis=-1))


def identify(
    curve: AllanCurve, candidates: Sequence[str] = tuple(TERMS), shortest: float = 0.0
) -> list[Noise]:
    """The noise of each channel: which of the candidate terms are present, and how large they are.

    Every set of candidates is fitted to the logarithm of the curve at cluster times (from `shortest` s on)
    half an octave apart, by least squares with the covariance between the points (`point_covariance`): first
    that of the richest set, then, for the few best, the one that each predicts itself. The set with the least
    BIC = -2 ln(likelihood) + p ln n wins, with p parameters and n the degrees of freedom of points an octave
    apart, summed (about the number of samples). Where a fit leaves more than chance does (the 99.9 % point
    of chi-square), every point is granted a relative error, the same for all, that makes it what chance
    leaves, and this is told as `misfit`: a sensor's own filter, or a vibration of the floor, is none of the
    six terms. The choice is a strict one: a term must stand out by three to four of its sigmas, and a weak
    one that is there is rather missed, its part going to its neighbours, than one invented that is not. A
    correlation time outside the cluster times is not found: such a process looks like white noise or a
    random walk.
    """
    if not candidates:
        raise InputError(f"no noise term to look for; choose among {', '.join(TERMS)}")
    for name in candidates:
        if name not in TERMS:
            raise InputError(f"noise term '{name}' is unknown{suggest(name, TERMS)}")
    if not curve.overlapping:
        raise InputError("noise is identified from an overlapping Allan curve; this one is not")
    usable = curve.at(_apart(np.where(curve.tau >= shortest, curve.tau, np.nan)))
    if len(usable.tau) < 4:
        raise InputError(
            f"{len(usable.tau)} points of an Allan curve half an octave apart are too few to tell noises "
            "apart; record longer"
        )
    if not (usable.deviation > 0).all():
        raise InputError("a channel has an Allan deviation of zero: it is constant, not a sensor's noise")
    return [_identify(usable, channel, tuple(candidates)) for channel in range(curve.deviation.shape[1])]


def _apart(tau: np.ndarray) -> np.ndarray:
    """Indices of finite cluster times that are far enough from each other, counted from the longest."""
    kept: list[int] = []
    for i in np.flatnonzero(np.isfinite(tau))[::-1]:
        if not kept or tau[kept[-1]] >= tau[i] * _SPACING * (1 - 1e-3):
            kept.append(int(i))
    return np.array(kept[::-1], int)


def _identify(curve: AllanCurve, channel: int, candidates: tuple[str, ...]) -> Noise:
    tau, seen = curve.tau, np.log(curve.deviation[:, channel] ** 2)
    sets = [s for n in range(1, len(candidates) + 1) for s in itertools.combinations(candidates, n)]
    sets = [s for s in sets if _count(s) < len(tau) - 1]
    richest = max(sets, key=_count)
    errors = _Errors(seen, np.diag(polygamma(1, curve.edf[:, channel] / 2)))
    for _ in range(2):
        errors = _expected(_fit(tau, errors, [richest]).values[0], curve, seen)
    errors = errors.plus(_misfit(tau, errors, richest))
    points = _edf_of(np.diag(errors.covariance))
    price = np.log(points.sum() * np.log2(tau[-1] / tau[0]) / (len(tau) - 1))
    first = _fit(tau, errors, sets)
    bic = first.chi2 + _OUTSIDE * ~first.inside + price * np.array([_count(s) for s in sets])
    judged = [_judge(curve, seen, sets[i], first.values[i], errors.misfit) for i in bic.argsort()[:_JUDGED]]
    final = np.array([each.cost + price * _count(each.terms) for each in judged])
    weights = np.exp(-0.5 * (final - final.min()))
    support = {t: float(weights[[t in j.terms for j in judged]].sum() / weights.sum()) for t in candidates}
    best = judged[int(final.argmin())]
    misfit = max(errors.misfit, _misfit(tau, best.errors, best.terms))
    last = _fit(tau, best.errors.plus(misfit), [best.terms])
    values = dict(zip(PARAMETERS, last.values[0].tolist(), strict=True))
    sigmas = dict(zip(PARAMETERS, last.sigmas[0].tolist(), strict=True))
    names = [name for term in best.terms for name in TERMS[term]]
    return Noise(
        best.terms,
        {name: values[name] for name in names},
        {name: sigmas[name] for name in names},
        support,
        float(last.chi2[0]),
        len(tau) - len(names),
        misfit,
    )


def _count(terms: tuple[str, ...]) -> int:
    return sum(len(TERMS[term]) for term in terms)


class _Errors(NamedTuple):
    """The logarithms `seen (K,)` less their expected error, their covariance, and what is added to it."""

    seen: np.ndarray
    covariance: np.ndarray
    misfit: float = 0.0

    def plus(self, misfit: float) -> _Errors:
        """With a relative error of every deviation in place of the one so far."""
        more = 4 * (misfit**2 - self.misfit**2) * np.eye(len(self.seen))
        return _Errors(self.seen, self.covariance + more, misfit)


class _Judged(NamedTuple):
    terms: tuple[str, ...]
    errors: _Errors
    cost: float


def _judge(
    curve: AllanCurve, seen: np.ndarray, terms: tuple[str, ...], values: np.ndarray, misfit: float
) -> _Judged:
    """Minus twice the logarithm of the likelihood of a set of terms, with the covariance it predicts."""
    errors = _expected(values, curve, seen)
    fit = _fit(curve.tau, errors.plus(misfit), [terms])
    size = np.linalg.slogdet(errors.plus(misfit).covariance)[1]
    return _Judged(terms, errors, float(fit.chi2[0] + size + _OUTSIDE * ~fit.inside[0]))


def _expected(values: np.ndarray, curve: AllanCurve, seen: np.ndarray) -> _Errors:
    """What a noise with these values lets expect of the points of its curve."""
    covariance = point_covariance(values, curve)
    edf = _edf_of(np.diag(covariance))
    return _Errors(seen - (digamma(edf / 2) - np.log(edf / 2)), covariance)


def _edf_of(spread: np.ndarray) -> np.ndarray:
    """Degrees of freedom whose log chi-square has this variance: trigamma(edf / 2) = spread, by Newton."""
    half = 1 / spread + 0.5
    for _ in range(20):
        half = half - (polygamma(1, half) - spread) / polygamma(2, half)
    return 2 * half


def _misfit(tau: np.ndarray, errors: _Errors, terms: tuple[str, ...]) -> float:
    """Relative error of every deviation with which the fit of these terms leaves what chance would."""
    dof = len(tau) - _count(terms)

    def left(error: float) -> float:
        return float(_fit(tau, errors.plus(error), [terms]).chi2[0])

    if left(0.0) <= chi_square.ppf(0.999, dof):
        return 0.0
    low, high = np.log(1e-4), np.log(1.0)
    for _ in range(12):
        middle = (low + high) / 2
        low, high = (middle, high) if left(np.exp(middle)) > dof else (low, middle)
    return float(np.exp(high))


class _Fits(NamedTuple):
    values: np.ndarray  # (S, 7)
    sigmas: np.ndarray  # (S, 7)
    chi2: np.ndarray  # (S,)
    inside: np.ndarray  # (S,) whether the correlation time, if any, lies within the curve


def _fit(tau: np.ndarray, errors: _Errors, sets: Sequence[tuple[str, ...]]) -> _Fits:
    """Least squares of the log curve with each set of terms, all at once: Levenberg-Marquardt on the
    logarithms of the values, where a correlation time is sought from several starts."""
    seen, whiten = errors.seen, np.linalg.inv(np.linalg.cholesky(errors.covariance))
    times = np.log(np.geomspace(tau[0], tau[-1], _STARTS + 2)[1:-1])
    starts = [(i, t) for i, s in enumerate(sets) for t in (times if "gauss_markov" in s else times[:1])]
    owner = np.array([i for i, _ in starts])
    present = np.array([[t in sets[i] for t in TERMS] for i in owner])
    active = present[:, _OWNER]
    x = np.zeros((len(starts), len(PARAMETERS)))
    x[:, _TIME] = [t for _, t in starts]
    unit = allan_parts(np.exp(x), tau)  # each term begins as large as the curve allows, shared among them
    largest = 0.5 * np.log((np.exp(seen)[:, None] / unit).min(axis=1) / present.sum(axis=1, keepdims=True))
    x[:, :_TIME] = largest
    low, high = np.log(tau[0]), np.log(tau[-1])

    def residuals(x: np.ndarray, present: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = np.exp(x)
        parts = allan_parts(values, tau) * present[:, None]
        total = parts.sum(axis=-1)
        slopes = 2 * parts[..., _OWNER]
        by_time = values[:, None, _TIME - 1] ** 2 * _gauss_markov(tau / values[:, None, _TIME])[1]
        slopes[..., _TIME] = by_time * present[:, None, -1]
        return (seen - np.log(total)) @ whiten.T, whiten @ (slopes / total[..., None])

    def normal(jacobian: np.ndarray, active: np.ndarray, damping: np.ndarray) -> np.ndarray:
        product = jacobian.swapaxes(1, 2) @ jacobian
        extra = damping[:, None] * (np.diagonal(product, axis1=1, axis2=2) + 1e-9) + ~active
        return product + extra[..., None] * np.eye(len(PARAMETERS))

    left, jacobian = residuals(x, present)
    chi2 = np.sum(left**2, axis=1)
    damping = np.full(len(x), 1e-2)
    live = np.arange(len(x))
    for _ in range(_MOST_STEPS):
        slope = (left[live, None, :] @ jacobian[live])[:, 0, :, None]
        step = np.linalg.solve(normal(jacobian[live], active[live], damping[live]), slope)[..., 0]
        trial = x[live] + np.clip(step * active[live], -1.0, 1.0)
        trial[:, _TIME] = np.clip(trial[:, _TIME], low, high)
        new_left, new_jacobian = residuals(trial, present[live])
        gain = chi2[live] - np.sum(new_left**2, axis=1)
        settled = ((gain > 0) & (gain < 1e-3) & (damping[live] < 1)) | (damping[live] > 1e6)
        better, at = gain > 0, live[gain > 0]
        x[at], left[at], jacobian[at] = trial[better], new_left[better], new_jacobian[better]
        chi2[at] -= gain[better]
        damping[live] *= np.where(better, 0.2, 5.0)
        live = live[~settled]
        if not len(live):
            break
    order = np.lexsort((chi2, owner))  # the best start of each set
    pick = order[np.searchsorted(owner[order], np.arange(len(sets)))]
    information = normal(jacobian[pick], active[pick], np.zeros(len(pick)))
    sigma = np.sqrt(np.diagonal(np.linalg.pinv(information, hermitian=True), axis1=1, axis2=2))
    values = np.exp(x[pick]) * (active[pick] | (np.arange(len(PARAMETERS)) == _TIME))
    time = x[pick, _TIME]
    inside = ~present[pick, -1] | ((time > low + 1e-6) & (time < high - 1e-6))
    return _Fits(values, values * sigma * active[pick], chi2[pick], inside)
