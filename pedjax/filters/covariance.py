"""The 15-state error covariance in fifteen 3×3 blocks.

Error states, in order: attitude `t` (small rotation in the navigation frame), gyroscope bias `g`, position
`p`, velocity `v`, accelerometer bias `a`. The convention is truth = estimate ⊞ error: C = exp([t×]) Ĉ, the
rest additive, so that corrections are added and an innovation is measurement minus prediction. Hence
ṫ = −C g and v̇ = −[fⁿ×] t − C a, with fⁿ the specific force in the navigation frame, gravity reaction
included. (Ma and Zhang define the error the other way round; Ma's Eq. 39 as printed doubles the attitude
error instead of removing it. The signs here are held to finite differences in the tests.)

Only the upper blocks are kept, `P["tv"]` is the covariance of attitude and velocity, `(3, 3, *L)`: half the
arithmetic of the full matrix, and symmetric by construction.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from pedjax.lanes import (
    add,
    cholesky,
    eye,
    forward_substitution,
    matmul,
    matmul_t,
    symmetric,
    transpose,
)
from pedjax.rotations import skew

STATES = "tgpva"
"""Attitude, gyroscope bias, position, velocity, accelerometer bias."""

PAIRS = tuple((a, b) for i, a in enumerate(STATES) for b in STATES[i:])

Covariance = dict[str, Array]


class ProcessNoise(NamedTuple):
    """Noise densities and correlation times of the model, scalars `(*L)`.

    `gyroscope` rad/s/√Hz, `accelerometer` m/s²/√Hz, `gyroscope_bias` rad/s²/√Hz, `accelerometer_bias`
    m/s³/√Hz; `..._time` in s. Densities make the filter independent of the sampling rate: a per-sample
    standard deviation s at rate r is the density s/√r.
    """

    gyroscope: Array
    accelerometer: Array
    gyroscope_bias: Array
    accelerometer_bias: Array
    gyroscope_bias_time: Array
    accelerometer_bias_time: Array


def block(P: Covariance, row: str, column: str) -> Array:
    """Any block of the symmetric whole."""
    return P[row + column] if row + column in P else transpose(P[column + row])


def diagonal(deviations: dict[str, Array]) -> Covariance:
    """Covariance of independent errors from standard deviations `(3, *L)` of each state."""
    P = {}
    for a, b in PAIRS:
        identity = eye(3, deviations["t"][0])
        like = deviations[a][:, None] * identity
        P[a + b] = like * like if a == b else jnp.zeros_like(like)
    return P


def dense(P: Covariance) -> Array:
    """The full `(15, 15, *L)` matrix."""
    return jnp.concatenate(
        [jnp.concatenate([block(P, a, b) for b in STATES], axis=1) for a in STATES], axis=0
    )


def variances(P: Covariance) -> Array:
    """The diagonal, `(15, *L)`."""
    return jnp.concatenate([jnp.stack([P[s + s][i, i] for i in range(3)]) for s in STATES])


def is_positive(P: Covariance) -> Array:
    """Whether every variance is a number and not negative, `(*L)` bool; cheaper than looking at them all."""
    smallest = P["tt"][0, 0]
    for state in STATES:
        for i in range(3):
            smallest = jnp.minimum(smallest, P[state + state][i, i])
    return smallest >= 0


def transition(attitude: Array, force_n: Array, dt: Array, noise: ProcessNoise) -> Array:
    """The dense `(15, 15, *L)` transition that `predict` applies blockwise; for analysis and tests."""
    one = eye(3, force_n[0]) * jnp.ones_like(force_n[0])
    zero = jnp.zeros_like(one)
    rows = {
        "t": {"t": one, "g": -dt * attitude},
        "g": {"g": one * jnp.exp(-dt / noise.gyroscope_bias_time)},
        "p": {"p": one, "v": dt * one},
        "v": {"v": one, "t": -dt * skew(force_n), "a": -dt * attitude},
        "a": {"a": one * jnp.exp(-dt / noise.accelerometer_bias_time)},
    }
    return jnp.concatenate(
        [jnp.concatenate([rows[a].get(b, zero) for b in STATES], axis=1) for a in STATES], axis=0
    )


def predict(P: Covariance, attitude: Array, force_n: Array, dt: Array, noise: ProcessNoise) -> Covariance:
    """F P Fᵀ + Q over `dt` s, with the zero and identity blocks of F left out."""
    D = dt * attitude
    G = dt * skew(force_n)
    keep_g = jnp.exp(-dt / noise.gyroscope_bias_time)
    keep_a = jnp.exp(-dt / noise.accelerometer_bias_time)
    identity = eye(3, force_n[0])

    def spread(density: Array) -> Array:
        return density * density * dt * identity

    # rows of F P, only those that the products below need
    t = {s: block(P, "t", s) - matmul(D, block(P, "g", s)) for s in STATES}
    p = {s: block(P, "p", s) + dt * block(P, "v", s) for s in "tpva"}
    v = {s: block(P, "v", s) - matmul(G, block(P, "t", s)) - matmul(D, block(P, "a", s)) for s in "tva"}

    def into_v(row: dict[str, Array]) -> Array:
        return row["v"] - matmul_t(row["t"], G) - matmul_t(row["a"], D)

    return {
        "tt": symmetric(t["t"] - matmul_t(t["g"], D)) + spread(noise.gyroscope),
        "tg": keep_g * t["g"],
        "tp": t["p"] + dt * t["v"],
        "tv": into_v(t),
        "ta": keep_a * t["a"],
        "gg": keep_g * keep_g * P["gg"] + spread(noise.gyroscope_bias),
        "gp": keep_g * (P["gp"] + dt * P["gv"]),
        "gv": keep_g * into_v({"v": P["gv"], "t": block(P, "g", "t"), "a": P["ga"]}),
        "ga": keep_g * keep_a * P["ga"],
        "pp": symmetric(p["p"] + dt * p["v"]),
        "pv": into_v(p),
        "pa": keep_a * p["a"],
        "vv": symmetric(into_v(v)) + spread(noise.accelerometer),
        "va": keep_a * v["a"],
        "aa": keep_a * keep_a * P["aa"] + spread(noise.accelerometer_bias),
    }


class Rows(NamedTuple):
    """A measurement: innovation `z (m, *L)`, its noise covariance `R (m, m, *L)`, and H by blocks.

    `H` maps a state to its `(m, 3, *L)` matrix, or to None for the identity (m = 3).
    """

    innovation: Array
    noise: Array
    H: dict[str, Array | None]


def _through(H: dict[str, Array | None], P: Covariance, state: str) -> Array:
    """H P for the columns of one state, `(m, 3, *L)`."""
    parts = [
        block(P, row, state) if matrix is None else matmul(matrix, block(P, row, state))
        for row, matrix in H.items()
    ]
    return add(parts)


def update(P: Covariance, rows: Rows, weight: Array) -> tuple[Covariance, dict[str, Array]]:
    """Kalman update with the measurement's information scaled by `weight (*L)` in [0, 1].

    S = w H P Hᵀ + R, K = w P Hᵀ S⁻¹. Written as a Cholesky downdate, P − w Yᵀ Y with Y = L⁻¹ H P and
    L Lᵀ = S, it stays symmetric, and positive as far as rounding allows. Returns the covariance and the
    correction of each state, to be added.
    """
    HP = {s: _through(rows.H, P, s) for s in STATES}
    HPH = sum(
        (HP[s] if matrix is None else matmul_t(HP[s], matrix) for s, matrix in rows.H.items()),
        jnp.zeros_like(rows.noise),
    )
    lower = cholesky(weight * HPH + rows.noise)
    z = forward_substitution(lower, rows.innovation)
    Y = {s: forward_substitution(lower, HP[s]) for s in STATES}
    correction = {s: weight * add(y * e for y, e in zip(Y[s], z, strict=True)) for s in STATES}

    def removed(a: str, b: str) -> Array:
        return add(x[:, None] * y[None] for x, y in zip(Y[a], Y[b], strict=True))

    return {a + b: P[a + b] - weight * removed(a, b) for a, b in PAIRS}, correction


def normalised_innovation(P: Covariance, rows: Rows) -> Array:
    """zᵀ S⁻¹ z `(*L)` with S = H P Hᵀ + R: χ² with m degrees of freedom where the model holds."""
    HPH = rows.noise
    for s, matrix in rows.H.items():
        HP = _through(rows.H, P, s)
        HPH = HPH + (HP if matrix is None else matmul_t(HP, matrix))
    z = forward_substitution(cholesky(HPH), rows.innovation)
    return add(e * e for e in z)
