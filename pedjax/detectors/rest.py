"""The standing start: for how long a foot rests before the first step, and what its gyroscope says meanwhile.

Windows of 0.25 s end to end from the first sample. One rests while the rate hardly changes within it and its
mean is small: what is left is the gyroscope's bias and the little that a standing foot turns. The rest is
the leading run of such windows. The limits are fixed, so that the rest of a recording is the same for every
parameter set.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

WINDOW_S = 0.25
"""Length of a window in s."""

QUICKEST = 0.02
"""Standard deviation of the rate in a window of rest, all axes together, is below this; rad/s."""

TURNING = 0.017453292519943295
"""Length of the mean rate in a window of rest is below this; rad/s, 1 deg/s."""


STEPPING = 0.1
"""Length of the rate, RMS in a window, from which on a foot no longer stands; rad/s."""


class Rest(NamedTuple):
    """The standing start of a recording: the mean `rate (3, *L)` rad/s over it, the `spread (*L)` rad^2/s^2,
    by how much the means of its windows vary about that mean (population variance, mean of the axes), and how
    many `windows (*L)` it has. All zero where a recording does not begin with rest."""

    rate: Array
    spread: Array
    windows: Array


def standing_rows(
    rate: Array, dt: Array, rate_hz: float, most_s: float, length: ArrayLike | None = None
) -> Array:
    """How many of the first samples, of at most so many seconds, a foot stands that may sway: the windows
    before the first whose rate has an RMS of `STEPPING` or more, less the last of them, in which the step may
    begin slowly. `rate (T, 3)` rad/s, without lanes; the rest as in `standing_start`."""
    windows, real = _windows(rate, dt, rate_hz, most_s, length)
    energy = jnp.sum(jnp.mean(windows**2, axis=1), axis=1)
    stands = jnp.cumsum(~((energy < STEPPING**2) & real.all(axis=1))) == 0
    count = jnp.sum(stands)
    return jnp.maximum(jnp.where(count < len(stands), count - 1, count), 0) * _width(rate_hz)


def _windows(
    rate: Array, dt: Array, rate_hz: float, most_s: float, length: ArrayLike | None
) -> tuple[Array, Array]:
    """The first windows' rates `(N, width, 3)`, and which of their samples there are."""
    width = _width(rate_hz)
    count = int(most_s * rate_hz + 1e-6) // width
    first = width * count  # as many windows for a short recording as for a long one: the same order of sums
    missing = max(first - rate.shape[0], 0)
    real = dt > 0 if length is None else (dt > 0) & (jnp.arange(dt.shape[0]) < length)
    real = jnp.pad(real[:first], (0, missing)).reshape(count, width)
    return jnp.pad(rate[:first], ((0, missing), (0, 0))).reshape(count, width, 3), real


def _width(rate_hz: float) -> int:
    return max(round(WINDOW_S * rate_hz), 2)


def standing_start(
    rate: Array, dt: Array, rate_hz: float, rest_s: float, length: ArrayLike | None = None
) -> Rest:
    """The rest with which a recording begins, of the first `rest_s` seconds at most; without lanes.

    `rate (T, 3)` rad/s and `dt (T,)` s at `rate_hz`. A window with a sample of dt = 0, or from `length` on,
    does not count. Samples after the window that ends the rest change no bit.
    """
    rates, real = _windows(rate, dt, rate_hz, rest_s, length)
    means = rates.mean(axis=1)
    variance = jnp.sum(jnp.mean((rates - means[:, None]) ** 2, axis=1), axis=1)
    still = (variance < QUICKEST**2) & (jnp.sum(means**2, axis=1) < TURNING**2)
    rests = jnp.cumsum(~(still & real.all(axis=1))) == 0
    windows = jnp.sum(rests).astype(rate.dtype)
    some = jnp.maximum(windows, 1.0)
    mean = jnp.sum(jnp.where(rests[:, None], means, 0.0), axis=0) / some
    away = jnp.where(rests[:, None], means - mean, 0.0)
    return Rest(mean, jnp.sum(away**2) / (3.0 * some), windows)
