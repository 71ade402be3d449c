"""Allan deviation of rate samples at rest, all channels at once, with its degrees of freedom."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from pedjax.errors import InputError

FEWEST_CLUSTERS = 9
"""Clusters below which a point of the curve says little: with nine its deviation is known to a quarter."""


@dataclass(frozen=True)
class AllanCurve:
    """Allan deviation of D channels at K cluster times.

    `size (K,)` samples in a cluster, `tau (K,) = size / rate` s, `deviation (K, D)` in the samples' unit,
    `edf (K, D)` equivalent degrees of freedom of its square, from `samples` samples at `rate` Hz;
    whether from `overlapping` clusters.
    """

    size: np.ndarray
    tau: np.ndarray
    deviation: np.ndarray
    edf: np.ndarray
    samples: int
    rate: float
    overlapping: bool = True

    @property
    def clusters(self) -> np.ndarray:
        """Whole clusters in the recording, `(K,)`."""
        return self.samples // self.size

    def band(self, probability: float = 0.683) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper end `(K, D)` of the interval that holds the true deviation with this
        probability: edf * estimate² / truth² follows chi-square (Riley, NIST SP 1065, 5.3.2)."""
        tail = (1 - probability) / 2
        low, high = (np.sqrt(self.edf / chi2.ppf(p, self.edf)) for p in (1 - tail, tail))
        return self.deviation * low, self.deviation * high

    def at(self, keep: np.ndarray) -> AllanCurve:
        """The points that `keep` (indices or a mask) names."""
        parts = {name: getattr(self, name)[keep] for name in ("size", "tau", "deviation", "edf")}
        return replace(self, **parts)


def even_rate(time: np.ndarray, where: str = "the recording") -> float:
    """Sampling rate in Hz of `time (T,)` s, which must be even: each step within half a step of the mean.

    One missing sample would shift every later cluster, so a gap is refused, not bridged.
    """
    time = np.asarray(time, float)
    if time.ndim != 1 or len(time) < 2 or not np.isfinite(time).all() or not time[-1] > time[0]:
        raise InputError(f"{where}: an Allan deviation needs finite time stamps (T,) that increase")
    steps = np.diff(time)
    usual = float(np.median(steps[steps > 0]))
    odd = np.flatnonzero(np.abs(steps - usual) > 0.5 * usual)
    if len(odd):
        at = int(odd[0])
        raise InputError(
            f"{where}: an Allan deviation needs an even clock, but {len(odd)} steps differ from the usual "
            f"{1e3 * usual:.4g} ms by more than half, the first at {time[at]:.3f} s "
            f"({1e3 * steps[at]:.4g} ms); take a stretch without gaps or repeats"
        )
    return float((len(time) - 1) / (time[-1] - time[0]))


def log_sizes(samples: int, per_decade: float = 10, fewest: int = FEWEST_CLUSTERS) -> np.ndarray:
    """Cluster sizes, evenly spaced in the logarithm, up to the last with `fewest` clusters."""
    longest = samples // max(fewest, 2)
    if longest < 2:
        raise InputError(
            f"an Allan deviation needs at least {2 * max(fewest, 2)} samples, here are {samples}; "
            "record longer"
        )
    count = max(int(np.ceil(per_decade * np.log10(longest))) + 1, 2)
    return np.unique(np.rint(np.geomspace(1, longest, count)).astype(int))


def allan_curve(
    values: np.ndarray, rate: float, sizes: np.ndarray | Sequence[int] | None = None, overlapping: bool = True
) -> AllanCurve:
    """Allan deviation of rate samples `values (T,)` or `(T, D)` taken at `rate` Hz.

    With theta the running sum of the samples (theta_0 = 0, so T + 1 of them) and m samples in a cluster,

        sigma²(m / rate) = 1 / (2 m² (T + 1 - 2 m)) sum_k (theta_{k+2m} - 2 theta_{k+m} + theta_k)²

    (IEEE Std 952, C.1; Riley, NIST SP 1065, 5.2.4); without `overlapping` k advances by m.
    `sizes (K,)` are the m, by default `log_sizes`.
    """
    values = np.asarray(values, float)
    values = values[:, None] if values.ndim == 1 else values
    if values.ndim != 2:
        raise ValueError(f"values {values.shape} must be (T,) or (T, D)")
    if not rate > 0:
        raise InputError(f"a sampling rate of {rate:g} Hz is no rate; it must be positive")
    samples = len(values)
    missing = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(missing):
        raise InputError(
            f"an Allan deviation cannot bridge gaps: {len(missing)} samples are not numbers, the first is "
            f"sample {missing[0]}; take a stretch without them"
        )
    sizes = log_sizes(samples) if sizes is None else np.unique(np.asarray(sizes, int))
    if len(sizes) == 0 or sizes[0] < 1 or 2 * sizes[-1] > samples:
        raise InputError(
            f"cluster sizes must lie between 1 and half the number of samples ({samples}); "
            f"asked for {'none' if len(sizes) == 0 else f'{sizes[0]} to {sizes[-1]}'}"
        )
    centred = values - values.mean(axis=0)  # which no second difference sees, but the rounding does
    theta = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(centred, axis=0)])
    tau = sizes / rate
    if overlapping:
        squares = np.stack([_mean_square(theta, m) for m in sizes])
    else:
        squares = np.stack([_mean_square(theta[::m], 1) for m in sizes])
    deviation = np.sqrt(squares / 2) / sizes[:, None]
    slope = local_slopes(tau, deviation)
    if overlapping:
        edf = degrees_of_freedom(samples + 1, sizes[:, None], slope)
    else:
        edf = degrees_of_freedom((samples // sizes)[:, None] + 1, np.ones_like(sizes)[:, None], slope)
    return AllanCurve(sizes, tau, deviation, edf, samples, float(rate), overlapping)


def _mean_square(theta: np.ndarray, m: int, block: int = 16384) -> np.ndarray:
    """Mean square of the second differences of `theta (N, D)` at size m, a block that the cache holds at a
    time."""
    many = len(theta) - 2 * m
    total = np.zeros(theta.shape[1])
    for start in range(0, many, block):
        stop = min(start + block, many)
        second = theta[start + 2 * m : stop + 2 * m] - theta[start + m : stop + m]
        second -= theta[start + m : stop + m]
        second += theta[start:stop]
        total += np.einsum("kd,kd->d", second, second)
    return total / many


def local_slopes(tau: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """Slope `(K, D)` of the log-log curve at each `tau (K,)`, between half and twice that time."""
    if len(tau) < 2:
        return np.full(deviation.shape, -0.5)
    x = np.log(tau)
    low, high = (np.clip(x + s * np.log(2.0), x[0], x[-1]) for s in (-1, 1))
    y = np.log(np.maximum(deviation, np.finfo(float).tiny)).T
    rise = np.stack([np.interp(high, x, column) - np.interp(low, x, column) for column in y], axis=-1)
    return rise / (high - low)[:, None]


def degrees_of_freedom(points: int | np.ndarray, size: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Equivalent degrees of freedom of the overlapping Allan variance of `points` phases with clusters of
    `size`, for the power law nearest to the `slope` of the deviation (Riley, NIST SP 1065, table 5):
    white phase (-1), white rate (-1/2), flicker rate (0), random walk of rate (+1/2)."""
    n, m = np.asarray(points, float), np.asarray(size, float)
    phase = (n + 1) * (n - 2 * m) / (2 * (n - m))
    white = (3 * (n - 1) / (2 * m) - 2 * (n - 2) / n) * 4 * m**2 / (4 * m**2 + 5)
    flicker = np.where(m == 1, 2 * (n - 2) ** 2 / (2.3 * n - 4.9), 5 * n**2 / (4 * m * (n + 3 * m)))
    walk = (n - 2) / m * ((n - 1) ** 2 - 3 * m * (n - 1) + 4 * m**2) / np.maximum(n - 3, 1) ** 2
    kind = np.digitize(slope, [-0.75, -0.25, 0.25])
    return np.maximum(np.choose(kind, np.broadcast_arrays(phase, white, flicker, walk)), 1.0)
