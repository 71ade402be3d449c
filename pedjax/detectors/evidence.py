"""What the stance detectors measure in a window, free of any tunable number.

Each function takes `specific_force (T, 3)` in m/s^2, `angular_rate (T, 3)` in rad/s and the window length in
samples, and gives `(T, m)`: m numbers for the window that ends at each sample. They are computed once for a
recording and shared by every parameter set of a sweep.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array

from pedjax.lanes import norm
from pedjax.windows import delay, trailing_mean, trailing_moments


def _norm(x: Array) -> Array:
    return norm(x, axis=-1, small=float(jnp.finfo(x.dtype).tiny * 1e6))


def force_and_rate(specific_force: Array, angular_rate: Array, window: int) -> Array:
    """Variance of the force (trace), norm of its mean, mean square rate, mean and variance of the norm."""
    mean, variance = trailing_moments(specific_force, window)
    norm_mean, norm_variance = trailing_moments(_norm(specific_force), window)
    rate = trailing_mean(jnp.sum(angular_rate * angular_rate, axis=-1), window)
    return jnp.stack([jnp.sum(variance, axis=-1), _norm(mean), rate, norm_mean, norm_variance], axis=-1)


def memory_based_graph(specific_force: Array, angular_rate: Array, window: int) -> Array:
    """MBGTD: the largest weighted distance between the earlier and the later part of the window.

    max over splits 0 <= s < t < W of sum_{i<=s} sum_{j>=t} |f_i - f_j| / ((t - s)(W - t + 1)).
    """
    past = [delay(specific_force, window - 1 - i) for i in range(window)]
    best = jnp.zeros_like(specific_force[:, 0])
    for s in range(window - 1):
        for t in range(s + 1, window):
            total = sum(_norm(past[i] - past[j]) for i in range(s + 1) for j in range(t, window))
            best = jnp.maximum(best, total / ((t - s) * (window - t + 1)))
    return best[:, None]


def eps_variances(specific_force: Array, angular_rate: Array, window: int) -> Array:
    """EPS (Sejong 2020, Eq. 1-9): variances of energy, product and sum of f_x, f_z, of the energy of the
    angular rate about x and y, and that energy itself. Body axes matter: x forward, z up or down."""
    x, z = specific_force[:, 0], specific_force[:, 2]
    energy = angular_rate[:, 0] ** 2 + angular_rate[:, 1] ** 2
    channels = jnp.stack([x * x + z * z, x * z, x + z, energy], axis=-1)
    _, variance = trailing_moments(channels, window)
    return jnp.concatenate([variance, energy[:, None]], axis=-1)
